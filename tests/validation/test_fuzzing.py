"""A hundred damaged inputs of every format are read or refused."""

import pytest

from validation.fuzzing import damage, fuzzed

FORMATS = (
    *("csv", "parquet", "mat", "h5", "bag", "lz4.bag", "db3", "mcap", "zstd.mcap", "ulg", "usd1", "usd2"),
    *("bbl", "bin", "log", "fit.json", "vehicle.toml", "machine.toml", "map.toml"),
)


@pytest.mark.thorough
@pytest.mark.parametrize("name", FORMATS)
def test_damaged_inputs_are_read_or_refused(name):
    assert set(FORMATS) == damage().seeds().keys()
    counts = fuzzed(name, 100)
    assert (counts["hang"], counts["raised"]) == (0, {})
