"""Trials of the flight study as one table: a row for each flight, every number a column.

Columns: what the flight was, `verdict`, `truth.QUANTITY`, and `ESTIMATOR.QUANTITY.value`, `.low`, `.high`;
of the recipe also `recipe.first_stage_F`, the least of the conditional ones, and `recipe.p_value` of the
over-identification test, NaN without instruments. What the table was made with stands in the file's
metadata.
"""

from __future__ import annotations

import platform
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
import polars as pl
from jaxtyping import Float

from eivor.atomic_file import atomic_write
from eivor.errors import InputError
from validation.flight_recipe.trials import ESTIMATORS, QUANTITIES, FlightTrial

#: Packages whose versions bear on the numbers.
PACKAGES = ("eivor", "numpy", "scipy", "rotorpy")
#: Significant binary digits of a number, five decimal ones: more would not compress.
MANTISSA_BITS = 17


@dataclass(frozen=True)
class TrialTable:
    """What a run of the study leaves behind."""

    rows: pl.DataFrame  # One row for each flight
    origin: Mapping[str, str]  # `grid`, `size`, and the versions it was made with

    def write(self, path: Path) -> None:
        """Write a small Parquet file."""
        narrow = self.rows.with_columns(pl.col(_rounded_columns(self.rows)).cast(pl.Float32))
        with atomic_write(path) as file:
            narrow.write_parquet(
                file, compression="zstd", compression_level=19, statistics=False, metadata=dict(self.origin)
            )


def trial_table(trials: Iterable[FlightTrial], *, grid: str, size: str) -> TrialTable:
    """Table of finished trials."""
    origin = {"grid": grid, "size": size, "python": platform.python_version()}
    rows = pl.DataFrame([_row(trial) for trial in trials])
    rounded = rows.with_columns(
        pl.Series(name, _rounded(rows[name].to_numpy())) for name in _rounded_columns(rows)
    )
    return TrialTable(rounded, origin | _versions())


def read_trial_table(path: Path) -> TrialTable:
    """Table from a file that `TrialTable.write` made."""
    try:
        rows, metadata = pl.read_parquet(path), pl.read_parquet_metadata(path)
    except (OSError, pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        raise InputError("a table of trials", f"{path}: {error}", "Make one with --out.") from error
    origin = {key: value for key, value in metadata.items() if not key.startswith("ARROW")}
    if "grid" not in origin or "verdict" not in rows.columns:
        raise InputError("a table of trials", f"{path}, which is another table", "Make one with --out.")
    return TrialTable(rows.with_columns(pl.col(pl.Float32).cast(pl.Float64)), origin)


def _row(trial: FlightTrial) -> dict[str, str | float | int | bool]:
    case = trial.case
    row: dict[str, str | float | int | bool] = {
        "flight": case.name,
        "class": case.flight_class,
        "simulator": case.simulator,
        "kind": case.kind,
        "calm": case.calm,
        "trajectory": str(case.spec.trajectory),
        "noise": str(case.spec.noise.kind),
        "gust_rms": case.spec.gust_rms,
        "delay": case.spec.delay,
        "seed": case.spec.seed,
        "verdict": trial.verdict,
    }
    row |= {f"truth.{name}": trial.truth[name] for name in QUANTITIES}
    row |= {"recipe.first_stage_F": trial.first_stage, "recipe.p_value": trial.p_value}
    for estimator, quantities in ESTIMATORS.items():
        for name in quantities:
            estimate = trial.estimates[estimator][name]
            row |= {
                f"{estimator}.{name}.{part}": getattr(estimate, part) for part in ("value", "low", "high")
            }
    return row


def _rounded_columns(rows: pl.DataFrame) -> list[str]:
    """Columns of results; what the grid gives is exact."""
    return [name for name in rows.columns if "." in name]


def _rounded(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Values that the file holds exactly, so that tables are the same before and after it."""
    mantissa, exponent = np.frexp(values)
    scale = 2.0**MANTISSA_BITS
    return np.ldexp(np.round(mantissa * scale) / scale, exponent)


def _versions() -> dict[str, str]:
    results = {}
    for package in PACKAGES:
        try:
            results[package] = version(package)
        except PackageNotFoundError:
            results[package] = "not installed"
    return results
