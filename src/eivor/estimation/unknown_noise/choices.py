"""Which equations tell parameters and noises: three schemes of the literature as choices of test functions.

An equation is mean(psi e) for a test function psi, a channel at a lag. What the noises of psi and e share is
a function of the unknown strengths: equations beyond those that the parameters need tell these.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, replace

from eivor.errors import UsageError
from eivor.models.column import Column
from eivor.models.signal_regression import SignalRegression

#: Lags of a regressor that has white noise, and of one whose noise has an order, the present one beside them.
WHITE_LAGS = 2
ORDER_LAGS = 6


class EquationChoice(ABC):
    """A choice of test functions."""

    @abstractmethod
    def columns(self, problem: SignalRegression, orders: tuple[str, ...]) -> tuple[Column, ...]:
        """Test functions: columns of the problem, and others of its channels.

        Parameters
        ----------
        problem : SignalRegression
            With its instruments.
        orders : tuple of str
            Channels whose noise has an unknown order.
        """


@dataclass(frozen=True, slots=True)
class GeneralizedEquations(EquationChoice):
    """Instruments, and every noisy regressor at some lags: generalized instrumental variables in full.

    Parameters
    ----------
    lags : int, optional
        Lags of each regressor's channel. Default: two, and six for a noise whose order is unknown.

    References
    ----------
    T. Soderstrom, "A generalized instrumental variable estimation method for errors-in-variables
    identification problems", Automatica 47 (2011).
    """

    lags: int | None = None

    def __post_init__(self) -> None:
        if self.lags is not None and self.lags < 0:
            raise UsageError("zero lags or more", f"{self.lags}", "Leave lags out.")

    def columns(self, problem: SignalRegression, orders: tuple[str, ...]) -> tuple[Column, ...]:
        """Instruments, and lags of the regressors' channels."""
        own = []
        for column in problem.regressor_columns:
            most = self.lags
            if most is None:
                most = ORDER_LAGS if column.channel in orders else WHITE_LAGS
            if column.channel:
                own += [replace(column, lag=column.lag + lag) for lag in range(most + 1)]
        return _once((*problem.instrument_columns, *own))


@dataclass(frozen=True, slots=True)
class BiasEliminating(EquationChoice):
    """The regressors themselves and instruments: bias-eliminating least squares.

    The normal equations of least squares, with a bias of known form, and equations of instruments that tell
    it (Zheng 1998).
    """

    def columns(self, problem: SignalRegression, _orders: tuple[str, ...]) -> tuple[Column, ...]:
        """Regressors, then instruments."""
        return _once((*problem.regressor_columns, *problem.instrument_columns))


@dataclass(frozen=True, slots=True)
class FrischScheme(EquationChoice):
    """Regressors, response and instruments: the Frisch scheme with the equations of past inputs.

    The covariance of [phi y] less that of its noises is singular along [theta -1] (Beghelli, Guidorzi and
    Soverini 1990): one more equation, and the strength of the response's noise one more unknown. A
    disturbance of the equation counts as noise of the response.
    """

    def columns(self, problem: SignalRegression, _orders: tuple[str, ...]) -> tuple[Column, ...]:
        """Regressors, response, then instruments."""
        return _once((*problem.regressor_columns, problem.equation.response, *problem.instrument_columns))


def _once(columns: Iterable[Column]) -> tuple[Column, ...]:
    """Each channel at each lag once, whatever its sign and size."""
    kept: dict[tuple[str, int, str], Column] = {}
    for column in columns:
        kept.setdefault((column.channel, column.lag, column.gain_channel), column)
    return tuple(kept.values())
