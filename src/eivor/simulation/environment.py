"""Wind, trajectories and sensor noise of simulated flights, and logs with their truth."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from importlib.metadata import version
from typing import Annotated, Generic, NamedTuple, TypeAlias, TypeVar

import numpy as np
import scipy

from eivor import checks
from eivor.signals.channels import held_by_default, unit_of
from eivor.signals.noise import fractional_difference, fractional_weights
from eivor.signals.recording import CONTROLLER_RATE, Channel, Frame, Recording
from eivor.tools import Float

Series = Float[np.ndarray, " n"]

#: Degrees of freedom of heavy-tailed noise, whose fourth moment is infinite.
STUDENT_DOF = 4.0


class NoiseKind(StrEnum):
    """Distribution and memory of the noise of acceleration and velocity."""

    WHITE = "white"
    HEAVY_TAILED = "heavy-tailed"
    FRACTIONAL = "fractional"


#: Sensors with such noise, and those of them whose noise has a distribution and memory: its order.
SENSORS = ("acceleration", "velocity", "position", "attitude")
ORDERS = {"acceleration": -0.5, "velocity": -0.4}
Errors: TypeAlias = dict[str, Float[np.ndarray, "n axes"]]


@dataclass(frozen=True, slots=True)
class SensorNoise:
    """Noise of what the controller measures and the log holds, equal on each axis.

    Every level is the standard deviation over the whole record. That also holds for fractional noise, whose
    variance grows along the record: its white source is scaled so that the mean variance is right.
    """

    kind: NoiseKind = NoiseKind.WHITE  # Of acceleration and velocity
    # Standard deviation of the specific force's error [m/s^2]
    acceleration: Annotated[float, checks.non_negative] = 0.4
    velocity: Annotated[float, checks.non_negative] = 0.03  # Standard deviation of the velocity's error [m/s]
    position: Annotated[float, checks.non_negative] = 0.01  # Standard deviation of the altitude's error [m]
    # Standard deviation of small rotations about the body's axes [rad]
    attitude: Annotated[float, checks.non_negative] = 0.002

    def __post_init__(self) -> None:
        checks.in_ranges(self, "Give standard deviations.")

    def errors(self, count: int, axes: int, rng: np.random.Generator) -> Errors:
        """Independent errors of every sensor on every axis, one row for each stamp, in SI units."""
        return {name: getattr(self, name) * self._unit(name, (count, axes), rng) for name in SENSORS}

    def _unit(
        self, name: str, shape: tuple[int, int], rng: np.random.Generator
    ) -> Float[np.ndarray, "n axes"]:
        """Independent records whose variance, averaged along the record, is 1."""
        kind = self.kind if name in ORDERS else NoiseKind.WHITE
        if kind is NoiseKind.HEAVY_TAILED:
            return np.asarray(rng.standard_t(STUDENT_DOF, size=shape) * np.sqrt(1.0 - 2.0 / STUDENT_DOF))
        white = rng.standard_normal(shape)
        if kind is NoiseKind.WHITE:
            return white
        mean_variance = np.cumsum(fractional_weights(ORDERS[name], shape[0]) ** 2).mean()
        return np.asarray(fractional_difference(white, ORDERS[name]) / np.sqrt(mean_variance))


def simulated_channel(name: str, simulator: str, time_s: Series, values: Series) -> Channel:
    """Channel of a simulated log, with the unit and the hold of its name."""
    held, unit = held_by_default(name), unit_of(name)
    return Channel(name, time_s, values, unit, source=simulator, held=held, estimated=False)


def simulated_recording(name: str, simulator: str, time_s: Series, series: Mapping[str, Series]) -> Recording:
    """Log of a simulated flight whose thrust is quadratic in the rotors' state."""
    channels = {key: simulated_channel(key, simulator, time_s, data.copy()) for key, data in series.items()}
    parameters = {CONTROLLER_RATE: (time_s.size - 1) / float(time_s[-1] - time_s[0])}
    return Recording(name, "simulation", channels, Frame.Z_UP, parameters=parameters, input_map="square")


#: Largest speed [m/s] and acceleration [m/s^2] of an excitation are drawn from these ranges.
SPEED_RANGE = (1.6, 2.2)
ACCELERATION_RANGE = (3.0, 4.0)
#: Steps of a hover that is not quite constant [m].
SMALL_STEP_M = 0.05


class TrajectoryKind(StrEnum):
    """Shape of the altitude reference."""

    STEPS = "steps"
    MULTISINE = "multisine"
    CHIRP = "chirp"
    CLIMBS = "climbs"
    HOVER = "hover"
    HOVER_STEPS = "hover-steps"


#: Kinds that keep their own height: they are scaled down to the limits, and never up.
OWN_HEIGHT = frozenset({TrajectoryKind.CLIMBS, TrajectoryKind.HOVER_STEPS})


class Trajectory(NamedTuple):
    """Altitude reference and its derivatives on the log's grid."""

    position: Series  # [m]
    velocity: Series  # [m]
    acceleration: Series  # [m]


def altitude_reference(
    kind: TrajectoryKind, *, count: int, step_s: float, rng: np.random.Generator, vigour: float = 1.0
) -> Trajectory:
    """Shape of the kind, scaled so that speed and acceleration reach the smaller of their limits."""
    time = step_s * np.arange(count)
    position = _SHAPES[kind](time, step_s, rng)
    spline = scipy.interpolate.make_interp_spline(time, position, k=5)
    velocity, acceleration = spline(time, 1), spline(time, 2)
    top_speed, top_acceleration = float(np.abs(velocity).max()), float(np.abs(acceleration).max())
    limits = rng.uniform(*SPEED_RANGE), rng.uniform(*ACCELERATION_RANGE)
    scale = min(limits[0] / top_speed, limits[1] / top_acceleration) * vigour if top_speed > 0.0 else 0.0
    if kind in OWN_HEIGHT:
        scale = min(1.0, scale)
    return Trajectory(scale * position, scale * velocity, scale * acceleration)


def _steps(time: Series, step_s: float, rng: np.random.Generator) -> Series:
    """Random levels, held 1.5 to 4 s each."""
    starts = np.cumsum(rng.uniform(1.5, 4.0, size=int(time[-1] / 1.5) + 2))
    return _smoothed_levels(time, step_s, starts, rng.uniform(-2.0, 2.0, size=starts.size + 1), rng)


def _hover_steps(time: Series, step_s: float, rng: np.random.Generator) -> Series:
    """Steps of 5 cm up or down about a hover, each level held 2 to 6 s."""
    starts = np.cumsum(rng.uniform(2.0, 6.0, size=int(time[-1] / 2.0) + 2))
    # Alternately away from the middle and back to it, so that every step has the same height.
    levels = rng.choice([-SMALL_STEP_M, SMALL_STEP_M], size=starts.size + 1)
    levels[::2] = 0.0
    return _smoothed_levels(time, step_s, starts, levels, rng)


def _smoothed_levels(
    time: Series,
    step_s: float,
    starts: Float[np.ndarray, " m"],
    levels: Float[np.ndarray, " levels"],
    rng: np.random.Generator,
) -> Series:
    """Steps to levels at their starts, from zero, through four equal first-order lags."""
    decay = np.exp(-step_s / rng.uniform(0.25, 0.45))
    levels[0] = 0.0
    series: Series = levels[np.searchsorted(starts, time, side="right")]
    for _ in range(4):
        series = scipy.signal.lfilter([1.0 - decay], [1.0, -decay], series)
    return series


def _multisine(time: Series, _step_s: float, rng: np.random.Generator) -> Series:
    """Twelve sines between 0.06 and 1.2 Hz with random phases, amplitude falling with frequency."""
    edges = np.geomspace(0.06, 1.2, 13)
    frequencies = rng.uniform(edges[:-1], edges[1:])
    phases = rng.uniform(0.0, 2.0 * np.pi, size=frequencies.size)
    angles = 2.0 * np.pi * frequencies * time[:, None] + phases
    return np.asarray(np.sin(angles) @ frequencies**-1.3)


def _chirp(time: Series, _step_s: float, rng: np.random.Generator) -> Series:
    """Sine whose frequency rises from about 0.1 to 1.2 Hz, at the full speed or acceleration throughout."""
    first, last = rng.uniform(0.08, 0.12), rng.uniform(1.0, 1.4)
    growth = np.log(last / first) / time[-1]
    angle = 2.0 * np.pi * first * np.expm1(growth * time) / growth + rng.uniform(0.0, 2.0 * np.pi)
    pulsation = 2.0 * np.pi * first * np.exp(growth * time)
    return np.asarray(np.sin(angle) / (pulsation / 2.0 + pulsation**2 / 3.5))


def _climbs(time: Series, _step_s: float, rng: np.random.Generator) -> Series:
    """One climb and one descent, each of least jerk (a polynomial of the fifth degree)."""
    span = float(time[-1])
    height = rng.uniform(1.5, 4.0)
    position = np.zeros_like(time)
    for sign, begin in ((1.0, 0.2), (-1.0, 0.6)):
        start, length = span * rng.uniform(begin, begin + 0.1), span * rng.uniform(0.05, 0.1)
        phase = np.clip((time - start) / length, 0.0, 1.0)
        position += sign * height * phase**3 * (10.0 - 15.0 * phase + 6.0 * phase**2)
    return position


#: A shape's heights at times [s], of which the second argument is the step; it draws what is random.
_SHAPES: Mapping[TrajectoryKind, Callable[[Series, float, np.random.Generator], Series]] = {
    TrajectoryKind.STEPS: _steps,
    TrajectoryKind.MULTISINE: _multisine,
    TrajectoryKind.CHIRP: _chirp,
    TrajectoryKind.CLIMBS: _climbs,
    TrajectoryKind.HOVER: lambda time, *_: np.zeros_like(time),
    TrajectoryKind.HOVER_STEPS: _hover_steps,
}

Truth = TypeVar("Truth")


@dataclass(frozen=True, slots=True)
class SimulatedFlight(Generic[Truth]):
    """A recording as a log would hold it, and the truth behind it."""

    recording: Recording  # Noisy channels, frame z up
    truth: Truth  # What is free of noise, and nominal parameters
    flew: bool  # False when the vehicle was lost; recording and truth then end where it was


#: Schema of the truth of a simulated log.
SCHEMA = "eivor.simulate/1"


@dataclass(frozen=True)
class KnownLog:
    """A log and its true parameters."""

    recording: Recording
    rate_hz: float
    samples: int
    seed: int
    known: Mapping[str, object]

    @property
    def truth(self) -> dict[str, object]:
        """Document of the truth, for JSON."""
        log_facts = {name: getattr(self, name) for name in ("rate_hz", "samples", "seed")}
        return {"schema": SCHEMA, **self.known, **log_facts, "provenance": {"version": version("eivor")}}


def gusts(
    *, count: int, axes: int, step_s: float, rms: float, correlation_s: float, rng: np.random.Generator
) -> Float[np.ndarray, "count axes"]:
    """Independent wind on each axis, sampled exactly and meant to be held over a step."""
    shocks = rng.standard_normal((count, axes))
    decay = np.exp(-step_s / correlation_s)
    shocks[1:] *= np.sqrt(1.0 - decay**2)
    return np.asarray(rms * scipy.signal.lfilter([1.0], [1.0, -decay], shocks, axis=0))
