"""Terms of a fractional difference equation: an order that is known, or one that is sought, and a lag."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from eivor import checks
from eivor.errors import ParameterError, UsageError

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
    """Terms from a sequence of them, of orders, or of both.

    Raises
    ------
    UsageError
        When it is no sequence of these, or empty.
    ParameterError
        When two terms of one lag are of one order, or might be, which no data can tell apart.
    """
    kinds = (FractionalTerm, UnknownOrder, *checks.NUMBERS)
    if not isinstance(given, tuple | list) or not given or not all(isinstance(one, kinds) for one in given):
        raise UsageError(
            f"one term or more for {name}: orders, unknown orders, or FractionalTerm(order, lag)",
            checks.described(given),
            "Give (0.0, 0.5), for example.",
        )
    terms = tuple(one if isinstance(one, FractionalTerm) else FractionalTerm(one) for one in given)
    for one, other in combinations(terms, 2):
        if one.may_be(other):
            raise ParameterError(
                f"terms of different orders or lags for {name}, in ranges that do not meet",
                f"orders {_span(one)} and {_span(other)} at lag {one.lag}",
                "Where orders are equal their columns are one: leave a term out, or narrow the range.",
            )
    return terms


def _span(term: FractionalTerm) -> str:
    low, high = term.range
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"
