"""One flight and what each method says of it; pure functions of the grid's values and a number."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import eivor as ev
from eivor.lab.known_logs import log_of_flight
from eivor.models.separable import Bounds
from eivor.signals.recording import Recording
from eivor.simulation.environment import TrajectoryKind
from eivor.simulation.vertical import VerticalFlightSpec

SEED = 20261122
#: References in turn.
EXCITATIONS = (TrajectoryKind.MULTISINE, TrajectoryKind.STEPS, TrajectoryKind.CHIRP)
#: What is said of the lag.
SEARCHED, OMITTED = "searched for", "left out"
#: What is compared with the truth.
PARAMETERS = ("viscous_friction", "input_gain")


@dataclass(frozen=True, slots=True)
class Regime:
    """Flights of one kind."""

    name: str  # How tables call it
    gust_rms: float  # Of the simulated flights [m/s, s]
    duration: float
    every: int  # Of so many samples of the log one is kept
    left_out: bool  # Whether methods are also told that there is no lag


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
    """Specification and log of one flight."""
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
    """Every method on one flight."""
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
