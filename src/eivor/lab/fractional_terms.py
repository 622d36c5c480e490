"""Terms, operators and columns of fractional difference equations."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from eivor import checks
from eivor.errors import ParameterError, UsageError
from eivor.signals.noise import fractional_weights, order_slope
from eivor.tools import Complex, Float

# -- Column --


@dataclass(frozen=True, slots=True)
class FractionalPart:
    """``gain * operator^order channel[k - lag]``, or its derivative by the order. Performs no checks."""

    channel: str
    order: float = 0.0
    lag: int = 0
    gain: float = 1.0  # Constant, noise-free factor
    by_order: bool = False  # True for the derivative by the order

    @property
    def derivative(self) -> FractionalPart:
        """The same part's derivative by its order."""
        return replace(self, by_order=True)

    def times(self, factor: float) -> FractionalPart:
        """The same part with another gain."""
        return replace(self, gain=factor * self.gain)


#: A column: the sum of its parts.
FractionalColumn = tuple[FractionalPart, ...]


def combined(columns: list[tuple[float, FractionalColumn]]) -> FractionalColumn:
    """Sum of columns, each times a number."""
    return tuple(part.times(factor) for factor, column in columns for part in column)


# -- Operator --


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


# -- Side --

#: Points of the unit circle, from so near to one on, at which the equation's roots are counted.
CIRCLE_POINTS = 20_000
NEAREST_ANGLE = 1e-9


@dataclass(frozen=True, slots=True)
class Side:
    """sum_i c_i z^-lag_i operator^order_i."""

    terms: tuple[tuple[float, float, int], ...]  # Coefficient, order and lag of each term
    operator: FractionalOperator
    step_s: float  # Time between samples [s]

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
        """Roots inside the unit circle of z^-1: each is a mode of the output that grows."""
        shared = min(order for _, order, _ in self.terms)
        angles = np.geomspace(NEAREST_ANGLE, np.pi, CIRCLE_POINTS)
        back = np.exp(-1j * angles)
        turned = np.unwrap(np.angle(self.response(back) / (1.0 - back) ** shared))
        # From one back to one below the real axis is the mirror image: twice the half circle.
        return abs(round(float(turned[-1] - turned[0]) / np.pi))


# -- Terms --

#: Largest order, in absolute value.
LARGEST_ORDER = 3.0


@dataclass(frozen=True, slots=True)
class UnknownOrder:
    """An order that is estimated; the same name in several terms is one unknown.

    Parameters
    ----------
    name : str
        How results call it.
    low, high : float
        Between what it is looked for, within -3 and 3.

    Raises
    ------
    ParameterError
        When the range is empty, or reaches beyond that.
    UsageError
        When the name is no text or empty, or a number is none.
    """

    name: str
    low: float
    high: float

    def __post_init__(self) -> None:
        checks.text("name", self.name)
        checks.number("low", self.low)
        checks.number("high", self.high)
        if not self.name:
            raise UsageError("a name for an unknown order", "''", 'Call it "order", for example.')
        if not -LARGEST_ORDER <= self.low < self.high <= LARGEST_ORDER:
            raise ParameterError(
                f"a range of orders between -{LARGEST_ORDER:g} and {LARGEST_ORDER:g}, the lower end first",
                f"{self.low} and {self.high} for '{self.name}'",
                "Differentiate or integrate the channel by whole orders first.",
            )


#: An order, known or sought.
Order = float | UnknownOrder


@dataclass(frozen=True, slots=True)
class FractionalTerm:
    """One term of the equation: a channel behind an operator of some order, some samples ago.

    Parameters
    ----------
    order : float or UnknownOrder
        Of the difference, between -3 and 3; below zero it is a sum.
    lag : int
        Samples back, zero or more.

    Raises
    ------
    ParameterError
        When a known order is out of range.
    UsageError
        When the lag is no whole number or negative, or the order is of another type.
    """

    order: Order
    lag: int = 0

    def __post_init__(self) -> None:
        checks.whole("lag", self.lag)
        if self.lag < 0:
            raise UsageError("a lag of zero or more samples", f"{self.lag}", "Only past samples have a part.")
        if isinstance(self.order, UnknownOrder):
            return
        checks.number("order", self.order)
        if not (np.isfinite(self.order) and abs(self.order) <= LARGEST_ORDER):
            raise ParameterError(
                f"an order between -{LARGEST_ORDER:g} and {LARGEST_ORDER:g}",
                f"{self.order}",
                "Differentiate or integrate the channel by whole orders first.",
            )

    def order_at(self, orders: Mapping[str, float]) -> float:
        """Order, which a mapping has where it is sought."""
        return orders[self.order.name] if isinstance(self.order, UnknownOrder) else float(self.order)

    @property
    def range(self) -> tuple[float, float]:
        """Least and largest order that it may have."""
        order = self.order
        return (order.low, order.high) if isinstance(order, UnknownOrder) else (float(order), float(order))

    def may_be(self, other: FractionalTerm) -> bool:
        """Whether the two could be one column: of one lag, with an order in common inside their ranges."""
        (low, high), (least, largest) = self.range, other.range
        if low < high and least < largest:  # two ranges may touch
            return self.lag == other.lag and low < largest and least < high
        return self.lag == other.lag and low <= largest and least <= high


def terms_of(name: str, given: object) -> tuple[FractionalTerm, ...]:
    """Terms from a sequence of them, of orders, or of both."""
    kinds = (FractionalTerm, UnknownOrder, *checks.NUMBERS)
    if not isinstance(given, tuple | list) or not given or not all(isinstance(item, kinds) for item in given):
        raise UsageError(
            f"one term or more for {name}: orders, unknown orders, or FractionalTerm(order, lag)",
            checks.described(given),
            "Give (0.0, 0.5), for example.",
        )
    terms = tuple(item if isinstance(item, FractionalTerm) else FractionalTerm(item) for item in given)
    for entry, other in combinations(terms, 2):
        if entry.may_be(other):
            raise ParameterError(
                f"terms of different orders or lags for {name}, in ranges that do not meet",
                f"orders {_span(entry)} and {_span(other)} at lag {entry.lag}",
                "Where orders are equal their columns are one: leave a term out, or narrow the range.",
            )
    return terms


def _span(term: FractionalTerm) -> str:
    low, high = term.range
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"
