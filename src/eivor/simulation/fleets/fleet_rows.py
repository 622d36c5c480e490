"""A simulated fleet as the table of its flights, without any log: quick, for statistics."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING

import numpy as np

from eivor.inference.quantiles import normal_quantile
from eivor.simulation.fleets.fleet_spec import FleetSpec, fleet_truth

if TYPE_CHECKING:
    import polars as pl

#: Standard errors of estimates are shares of their values, uniform between these.
STD_ERRORS = (0.01, 0.05)
#: First flight of every vehicle, and the time between flights.
FIRST, APART = datetime(2025, 1, 6, 9, tzinfo=UTC), timedelta(days=6)
#: First-stage F of flights, which are all told.
FIRST_STAGE = 100.0


def fleet_rows(spec: FleetSpec, std_errors: tuple[float, float] = STD_ERRORS) -> pl.DataFrame:
    """Table of a fleet whose estimates are the truth with normal errors.

    Parameters
    ----------
    spec : FleetSpec
        The fleet.
    std_errors : tuple of float
        Range of their standard errors, as shares of the values.

    Returns
    -------
    polars.DataFrame
        Columns as `eivor fleet run` writes them.
    """
    import polars as pl

    truth = fleet_truth(spec)
    rng = np.random.default_rng([spec.seed, 2])
    rows = truth.vehicle.size
    names = [
        f"v{vehicle:04d}-{flight:04d}" for vehicle, flight in zip(truth.vehicle, truth.flight, strict=True)
    ]
    columns: dict[str, object] = {
        "sha256": names,
        "name": [f"{name}.ulg" for name in names],
        "copy_of": pl.Series([None] * rows, dtype=pl.String),
        "vehicle": [f"v{vehicle:04d}" for vehicle in truth.vehicle],
        "type": ["quad"] * rows,
        "motion": ["vertical"] * rows,
        "firmware": pl.Series([None] * rows, dtype=pl.String),
        "start": pl.Series(
            [FIRST + int(flight) * APART for flight in truth.flight], dtype=pl.Datetime("us", "UTC")
        ),
        "duration_s": np.full(rows, spec.duration_s),
        "verdict": ["identified"] * rows,
        "reason": pl.Series([None] * rows, dtype=pl.String),
    }
    told = {
        "viscous_friction": truth.viscous_friction,
        "input_gain": truth.input_gain,
        "effective_lag": truth.actuator_lag,
        "hover_input": truth.hover_input,
    }
    for name, values in told.items():
        errors = rng.uniform(*std_errors, rows) * values
        found = values + errors * rng.standard_normal(rows)
        half = normal_quantile(0.95) * errors
        numbers = {"value": found, "std_error": errors, "low": found - half, "high": found + half}
        columns |= {f"{name}.{part}": one for part, one in numbers.items()}
        columns[f"{name}.verdict"] = ["identified"] * rows
    columns |= {"air_density": truth.air_density, "battery_voltage": truth.battery_voltage}
    columns["temperature"] = pl.Series([None] * rows, dtype=pl.Float64)
    columns["covariance"] = pl.Series([None] * rows, dtype=pl.List(pl.Float64))
    columns["covariance_names"] = pl.Series([None] * rows, dtype=pl.List(pl.String))
    for name in ("eivor_version", "options_hash"):
        columns[name] = pl.Series([None] * rows, dtype=pl.String)
    for name in ("viscous_friction", "input_gain", "actuator_lag"):
        columns[f"diagnostic.first_stage_F_{name}"] = np.full(rows, FIRST_STAGE)
    return pl.DataFrame(columns)
