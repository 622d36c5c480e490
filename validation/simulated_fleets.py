"""Simulated fleets with known changes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from eivor.errors import UsageError
from eivor.inference.distributions import normal_quantile
from eivor.logs.table.columnar import write_recording
from eivor.signals.recording import GRAVITY
from eivor.simulation.vertical import VerticalFlightSpec, logs_of_flights
from eivor.tools import Float, Int

if TYPE_CHECKING:
    import polars as pl


# -- Fleet spec --

#: Density of the air [kg/m^3] and voltage of the battery [V] about which they vary.
DENSITY, VOLTAGE = 1.20, 15.6
#: Mass without payload [kg].
MASS = 1.5
#: Powers of them that thrust goes with.
DENSITY_POWER, VOLTAGE_POWER = 1.0, 1.5
#: Flights between one summer and the next.
SEASON = 60


@dataclass(frozen=True, slots=True)
class FleetSpec:
    """A fleet of one type."""

    vehicles: int = 10
    flights: int = 40
    viscous_friction: float = 0.4  # [1/s]
    hover_input: float = 0.5  # [1/s]
    actuator_lag: float = 0.04  # [1/s]
    between_vehicles: float = 0.05
    between_flights: float = 0.02
    wear: float = 0.0
    broken: tuple[tuple[int, int, float], ...] = ()
    weather: float = 0.0
    battery: float = 0.0
    payload: float = 0.0
    duration_s: float = 600.0
    seed: int = 0

    def __post_init__(self) -> None:
        if min(self.vehicles, self.flights) < 1:
            raise UsageError(
                "a fleet of one vehicle with one flight, at least",
                f"{self.vehicles} with {self.flights} each",
                "Name more.",
            )
        lost = max([self.wear, *(share for _, _, share in self.broken)])
        if not 0.0 <= lost < 1.0:
            raise UsageError("a share of thrust lost in [0, 1)", f"{lost}", "Name a smaller one.")


@dataclass(frozen=True)
class FleetTruth:
    """What is true of the flights of a fleet, vehicle after vehicle."""

    vehicle: Int[np.ndarray, " rows"]
    flight: Int[np.ndarray, " rows"]
    viscous_friction: Float[np.ndarray, " rows"]  # [1/s]
    input_gain: Float[np.ndarray, " rows"]  # [1/s]
    actuator_lag: Float[np.ndarray, " rows"]  # [1/s]
    hover_input: Float[np.ndarray, " rows"]  # [1/s]
    worn: Float[np.ndarray, " rows"]  # Share of thrust that is left
    mass: Float[np.ndarray, " rows"]  # At take-off [kg]
    air_density: Float[np.ndarray, " rows"]  # [kg/m^3]
    battery_voltage: Float[np.ndarray, " rows"]  # [kg/m^3]


def fleet_truth(spec: FleetSpec) -> FleetTruth:
    """Draw what is true of every flight."""
    rng = np.random.default_rng([spec.seed, 1])
    shape = (spec.vehicles, spec.flights)
    vehicle, flight = np.indices(shape)
    begin = rng.uniform(0.0, SEASON, (spec.vehicles, 1))
    season = np.sin(2.0 * np.pi * (flight + begin) / SEASON)
    density = spec.weather * (season + np.sqrt(0.5) * rng.standard_normal(shape))
    voltage = spec.battery * rng.standard_normal(shape)
    part = flight / max(spec.flights - 1, 1)
    worn, heavier = 1.0 - spec.wear * part, np.log1p(spec.payload * part)
    for which, first, share in spec.broken:
        worn = np.where((vehicle == which) & (flight >= first), worn * (1.0 - share), worn)

    def own() -> Float[np.ndarray, "vehicles flights"]:
        of_vehicle = spec.between_vehicles * rng.standard_normal((spec.vehicles, 1))
        return of_vehicle + spec.between_flights * rng.standard_normal(shape)

    thrust = own() + np.log(worn) + DENSITY_POWER * density + VOLTAGE_POWER * voltage - heavier
    gain = GRAVITY / spec.hover_input**2 * np.exp(thrust)
    return FleetTruth(
        vehicle.ravel(),
        flight.ravel(),
        (spec.viscous_friction * np.exp(own() + density - heavier)).ravel(),
        gain.ravel(),
        (spec.actuator_lag * np.exp(own())).ravel(),
        np.sqrt(GRAVITY / gain).ravel(),
        worn.ravel(),
        (MASS * np.exp(heavier)).ravel(),
        (DENSITY * np.exp(density)).ravel(),
        (VOLTAGE * np.exp(voltage)).ravel(),
    )


# -- Fleet logs --


def write_fleet_logs(spec: FleetSpec, folder: Path) -> Iterator[Path]:
    """Simulate and write the flights of a fleet, one after the other."""
    truth = fleet_truth(spec)
    specs = [
        VerticalFlightSpec(
            viscous_friction=float(truth.viscous_friction[row]),
            hover_input=float(truth.hover_input[row]),
            actuator_lag=float(truth.actuator_lag[row]),
            duration=spec.duration_s,
            seed=spec.seed * truth.vehicle.size + row,
        )
        for row in range(truth.vehicle.size)
    ]
    for vehicle, flight, made in zip(truth.vehicle, truth.flight, logs_of_flights(specs), strict=True):
        path = folder / f"v{vehicle:04d}" / f"{flight:04d}.parquet"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_recording(made.recording, path)
        yield path


# -- Fleet rows --

#: Standard errors of estimates are shares of their values, uniform between these.
STD_ERRORS = (0.01, 0.05)
#: First flight of every vehicle, and the time between flights.
FIRST, APART = datetime(2025, 1, 6, 9, tzinfo=UTC), timedelta(days=6)
#: First-stage F of flights, which are all reported.
FIRST_STAGE = 100.0


def fleet_rows(spec: FleetSpec, std_errors: tuple[float, float] = STD_ERRORS) -> pl.DataFrame:
    """Table of a fleet whose estimates are the truth with normal errors."""
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
    selected = {
        "viscous_friction": truth.viscous_friction,
        "input_gain": truth.input_gain,
        "effective_lag": truth.actuator_lag,
        "hover_input": truth.hover_input,
    }
    for name, values in selected.items():
        errors = rng.uniform(*std_errors, rows) * values
        result = values + errors * rng.standard_normal(rows)
        half = normal_quantile(0.95) * errors
        numbers = {"value": result, "std_error": errors, "low": result - half, "high": result + half}
        columns |= {f"{name}.{part}": number for part, number in numbers.items()}
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
