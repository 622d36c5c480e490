"""Height setpoints over time: multisines and steps, each within limits, from rest to rest.

A shape is drawn about zero height and scaled until height, speed or acceleration reaches its limit, less
`ROOM` for how a vehicle follows it. It begins and ends in a hover: references that jump raise false alarms.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from eivor.planning.limits import FlightLimits
from eivor.shapes import Float
from eivor.signals.actuator import first_order_lag

#: Step of the simulation, and of what the recipe sees [s].
STEP_S = 0.01
#: Share of the limits of height and speed that setpoints use.
ROOM = 0.8
#: Hover at both ends, and how long a multisine takes to rise and to fade [s].
HOVER_S, FADE_S = 2.0, 3.0
#: A step passes through so many equal first-order lags.
SMOOTHINGS = 4


@dataclass(frozen=True)
class Shape:
    """What a flight does, by the numbers that it was drawn with.

    Parameters
    ----------
    kind : str
        "multisine" or "steps".
    words : str
        In words.
    offset : ndarray, shape (n,)
        Height from the middle, every `STEP_S` [m].
    """

    kind: str
    words: str
    offset: Float[np.ndarray, " n"]

    @cached_property
    def derivatives(self) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Velocity and acceleration [m/s, m/s^2]."""
        velocity = np.gradient(self.offset, STEP_S)
        return velocity, np.gradient(velocity, STEP_S)

    def scaled(self, factor: float) -> Shape:
        """Return the same shape, higher or lower."""
        return Shape(self.kind, self.words, factor * self.offset)

    def within(self, limits: FlightLimits) -> Shape:
        """Return the shape as large as the limits allow."""
        velocity, acceleration = self.derivatives
        half_height = 0.5 * (limits.height_m[1] - limits.height_m[0])
        factor = min(
            ROOM * half_height / float(np.abs(self.offset).max()),
            ROOM * limits.speed / float(np.abs(velocity).max()),
            limits.acceleration / float(np.abs(acceleration).max()),
        )
        return self.scaled(factor)


def candidates(limits: FlightLimits, kinds: tuple[str, ...], seed: int) -> Iterator[Shape]:
    """Shapes of these kinds that a flight of the limits may have."""
    count = round(limits.duration_s / STEP_S)
    rng = np.random.default_rng(seed)
    if "multisine" in kinds:
        for low in (0.06, 0.12, 0.25):
            for high in (0.5, 0.8, 1.2, 1.8):
                for fall in (0.8, 1.3, 1.8, 2.4):
                    yield _multisine(count, low, high, fall, rng).within(limits)
    if "steps" in kinds:
        for hold in (2.0, 3.0, 4.5):
            for smoothing in (0.12, 0.2, 0.35, 0.6):
                yield _steps(count, hold, smoothing, rng).within(limits)


def _multisine(count: int, low_hz: float, high_hz: float, fall: float, rng: np.random.Generator) -> Shape:
    """Sines on a grid of frequencies, amplitudes falling as a power of it, phases of the smallest crest."""
    time = STEP_S * np.arange(count)
    frequency = np.geomspace(low_hz, high_hz, 10)
    angle = 2.0 * np.pi * time[:, None] * frequency
    amplitude = frequency**-fall
    best, crest = np.zeros(count), np.inf
    for phases in rng.uniform(0.0, 2.0 * np.pi, (4, frequency.size)):
        series = np.sin(angle + phases) @ amplitude
        speed = np.diff(series)
        peak = float(np.abs(speed).max() / speed.std())
        if peak < crest:
            best, crest = series, peak
    words = f"{frequency.size} sines from {low_hz:g} to {high_hz:g} Hz, amplitudes falling as f^-{fall:g}"
    return Shape("multisine", words, best * _window(time))


def _window(time: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Rise and fall between the hovers at the ends, with three continuous derivatives."""
    from_end = np.minimum(time, time[-1] - time)
    part = np.clip((from_end - HOVER_S) / FADE_S, 0.0, 1.0)
    rise: Float[np.ndarray, " n"] = part**4 * (35.0 - 84.0 * part + 70.0 * part**2 - 20.0 * part**3)
    return rise


def _steps(count: int, hold_s: float, smoothing_s: float, rng: np.random.Generator) -> Shape:
    """Levels up and down, each held for a while that varies, through equal first-order lags."""
    time = STEP_S * np.arange(count)
    settle = SMOOTHINGS * 2.0 * smoothing_s
    starts = [HOVER_S]
    while starts[-1] < time[-1] - HOVER_S - settle - hold_s:
        starts.append(starts[-1] + hold_s * rng.uniform(0.6, 1.4))
    sign = np.where(np.arange(len(starts)) % 2 == 0, 1.0, -1.0)
    levels = np.concatenate([[0.0], sign * rng.uniform(0.5, 1.0, sign.size)])
    levels[-1] = 0.0
    series: Float[np.ndarray, " n"] = levels[np.searchsorted(starts, time, side="right")]
    for _ in range(SMOOTHINGS):
        series = first_order_lag(series, step_s=STEP_S, lag_s=smoothing_s)
    words = (
        f"{len(starts)} steps, one every {hold_s:g} s or so, smoothed over {SMOOTHINGS * smoothing_s:.1f} s"
    )
    return Shape("steps", words, series)
