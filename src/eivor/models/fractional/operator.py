"""What an order means: a difference of samples, or a derivative by time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from eivor.shapes import Complex, Float
from eivor.signals.fractional import fractional_weights, order_slope


class FractionalOperator(ABC):
    """A causal filter for each order, the identity at zero; the record is zero before it starts."""

    @abstractmethod
    def weights(self, order: float, count: int, step_s: float, /) -> Float[np.ndarray, " count"]:
        """Weights w_0 ... w_{count-1} of the filter, for samples `step_s` apart [s]."""

    @abstractmethod
    def slope(self, order: float, count: int, step_s: float, /) -> Float[np.ndarray, " count"]:
        """Derivatives of the weights by the order."""

    @abstractmethod
    def response(
        self, order: float, back: Complex[np.ndarray, " k"], step_s: float, /
    ) -> Complex[np.ndarray, " k"]:
        """sum_j w_j z^-j where z^-1 has the values `back`."""


@dataclass(frozen=True, slots=True)
class FractionalDifference(FractionalOperator):
    """Grunwald-Letnikov's difference of samples, Delta^order = (1 - z^-1)^order: the step is not in it."""

    def weights(self, order: float, count: int, _step_s: float, /) -> Float[np.ndarray, " count"]:
        """See `fractional_weights`."""
        return fractional_weights(order, count)

    def slope(self, order: float, count: int, _step_s: float, /) -> Float[np.ndarray, " count"]:
        """See `order_slope`."""
        return order_slope(order, count)

    def response(
        self, order: float, back: Complex[np.ndarray, " k"], _step_s: float, /
    ) -> Complex[np.ndarray, " k"]:
        """(1 - z^-1)^order, the principal value."""
        return np.asarray((1.0 - back) ** order)


@dataclass(frozen=True, slots=True)
class FractionalDerivative(FractionalOperator):
    """Derivative by time, (Delta^order + order/2 Delta^(order+1)) / step^order: per second to the order.

    Delta^order / step^order alone is the derivative at a time order/2 steps ago and has an error of the
    first order of the step; the second term takes it away, which leaves one of the second order.
    """

    def weights(self, order: float, count: int, step_s: float, /) -> Float[np.ndarray, " count"]:
        """Weights of both terms."""
        both = fractional_weights(order, count) + 0.5 * order * fractional_weights(order + 1.0, count)
        return np.asarray(both * step_s**-order)

    def slope(self, order: float, count: int, step_s: float, /) -> Float[np.ndarray, " count"]:
        """Of the weights, and of the power of the step before them."""
        both = order_slope(order, count) + 0.5 * order * order_slope(order + 1.0, count)
        both += 0.5 * fractional_weights(order + 1.0, count)
        return both * step_s**-order - np.log(step_s) * self.weights(order, count, step_s)

    def response(
        self, order: float, back: Complex[np.ndarray, " k"], step_s: float, /
    ) -> Complex[np.ndarray, " k"]:
        """((1 - z^-1) / step)^order (1 + order/2 (1 - z^-1))."""
        change = 1.0 - back
        return np.asarray((change / step_s) ** order * (1.0 + 0.5 * order * change))
