"""Confidence ellipses of two parameters, or of two linear combinations of them.

Notation: C covariance (2 x 2) of the pair, q = 2. The ellipse is ``(p - c)' C^-1 (p - c) <= T^2``. A
covariance of equal-weighted cosine averages with B degrees of freedom is a Wishart matrix over B, so that
T^2 is Hotelling's, q B / (B - q + 1) F(q, B - q + 1) (Lazarus, Lewis, Stock and Watson 2018, their (5));
with infinitely many degrees of freedom it is chi-square on q.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import special

from eivor.errors import ShapeError, UsageError
from eivor.inference.quantiles import check_level, chi_square_quantile
from eivor.shapes import Bool, Float

#: Largest magnitude of a correlation that still spans an ellipse in numbers.
FULL_CORRELATION = 1.0 - 1e-15


@dataclass(frozen=True)
class Ellipse:
    """Confidence ellipse of a pair.

    Parameters
    ----------
    centre : ndarray, shape (2,)
        The pair's estimates, each in its own unit.
    covariance : ndarray, shape (2, 2)
        Their covariance.
    level : float
        Confidence level.
    degrees : float
        Degrees of freedom of the covariance; infinite for a known one.

    Raises
    ------
    ShapeError
        When it is not a pair.
    UsageError
        When the covariance is not one, the level not between 0 and 1, or there are fewer than two degrees
        of freedom.
    """

    centre: Float[np.ndarray, " pair"]
    covariance: Float[np.ndarray, "pair pair"]
    level: float = 0.95
    degrees: float = math.inf

    def __post_init__(self) -> None:
        if self.centre.shape != (2,) or self.covariance.shape != (2, 2):
            raise ShapeError(
                "a pair of estimates and their 2 x 2 covariance",
                f"shapes {self.centre.shape} and {self.covariance.shape}",
                "Choose two parameters, or two linear combinations.",
            )
        C = self.covariance
        shared = math.sqrt(max(float(C[0, 0]) * float(C[1, 1]), 0.0))
        symmetric = abs(float(C[0, 1] - C[1, 0])) <= 1e-10 * shared
        bounded = abs(float(C[0, 1])) <= shared * (1.0 + 1e-10)
        if not (np.isfinite(C).all() and C[0, 0] >= 0.0 and C[1, 1] >= 0.0 and symmetric and bounded):
            raise UsageError(
                "a finite, symmetric, positive semidefinite covariance",
                f"{C.tolist()}",
                "Use rows and columns of an estimate's covariance.",
            )
        hotelling_quantile(self.level, 2, self.degrees)

    @property
    def squared_radius(self) -> float:
        """T^2: the largest squared distance, in standard errors, from the centre."""
        return hotelling_quantile(self.level, 2, self.degrees)

    @property
    def std_errors(self) -> Float[np.ndarray, "2"]:
        """Standard error of each of the pair."""
        errors: Float[np.ndarray, "2"] = np.sqrt(np.diag(self.covariance))
        return errors

    @property
    def correlation(self) -> float:
        """Correlation of the pair; zero when one of them is exact."""
        shared = float(np.prod(self.std_errors))
        return min(max(float(self.covariance[0, 1]) / shared, -1.0), 1.0) if shared > 0.0 else 0.0

    @property
    def bounds(self) -> Float[np.ndarray, "2 2"]:
        """Lowest and highest value (columns) of each of the pair (rows) on the ellipse.

        Wider than the intervals of the parameters one by one: these hold for both, whatever their
        combination (Scheffe).
        """
        reach = math.sqrt(self.squared_radius) * self.std_errors
        return np.column_stack([self.centre - reach, self.centre + reach])

    @property
    def semi_axes(self) -> Float[np.ndarray, "2 2"]:
        """Vectors (rows) from the centre to the ends of the longer and of the shorter axis.

        Orthogonal in the plane of the two numbers, so that they change with the parameters' units.
        """
        eigenvalues, vectors = np.linalg.eigh(self.covariance)
        lengths = np.sqrt(self.squared_radius * np.maximum(eigenvalues, 0.0))
        axes: Float[np.ndarray, "2 2"] = (vectors * lengths).T[::-1]
        return axes

    @property
    def area(self) -> float:
        """Area, in the product of the two units."""
        shape = math.sqrt(max(1.0 - self.correlation**2, 0.0))
        return math.pi * self.squared_radius * float(np.prod(self.std_errors)) * shape

    def outline(self, points: int = 181) -> Float[np.ndarray, "points 2"]:
        """Points around the ellipse, the first one again as the last.

        Parameters
        ----------
        points : int
            How many.
        """
        angle = np.linspace(0.0, 2.0 * np.pi, points)
        r = self.correlation
        # principal axes of the correlation matrix, whatever r: the diagonals of the unit square
        along, across = np.sqrt(0.5 * (1.0 + r)) * np.cos(angle), np.sqrt(0.5 * (1.0 - r)) * np.sin(angle)
        unit = np.column_stack([along - across, along + across])
        outline: Float[np.ndarray, "points 2"] = (
            self.centre + math.sqrt(self.squared_radius) * unit * self.std_errors
        )
        return outline

    def distance(self, points: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, " k"]:
        """Squared distance (p - c)' C^-1 (p - c) of each point; infinite off a degenerate ellipse.

        Parameters
        ----------
        points : ndarray, shape (k, 2)
            Points of the plane.
        """
        errors, r = self.std_errors, self.correlation
        away = points - self.centre
        z = np.divide(away, errors, out=np.where(away == 0.0, 0.0, np.inf), where=errors > 0.0)
        if abs(r) > FULL_CORRELATION:
            on_line = np.isclose(z[:, 0], math.copysign(1.0, r) * z[:, 1], rtol=1e-9, atol=1e-9)
            return np.where(on_line, z[:, 0] ** 2, np.inf)
        squared: Float[np.ndarray, " k"] = np.square(z[:, 0])
        rest = z[:, 1] - r * z[:, 0] if r else z[:, 1]
        return squared + np.square(rest) / (1.0 - r * r)

    def contains(self, points: Float[np.ndarray, "k 2"]) -> Bool[np.ndarray, " k"]:
        """Return which points lie inside or on the ellipse.

        Parameters
        ----------
        points : ndarray, shape (k, 2)
            Points of the plane.
        """
        return self.distance(points) <= self.squared_radius * (1.0 + 1e-12)


def joint_ellipse(
    values: Float[np.ndarray, " n"],
    covariance: Float[np.ndarray, "n n"],
    directions: Float[np.ndarray, "pair columns"],
    *,
    level: float = 0.95,
    degrees: float = math.inf,
) -> Ellipse:
    """Confidence ellipse of two linear combinations of a vector of estimates.

    Parameters
    ----------
    values : ndarray, shape (n,)
        Estimates.
    covariance : ndarray, shape (n, n)
        Their covariance.
    directions : ndarray, shape (2, n)
        Each combination's coefficients; two rows of the identity for two parameters.
    level : float
        Confidence level.
    degrees : float
        Degrees of freedom of the covariance.

    Raises
    ------
    ShapeError, UsageError
        When shapes do not fit; see also `Ellipse`.
    """
    size = values.size
    if covariance.shape != (size, size) or directions.shape != (2, size):
        raise ShapeError(
            f"a {size} x {size} covariance and two directions of length {size}",
            f"shapes {covariance.shape} and {directions.shape}",
            "Give one coefficient for each estimate.",
        )
    C = directions @ covariance @ directions.T
    return Ellipse(directions @ values, 0.5 * (C + C.T), level, float(degrees))


def hotelling_quantile(level: float, dimension: int, degrees: float = math.inf) -> float:
    """Value that Hotelling's T^2 stays below with probability `level`.

    Parameters
    ----------
    level : float
        Probability.
    dimension : int
        q, estimates that are judged together.
    degrees : float
        B, degrees of freedom of their covariance; chi-square when infinite.

    Raises
    ------
    UsageError
        When the level is not between 0 and 1, or there are fewer degrees of freedom than estimates.
    """
    check_level(level)
    if not degrees >= dimension:
        raise UsageError(
            f"at least {dimension} degrees of freedom for {dimension} estimates together",
            f"{degrees:g}",
            "Use more cosine averages, or intervals one by one.",
        )
    if math.isinf(degrees):
        return chi_square_quantile(level, dimension)
    second = degrees - dimension + 1.0
    return dimension * degrees / second * float(special.fdtri(dimension, second, level))
