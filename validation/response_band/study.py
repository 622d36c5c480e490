"""Bands of joint draws on flights with known truth, and the command that finds out how often they hold it.

    python -m validation.response_band.study --kept FILE.jsonl [--size small|full] [--page docs/exports.md]

flies the grid beside this file, keeps every flight in the file, and prints its table: at each time after a
step of the command the share of flights whose band of 90 % of the draws holds the true climb rate. A run that
was interrupted goes on.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import eivor as ev
from eivor.errors import EivorError
from eivor.simulation.environment import SimulatedFlight
from eivor.simulation.vertical import VerticalFlightSpec, simulate_vertical_flights
from eivor.tools import Float
from validation.pages import markdown
from validation.studies import GridStruct, Group, KeptRun, KeptStudy, Requirement
from validation.suite_files import versions

#: Times after a step of the command at which the climb rate is asked [s].
TIMES_S = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2)
#: Share of the draws that a band holds at each of them, and how many draws there are.
LEVEL, DRAWS = 0.90, 1000
SEED = 20261122
#: What is drawn for each flight, evenly: K [1/s], hover command, lag [s].
VEHICLES = {"viscous_friction": (0.2, 0.6), "hover_input": (0.3, 0.6), "actuator_lag": (0.02, 0.08)}


class Kind(GridStruct, frozen=True):
    """Flights of one kind."""

    name: str
    small: int  # How many, by the size of the study
    full: int
    gust_rms: float = 0.0
    delay: float = 0.0
    vigour: float = 1.0


class Grid(GridStruct, frozen=True):
    flights: list[Kind]


@dataclass(frozen=True, slots=True)
class Banded:
    name: str  # Of its kind
    run: int  # Number of the flight
    verdict: str  # Of the flight; empty where nothing was estimated
    held: list[bool]  # At each of `TIMES_S`, whether the band holds the true climb rate
    width: list[float]  # Half of the band over the true climb rate


def trials(kind: Kind, position: int, keys: Sequence[tuple[str, int]]) -> Iterator[list[Banded]]:
    """Fly some of a kind side by side: the kind's place and a run give the same flight in any company."""
    specs = [_spec(kind, position, run) for _, run in keys]
    for (name, run), spec, flight in zip(keys, specs, simulate_vertical_flights(specs), strict=True):
        yield [_report(name, run, spec, flight)]


def _spec(kind: Kind, position: int, run: int) -> VerticalFlightSpec:
    rng = np.random.default_rng([SEED, position, run])
    vehicle: dict[str, Any] = {name: float(rng.uniform(*ends)) for name, ends in VEHICLES.items()}
    return VerticalFlightSpec(
        **vehicle, delay=kind.delay, gust_rms=kind.gust_rms, vigour=kind.vigour, seed=int(rng.integers(2**31))
    )


def _report(name: str, run: int, spec: VerticalFlightSpec, flight: SimulatedFlight) -> Banded:
    numbers = (spec.viscous_friction, spec.input_gain, spec.actuator_lag, spec.delay)
    (truth,) = climb_rates(*(np.array([number]) for number in numbers))
    try:
        fit = ev.identify_flight(flight.recording)
        low, high = _band(fit, run)
    except EivorError:
        return Banded(name, run, "", [], [])
    return Banded(
        name,
        run,
        fit.verdict.status.value,
        ((low <= truth) & (truth <= high)).tolist(),
        (0.5 * (high - low) / truth).tolist(),
    )


def _band(fit: ev.FlightEstimate, seed: int) -> Float[np.ndarray, "2 times"]:
    draws, best = fit.sample(DRAWS, seed=seed), fit.parameters
    columns = (
        draws.get(name, np.full(DRAWS, best[name]))
        for name in ("viscous_friction", "input_gain", "actuator_lag", "delay")
    )
    ends = (0.5 - 0.5 * LEVEL, 0.5 + 0.5 * LEVEL)
    band: Float[np.ndarray, "2 times"] = np.quantile(climb_rates(*columns), ends, axis=0)
    return band


def climb_rates(
    friction: Float[np.ndarray, " n"],
    gain: Float[np.ndarray, " n"],
    lag: Float[np.ndarray, " n"],
    delay: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "n times"]:
    """Climb rate after a step of the mapped command, of which one per cent is 1 [m/s per unit]."""
    rows = friction[:, None], gain[:, None], np.maximum(lag, 1e-4)[:, None]
    since = np.maximum(np.array(TIMES_S) - delay[:, None], 0.0)
    each, steep, slow = rows
    steady = -np.expm1(-each * since) / each
    passing = (np.exp(-each * since) - np.exp(-since / slow)) / (1.0 / slow - each)
    return steep * (steady - passing)


#: Asked: pointwise coverage of the band of 90 %.
COVERAGE = (0.86, 0.94)
#: Flights that are simulated side by side.
TOGETHER = 25
TIMES = tuple(f"{time:g} s" for time in TIMES_S)
HEADER = ("flights", "how many", "identified", *TIMES, "all times")


def groups(grid: Grid, size: str, _kept: Path) -> list[Group[tuple[str, int], Banded]]:
    """Flights side by side; kinds take turns, so that a study that is cut short has some of each."""
    turns = [
        (first, position, kind, range(first, min(first + TOGETHER, getattr(kind, size))))
        for position, kind in enumerate(grid.flights)
        for first in range(0, getattr(kind, size), TOGETHER)
    ]
    return [
        ([(kind.name, run) for run in runs], partial(trials, kind, position))
        for _, position, kind, runs in sorted(turns, key=lambda turn: turn[:2])
    ]


def requirements(run: KeptRun[Grid, Banded]) -> list[Requirement]:
    covered = float(np.mean([held for line in run.lines for held in line.held]))
    return [Requirement.within("pointwise coverage of the band of 90 %", covered, COVERAGE)]


def tables(run: KeptRun[Grid, Banded]) -> Iterator[str]:
    flights = f"{len(run.lines)} flights of a minute, {DRAWS} draws of each"
    yield f" with {versions()}: {flights}, seed {SEED}."
    kinds = dict.fromkeys(item.name for item in run.lines)
    rows = [_row(kind, [item for item in run.lines if item.name == kind]) for kind in kinds]
    yield markdown(HEADER, [*rows, _row("**all**", run.lines)])


def _row(kind: str, lines: Sequence[Banded]) -> tuple[str, ...]:
    held = np.array([item.held for item in lines if item.held], dtype=float)
    return (
        kind,
        f"{len(lines)}",
        f"{sum(item.verdict == 'identified' for item in lines)}",
        *(f"{share:.2f}" for share in held.mean(axis=0)),
        f"{held.mean():.3f}",
    )


STUDY = KeptStudy(
    "response_band.study",
    __doc__,
    "response band",
    Grid,
    Banded,
    ("name", "run"),
    groups,
    requirements,
    tables,
)
main = STUDY.main


if __name__ == "__main__":
    sys.exit(main())
