"""Seals of tables: whatever happens to a byte is noticed before anything decodes it."""

from __future__ import annotations

import io
import subprocess
import sys

import numpy as np
import polars as pl
import pytest

from eivor.atomic_file import SEAL_MARK, is_sealed, sealed
from eivor.errors import InputError
from eivor.lab.scenario_files import numbers_in_file
from eivor.strict_toml import TomlTable
from validation.coverage.study import read_coverage
from validation.flight_recipe.trials import read_trial_table

FACTS = {"eivor.study": "b" * 64, "eivor.trials": "25 to 49"}


@pytest.fixture(scope="module")
def table() -> pl.DataFrame:
    rng = np.random.default_rng(3)
    status = pl.Series("status", ["identified", "weak", None] * 8)
    return pl.DataFrame({"trial": np.arange(24), "value": rng.standard_normal(24)}).with_columns(status)


@pytest.fixture(scope="module")
def content(table) -> bytes:
    return sealed(table, FACTS)


def test_the_file_is_what_was_sealed(table, content):
    assert is_sealed(content, FACTS)
    assert pl.read_parquet(io.BytesIO(content)).equals(table)
    result = pl.read_parquet_metadata(io.BytesIO(content))
    assert {key: result[key] for key in FACTS} == FACTS


def test_another_tables_seal_is_refused(content):
    assert not is_sealed(content, FACTS | {"eivor.trials": "50 to 74"})
    assert not is_sealed(content, FACTS | {"eivor.more": ""})


def test_every_flipped_bit_is_noticed(content):
    """Of every byte each bit, and the whole byte: nothing is decoded, so nothing can crash."""
    for index in range(len(content)):
        for flip in (1, 2, 4, 8, 16, 32, 64, 128, 255):
            damaged = bytearray(content)
            damaged[index] ^= flip
            assert not is_sealed(bytes(damaged), FACTS), (index, flip)


def test_every_cut_and_every_addition_is_noticed(content):
    for length in range(len(content)):
        assert not is_sealed(content[:length], FACTS)
    for more in (b"\0", content, SEAL_MARK, SEAL_MARK + b"0" * 64):
        assert not is_sealed(content + more, FACTS)
        assert not is_sealed(more + content, FACTS)


def test_a_table_without_a_seal_is_refused(table):
    buffer = io.BytesIO()
    table.write_parquet(buffer, metadata=dict(FACTS))
    assert not is_sealed(buffer.getvalue(), FACTS)


def test_a_seal_in_the_data_is_not_the_files(table):
    text = SEAL_MARK.decode() + "0" * 64
    content = sealed(table.with_columns(note=pl.lit(text)), FACTS | {"note": text})
    assert is_sealed(content, FACTS)


@pytest.mark.thorough
def test_equal_tables_give_equal_bytes_in_every_process():
    script = (
        "import polars as pl; from eivor.atomic_file import sealed; import sys;"
        "sys.stdout.buffer.write(sealed(pl.DataFrame({'a': [1.5, None]}), {'x': '1', 'y': '2', 'z': '3'}))"
    )
    made = [subprocess.run([sys.executable, "-c", script], capture_output=True, check=True) for _ in range(3)]
    assert len({item.stdout for item in made}) == 1
    assert is_sealed(made[0].stdout, {"x": "1", "y": "2", "z": "3"})


@pytest.mark.parametrize("reader", ["coverage", "trials", "numbers"])
def test_a_decoders_panic_is_told(tmp_path, monkeypatch, reader):
    """Polars' own kind of crash is no Exception; every table that a study reads may be damaged."""

    def panic(*parts: object, **options: object) -> None:
        raise pl.exceptions.PanicException("index out of bounds")

    path = tmp_path / "table.parquet"
    pl.DataFrame({"u": [1.0]}).write_parquet(path)
    monkeypatch.setattr(pl, "read_parquet", panic)
    monkeypatch.setattr(pl, "scan_parquet", panic)
    readers = {
        "coverage": read_coverage,
        "trials": read_trial_table,
        "numbers": lambda file: numbers_in_file(
            TomlTable({"file": file.name, "column": "u"}, "scenario.toml", folder=file.parent)
        ),
    }
    with pytest.raises(InputError, match="index out of bounds"):
        readers[reader](path)
