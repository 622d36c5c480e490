"""Vertical trajectories: what a simulated vehicle is asked to fly.

Every kind is a shape of the altitude over time, drawn from a generator, with its exact derivatives as
feed-forward. Shapes that are meant as excitation are scaled to the speed and the acceleration that the
flight card asks for; a climb and small steps about a hover keep their own height.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from eivor.shapes import Float

#: Largest speed [m/s] and acceleration [m/s^2] of an excitation are drawn from these ranges.
SPEED_RANGE = (1.6, 2.2)
ACCELERATION_RANGE = (3.0, 4.0)
#: Steps of a hover that is not quite constant [m].
SMALL_STEP_M = 0.05


class TrajectoryKind(StrEnum):
    """What the altitude reference does."""

    STEPS = "steps"
    MULTISINE = "multisine"
    CHIRP = "chirp"
    CLIMBS = "climbs"
    HOVER = "hover"
    HOVER_STEPS = "hover-steps"


#: Kinds that keep their own height: they are scaled down to the limits, and never up.
OWN_HEIGHT = frozenset({TrajectoryKind.CLIMBS, TrajectoryKind.HOVER_STEPS})


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Altitude reference and its derivatives on the log's grid.

    Parameters
    ----------
    position, velocity, acceleration : ndarray, shape (n,)
        [m], [m/s], [m/s^2].
    """

    position: Float[np.ndarray, " n"]
    velocity: Float[np.ndarray, " n"]
    acceleration: Float[np.ndarray, " n"]


def altitude_reference(
    kind: TrajectoryKind, *, count: int, step_s: float, rng: np.random.Generator, vigour: float = 1.0
) -> Trajectory:
    """Shape of the kind, scaled so that speed and acceleration reach the smaller of their limits.

    Parameters
    ----------
    kind : TrajectoryKind
        What to fly.
    count : int
        Samples.
    step_s : float
        Time between them [s].
    rng : numpy.random.Generator
        Draws the shape and its limits.
    vigour : float
        Share of the limits that is flown.
    """
    from scipy.interpolate import make_interp_spline

    time = step_s * np.arange(count)
    position = _SHAPES[kind](time, step_s, rng)
    spline = make_interp_spline(time, position, k=5)
    velocity, acceleration = spline(time, 1), spline(time, 2)
    fastest, hardest = float(np.abs(velocity).max()), float(np.abs(acceleration).max())
    limits = rng.uniform(*SPEED_RANGE), rng.uniform(*ACCELERATION_RANGE)
    scale = min(limits[0] / fastest, limits[1] / hardest) * vigour if fastest > 0.0 else 0.0
    if kind in OWN_HEIGHT:
        scale = min(1.0, scale)
    return Trajectory(scale * position, scale * velocity, scale * acceleration)


def _steps(time: Float[np.ndarray, " n"], step_s: float, rng: np.random.Generator) -> Float[np.ndarray, " n"]:
    """Random levels, held 1.5 to 4 s each, through four equal first-order lags."""
    starts = np.cumsum(rng.uniform(1.5, 4.0, size=int(time[-1] / 1.5) + 2))
    levels = rng.uniform(-2.0, 2.0, size=starts.size + 1)
    return _smoothed_levels(time, starts, levels, np.exp(-step_s / rng.uniform(0.25, 0.45)))


def _hover_steps(
    time: Float[np.ndarray, " n"], step_s: float, rng: np.random.Generator
) -> Float[np.ndarray, " n"]:
    """Steps of 5 cm up or down about a hover, each level held 2 to 6 s."""
    starts = np.cumsum(rng.uniform(2.0, 6.0, size=int(time[-1] / 2.0) + 2))
    # Alternately away from the middle and back to it, so that every step has the same height.
    away = rng.choice([-SMALL_STEP_M, SMALL_STEP_M], size=starts.size + 1)
    levels = np.where(np.arange(away.size) % 2 == 1, away, 0.0)
    return _smoothed_levels(time, starts, levels, np.exp(-step_s / rng.uniform(0.25, 0.45)))


def _smoothed_levels(
    time: Float[np.ndarray, " n"],
    starts: Float[np.ndarray, " m"],
    levels: Float[np.ndarray, " levels"],
    decay: float,
) -> Float[np.ndarray, " n"]:
    """Levels from their starts on, the first one zero, through four equal first-order lags."""
    from scipy.signal import lfilter

    levels[0] = 0.0
    series: Float[np.ndarray, " n"] = levels[np.searchsorted(starts, time, side="right")]
    for _ in range(4):
        series = lfilter([1.0 - decay], [1.0, -decay], series)
    return series


def _multisine(
    time: Float[np.ndarray, " n"],
    _step_s: float,
    rng: np.random.Generator,
) -> Float[np.ndarray, " n"]:
    """Twelve sines between 0.06 and 1.2 Hz with random phases, amplitude falling with frequency."""
    edges = np.geomspace(0.06, 1.2, 13)
    frequencies = rng.uniform(edges[:-1], edges[1:])
    phases = rng.uniform(0.0, 2.0 * np.pi, size=frequencies.size)
    angles = 2.0 * np.pi * frequencies * time[:, None] + phases
    return np.asarray(np.sin(angles) @ frequencies**-1.3)


def _chirp(
    time: Float[np.ndarray, " n"],
    _step_s: float,
    rng: np.random.Generator,
) -> Float[np.ndarray, " n"]:
    """Sine whose frequency rises from about 0.1 to 1.2 Hz, at the full speed or acceleration throughout."""
    first, last = rng.uniform(0.08, 0.12), rng.uniform(1.0, 1.4)
    growth = np.log(last / first) / time[-1]
    angle = 2.0 * np.pi * first * np.expm1(growth * time) / growth + rng.uniform(0.0, 2.0 * np.pi)
    pulsation = 2.0 * np.pi * first * np.exp(growth * time)
    return np.asarray(np.sin(angle) / (pulsation / 2.0 + pulsation**2 / 3.5))


def _climbs(
    time: Float[np.ndarray, " n"],
    _step_s: float,
    rng: np.random.Generator,
) -> Float[np.ndarray, " n"]:
    """One climb and one descent, each of least jerk (a polynomial of the fifth degree)."""
    span = float(time[-1])
    height = rng.uniform(1.5, 4.0)
    position = np.zeros_like(time)
    for sign, earliest in ((1.0, 0.2), (-1.0, 0.6)):
        start, length = span * rng.uniform(earliest, earliest + 0.1), span * rng.uniform(0.05, 0.1)
        part = np.clip((time - start) / length, 0.0, 1.0)
        position += sign * height * part**3 * (10.0 - 15.0 * part + 6.0 * part**2)
    return position


def _hover(
    time: Float[np.ndarray, " n"],
    _step_s: float,
    _rng: np.random.Generator,
) -> Float[np.ndarray, " n"]:
    """Return a constant reference."""
    return np.zeros_like(time)


#: A shape's heights at times [s], of which the second argument is the step; it draws what is random.
_Shape = Callable[[Float[np.ndarray, " n"], float, np.random.Generator], Float[np.ndarray, " n"]]
_SHAPES: Mapping[TrajectoryKind, _Shape] = {
    TrajectoryKind.STEPS: _steps,
    TrajectoryKind.MULTISINE: _multisine,
    TrajectoryKind.CHIRP: _chirp,
    TrajectoryKind.CLIMBS: _climbs,
    TrajectoryKind.HOVER: _hover,
    TrajectoryKind.HOVER_STEPS: _hover_steps,
}
