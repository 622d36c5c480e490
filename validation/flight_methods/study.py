"""Every method of flights on simulated flights with known truth, and the command that compares them.

    python -m validation.flight_methods.study --kept FILE.jsonl [--size small|full] [--page FILE.md]

runs the grid beside this file, keeps every answer in the file, and prints its tables: what a lag that is left
out does to each method, how they do in each regime, and whether one is better than the default. A run that
was interrupted goes on. The exit code is 0 when every requirement is met, 3 when one is not, 2 for an input
of no use.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import eivor as ev
from eivor.inference.verdict import Status
from eivor.lab.experiments import markdown
from eivor.models.separable import Bounds
from eivor.signals.recording import Recording
from eivor.simulation.environment import TrajectoryKind
from eivor.simulation.known_logs import log_of_flight
from eivor.simulation.vertical import VerticalFlightSpec
from validation.studies import (
    Answer,
    GridStruct,
    Requirement,
    keep,
    kept_command,
    kept_lines,
    read_as,
    requirement_table,
    versions,
)

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


@dataclass(frozen=True, slots=True)
class Told:
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
    log = log_of_flight(spec).recording
    channels = {
        name: replace(channel, time_s=channel.time_s[:: regime.every], values=channel.values[:: regime.every])
        for name, channel in log.channels.items()
    }
    return spec, replace(log, channels=channels)


def trial(regime: Regime, vehicle: dict[str, float], methods: Sequence[str], run: int) -> Iterator[Told]:
    spec, log = flight(regime, vehicle, run)
    truth = np.array([getattr(spec, name) for name in PARAMETERS])
    for lag, known in ((SEARCHED, None), (OMITTED, Bounds(0.0, 0.0))):
        if known is not None and not regime.left_out:
            continue
        for method in methods:
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
            yield Told(
                regime.name,
                run,
                method,
                lag,
                result.verdict.status.value,
                errors.tolist(),
                [bool(item) for item in held],
            )


PART = "flight-methods"
GRID = Path(__file__).with_name("grid.toml")
#: The default, and those that could take its place.
DEFAULT, CANDIDATES = "reference_iv", ("spectral_giv", "whittle_ml")
IDENTIFIED = Status.IDENTIFIED.value
COLUMNS = ("flights", "bias of K / K_u", "RMSE", "coverage", "identified", "no estimate")


class Grid(GridStruct, frozen=True):
    """What is flown, by what, and how often."""

    vehicle: dict[str, float]
    methods: tuple[str, ...]
    regimes: tuple[Regime, ...]


def answer(grid: Path, size: str, kept: Path) -> Answer:
    """Fly what the file does not have yet, and judge all of it."""
    requested = read_as(Grid, grid)
    done = kept_lines(kept, Told)
    tolds: list[Told] = []
    for run in range(max(getattr(regime, size) for regime in requested.regimes)):
        for regime in requested.regimes:
            if run >= getattr(regime, size):
                continue
            selected = [item for item in done if (item.regime, item.run) == (regime.name, run)]
            if not selected:
                selected = list(trial(regime, requested.vehicle, requested.methods, run))
                keep(kept, selected)
            tolds.extend(selected)
    requirements = tuple(_requirements(tolds))
    return _tables(requested, size, tolds, requirements), requirements


def _requirements(tolds: Sequence[Told]) -> Iterator[Requirement]:
    without = [item for item in tolds if item.lag == OMITTED]
    wrong = [item for item in without if item.verdict == IDENTIFIED and not all(item.held)]
    yield Requirement(
        "flights whose lag is left out, identified with a wrong number",
        "at most 0.05",
        f"{len(wrong) / max(len(without), 1):.3f}",
        len(wrong) <= 0.05 * len(without),
    )
    for method in (DEFAULT, CANDIDATES[0]):
        judged = [item for item in _searched(tolds, method) if item.verdict == IDENTIFIED]
        held = [held for item in judged for held in item.held]
        share = float(np.mean(held)) if held else 1.0
        yield Requirement(
            f"{method}: intervals of identified flights hold", "at least 0.90", f"{share:.3f}", share >= 0.90
        )


def _searched(tolds: Sequence[Told], method: str) -> list[Told]:
    return [item for item in tolds if (item.method, item.lag) == (method, SEARCHED)]


def _tables(grid: Grid, size: str, tolds: Sequence[Told], requirements: Sequence[Requirement]) -> str:
    flights = ", ".join(f"{getattr(regime, size)} of {regime.name}" for regime in grid.regimes)
    compared = [regime.name for regime in grid.regimes if regime.left_out]
    of_lag = [
        (lag, method, *_line([o for o in tolds if (o.regime, o.method, o.lag) == (name, method, lag)]))
        for name in compared
        for lag in (OMITTED, SEARCHED)
        for method in grid.methods
    ]
    of_regimes = [
        (regime.name, method, *_line([o for o in _searched(tolds, method) if o.regime == regime.name]))
        for regime in grid.regimes
        for method in grid.methods
    ]
    overall = [(method, *_line(_searched(tolds, method))) for method in grid.methods]
    return "\n\n".join(
        (
            f"Made by `python -m validation.flight_methods.study` with {versions()}: flights {flights}, "
            f"actuators of {1e3 * grid.vehicle['actuator_lag']:g} ms, seed {SEED}.",
            requirement_table(requirements),
            f"The lag left out, and a nuisance ({', '.join(compared)}):",
            markdown(("lag", "method", *COLUMNS), of_lag),
            "Regimes, the lag a nuisance:",
            markdown(("regime", "method", *COLUMNS), of_regimes),
            "All regimes together:",
            markdown(("method", *COLUMNS), overall),
            " ".join(_judged(tolds, method) for method in CANDIDATES if method in grid.methods),
        )
    )


def _line(tolds: Sequence[Told]) -> tuple[str, ...]:
    errors = np.array([item.errors for item in tolds]).reshape(len(tolds), 2)
    known = np.isfinite(errors).all(axis=1)
    held = np.array([item.held for item in tolds], dtype=np.float64).reshape(len(tolds), 2)[known]
    errors = errors[known]

    def both(of: Callable[[np.ndarray], np.ndarray], values: np.ndarray, displayed: str) -> str:
        return " / ".join(displayed.format(item) for item in of(values)) if values.size else "-"

    return (
        f"{len(tolds)}",
        both(lambda e: 100.0 * e.mean(axis=0), errors, "{:+.1f} %"),
        both(lambda e: 100.0 * np.sqrt((e**2).mean(axis=0)), errors, "{:.1f} %"),
        both(lambda h: h.mean(axis=0), held, "{:.2f}"),
        f"{_identified(tolds):.2f}",
        f"{int((~known).sum())}",
    )


def _identified(tolds: Sequence[Told]) -> float:
    return float(np.mean([item.verdict == IDENTIFIED for item in tolds])) if tolds else 0.0


def _coverage(tolds: Sequence[Told]) -> float:
    held = [held for item in tolds for held in item.held if np.isfinite(item.errors).all()]
    return float(np.mean(held)) if held else 0.0


def _judged(tolds: Sequence[Told], method: str) -> str:
    searched, usual = _searched(tolds, method), _searched(tolds, DEFAULT)
    better = _coverage(searched) > _coverage(usual) and _identified(searched) > _identified(usual)
    words = "better in both" if better else "not better in both"
    return (
        f"`{method}` holds the truth in {_coverage(searched):.3f} of its intervals and identifies "
        f"{_identified(searched):.3f} of the flights, `{DEFAULT}` {_coverage(usual):.3f} and "
        f"{_identified(usual):.3f}: it is {words}."
    )


main = kept_command("validation.flight_methods.study", __doc__, GRID, PART, answer).main

if __name__ == "__main__":
    sys.exit(main())
