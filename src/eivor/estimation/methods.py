"""The methods by name: a table that maps a word to an assembler, a weighting and a solver."""

from __future__ import annotations

from collections.abc import Callable

from eivor.errors import UsageError
from eivor.estimation.assembler import Compensated, Direct, Instrumental
from eivor.estimation.equation_weighting import TwoStage, TwoStepRobust
from eivor.estimation.method import Method
from eivor.estimation.weighting import Unweighted, Weighting
from eivor.estimation.whitening import SpectralWhitening
from eivor.linalg import AugmentedLeastSquares, AugmentedTotalLeastSquares, LeastSquares

__all__ = [
    "TABLE",
    "TwoStage",
    "TwoStepRobust",
    "Unweighted",
    "bias_compensated_least_squares",
    "by_name",
    "extended_iv",
    "extended_iv_tls",
    "generalized_iv",
    "generalized_iv_tls",
    "least_squares",
    "reference_iv",
    "total_least_squares",
]


def reference_iv() -> Method:
    """Whitened reference-instrument IV, the default for flights."""
    return Method("reference_iv", Instrumental(), SpectralWhitening(), LeastSquares())


def least_squares() -> Method:
    """Least squares, the paper's (9), (10); with a lag to find, nonlinear least squares."""
    return Method("least_squares", Direct(), Unweighted(), AugmentedLeastSquares())


def total_least_squares() -> Method:
    """Total least squares with the columns' declared noise covariance, the paper's (13)-(16)."""
    return Method("total_least_squares", Direct(), Unweighted(), AugmentedTotalLeastSquares())


def bias_compensated_least_squares() -> Method:
    """Least squares without what the declared noises add to the regressors' moments."""
    return Method("bias_compensated_least_squares", Compensated(False), Unweighted(), AugmentedLeastSquares())


def extended_iv(weighting: Weighting | None = None) -> Method:
    """Extended instrumental variables, the paper's (21)-(25).

    Parameters
    ----------
    weighting : Weighting, optional
        Of the equations: `Unweighted` (the paper's, default), `TwoStage` or `TwoStepRobust`.
    """
    return Method("extended_iv", Instrumental(), weighting or Unweighted(), AugmentedLeastSquares())


def extended_iv_tls() -> Method:
    """Extended instrumental variables solved by total least squares, the paper's (26), (27)."""
    return Method("extended_iv_tls", Instrumental(), Unweighted(), AugmentedTotalLeastSquares())


def generalized_iv(weighting: Weighting | None = None) -> Method:
    """Generalized instrumental variables, the paper's (28)-(31).

    Parameters
    ----------
    weighting : Weighting, optional
        Of the equations: `Unweighted` (the paper's, default), `TwoStage` or `TwoStepRobust`.
    """
    return Method("generalized_iv", Compensated(), weighting or Unweighted(), AugmentedLeastSquares())


def generalized_iv_tls() -> Method:
    """Generalized instrumental variables solved by total least squares, the paper's (32), (33)."""
    return Method("generalized_iv_tls", Compensated(), Unweighted(), AugmentedTotalLeastSquares())


#: What the command line offers for flights.
TABLE: dict[str, Callable[[], Method]] = {
    "reference_iv": reference_iv,
    "least_squares": least_squares,
    "total_least_squares": total_least_squares,
    "extended_iv": extended_iv,
}


def by_name(name: str) -> Method:
    """Return the method for flights of that name.

    Raises
    ------
    UsageError
        When there is none.
    """
    if name not in TABLE:
        raise UsageError(f"a method out of {', '.join(TABLE)}", f"'{name}'", "Name one of them.")
    return TABLE[name]()
