"""One side of a fractional difference equation with its numbers: a power series in the backward shift."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eivor.models.fractional.operator import FractionalOperator
from eivor.shapes import Complex, Float

#: Points of the unit circle, from so near to one on, at which the equation's roots are counted.
CIRCLE_POINTS = 20_000
NEAREST_ANGLE = 1e-9


@dataclass(frozen=True, slots=True)
class Side:
    """sum_i c_i z^-lag_i operator^order_i.

    Parameters
    ----------
    terms : tuple of (float, float, int)
        Coefficient, order and lag of each term.
    operator : FractionalOperator
        What an order means.
    step_s : float
        Time between samples [s].
    """

    terms: tuple[tuple[float, float, int], ...]
    operator: FractionalOperator
    step_s: float

    def weights(self, count: int) -> Float[np.ndarray, " count"]:
        """Weights of the side as one filter."""
        total: Float[np.ndarray, " count"] = np.zeros(count)
        for coefficient, order, lag in self.terms:
            weights = self.operator.weights(order, count, self.step_s)
            total[lag:] += coefficient * weights[: max(count - lag, 0)]
        return total

    def response(self, back: Complex[np.ndarray, " k"]) -> Complex[np.ndarray, " k"]:
        """Value where z^-1 has the values `back`."""
        total: Complex[np.ndarray, " k"] = np.zeros(back.size, dtype=np.complex128)
        for coefficient, order, lag in self.terms:
            total += coefficient * back**lag * self.operator.response(order, back, self.step_s)
        return total

    @property
    def growing_modes(self) -> int:
        """Roots inside the unit circle of z^-1: each is a mode of the output that grows.

        The argument principle: a side is analytic inside the circle, so that the number of its roots there
        is how often its value winds about zero along the circle. Powers of 1 - z^-1 that all terms share
        have no root inside, and are taken out, since they vanish or grow without bound at one.
        """
        shared = min(order for _, order, _ in self.terms)
        angles = np.geomspace(NEAREST_ANGLE, np.pi, CIRCLE_POINTS)
        back = np.exp(-1j * angles)
        turned = np.unwrap(np.angle(self.response(back) / (1.0 - back) ** shared))
        # From one back to one below the real axis is the mirror image: twice the half circle.
        return abs(round(float(turned[-1] - turned[0]) / np.pi))
