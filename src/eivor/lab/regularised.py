"""Regularised solvers and the choice of their parameter."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from eivor import checks
from eivor.errors import EstimationError, NonFiniteError, ShapeError, UsageError
from eivor.estimation.estimate import Estimate
from eivor.estimation.linear import LinearMethod, Method, Problem, check_method
from eivor.linalg import total_least_squares as tls
from eivor.linalg.system import LinearSystem, Shrinkage, Solution, Solver, triangular_root
from eivor.tools import Float

#: Decades of the parameter that cross-validation tries, and points in each; zero is tried as well.
DECADES, POINTS = (-14, 4), 20


@dataclass(frozen=True)
class ReducedProblem:
    """A problem in the coordinates in which it is regularised."""

    R: Float[np.ndarray, "n n"]  # triangular factor of the scaled or whitened columns
    right: Float[np.ndarray, " n"]
    outside: float  # squared norm of the right-hand side outside the range of R
    shift: float  # sigma^2
    towards: Float[np.ndarray, " n"]
    equations: float  # number of equations that R is the root of
    column_errors: float  # variance of the columns' errors over the right-hand side's: 0, or 1 in TLS

    @property
    def unit(self) -> float:
        """Mean of the squared singular values, the unit of the parameter."""
        return float(np.sum(self.R**2)) / self.R.shape[0]

    def solution(self, parameter: float) -> Float[np.ndarray, " n"]:
        """Theta of the shifted system."""
        a = parameter * self.unit
        upper = tls.balanced(self.R, self.shift - a)
        below = -(a / upper) * self.towards
        return tls.solve_augmented(self.R, self.right, upper, (self.shift - a) / upper, below=below)

    def effective(self, parameters: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        """Effective number of parameters, of n."""
        powers = (np.linalg.svd(self.R, compute_uv=False) ** 2 - self.shift) / self.unit
        return np.sum(powers / (powers + parameters[:, None]), axis=1)

    def cross_validated(self) -> float:
        """Parameter of the least misfit / (m - parameters left)^2 (Golub, Heath and Wahba 1979)."""
        if self.equations <= self.right.size:
            expected = f"more equations than the {self.right.size} unknowns for generalized cross-validation"
            remedy = "Give more instruments (moments count, not rows), or give the parameter."
            raise EstimationError(expected, f"{self.equations:g}", remedy)
        first, last = DECADES
        parameters = np.append(0.0, np.logspace(first, last, (last - first) * POINTS + 1))
        U, s, Vt = np.linalg.svd(self.R)
        powers = s**2 - self.shift
        beta, target = U.T @ self.right, Vt @ self.towards
        x = target + powers / (powers + parameters[:, None] * self.unit) * (s * beta / powers - target)
        misfits = self.outside + np.sum((beta - s * x) ** 2, axis=1)
        misfits /= 1.0 + self.column_errors * np.sum(x**2, axis=1)
        return float(parameters[np.argmin(misfits / (self.equations - self.effective(parameters)) ** 2)])


@dataclass(frozen=True)
class Tikhonov:
    """Parameter, and the vector that the solution is shrunk towards."""

    parameter: float | None = None  # Zero or more
    towards: Float[np.ndarray, " n"] | None = None

    def __post_init__(self) -> None:
        if self.parameter is not None:
            checks.number("parameter", self.parameter)
            if not 0.0 <= self.parameter < np.inf:
                expected = "a parameter of zero or more"
                raise UsageError(expected, f"{self.parameter:g}", "Zero regularises nothing.")
        if self.towards is not None:
            vector = checks.real_array("towards", self.towards)
            if vector.ndim != 1 or not np.isfinite(vector).all():
                expected = "a vector of finite numbers"
                raise NonFiniteError(expected, f"{vector}", "Give one number for each parameter.")
            object.__setattr__(self, "towards", vector)

    def vector(self, unknowns: int) -> Float[np.ndarray, " n"]:
        if self.towards is None:
            return np.zeros(unknowns)
        if self.towards.size != unknowns:
            expected = f"{unknowns} numbers to be shrunk towards, one for each parameter"
            raise ShapeError(expected, f"{self.towards.size}", "Give them in the order of the parameters.")
        return self.towards

    def solve(
        self, problem: ReducedProblem, back: Callable[[Float[np.ndarray, " q"]], Float[np.ndarray, " n"]]
    ) -> tuple[Float[np.ndarray, " n"], Shrinkage]:
        """Theta in its own units, and the shift that regularisation made."""
        chosen = "gcv" if self.parameter is None else "given"
        parameter = problem.cross_validated() if self.parameter is None else float(self.parameter)
        theta = back(problem.solution(parameter))
        kept = float(problem.effective(np.array([parameter]))[0])
        return theta, Shrinkage(chosen, parameter, kept, theta - back(problem.solution(0.0)))


@dataclass(frozen=True)
class RegularisedLeastSquares(Solver):
    """Least of ||b - A theta||^2 + a ||D (theta - towards)||^2, D the columns' lengths."""

    scheme: Tikhonov = Tikhonov()  # Parameter and vector

    def solve(self, system: LinearSystem) -> Solution:
        n = system.matrix.shape[1]
        scale = tls.column_lengths(system.matrix)
        root = triangular_root(np.column_stack([system.matrix / scale, system.right]))
        _, condition = tls.smallest_singular_value(root[:n, :n])
        outside = float(root[n, n] ** 2) if root.shape[0] > n else 0.0
        towards = self.scheme.vector(n) * scale
        problem = ReducedProblem(root[:n, :n], root[:n, -1], outside, 0.0, towards, system.equations, 0.0)
        theta, shrinkage = self.scheme.solve(problem, lambda scaled: scaled / scale)
        residual = system.right - system.matrix @ theta
        return Solution(theta, residual, float(residual @ residual), condition, shrinkage)


@dataclass(frozen=True)
class RegularisedTotalLeastSquares(tls.ErrorsInColumns):
    """Generalized total least squares with the shift a taken off sigma^2, sigma = sigma_min([A b])."""

    scheme: Tikhonov = Tikhonov()  # Parameter and vector

    def solve(self, system: LinearSystem) -> Solution:
        split = tls.split_problem(system)
        if not split.noisy.size:
            return split.solution(split.theta(np.empty(0)))
        towards = split.whitened(self.scheme.vector(system.matrix.shape[1]))
        count = system.equations - split.exact.size
        problem = ReducedProblem(split.R, split.right, split.outside, split.smallest**2, towards, count, 1.0)
        return split.solution(*self.scheme.solve(problem, split.theta))


@dataclass(frozen=True)
class ShrunkTowards(Method):
    """A method whose solution is shrunk towards the estimate of another method on the same problem."""

    name: str
    method: LinearMethod
    parameter: float | None
    target: Method

    @property
    def needs_instruments(self) -> bool:
        return self.method.needs_instruments or self.target.needs_instruments

    def estimate(self, problem: Problem) -> Estimate:
        towards = self.target.estimate(problem).theta
        return _shrunk(self.method, Tikhonov(self.parameter, towards)).estimate(problem)


def regularised(
    method: LinearMethod,
    parameter: float | None = None,
    towards: Float[np.ndarray, " n"] | Method | None = None,
) -> Method:
    """Return a linear method with Tikhonov's regularisation.

    On simulated records it gains nothing over generalized IV, see `docs/efficiency.md`. It serves comparison,
    and equations that are ill-conditioned for want of a better input.

    Parameters
    ----------
    method : LinearMethod
        Solved by least squares or total least squares, such as ``generalized_iv()``.
    parameter : float, optional
        Zero or more, in units of the mean squared singular value; generalized cross-validation by default.
    towards : ndarray, shape (n,), or Method, optional
        In the order and the units of the parameters; the estimate of another method; or zero.

    Returns
    -------
    Method
        Its estimate is biased. Intervals have the covariance without regularisation, with the square of the
        whole shift added: they are never shorter than those without.

    Raises
    ------
    UsageError
        When the method cannot be regularised, or an argument is of another kind.
    """
    check_method(method)
    if isinstance(towards, Method):
        _shrunk(method, Tikhonov(parameter))  # refuses what cannot be regularised
        return ShrunkTowards(f"{method.name}_tikhonov", method, parameter, towards)
    return _shrunk(method, Tikhonov(parameter, towards))


def _shrunk(method: LinearMethod, scheme: Tikhonov) -> LinearMethod:
    solver: RegularisedLeastSquares | RegularisedTotalLeastSquares
    if isinstance(method.solver, tls.UnweightedLeastSquares):
        solver = RegularisedLeastSquares(scheme)
    elif isinstance(method.solver, tls.GeneralizedTotalLeastSquares):
        solver = RegularisedTotalLeastSquares(scheme)
    else:
        expected = "a method that is solved by least squares or total least squares"
        remedy = "Use generalized_iv(), extended_iv() or least_squares(), for example."
        raise UsageError(expected, f"{method.name}, which has {type(method.solver).__name__}", remedy)
    return replace(method, name=f"{method.name}_tikhonov", solver=solver)
