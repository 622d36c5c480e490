"""The methods by name: a table that maps a word to an assembler, a weighting and a solver."""

from __future__ import annotations

from eivor.errors import UsageError
from eivor.estimation.assembler import Direct, Instrumental
from eivor.estimation.method import Method
from eivor.estimation.weighting import Unweighted
from eivor.estimation.whitening import SpectralWhitening
from eivor.linalg import LeastSquares, TotalLeastSquares


def reference_iv() -> Method:
    """Whitened reference-instrument IV, the default for flights."""
    return Method("reference_iv", Instrumental(), SpectralWhitening(), LeastSquares())


def least_squares() -> Method:
    """Least squares, the paper's (9); with a lag to find, nonlinear least squares."""
    return Method("least_squares", Direct(), Unweighted(), LeastSquares())


def total_least_squares() -> Method:
    """Total least squares scaled by the columns' error scale, the paper's (13)-(16)."""
    return Method("total_least_squares", Direct(), Unweighted(), TotalLeastSquares())


def extended_iv() -> Method:
    """Extended instrumental variables, the paper's (21)-(25): least squares on Psi'Phi theta = Psi'y."""
    return Method("extended_iv", Instrumental(), Unweighted(), LeastSquares())


TABLE = {
    "reference_iv": reference_iv,
    "least_squares": least_squares,
    "total_least_squares": total_least_squares,
    "extended_iv": extended_iv,
}


def by_name(name: str) -> Method:
    """Return the method of that name.

    Raises
    ------
    UsageError
        When there is none.
    """
    if name not in TABLE:
        raise UsageError(f"a method out of {', '.join(TABLE)}", f"'{name}'", "Name one of them.")
    return TABLE[name]()
