"""Columns of a fractional difference equation: which channel, to which order, at which lag, times what.

A column is a sum of such parts. The derivative of an equation by an order is a column as well, with parts
of every channel that has a term of this order; so one rule says what noise any two columns share.
"""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True, slots=True)
class Part:
    """``gain * operator^order channel[k - lag]``, or its derivative by the order. Performs no checks.

    Parameters
    ----------
    channel : str
        Canonical name.
    order : float
        Of the operator.
    lag : int
        Samples back.
    gain : float
        Constant, noise-free factor.
    by_order : bool
        True for the derivative by the order.
    """

    channel: str
    order: float = 0.0
    lag: int = 0
    gain: float = 1.0
    by_order: bool = False

    @property
    def derivative(self) -> Part:
        """The same part's derivative by its order."""
        return replace(self, by_order=True)

    def times(self, factor: float) -> Part:
        """The same part with another gain."""
        return replace(self, gain=factor * self.gain)


#: A column: the sum of its parts.
FractionalColumn = tuple[Part, ...]


def combined(columns: list[tuple[float, FractionalColumn]]) -> FractionalColumn:
    """Sum of columns, each times a number."""
    return tuple(part.times(factor) for factor, column in columns for part in column)
