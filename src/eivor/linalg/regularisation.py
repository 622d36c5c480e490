"""Regularisations: how a solution is pulled towards a vector.

Least squares and total least squares alike solve (R'R - sigma^2 I) theta = R' right, with sigma = 0 for the
first. Both regularisations here solve the *shifted* system in place of it,

    (R'R - sigma^2 I + a I) theta = R' right + a towards,

through the augmented system [[s I, R], [R', t I]] [r/s; theta] = [right; -(a/s) towards], s t = sigma^2 - a:
once (Tikhonov), or again and again towards what the step before gave (implicit iteration). With lambda_i the
eigenvalues of R'R - sigma^2 I, what is kept in direction i of the way from the vector to the solution that is
not regularised is the share lambda_i / (lambda_i + a), or 1 - (a / (lambda_i + a))^k after k steps.

Parameters count in units of the mean of R's squared singular values, so that they have none themselves.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from eivor import checks
from eivor.errors import UsageError
from eivor.linalg.augmented import balanced, solve_augmented
from eivor.shapes import Float

#: Decades of Tikhonov's parameter that are tried, and points in each.
DECADES, POINTS = (-14, 4), 20


@dataclass(frozen=True)
class ReducedProblem:
    """A problem in the coordinates in which it is regularised.

    Parameters
    ----------
    R : ndarray, shape (n, n)
        Triangular factor: of columns of unit length for least squares, of whitened ones for total.
    right : ndarray, shape (n,)
        Right-hand side in its coordinates.
    outside : float
        Square of the right-hand side that R does not reach.
    shift : float
        sigma^2; zero for least squares.
    towards : ndarray, shape (n,)
        The vector that solutions are pulled towards.
    equations : float
        Number of equations that R is the root of.
    column_errors : float
        Variance of the columns' errors over that of the right-hand side's: 0, or 1 in total least squares.
    """

    R: Float[np.ndarray, "n n"]
    right: Float[np.ndarray, " n"]
    outside: float
    shift: float
    towards: Float[np.ndarray, " n"]
    equations: float
    column_errors: float

    @property
    def unit(self) -> float:
        """Mean of the squared singular values, the unit of parameters."""
        return float(np.sum(self.R**2)) / self.R.shape[0]

    def pulled(self, strength: float, towards: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Theta of the shifted system, pulled towards a vector by `strength` units."""
        a = strength * self.unit
        upper = balanced(self.R, self.shift - a)
        return solve_augmented(
            self.R, self.right, upper, (self.shift - a) / upper, below=-(a / upper) * towards
        )


class Regularisation(ABC):
    """A way to pull a solution towards a vector, with one parameter."""

    #: The word that results use.
    name: ClassVar[str]

    @property
    @abstractmethod
    def parameters(self) -> Float[np.ndarray, " k"]:
        """Parameters that may be chosen, the one that changes the solution least first."""

    @abstractmethod
    def kept(
        self, powers: Float[np.ndarray, " n"], parameters: Float[np.ndarray, " k"]
    ) -> Float[np.ndarray, "k n"]:
        """Share of each direction that is kept, for powers lambda_i in units of the mean squared s_i."""

    @abstractmethod
    def solution(self, problem: ReducedProblem, parameter: float) -> Float[np.ndarray, " n"]:
        """Theta at a parameter, through augmented systems."""

    @abstractmethod
    def check(self, parameter: float) -> None:
        """Refuse a parameter that is none.

        Raises
        ------
        UsageError
            With the range.
        """


@dataclass(frozen=True, slots=True)
class Tikhonov(Regularisation):
    """Least of ||b - A theta||^2 + a ||D (theta - towards)||^2, D the columns' lengths (Tikhonov 1963).

    The parameter is a: at 1 a regressor that is orthogonal to all others keeps half of its coefficient. Of
    total least squares it is the shifted system, in which a is taken off sigma^2.
    """

    name: ClassVar[str] = "tikhonov"

    @property
    def parameters(self) -> Float[np.ndarray, " k"]:
        """Zero, and a grid of equal ratios."""
        first, last = DECADES
        return np.append(0.0, np.logspace(first, last, (last - first) * POINTS + 1))

    def kept(
        self, powers: Float[np.ndarray, " n"], parameters: Float[np.ndarray, " k"]
    ) -> Float[np.ndarray, "k n"]:
        """Shares lambda / (lambda + a)."""
        return powers / (powers + parameters[:, None])

    def solution(self, problem: ReducedProblem, parameter: float) -> Float[np.ndarray, " n"]:
        """One step from the vector."""
        return problem.pulled(parameter, problem.towards)

    def check(self, parameter: float) -> None:
        """Zero or more."""
        if not 0.0 <= parameter < np.inf:
            raise UsageError("a parameter of zero or more", f"{parameter:g}", "Zero regularises nothing.")


@dataclass(frozen=True, slots=True)
class ImplicitIteration(Regularisation):
    """Steps (R'R - sigma^2 I + a I) theta_k+1 = R' right + a theta_k, stopped early.

    As Ivanov and Zhdanov (2022) use it for total least squares. The parameter is the number
    of steps. Each is a system whose condition number is smaller than the problem's; without an end they would
    lead to the solution that is not regularised.

    Parameters
    ----------
    strength : float
        a, in units of the mean squared singular value.
    most : int
        Steps at most.

    Raises
    ------
    UsageError
        When a number is out of range.
    """

    name: ClassVar[str] = "implicit_iteration"

    strength: float = 0.1
    most: int = 1000

    def __post_init__(self) -> None:
        checks.within(self, {"strength": (1e-12, 1e6)}, "Use 0.1.")
        checks.whole("most", self.most)
        checks.within(self, {"most": (1, 100_000)}, "Use 1000.")

    @property
    def parameters(self) -> Float[np.ndarray, " k"]:
        """Every number of steps, the largest first."""
        return np.arange(self.most, 0, -1, dtype=np.float64)

    def kept(
        self, powers: Float[np.ndarray, " n"], parameters: Float[np.ndarray, " k"]
    ) -> Float[np.ndarray, "k n"]:
        """1 - (a / (lambda + a))^k."""
        return -np.expm1(-np.log1p(powers / self.strength) * parameters[:, None])

    def solution(self, problem: ReducedProblem, parameter: float) -> Float[np.ndarray, " n"]:
        """As many steps; a step is linear in where it starts, so k of them are made by log2 k squarings."""
        still = replace(problem, right=np.zeros_like(problem.right))
        step = np.column_stack([still.pulled(self.strength, one) for one in np.eye(problem.right.size)])
        moved = problem.pulled(self.strength, np.zeros_like(problem.right))
        theta, left = problem.towards, round(parameter)
        while left:
            if left % 2:
                theta = step @ theta + moved
            step, moved, left = step @ step, step @ moved + moved, left // 2
        return theta

    def check(self, parameter: float) -> None:
        """A number of steps."""
        if not 1.0 <= parameter <= self.most or parameter != round(parameter):
            raise UsageError(f"a whole number of steps from 1 to {self.most}", f"{parameter:g}", "Use 10.")
