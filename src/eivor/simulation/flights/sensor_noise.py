"""Errors of simulated sensors: what the controller sees too much, and the log holds."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from eivor.errors import UsageError
from eivor.shapes import Float
from eivor.signals.fractional import fractional_difference, fractional_weights

#: Orders of fractional noise of acceleration and velocity.
ACCELERATION_ORDER = -0.5
VELOCITY_ORDER = -0.4
#: Degrees of freedom of heavy-tailed noise, whose fourth moment is infinite.
STUDENT_DOF = 4.0


class NoiseKind(StrEnum):
    """Distribution and memory of the noise of acceleration and velocity.

    Fractional noise has the order -0.5 on acceleration and -0.4 on velocity. Position, attitude and rate
    noise are white in every kind.
    """

    WHITE = "white"
    HEAVY_TAILED = "heavy-tailed"
    FRACTIONAL = "fractional"


@dataclass(frozen=True, slots=True)
class SensorNoise:
    """Noise of what the controller sees and the log holds, alike on each axis.

    Every level is the standard deviation over the whole record. That also holds for fractional noise,
    whose variance grows along the record: its white source is scaled so that the mean variance is right.

    Parameters
    ----------
    kind : NoiseKind
        Of acceleration and velocity.
    acceleration : float
        Standard deviation of the specific force's error [m/s^2].
    velocity : float
        Standard deviation of the velocity's error [m/s].
    position : float
        Standard deviation of the altitude's error [m].
    attitude : float
        Standard deviation of small rotations about the body's axes [rad].
    angular_rate : float
        Standard deviation of the body rates' error [rad/s].

    Raises
    ------
    UsageError
        When a level is negative or not finite.
    """

    kind: NoiseKind = NoiseKind.WHITE
    acceleration: float = 0.4
    velocity: float = 0.03
    position: float = 0.01
    attitude: float = 0.002
    angular_rate: float = 0.01

    def __post_init__(self) -> None:
        levels = (self.acceleration, self.velocity, self.position, self.attitude, self.angular_rate)
        if not all(0.0 <= level < np.inf for level in levels):
            raise UsageError("finite noise levels of at least 0", f"{levels}", "Give standard deviations.")

    @classmethod
    def none(cls) -> SensorNoise:
        """Sensors without noise."""
        return cls(NoiseKind.WHITE, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class SensorErrors:
    """What is added to each measurement, one row for each stamp, in SI units.

    Parameters
    ----------
    acceleration, velocity, position, attitude, angular_rate : ndarray, shape (n, axes)
        Errors along each axis.
    """

    acceleration: Float[np.ndarray, "n axes"]
    velocity: Float[np.ndarray, "n axes"]
    position: Float[np.ndarray, "n axes"]
    attitude: Float[np.ndarray, "n axes"]
    angular_rate: Float[np.ndarray, "n axes"]


def sensor_errors(noise: SensorNoise, *, count: int, axes: int, rng: np.random.Generator) -> SensorErrors:
    """Independent errors of every sensor on every axis.

    Parameters
    ----------
    noise : SensorNoise
        Kind and levels.
    count, axes : int
        Samples and axes.
    rng : numpy.random.Generator
        Where they come from.
    """
    acceleration, velocity = (
        level * _unit_noise(noise.kind, order, (count, axes), rng)
        for level, order in ((noise.acceleration, ACCELERATION_ORDER), (noise.velocity, VELOCITY_ORDER))
    )
    position, attitude, angular_rate = (
        level * rng.standard_normal((count, axes))
        for level in (noise.position, noise.attitude, noise.angular_rate)
    )
    return SensorErrors(acceleration, velocity, position, attitude, angular_rate)


def _unit_noise(
    kind: NoiseKind, order: float, shape: tuple[int, int], rng: np.random.Generator
) -> Float[np.ndarray, "n axes"]:
    """Independent records of the kind whose variance, averaged along the record, is 1."""
    if kind is NoiseKind.HEAVY_TAILED:
        return np.asarray(rng.standard_t(STUDENT_DOF, size=shape) * np.sqrt(1.0 - 2.0 / STUDENT_DOF))
    white = rng.standard_normal(shape)
    if kind is NoiseKind.WHITE:
        return white
    mean_variance = np.cumsum(fractional_weights(order, shape[0]) ** 2).mean()
    return np.asarray(fractional_difference(white, order) / np.sqrt(mean_variance))
