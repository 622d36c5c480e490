"""Stretches of a Crazyflie log between gaps, with the stamps and units of the card."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from eivor.logs.crazyflie.reader import Event, parse_header, read_events
from eivor.tools import Float

#: Of the one type of events that these logs have.
STAMP_S = 1e-6
#: A step of so many usual ones ends a stretch, and stretches below this share of the window are left out.
GAP, SHORTEST_SHARE = 3.0, 0.01
ROTORS = range(1, 5)


@dataclass(frozen=True)
class Stretch:
    """Records in a row."""

    time_s: Float[np.ndarray, " n"]  # Stamps since the vehicle was switched on [s]
    force_g: Float[np.ndarray, " n"]  # Accelerometer along z [g]
    rates: Float[np.ndarray, "n 3"]  # Body rates [rad/s]
    commands: Float[np.ndarray, "n 4"]  # Of the motors, 0 to 65535


def stretches(log: Path, window: tuple[float, float]) -> tuple[Stretch, ...]:
    """Stretches of a log within a window [s since the vehicle was switched on]."""
    event = _event(log)
    time = event.records["stamp"].astype(np.float64) * STAMP_S
    rates = np.deg2rad(np.column_stack([event.values(f"gyro.{axis}") for axis in "xyz"]))
    commands = np.column_stack([event.values(f"motor.m{rotor}") for rotor in ROTORS])
    force = event.values("acc.z")
    inside = np.flatnonzero((time > window[0]) & (time < window[1]))
    return tuple(
        Stretch(time[part], force[part], rates[part], commands[part]) for part in _parts(inside, time)
    )


def _event(log: Path) -> Event:
    data = log.read_bytes()
    events, _ = read_events(data, parse_header(data, log.name))
    return events[0]


def _parts(inside: np.ndarray, time: Float[np.ndarray, " n"]) -> Sequence[np.ndarray]:
    """Numbers of the samples of each stretch, without the ones beside gaps and the window's ends."""
    step = np.diff(time[inside])
    edges = [0, *(np.flatnonzero(step > GAP * np.median(step)) + 1).tolist(), inside.size]
    shortest = SHORTEST_SHARE * (time[inside[-1]] - time[inside[0]])
    results = [inside[first + 1 : last - 1] for first, last in pairwise(edges)]
    return [part for part in results if part.size and time[part[-1]] - time[part[0]] > shortest]
