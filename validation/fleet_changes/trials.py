"""One cell of the study: fleets alike, and what their reports say of each vehicle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import polars as pl

from eivor.fleets.course import STEADY, STEPS
from eivor.fleets.report import fleet_report
from eivor.motions import motion_by_name
from eivor.simulation.fleets.fleet_rows import fleet_rows
from eivor.simulation.fleets.fleet_spec import FleetSpec

SEED = 20261122
#: What loses thrust, and flights from either end without a step.
QUANTITY, END = "input_gain", 6
#: A step is dated when it is told within so many flights of the truth.
NEAR = 3


@dataclass(frozen=True, slots=True)
class Cell:
    """What a cell is.

    Parameters
    ----------
    what : str
        "nothing", "wear" or "step".
    share : float
        Of thrust lost.
    flights, vehicles, fleets : int
        Of a vehicle, of a fleet, of the cell.
    weather, battery : float
        Standard deviations of the logarithms of density and voltage.
    """

    what: str
    share: float
    flights: int
    vehicles: int
    fleets: int
    weather: float
    battery: float


@dataclass(frozen=True, slots=True)
class Told:
    """Shares of a cell's vehicles.

    Parameters
    ----------
    what : str
        As in `Cell`.
    flights, vehicles, fleets : int
        Likewise.
    changes : float
        A change is told of some quantity.
    gain_changes : float
        Of the one that loses thrust.
    sign, covered : float
        The drift's interval has the sign of the wear alone; it holds the wear.
    dated, held : float
        A step is told within three flights of the truth; the flights left open hold it.
    """

    what: str
    flights: int
    vehicles: int
    fleets: int
    changes: float
    gain_changes: float
    sign: float
    covered: float
    dated: float
    held: float


def told(cell: Cell) -> Told:
    """Simulate a cell's fleets and read their reports."""
    parts = [_fleet(cell, number) for number in range(cell.fleets)]
    rows = pl.concat([part for part, _ in parts])
    first = np.concatenate([places for _, places in parts])
    by_vehicle = rows.group_by("fleet", "vehicle", maintain_order=True)
    changes = by_vehicle.agg((pl.col("course") != STEADY).any())["course"]
    gains = rows.filter(pl.col("quantity") == QUANTITY)
    truth = -cell.share
    steps = gains["course"].to_numpy() == STEPS
    flight = gains["step_flight"].fill_null(-np.inf).to_numpy()
    low, high = (gains[f"step_flight_{end}"].fill_null(np.nan).to_numpy() for end in ("first", "last"))
    return Told(
        cell.what,
        cell.flights,
        cell.vehicles,
        cell.fleets,
        float(changes.to_numpy().mean()),
        float((gains["course"] != STEADY).to_numpy().mean()),
        float((gains["change_high"] < 0.0).to_numpy().mean()),
        float(((gains["change_low"] <= truth) & (gains["change_high"] >= truth)).to_numpy().mean()),
        float(np.mean(steps & (np.abs(flight - first) <= NEAR))),
        float(np.mean(((low <= first) & (first <= high))[steps])) if steps.any() else 0.0,
    )


def _fleet(cell: Cell, number: int) -> tuple[pl.DataFrame, np.ndarray]:
    """Report of one fleet, and the first flight, counted from one, after the step of each vehicle."""
    rng = np.random.default_rng([SEED, cell.flights, cell.vehicles, number])
    first = rng.integers(END, cell.flights - END, cell.vehicles) if cell.what == "step" else np.zeros(0, int)
    spec = FleetSpec(
        vehicles=cell.vehicles,
        flights=cell.flights,
        wear=cell.share if cell.what == "wear" else 0.0,
        broken=tuple((vehicle, int(at), cell.share) for vehicle, at in enumerate(first)),
        weather=cell.weather,
        battery=cell.battery,
        seed=int(rng.integers(2**31)),
    )
    report = fleet_report(fleet_rows(spec), motion_by_name("vertical"))
    places = first + 1 if first.size else np.full(cell.vehicles, -1)
    return report.vehicles.with_columns(fleet=pl.lit(number)), places
