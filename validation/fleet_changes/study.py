"""What fleet reports say of vehicles that change, and the command that finds out.

    python -m validation.fleet_changes.study --kept FILE.jsonl [--size small|full] [--page FILE.md]

simulates the fleets of the grid beside this file, keeps every cell in the file, and prints its table: false
alarms, wear with its sign and interval, steps and their dates.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
import polars as pl

from eivor.fleet.analysis import STEADY, STEPS, fleet_report
from eivor.motions.table import motion_by_name
from validation.simulated_fleets import FleetSpec, fleet_rows, fleet_truth
from validation.studies import GridStruct, Group, KeptRun, KeptStudy, Requirement, alone, table_of
from validation.suite_files import versions

SEED = 20261122
#: What loses thrust, and flights from either end without a step.
QUANTITY, END = "input_gain", 6
#: Flights that deviate are off by so much, up or down.
OFF = 0.3
#: Fleets that are reported together, each as a type of its own: types share nothing.
TOGETHER = 50
#: Vehicle that is weaker where one is.
WEAKER = "v0000"
#: A step is dated when it is told within so many flights of the truth.
NEAR = 3


class Cell(GridStruct, frozen=True):
    """Fleets to which the same happens."""

    # "weaker": the first vehicle of each fleet, from its first flight
    what: Literal["nothing", "wear", "step", "weaker"]
    share: float  # Of thrust lost
    flights: int  # Of a vehicle
    vehicles: int  # Of a fleet
    small: int  # Fleets, by the size of the study
    full: int
    outliers: int = 0  # Flights of each vehicle that are off by `OFF`
    payload: float = 0.0  # Share by which the mass, which is given, grows evenly over the flights


class Grid(GridStruct, frozen=True):
    weather: float  # Standard deviations of the logarithms of density and voltage
    battery: float
    cells: list[Cell]


@dataclass(frozen=True, slots=True)
class Reported:
    what: str  # As in `Cell`
    flights: int  # Likewise
    vehicles: int
    fleets: int
    outliers: int
    payload: float  # Likewise
    changes: float  # A change is told of some quantity
    gain_changes: float  # Of the one that loses thrust
    # Of the flights that are off those that are told to deviate; vehicles of which another one is
    deviating: float
    wrong: float
    sign: float  # The drift's interval has the sign of the wear alone; it holds the wear
    covered: float
    dated: float  # A step is told within three flights of the truth; the flights left open hold it
    held: float
    # Of the weaker vehicles those that are told to differ in the gain; of the others those told to in any
    # quantity
    differing: float
    others: float


def told(grid: Grid, cell: Cell, fleets: int) -> Reported:
    parts = [
        _reported(grid, cell, range(start, min(start + TOGETHER, fleets)))
        for start in range(0, fleets, TOGETHER)
    ]
    rows = pl.concat([part.vehicles for part in parts])
    first = np.concatenate([part.first for part in parts])
    off, named = (pl.concat([getattr(part, name) for part in parts]) for name in ("off", "named"))
    by_vehicle = rows.group_by("type", "vehicle", maintain_order=True)
    changes = by_vehicle.agg((pl.col("course") != STEADY).any())["course"]
    gains = rows.filter(pl.col("quantity") == QUANTITY)
    weaker = (pl.col("vehicle") == WEAKER) & (cell.what == "weaker")
    truth = -cell.share
    steps = gains["course"].to_numpy() == STEPS
    flight = gains["step_flight"].fill_null(-np.inf).to_numpy()
    low, high = (gains[f"step_flight_{end}"].fill_null(np.nan).to_numpy() for end in ("first", "last"))
    return Reported(
        cell.what,
        cell.flights,
        cell.vehicles,
        fleets,
        cell.outliers,
        cell.payload,
        float(changes.to_numpy().mean()),
        float((gains["course"] != STEADY).to_numpy().mean()),
        named.join(off, on=["type", "name"], how="semi").height / max(off.height, 1),
        named.join(off, on=["type", "name"], how="anti").n_unique(["type", "vehicle"]) / gains.height,
        float((gains["change_high"] < 0.0).to_numpy().mean()),
        float(((gains["change_low"] <= truth) & (gains["change_high"] >= truth)).to_numpy().mean()),
        float(np.mean(steps & (np.abs(flight - first) <= NEAR))),
        float(np.mean(((low <= first) & (first <= high))[steps])) if steps.any() else 0.0,
        _share(gains.filter(weaker)),
        _share(by_vehicle.agg(pl.col("differs").any()).filter(~weaker)),
    )


def _share(vehicles: pl.DataFrame) -> float:
    return float(vehicles["differs"].sum()) / max(vehicles.height, 1)


@dataclass(frozen=True)
class _Reported:
    """Vehicles of some fleets, first flights after steps, flights that are off, and those told to be."""

    vehicles: pl.DataFrame
    first: np.ndarray
    off: pl.DataFrame
    named: pl.DataFrame


def _reported(grid: Grid, cell: Cell, numbers: Iterable[int]) -> _Reported:
    tables, positions = zip(*(_fleet(grid, cell, number) for number in numbers), strict=True)
    table = pl.concat(tables)
    report = fleet_report(table, motion_by_name("vertical"))
    named = report.deviating.filter(pl.col("quantity") == QUANTITY).select("type", "vehicle", "name")
    return _Reported(
        report.vehicles, np.concatenate(positions), table.filter("off").select("type", "name"), named
    )


def _fleet(grid: Grid, cell: Cell, number: int) -> tuple[pl.DataFrame, np.ndarray]:
    """One fleet, and the first flight, counted from one, after the step of each vehicle."""
    rng = np.random.default_rng([SEED, cell.flights, cell.vehicles, number])
    first = rng.integers(END, cell.flights - END, cell.vehicles) if cell.what == "step" else np.zeros(0, int)
    spec = FleetSpec(
        vehicles=cell.vehicles,
        flights=cell.flights,
        wear=cell.share if cell.what == "wear" else 0.0,
        broken=((0, 0, cell.share),)
        if cell.what == "weaker"
        else tuple((vehicle, int(item), cell.share) for vehicle, item in enumerate(first)),
        weather=grid.weather,
        battery=grid.battery,
        payload=cell.payload,
        seed=int(rng.integers(2**31)),
    )
    chosen = np.argsort(rng.uniform(size=(cell.vehicles, cell.flights)), axis=1) < cell.outliers
    off = np.where(chosen, rng.choice([-OFF, OFF], chosen.shape), 0.0).ravel()
    rows = fleet_rows(spec).with_columns(
        pl.col(f"^{QUANTITY}\\.(value|std_error|low|high)$") * np.exp(off),
        type=pl.lit(f"{number:05d}"),
        off=pl.Series(off != 0.0),
    )
    if cell.payload:
        rows = rows.with_columns(mass=pl.Series(fleet_truth(spec).mass))
    return rows, first + 1 if first.size else np.full(cell.vehicles, -1)


#: Asked: vehicles with a false alarm at most, or told to differ; worn ones with the sign, and with an
#: interval that covers; steps dated within three flights.
ALARMS, SIGN, COVERED, DATED = 0.05, 0.95, 0.93, 0.80


def only(what: str, text: str) -> Callable[[Reported], str]:
    """Number of the cells in which this happens."""
    return lambda line: text.format(line) if line.what == what else "-"


COLUMNS: dict[str, str | Callable[[Reported], str]] = {
    "what happens": "{.what}",
    "flights": "{.flights}",
    "vehicles of a fleet": "{.vehicles}",
    "fleets": "{.fleets}",
    "flights off by 30 %": "{.outliers}",
    "payload": "{.payload:g}",
    "told to change, in any quantity": "{.changes:.3f}",
    "in the gain": "{.gain_changes:.3f}",
    "drift's interval below zero": only("wear", "{.sign:.3f}"),
    "drift's interval holds the wear": only("wear", "{.covered:.3f}"),
    "step dated within 3 flights": only("step", "{.dated:.3f}"),
    "flights left open hold it": only("step", "{.held:.3f}"),
    "flights off that are told to deviate": lambda line: f"{line.deviating:.3f}" if line.outliers else "-",
    "vehicles with another that is": "{.wrong:.4f}",
    "weaker vehicles that are told to differ": only("weaker", "{.differing:.3f}"),
    "others that are": "{.others:.3f}",
}
#: What names a cell.
KEY = ("what", "flights", "vehicles", "fleets", "outliers", "payload")


def groups(grid: Grid, size: str, _kept: Path) -> list[Group[tuple[object, ...], Reported]]:
    trials = {}
    for cell in grid.cells:
        fleets = getattr(cell, size)
        key = tuple(fleets if name == "fleets" else getattr(cell, name) for name in KEY)
        trials[key] = partial(told, grid, cell, fleets)
    return alone(trials)


def requirements(run: KeptRun[Grid, Reported]) -> Iterator[Requirement]:
    for item in run.lines:
        where = f"{item.flights} flights, fleets of {item.vehicles}"
        where += f", {item.outliers} flights off" if item.outliers else ""
        where += ", growing payload" if item.payload else ""
        if item.what == "nothing":
            yield Requirement.at_most(f"vehicles with a false alarm: {where}", item.changes, ALARMS)
        if item.what in ("nothing", "weaker") and item.vehicles > 1:
            what = f"vehicles alike that are told to differ: {item.what}, {where}"
            yield Requirement.at_most(what, item.others, ALARMS)
        for what, words, least, measured in (
            ("wear", "the drift has the sign of the wear", SIGN, item.sign),
            ("wear", "the drift's interval holds the wear", COVERED, item.covered),
            ("step", "steps dated within three flights", DATED, item.dated),
        ):
            if item.what == what:
                yield Requirement.at_least(f"{words}: {where}", measured, least)


STUDY = KeptStudy(
    "fleet_changes.study",
    __doc__,
    "fleet-changes",
    Grid,
    Reported,
    KEY,
    groups,
    requirements,
    lambda run: (f" with {versions()}, seed {SEED}.", table_of(COLUMNS, run.lines)),
)
main = STUDY.main

if __name__ == "__main__":
    sys.exit(main())
