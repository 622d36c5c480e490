"""The problem of a fractional difference equation: a regression at any orders, and one beside them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from eivor.errors import UsageError
from eivor.models.column import Column
from eivor.models.equation import Parameter
from eivor.models.fractional.column import FractionalColumn, Part, combined
from eivor.models.fractional.filtered_signals import FilteredSignals
from eivor.models.fractional.regression import FractionalRegression
from eivor.models.fractional.terms import FractionalTerm, UnknownOrder
from eivor.models.linearisable import LinearisableProblem
from eivor.models.separable import Nuisance, Values
from eivor.models.spectral import SpectralRegression
from eivor.shapes import Float

#: Values of an order at which its search begins.
GRID_POINTS = 11
#: Accuracy of the search, before the equations themselves say the rest.
ORDER_TOLERANCE = 1e-5


@dataclass(frozen=True)
class ChannelTerm:
    """A term of the equation with the channel it is of.

    Parameters
    ----------
    channel : str
        Canonical name.
    term : FractionalTerm
        Order and lag.
    sign : float
        1 on the right side, -1 for what is brought there.
    """

    channel: str
    term: FractionalTerm
    sign: float = 1.0

    def column(self, at: Values) -> FractionalColumn:
        """The term at values of the orders that are sought."""
        return (Part(self.channel, self.term.order_at(at), self.term.lag, self.sign),)


@dataclass(frozen=True)
class FractionalProblem(LinearisableProblem):
    """A fractional difference equation and a record of it.

    Parameters
    ----------
    filtered : FilteredSignals
        The record.
    response : ChannelTerm
        Left side, of a known order.
    terms : tuple of (Parameter, ChannelTerm)
        Right side.
    instruments : tuple of Column
        May be empty.
    nuisances : tuple of Nuisance
        Orders that are sought.
    """

    filtered: FilteredSignals
    response: ChannelTerm
    terms: tuple[tuple[Parameter, ChannelTerm], ...]
    instruments: tuple[Column, ...] = ()
    nuisances: tuple[Nuisance, ...] = field(default=())

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Coefficients of the right side."""
        return tuple(parameter for parameter, _ in self.terms)

    def regression(self, at: Values) -> FractionalRegression:
        """Rows of the coefficients at some orders."""
        columns = tuple(term.column(at) for _, term in self.terms)
        return FractionalRegression(
            self.filtered, self.parameters, self.response.column(at), columns, self.instruments
        )

    def linearised(self, at: Values, theta: Float[np.ndarray, " n"]) -> FractionalRegression:
        """Rows of the coefficients and of the changes of the orders."""
        known = self.regression(at)
        changes = tuple(self._by_order(nuisance.name, at, theta) for nuisance in self.nuisances)
        orders = tuple(nuisance.parameter for nuisance in self.nuisances)
        return FractionalRegression(
            self.filtered,
            self.parameters + orders,
            known.response,
            known.regressors + changes,
            self.instruments,
        )

    def _by_order(self, name: str, at: Values, theta: Float[np.ndarray, " n"]) -> FractionalColumn:
        """Derivative of Phi theta by an order."""
        return combined(
            [
                (value, tuple(part.derivative for part in term.column(at)))
                for value, (_, term) in zip(theta.tolist(), self.terms, strict=True)
                if isinstance(term.term.order, UnknownOrder) and term.term.order.name == name
            ]
        )

    def bins(self, at: Values) -> SpectralRegression:
        """Nothing: an operator's memory does not end with a run.

        Raises
        ------
        UsageError
            Always.
        """
        raise UsageError(
            "a method without spectral whitening for a fractional difference equation",
            f"one that asks for its spectra at {dict(at)}",
            "Use generalized_iv, or another method of the page on fractional equations.",
        )


def sought(order: UnknownOrder) -> Nuisance:
    """Nuisance of an order."""
    grid = np.linspace(order.low, order.high, GRID_POINTS)
    return Nuisance(Parameter(order.name), grid, tolerance=ORDER_TOLERANCE)
