"""Noises of the vertical study, for the sensors of the whole vehicle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eivor.signals.noise import FractionalNoise, MeasurementNoise, WhiteNoise, fractional_weights
from eivor.simulation.environment import STUDENT_DOF, NoiseKind


@dataclass(frozen=True, slots=True)
class HeavyTailedNoise(MeasurementNoise):
    """Independent values of Student's distribution."""

    std: float  # Standard deviation, in the channel's unit

    def autocovariance(self, lag: int, _start: int, count: int, /) -> Float[np.ndarray, " count"]:
        """Square of `std` at lag zero, nothing else."""
        return np.full(count, self.std**2 if lag == 0 else 0.0)

    def moving_average(self, count: int) -> Float[np.ndarray, " count"]:
        """That of white noise."""
        return WhiteNoise(self.std).moving_average(count)

    def sample(self, count: int, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        """One realisation."""
        scale = self.std * np.sqrt(1.0 - 2.0 / STUDENT_DOF)
        return scale * np.asarray(rng.standard_t(STUDENT_DOF, size=count))

    def with_std(self, std: float) -> HeavyTailedNoise:
        """Return the same with another standard deviation."""
        return HeavyTailedNoise(std)


def noise_of(kind: NoiseKind, std: float, order: float, count: int) -> MeasurementNoise:
    """Noise of a kind with a standard deviation over a record of `count` samples."""
    if kind is NoiseKind.WHITE:
        return WhiteNoise(std)
    if kind is NoiseKind.HEAVY_TAILED:
        return HeavyTailedNoise(std)
    mean_variance = np.cumsum(fractional_weights(order, count) ** 2).mean()
    return FractionalNoise(float(std / np.sqrt(mean_variance)), order)
