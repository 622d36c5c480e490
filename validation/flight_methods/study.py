"""Every method of flights on simulated flights with known truth, and the command that compares them.

    python -m validation.flight_methods.study --kept FILE.jsonl [--size small|full] [--page FILE.md]

runs the grid beside this file, keeps every answer in the file, and prints its tables: what a lag that is left
out does to each method, how they do in each regime, and whether one is better than the default. A run that
was interrupted goes on.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import eivor as ev
from eivor.inference.verdict import Status
from eivor.models.separable import Bounds
from eivor.signals.recording import Recording
from eivor.simulation.environment import TrajectoryKind
from eivor.simulation.vertical import VerticalFlightSpec, logs_of_flights
from validation.pages import markdown
from validation.studies import GridStruct, Group, KeptRun, KeptStudy, Requirement
from validation.suite_files import versions

SEED = 20261122
#: References in turn.
EXCITATIONS = (TrajectoryKind.MULTISINE, TrajectoryKind.STEPS, TrajectoryKind.CHIRP)
#: What is said of the lag.
SEARCHED, OMITTED = "searched for", "left out"
#: What is compared with the truth.
PARAMETERS = ("viscous_friction", "input_gain")


class Regime(GridStruct, frozen=True):
    name: str  # How tables call it
    gust_rms: float  # Of the simulated flights [m/s, s]
    duration: float
    every: int  # Of so many samples of the log one is kept
    small: int  # Flights by size of the study
    full: int
    left_out: bool = False  # Whether methods are also told that there is no lag


class Grid(GridStruct, frozen=True):
    """What is flown, by what, and how often."""

    vehicle: dict[str, float]
    methods: tuple[str, ...]
    regimes: tuple[Regime, ...]


@dataclass(frozen=True, slots=True)
class Identified:
    """What one method says of one flight."""

    regime: str  # Which flight
    run: int
    method: str  # By which method, and whether the lag is `SEARCHED` or `OMITTED`
    lag: str
    verdict: str  # On the flight
    errors: list[float]  # Of friction and gain over the truth; NaN without an estimate
    held: list[bool]  # Whether their intervals hold the truth


def flight(regime: Regime, vehicle: dict[str, float], run: int) -> tuple[VerticalFlightSpec, Recording]:
    values: dict[str, Any] = vehicle
    spec = VerticalFlightSpec(
        **values,
        gust_rms=regime.gust_rms,
        duration=regime.duration,
        trajectory=EXCITATIONS[run % len(EXCITATIONS)],
        seed=SEED + run,
    )
    log = next(logs_of_flights([spec])).recording
    channels = {
        name: replace(channel, time_s=channel.time_s[:: regime.every], values=channel.values[:: regime.every])
        for name, channel in log.channels.items()
    }
    return spec, replace(log, channels=channels)


def trial(regime: Regime, grid: Grid, run: int) -> Iterator[Identified]:
    spec, log = flight(regime, grid.vehicle, run)
    truth = np.array([getattr(spec, name) for name in PARAMETERS])
    for lag, known in ((SEARCHED, None), (OMITTED, Bounds(0.0, 0.0))):
        if known is not None and not regime.left_out:
            continue
        for method in grid.methods:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                result = ev.identify_flight(
                    log, method=method, input_map="square", noise="estimate", lag=known
                )
            selected = [result.quantities[name] for name in PARAMETERS]
            errors = np.array([item.value for item in selected]) / truth - 1.0
            held = [
                item.interval[0] <= true <= item.interval[1]
                for item, true in zip(selected, truth, strict=True)
            ]
            yield Identified(
                regime.name,
                run,
                method,
                lag,
                result.verdict.status.value,
                errors.tolist(),
                [bool(item) for item in held],
            )


#: The default, and those that could take its place.
DEFAULT, CANDIDATES = "reference_iv", ("spectral_giv", "whittle_ml")
IDENTIFIED = Status.IDENTIFIED.value
COLUMNS = ("flights", "bias of K / K_u", "RMSE", "coverage", "identified", "no estimate")


def groups(grid: Grid, size: str, _kept: Path) -> Iterator[Group[tuple[str, int], Identified]]:
    """Runs of all regimes in turn."""
    for run in range(max(getattr(regime, size) for regime in grid.regimes)):
        for regime in grid.regimes:
            if run < getattr(regime, size):
                made = partial(trial, regime, grid, run)
                yield [(regime.name, run)], lambda _, made=made: [list(made())]  # type: ignore[misc]


def requirements(run: KeptRun[Grid, Identified]) -> Iterator[Requirement]:
    without = [item for item in run.lines if item.lag == OMITTED]
    wrong = [item for item in without if item.verdict == IDENTIFIED and not all(item.held)]
    yield Requirement(
        "flights whose lag is left out, identified with a wrong number",
        "at most 0.05",
        f"{len(wrong) / max(len(without), 1):.3f}",
        len(wrong) <= 0.05 * len(without),
    )
    for method in (DEFAULT, CANDIDATES[0]):
        held = [
            held for item in _searched(run.lines, method) if item.verdict == IDENTIFIED for held in item.held
        ]
        share = float(np.mean(held)) if held else 1.0
        what = f"{method}: intervals of identified flights hold"
        yield Requirement(what, "at least 0.90", f"{share:.3f}", share >= 0.90)


def _searched(lines: Sequence[Identified], method: str) -> list[Identified]:
    return [item for item in lines if (item.method, item.lag) == (method, SEARCHED)]


def tables(run: KeptRun[Grid, Identified]) -> Iterator[str]:
    grid, lines = run.grid, run.lines
    flights = ", ".join(f"{getattr(regime, run.size)} of {regime.name}" for regime in grid.regimes)
    compared = [regime.name for regime in grid.regimes if regime.left_out]
    of_lag = [
        (lag, method, *_row([o for o in lines if (o.regime, o.method, o.lag) == (name, method, lag)]))
        for name in compared
        for lag in (OMITTED, SEARCHED)
        for method in grid.methods
    ]
    of_regimes = [
        (regime.name, method, *_row([o for o in _searched(lines, method) if o.regime == regime.name]))
        for regime in grid.regimes
        for method in grid.methods
    ]
    lag_ms = 1e3 * grid.vehicle["actuator_lag"]
    yield f" with {versions()}: flights {flights}, actuators of {lag_ms:g} ms, seed {SEED}."
    yield f"The lag left out, and a nuisance ({', '.join(compared)}):"
    yield markdown(("lag", "method", *COLUMNS), of_lag)
    yield "Regimes, the lag a nuisance:"
    yield markdown(("regime", "method", *COLUMNS), of_regimes)
    yield "All regimes together:"
    overall = [(method, *_row(_searched(lines, method))) for method in grid.methods]
    yield markdown(("method", *COLUMNS), overall)
    yield " ".join(_judged(lines, method) for method in CANDIDATES if method in grid.methods)


def _row(lines: Sequence[Identified]) -> tuple[str, ...]:
    errors = np.array([item.errors for item in lines]).reshape(len(lines), 2)
    known = np.isfinite(errors).all(axis=1)
    held = np.array([item.held for item in lines], dtype=np.float64).reshape(len(lines), 2)[known]
    errors = errors[known]

    def both(of: Callable[[np.ndarray], np.ndarray], values: np.ndarray, displayed: str) -> str:
        return " / ".join(displayed.format(item) for item in of(values)) if values.size else "-"

    return (
        f"{len(lines)}",
        both(lambda e: 100.0 * e.mean(axis=0), errors, "{:+.1f} %"),
        both(lambda e: 100.0 * np.sqrt((e**2).mean(axis=0)), errors, "{:.1f} %"),
        both(lambda h: h.mean(axis=0), held, "{:.2f}"),
        f"{_identified(lines):.2f}",
        f"{int((~known).sum())}",
    )


def _identified(lines: Sequence[Identified]) -> float:
    return float(np.mean([item.verdict == IDENTIFIED for item in lines])) if lines else 0.0


def _coverage(lines: Sequence[Identified]) -> float:
    held = [held for item in lines for held in item.held if np.isfinite(item.errors).all()]
    return float(np.mean(held)) if held else 0.0


def _judged(lines: Sequence[Identified], method: str) -> str:
    (share, usual_share), (found, usual_found) = (
        [of(_searched(lines, name)) for name in (method, DEFAULT)] for of in (_coverage, _identified)
    )
    words = "better in both" if share > usual_share and found > usual_found else "not better in both"
    return (
        f"`{method}` holds the truth in {share:.3f} of its intervals and identifies {found:.3f} of the "
        f"flights, `{DEFAULT}` {usual_share:.3f} and {usual_found:.3f}: it is {words}."
    )


STUDY = KeptStudy(
    "flight_methods.study",
    __doc__,
    "flight-methods",
    Grid,
    Identified,
    ("regime", "run"),
    groups,
    requirements,
    tables,
)
main = STUDY.main


if __name__ == "__main__":
    sys.exit(main())
