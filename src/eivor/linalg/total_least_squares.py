"""Least squares, total least squares and Fuller's modification."""

from __future__ import annotations

import sys
from abc import abstractmethod
from dataclasses import dataclass

import numpy as np
import scipy

from eivor import checks
from eivor.errors import (
    CollinearError,
    ConvergenceError,
    CovarianceError,
    NoUniqueSolutionError,
    ShapeError,
    TooFewSamplesError,
    UsageError,
)
from eivor.linalg.system import LinearSystem, ScoreCorrection, Shrinkage, Solution, Solver, triangular_root
from eivor.tools import Float, Int

Vector = Float[np.ndarray, " n"]
Square = Float[np.ndarray, "n n"]
Matrix = Float[np.ndarray, "m n"]
Covariance = Float[np.ndarray, "n_plus_1 n_plus_1"]
PerRow = Float[np.ndarray, " m"]
Covariances = Float[np.ndarray, "m n_plus_1 n_plus_1"]


def solve_augmented(A: Matrix, b: PerRow, upper: float, lower: float, below: Vector | None = None) -> Vector:
    """Theta of the augmented system with `upper` and `lower` on its diagonal blocks, and `below` for c."""
    rows, unknowns = A.shape
    matrix = np.diag([upper] * rows + [lower] * unknowns)
    matrix[:rows, rows:] = A  # the upper triangle is enough
    right = np.concatenate([b, np.zeros(unknowns) if below is None else below])
    with np.errstate(all="ignore"):
        solution: Float[np.ndarray, " size"] = scipy.linalg.lapack.dsysv(matrix, right)[2].ravel()
    return solution[rows:]


def balanced(R: Square, shift: float) -> float:
    """Value of s in [[s I, R], [R', (shift/s) I]] that keeps it as well conditioned as R."""
    smallest = float(np.linalg.svd(R, compute_uv=False)[-1])
    return max(float(np.sqrt(abs(shift))), smallest / float(np.sqrt(2.0)))


#: Share of a solution, and of its standard errors, that rounding may take. A condition number times the
#: rounding of a number is about what it does take.
LARGEST_ROUNDING = 1e-3


class UnweightedLeastSquares(Solver):
    """Least squares by QR, all but the last step."""

    @abstractmethod
    def triangular_solution(self, R: Square, right: Vector, smallest: float, /) -> Vector:
        """Solution of R theta = right, given R's smallest singular value."""

    def solve(self, system: LinearSystem) -> Solution:
        unknowns = system.matrix.shape[1]
        scale = column_lengths(system.matrix)
        scaled = np.column_stack([system.matrix / scale, system.right])
        root = triangular_root(scaled / row_lengths(system.matrix)[:, None])
        R = root[:unknowns, :unknowns]
        smallest, condition = smallest_singular_value(R)
        theta = self.triangular_solution(R, root[:unknowns, -1], smallest) / scale
        residual = system.right - system.matrix @ theta
        return Solution(theta, residual, float(residual @ residual), condition)

    def objectives(self, systems: Float[np.ndarray, "systems m n_plus_1"]) -> Float[np.ndarray, " systems"]:
        """Residual sums of squares, by one QR of all, see `Solver.objectives`."""
        if systems.shape[1] < systems.shape[2]:
            return np.zeros(systems.shape[0])  # as many equations as unknowns are met exactly
        roots = np.asarray(np.linalg.qr(systems, mode="r"))
        return np.asarray(roots[:, -1, -1] ** 2)


@dataclass(frozen=True, slots=True)
class LeastSquares(UnweightedLeastSquares):
    """Minimise ||b - A theta||_2 by QR. O(m n^2); never squares the condition number."""

    def triangular_solution(self, R: Square, right: Vector, _smallest: float, /) -> Vector:
        """Back substitution, by LAPACK itself: a search solves thousands of small systems."""
        return scipy.linalg.lapack.dtrtrs(R, right)[0]


@dataclass(frozen=True, slots=True)
class AugmentedLeastSquares(UnweightedLeastSquares):
    """Minimise ||b - A theta||_2 through the augmented system, the paper's (10), (25), (31)."""

    def triangular_solution(self, R: Square, right: Vector, smallest: float) -> Vector:
        return solve_augmented(R, right, smallest / np.sqrt(2.0), 0.0)


def column_lengths(matrix: Matrix) -> Vector:
    """Euclidean length of each column."""
    lengths: Vector = np.sqrt(np.einsum("ij,ij->j", matrix, matrix))
    if not lengths.all():
        remedy = "Leave that column out, or give rows in which it moves."
        raise CollinearError("regressors that vary", f"column {int(np.argmin(lengths))} is zero", remedy)
    return lengths


def row_lengths(matrix: Matrix) -> Float[np.ndarray, " m_or_one"]:
    """Lengths of the rows of a square matrix whose columns are given unit length; of any other, a 1."""
    if matrix.shape[0] != matrix.shape[1]:
        return np.ones(1)
    columns = np.einsum("ij,ij->j", matrix, matrix)
    rows = (matrix * matrix) @ (1.0 / np.where(columns > 0.0, columns, 1.0))
    return np.asarray(np.sqrt(np.where(rows > 0.0, rows, 1.0)))


def smallest_singular_value(R: Square) -> tuple[float, float]:
    """Smallest singular value and condition number of the triangular factor of unit-length columns."""
    singular = scipy.linalg.lapack.dgesdd(R, compute_uv=False)[1]
    if lost_to_rounding(singular, R.shape[0]):
        expected = "linearly independent regressors"
        remedy = "Remove a column, or give data in which they move independently."
        raise CollinearError(expected, "columns of which one is a combination of the others", remedy)
    return float(singular[-1]), float(singular[0] / singular[-1])


def lost_to_rounding(singular: Vector, size: int) -> bool:
    """Whether a matrix of these singular values is too ill-conditioned for its rounding."""
    return bool(singular[-1] * LARGEST_ROUNDING <= singular[0] * size * sys.float_info.epsilon)


#: sigma_min([A b]) must lie below sigma_min(A) by this share.
SEPARATION = 1e-12


@dataclass(frozen=True)
class SplitProblem:
    """Whitened columns with errors, and the way back."""

    system: LinearSystem
    covariance: Covariance  # S, of all columns
    exact: Int[np.ndarray, " k"]
    noisy: Int[np.ndarray, " q"]
    root: Float[np.ndarray, "rows n_plus_1"]  # Triangular root of [A b], exact columns first
    factor: Float[np.ndarray, "q_plus_1 q_plus_1"]  # L of the noisy columns and the response
    R: Float[np.ndarray, "q q"]  # Triangular factor of the whitened regressors
    right: Float[np.ndarray, " q"]
    outside: float  # Square of the whitened right-hand side that no regressor reaches
    smallest: float  # Smallest singular value of the whitened [A b]
    condition: float  # Condition number of A, columns scaled to unit length

    def theta(self, whitened: Float[np.ndarray, " q"]) -> Vector:
        """All unknowns, from those of the whitened columns."""
        known, unknowns = self.exact.size, self.exact.size + self.noisy.size
        result = np.empty(unknowns)
        if self.noisy.size:
            direction = scipy.linalg.solve_triangular(
                self.factor, np.append(whitened, -1.0), lower=True, trans="T"
            )
            result[self.noisy] = -direction[:-1] / direction[-1]
        if known:
            right = self.root[:known, -1] - self.root[:known, known:unknowns] @ result[self.noisy]
            result[self.exact] = scipy.linalg.solve_triangular(self.root[:known, :known], right)
        return result

    def whitened(self, theta: Vector) -> Float[np.ndarray, " q"]:
        """Unknowns of the whitened columns, from all unknowns."""
        direction = self.factor.T @ np.append(theta[self.noisy], -1.0)
        return np.asarray(-direction[:-1] / direction[-1])

    def solution(self, theta: Vector, shrinkage: Shrinkage | None = None) -> Solution:
        residual = self.system.right - self.system.matrix @ theta
        power = float(residual @ residual) / residual_weight(theta, self.covariance)
        return Solution(theta, residual, power, self.condition, shrinkage)


def split_problem(system: LinearSystem) -> SplitProblem:
    """Split and whiten a problem."""
    rows, unknowns = system.matrix.shape
    if rows < unknowns + 1:
        expected = f"at least {unknowns + 1} equations for total least squares with {unknowns} unknowns"
        raise TooFewSamplesError(expected, f"{rows}", "Give more equations, or use least squares.")
    S = np.eye(unknowns + 1) if system.error_covariance is None else system.error_covariance
    if not (np.diag(S) >= 0.0).all():
        remedy = "Check the covariance of the columns' errors."
        raise CovarianceError("variances of zero or more", f"{np.diag(S)}", remedy)
    exact = np.flatnonzero(np.diag(S)[:-1] == 0.0)
    noisy = np.flatnonzero(np.diag(S)[:-1] > 0.0)
    order = np.concatenate([exact, noisy])
    lengths = column_lengths(system.matrix)
    root = triangular_root(np.column_stack([system.matrix[:, order], system.right]))
    _, condition = smallest_singular_value(root[:unknowns, :unknowns] / lengths[order])
    if not noisy.size:
        empty = np.empty((0, 0))
        return SplitProblem(system, S, exact, noisy, root, empty, empty, np.empty(0), 0.0, 0.0, condition)
    columns = np.append(noisy, unknowns)
    L = _cholesky(S[np.ix_(columns, columns)])
    whitened = scipy.linalg.solve_triangular(L, root[exact.size :, exact.size :].T, lower=True).T
    reduced = triangular_root(whitened)
    q = noisy.size
    smallest = _smallest(reduced, q)
    outside = float(reduced[q, q] ** 2) if reduced.shape[0] > q else 0.0
    return SplitProblem(
        system, S, exact, noisy, root, L, reduced[:q, :q], reduced[:q, -1], outside, smallest, condition
    )


def residual_weight(theta: Vector, S: Covariance) -> float:
    """[theta; -1]' S [theta; -1]: variance of a row's residual; one when every column is exact."""
    direction = np.append(theta, -1.0)
    return float(direction @ S @ direction) or 1.0


def _smallest(root: Float[np.ndarray, "k q_plus_1"], unknowns: int) -> float:
    singular = np.linalg.svd(root, compute_uv=False)
    regressors_only = np.linalg.svd(root[:unknowns, :unknowns], compute_uv=False)
    smallest = float(singular[-1]) if singular.size > unknowns else 0.0
    if smallest >= float(regressors_only[-1]) * (1.0 - SEPARATION):
        raise NoUniqueSolutionError(
            "sigma_min([A b]) below sigma_min(A)",
            f"{smallest:.6g} and {regressors_only[-1]:.6g}",
            "Total least squares has no unique solution here: the regressors alone explain the "
            "smallest direction. Use least squares, or more and better excited data.",
        )
    return smallest


def _cholesky(S: Square) -> Square:
    scale = np.sqrt(np.diag(S))
    if not scale.all():
        expected = "a response with noise"
        remedy = "Declare the response's noise, or exchange response and regressor."
        raise NoUniqueSolutionError(expected, "an exact response beside noisy regressors", remedy)
    try:
        return np.asarray(scale[:, None] * np.linalg.cholesky(S / np.outer(scale, scale)))
    except np.linalg.LinAlgError as error:
        expected = "a positive definite covariance of the noisy columns' errors"
        remedy = "Errors of two columns must not be exact multiples of each other; check signs and sizes."
        raise CovarianceError(expected, "one that is singular or indefinite", remedy) from error


class ErrorsInColumns(Solver):
    """Solver of problems with errors in their columns: the correction of the score."""

    def score_correction(
        self, residual: Float[np.ndarray, " rows"], theta: Vector, error_covariance: Covariance | None, /
    ) -> ScoreCorrection:
        """e_t (W theta - w) / s beside the regressors and -(e'e / s) W beside G'G."""
        S = np.eye(theta.size + 1) if error_covariance is None else error_covariance
        W, pull = S[:-1, :-1], S[:-1, :-1] @ theta - S[:-1, -1]
        weight = residual_weight(theta, S)
        power = float(residual @ residual) / weight
        return ScoreCorrection(np.outer(residual, pull / weight), -power * W)


class GeneralizedTotalLeastSquares(ErrorsInColumns):
    """Minimise ||b - A theta||^2 / ([theta; -1]' S [theta; -1]), the paper's (13) with any covariance S."""

    @abstractmethod
    def whitened_solution(self, R: Square, right: Vector, smallest: float) -> Vector:
        """Theta of (R'R - smallest^2 I) theta = R' right."""

    def solve(self, system: LinearSystem) -> Solution:
        split = split_problem(system)
        whitened = np.empty(0)
        if split.noisy.size:
            whitened = self.whitened_solution(split.R, split.right, split.smallest)
        return split.solution(split.theta(whitened))


@dataclass(frozen=True, slots=True)
class TotalLeastSquares(GeneralizedTotalLeastSquares):
    """Generalized total least squares by the SVD. O(m n^2)."""

    def whitened_solution(self, R: Square, right: Vector, smallest: float) -> Vector:
        """Theta by the SVD of R: V diag(s_i / (s_i^2 - sigma^2)) U' right."""
        U, singular, Vt = np.linalg.svd(R)
        gains = singular / ((singular - smallest) * (singular + smallest))
        return np.asarray(Vt.T @ (gains * (U.T @ right)))


@dataclass(frozen=True, slots=True)
class AugmentedTotalLeastSquares(GeneralizedTotalLeastSquares):
    """Generalized total least squares through the augmented system, the paper's (16), (27), (33)."""

    def whitened_solution(self, R: Square, right: Vector, smallest: float) -> Vector:
        if smallest == 0.0:
            return np.asarray(scipy.linalg.solve_triangular(R, right))
        return solve_augmented(R, right, smallest, smallest)


@dataclass(frozen=True, slots=True)
class Fuller(ErrorsInColumns):
    """Total least squares with less of a shift: (R'R - (sigma^2 - a/nu) I) theta = R' right (Fuller 1977)."""

    strength: float = 1.0  # a, zero for LIML

    def __post_init__(self) -> None:
        checks.between("strength", self.strength, 0.0, 1e6, "Use 1, or 4.")

    def solve(self, system: LinearSystem) -> Solution:
        if system.error_degrees is None:
            expected = "equations whose errors' covariance was estimated, on so many degrees of freedom"
            remedy = "Use the method that goes with it: eivor.methods.fuller()."
            raise UsageError(expected, "ones without", remedy)
        split = split_problem(system)
        if not split.noisy.size:
            return split.solution(split.theta(np.empty(0)))
        shift = split.smallest**2 - self.strength / system.error_degrees
        upper = balanced(split.R, shift)
        return split.solution(split.theta(solve_augmented(split.R, split.right, upper, shift / upper)))


#: Relative change of theta at which the iteration stops, and its longest run.
TOLERANCE = 1e-14
ITERATIONS = 500


def weighted_total_least_squares(system: LinearSystem, row_covariances: Covariances) -> Solution:
    """Minimise sum_t e_t^2 / w_t, w_t = [theta; -1]' S_t [theta; -1], e = b - A theta.

    At the minimum sum_t (e_t / w_t) x_t = 0 (York 1966 for a straight line). The regressors adjusted for
    their estimated errors are x_t = a_t + e_t (W_t theta - v_t) / w_t, with W_t, v_t the blocks of S_t.
    The iteration solves that equation for theta with x_t and w_t from the theta before.

    Parameters
    ----------
    system : LinearSystem
        A and b; its own error covariance is not used.
    row_covariances : ndarray, shape (m, n + 1, n + 1)
        Covariance S_t of the errors in each row of [A b].

    Raises
    ------
    ShapeError, CovarianceError
        When the covariances do not fit, or a row's residual has no variance.
    ConvergenceError
        When the iteration does not settle.
    """
    checks.kind("system", system, LinearSystem, "a LinearSystem", "Make one: LinearSystem(A, b).")
    A, b, S = system.matrix, system.right, checks.real_array("row_covariances", row_covariances)
    if S.shape != (*A.shape[:1], A.shape[1] + 1, A.shape[1] + 1):
        expected = f"covariances of shape {(A.shape[0], A.shape[1] + 1, A.shape[1] + 1)}"
        raise ShapeError(expected, f"{S.shape}", "One a row.")
    start = LeastSquares().solve(system)
    # Rows [A b] in units in which every column has length one: neither the stopping rule nor the solve
    # then depends on the user's.
    lengths = np.append(column_lengths(A), 1.0)
    A, S = A / lengths[:-1], S / np.outer(lengths, lengths)
    theta = start.theta * lengths[:-1]
    for _ in range(ITERATIONS):
        weight, adjusted = _adjusted(A, b, S, theta)
        projected = adjusted / weight[:, None]
        renewed = np.linalg.solve(projected.T @ A, projected.T @ b)
        change = float(np.max(np.abs(renewed - theta)))
        theta = renewed
        if change <= TOLERANCE * float(np.max(np.abs(theta))):
            break
    else:
        expected = f"a settled weighted total least squares iteration within {ITERATIONS} steps"
        received = f"a last relative change of {change / float(np.max(np.abs(theta))):.2g}"
        remedy = "The data hardly determine a parameter, or the weights are extreme: check the covariances."
        raise ConvergenceError(expected, received, remedy)
    residual = b - A @ theta
    weight, _ = _adjusted(A, b, S, theta)
    return Solution(theta / lengths[:-1], residual, float(np.sum(residual**2 / weight)), start.condition)


def _adjusted(A: Matrix, b: PerRow, S: Covariances, theta: Vector) -> tuple[PerRow, Matrix]:
    """Variance of each row's residual, and its regressors adjusted for their estimated errors."""
    pull = S @ np.append(theta, -1.0)
    weight = pull @ np.append(theta, -1.0)
    if not (weight > 0.0).all():
        expected = "a positive variance of every row's residual"
        remedy = "Give every row an error in the response or in a regressor."
        raise CovarianceError(expected, f"{float(weight.min()):.3g} in row {int(np.argmin(weight))}", remedy)
    residual = b - A @ theta
    return weight, A + (residual / weight)[:, None] * pull[:, :-1]
