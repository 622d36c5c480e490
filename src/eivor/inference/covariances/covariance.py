"""Covariance of an estimate from its estimating equation ``sum of s_t(theta) = 0``.

Notation: M sensitivity of the sum to the estimates, V covariance of the sum of the scores. Then
theta_hat - theta = M^-1 sum s_t to first order, and its covariance is M^-1 V M^-T. How V is estimated is
an axis of its own, see `eivor.inference.covariances.estimators`. Both are taken in orthonormal coordinates of
the equation, where M has the condition of the regressors and not its square.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from eivor.errors import UsageError
from eivor.inference.estimating_equation import singular_sensitivity
from eivor.inference.quantiles import t_quantile
from eivor.shapes import Float

#: A larger variance tells nothing, and its products overflow.
LARGEST_VARIANCE = 1e250


@dataclass(frozen=True)
class CovariancePart:
    """Covariance under one assumption on the residual, and what its intervals are read from.

    Parameters
    ----------
    name : str
        Of the assumption: "classical", "equal_weighted_cosines", ...
    matrix : ndarray, shape (n, n)
        Covariance of the estimates.
    degrees : float
        Degrees of freedom of Student's t; infinite for the normal distribution.
    share : float
        Share of the variance that the estimator is expected to see. Below one for kernels, which are
        made of centred scores: fixed-b critical values allow for it.
    """

    name: str
    matrix: Float[np.ndarray, "n n"]
    degrees: float = math.inf
    share: float = 1.0

    def variance(self, direction: Float[np.ndarray, " n"]) -> float:
        """Variance of ``direction @ estimates``."""
        return max(float(direction @ self.matrix @ direction), 0.0)

    def half_width(
        self, direction: Float[np.ndarray, " n"], level: float, extra_variance: float = 0.0
    ) -> float:
        """Half-width of the interval for ``direction @ estimates``."""
        if self.degrees <= 0.0:
            return math.inf
        quantile = t_quantile(level, self.degrees)
        return quantile * math.sqrt((self.variance(direction) + extra_variance) / self.share)


@dataclass(frozen=True)
class JointCovariance:
    """Covariances of one vector of estimates; intervals are the widest that one of them asks for.

    Parameters
    ----------
    parts : tuple of CovariancePart
        One or more, the leading one first.
    """

    parts: tuple[CovariancePart, ...]

    def beside(self, bias: Float[np.ndarray, " n"]) -> JointCovariance:
        """Mean square errors of estimates that have a bias as well."""
        square = np.outer(bias, bias)
        return JointCovariance(tuple(replace(part, matrix=part.matrix + square) for part in self.parts))

    def part(self, name: str) -> CovariancePart:
        """Part of that name.

        Raises
        ------
        UsageError
            When there is none.
        """
        for one in self.parts:
            if one.name == name:
                return one
        names = ", ".join(one.name for one in self.parts)
        raise UsageError(f"a covariance out of {names}", f"'{name}'", "Name one of them.")

    def std_error(self, direction: Float[np.ndarray, " n"]) -> float:
        """Largest of the standard errors of ``direction @ estimates``."""
        return math.sqrt(max(part.variance(direction) for part in self.parts))

    def half_width(
        self, direction: Float[np.ndarray, " n"], level: float = 0.95, extra_variance: float = 0.0
    ) -> float:
        """Half-width of the interval for ``direction @ estimates``: the widest of the parts'.

        Parameters
        ----------
        direction : ndarray, shape (n,)
            Gradient of the quantity.
        level : float
            Confidence level.
        extra_variance : float
            Variance to add that does not come from the estimates.
        """
        return max(part.half_width(direction, level, extra_variance) for part in self.parts)

    @property
    def matrix(self) -> Float[np.ndarray, "n n"]:
        """Correlations of the leading part, with the largest of the standard errors on the diagonal."""
        leading = self.parts[0].matrix
        largest = np.array([self.std_error(direction) for direction in np.eye(leading.shape[0])])
        own = np.sqrt(np.maximum(np.diag(leading), 0.0))
        scale = np.divide(largest, own, out=np.zeros(own.size), where=own > 0.0)
        return leading * np.outer(scale, scale)


def sandwich(M: Float[np.ndarray, "n n"], meat: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "n n"]:
    """M^-1 meat M^-T without an explicit inverse.

    A sensitivity that is singular but for rounding gives the huge variances that it deserves.

    Raises
    ------
    CollinearError
        When the sensitivity is singular altogether, or so nearly that variances are no numbers.
    """
    # units apart by many powers of ten (a gain per squared rotor speed) must not pass for collinearity
    columns = unit_scale(np.einsum("ij,ij->j", M, M))
    rows = unit_scale(np.einsum("ij,ij->i", M * columns, M * columns))
    scaled = rows[:, None] * M * columns
    try:
        half = np.linalg.solve(scaled, np.outer(rows, rows) * meat)
        covariance: Float[np.ndarray, "n n"] = np.linalg.solve(scaled, half.T)
    except np.linalg.LinAlgError as error:
        raise singular_sensitivity() from error
    with np.errstate(over="ignore", invalid="ignore"):
        found: Float[np.ndarray, "n n"] = np.outer(columns, columns) * (0.5 * (covariance + covariance.T))
    if not bool((np.abs(found) <= LARGEST_VARIANCE).all()):
        raise singular_sensitivity()
    return found


def unit_scale(squares: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """One over the square roots: what brings quantities of these squares to one; one where they are zero."""
    return 1.0 / np.sqrt(np.where(squares > 0.0, squares, 1.0))
