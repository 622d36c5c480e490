"""Signals in chunks: a Parquet table larger than memory, read a stretch of rows at a time."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from eivor import checks
from eivor.errors import ChannelMapError, InputError, UsageError
from eivor.signals.noise import MeasurementNoise
from eivor.signals.signals import Signals

#: Rows read at a time.
CHUNK_ROWS = 1_000_000


def read_chunks(
    path: str | os.PathLike[str],
    *,
    rate_hz: float,
    channels: Mapping[str, str] | None = None,
    noise: Mapping[str, MeasurementNoise] | None = None,
    rows: int = CHUNK_ROWS,
) -> Iterator[Signals]:
    """Read successive stretches of a Parquet table whose rows are samples at a uniform rate.

    Parameters
    ----------
    path : str or Path
        Parquet file.
    rate_hz : float
        Samples per second [Hz].
    channels : mapping of str to str, optional
        Channel to the column that holds it. Default: every column but `time`, under its own name.
    noise : mapping of str to MeasurementNoise, optional
        Declared noises.
    rows : int
        Rows of a chunk; memory is that of one chunk.

    Returns
    -------
    iterator of Signals
        In the order of the file, which is opened when the first is asked for.

    Raises
    ------
    InputError
        When the file, or a stretch of it, cannot be read, or a column has no numbers.
    ChannelMapError
        When a column is not in the table.
    UsageError
        At once, when an argument is of another type.
    """
    checks.path("path", path)
    checks.number("rate_hz", rate_hz)
    if channels is not None:
        checks.mapping("channels", channels, str, "columns")
    if noise is not None:
        checks.mapping("noise", noise, MeasurementNoise, "noises")
    checks.whole("rows", rows)
    if rows < 1:
        raise UsageError("one row or more in a chunk", f"rows={rows}", "A million are the default.")
    return _chunks(path, rate_hz, channels, dict(noise or {}), rows)


def _chunks(
    path: str | os.PathLike[str],
    rate_hz: float,
    channels: Mapping[str, str] | None,
    noise: dict[str, MeasurementNoise],
    rows: int,
) -> Iterator[Signals]:
    import polars as pl

    with _reading(path):
        frame = pl.scan_parquet(Path(path))
        available = frame.collect_schema().names()
    wanted = dict(channels) if channels is not None else {name: name for name in available if name != "time"}
    missing = [column for column in wanted.values() if column not in available]
    if missing:
        raise ChannelMapError(
            f"columns out of {', '.join(available)}", f"{', '.join(missing)}", "Name columns of the table."
        )
    first = 0
    while True:
        with _reading(path):
            table = frame.select(list(wanted.values())).slice(first, rows).collect()
            values = {
                name: table[column].cast(pl.Float64).to_numpy().astype(np.float64, copy=False)
                for name, column in wanted.items()
            }
        if table.height == 0:
            return
        yield Signals(rate_hz, values, noise=noise, start_s=first / rate_hz)
        first += table.height


@contextmanager
def _reading(path: str | os.PathLike[str]) -> Iterator[None]:
    """Turn what the table's reader raises, its panics too, into one error."""
    import polars as pl

    try:
        yield
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError) as error:
        raise InputError(
            "a Parquet file whose columns are numbers",
            f"{Path(path).name}: {error}",
            "Check the path and the file.",
        ) from error
