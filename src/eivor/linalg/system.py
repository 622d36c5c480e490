"""A linear system, its solution and its triangular factor."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import chain, islice
from typing import TypeVar

import numpy as np
import scipy

from eivor import checks
from eivor.errors import NonFiniteError, ShapeError, TooFewSamplesError
from eivor.tools import Float

Block = TypeVar("Block")
Result = TypeVar("Result")

#: Rows that pass through several steps: a dozen columns of them fit in a second-level cache.
PASSED_ROWS = 16_384
#: Rows that are multiplied with each other: a few columns of them fit.
MULTIPLIED_ROWS = 32_768
#: Rows that are copied at once: calls cost nothing, and the copy is small.
COPIED_ROWS = 65_536
#: Columns that LAPACK reduces at a time.
BLOCKED = 32
#: Fewer blocks are not worth threads.
THREADED_FROM = 8


def row_blocks(first: int, stop: int, size: int) -> Iterator[tuple[int, int]]:
    """First row of each block from `first` to `stop`, and the row after its last."""
    for start in range(first, stop, size):
        yield start, min(start + size, stop)


def map_ahead(make: Callable[[Block], Result], blocks: Iterable[Block]) -> Iterator[Result]:
    """Results of each block, in order; of many blocks by threads, a few ahead of their use."""
    remaining = iter(blocks)
    first = list(islice(remaining, THREADED_FROM))
    if len(first) < THREADED_FROM:
        yield from map(make, first)
        return
    # with what logs, which short records do without
    from concurrent.futures import Future, ThreadPoolExecutor

    workers = os.cpu_count() or 1
    with ThreadPoolExecutor(workers) as pool:
        waiting: deque[Future[Result]] = deque()
        for block in chain(first, remaining):
            waiting.append(pool.submit(make, block))
            if len(waiting) > workers:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()


def triangular_root(rows: Float[np.ndarray, "m n"]) -> Float[np.ndarray, "k n"]:
    """R of the QR factorisation of `rows`, k = min(m, n): R'R = rows' rows, and no condition is squared."""
    m, n = rows.shape
    if m > 2 * COPIED_ROWS:
        root = rows[:0]
        for first, stop in row_blocks(0, m, COPIED_ROWS):
            root = merged_roots(root, rows[first:stop])
        return root
    if not rows.size:
        return np.zeros((0, n))
    root = np.array(scipy.linalg.lapack.dgeqrf(rows, lwork=BLOCKED * n)[0][:n], order="C")
    for column in range(min(m - 1, n)):
        root[column + 1 :, column] = 0.0
    return root


def merged_roots(
    first: Float[np.ndarray, "k n"], second: Float[np.ndarray, "m n"]
) -> Float[np.ndarray, "q n"]:
    """Root of two stacked blocks of rows, either of which may be a root itself."""
    return triangular_root(np.concatenate([first, second]))


def orthogonal_factors(
    rows: Float[np.ndarray, "m n"],
) -> tuple[Float[np.ndarray, "m n"], Float[np.ndarray, "n n"]]:
    """Q and R of at least as many rows as columns."""
    factored, scales, _, _ = scipy.linalg.lapack.dgeqrf(rows)
    return scipy.linalg.lapack.dorgqr(factored, scales)[0], np.triu(factored[: rows.shape[1]])


def symmetric_eigen(
    matrix: Float[np.ndarray, "n n"],
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n n"]]:
    """Eigenvalues of a small symmetric matrix, ascending, and eigenvectors."""
    values, vectors, failed = scipy.linalg.lapack.dsyevd(matrix, lower=True)
    if failed:
        raise np.linalg.LinAlgError("eigenvalues did not converge")
    return values, vectors


@dataclass(frozen=True, slots=True)
class LinearSystem:
    """Equations A theta = b, usually more of them than unknowns."""

    matrix: Float[np.ndarray, "m n"]
    right: Float[np.ndarray, " m"]
    error_covariance: Float[np.ndarray, "n_plus_1 n_plus_1"] | None = None  # [A b]
    count: float | None = None  # Number of equations that these are a triangular root of
    error_degrees: float | None = None  # Degrees of freedom that the error covariance was estimated on

    def __post_init__(self) -> None:
        for name in ("matrix", "right", "error_covariance"):
            values = getattr(self, name)
            if values is not None or name != "error_covariance":
                object.__setattr__(self, name, checks.real_array(name, values))
        if self.matrix.ndim != 2:
            remedy = "Stack columns with column_stack."
            raise ShapeError("a matrix with two dimensions", f"shape {self.matrix.shape}", remedy)
        rows, unknowns = self.matrix.shape
        covariance = self.error_covariance
        if self.right.shape != (rows,) or (
            covariance is not None and covariance.shape != (unknowns + 1, unknowns + 1)
        ):
            raise ShapeError(
                f"{rows} right-hand sides and an error covariance of {unknowns + 1} columns for a "
                f"{rows} x {unknowns} matrix",
                f"{self.right.shape} and {None if covariance is None else covariance.shape}",
                "Check the shapes.",
            )
        if rows < unknowns:
            expected = f"at least {unknowns} equations for {unknowns} unknowns"
            raise TooFewSamplesError(expected, f"{rows}", "Give more samples or more instruments.")
        if not (np.isfinite(self.matrix).all() and np.isfinite(self.right).all()):
            remedy = "Repair or mask the samples they come from."
            raise NonFiniteError("finite equations", "NaN or infinity", remedy)

    @property
    def equations(self) -> float:
        """Number of equations, of all that a root stands for."""
        return float(self.matrix.shape[0]) if self.count is None else self.count


@dataclass(frozen=True, slots=True)
class Shrinkage:
    """Effect of regularisation on a solution."""

    choice: str
    parameter: float
    kept: float  # Number of parameters that are left, of n
    shift: Float[np.ndarray, " n"]  # Theta less the solution that is not regularised


@dataclass(frozen=True, slots=True)
class Solution:
    """Solution of a linear system."""

    theta: Float[np.ndarray, " n"]
    residual: Float[np.ndarray, " m"]  # b - A theta
    objective: float
    condition: float  # Condition number of the matrix after columns were scaled to unit length
    shrinkage: Shrinkage | None = None


@dataclass(frozen=True, slots=True)
class ScoreCorrection:
    """Corrections of a direct method's test functions and of the sensitivity of its score."""

    rows: Float[np.ndarray, "rows n"]  # Added to the regressors
    sensitivity: Float[np.ndarray, "n n"]  # Added to G'G


class Solver(ABC):
    """One way to solve a `LinearSystem`."""

    @abstractmethod
    def solve(self, system: LinearSystem) -> Solution:
        """Solution of `system`."""

    def objectives(self, systems: Float[np.ndarray, "systems m n_plus_1"]) -> Float[np.ndarray, " systems"]:
        """Objectives of many systems [A b] of one size. Performs no checks."""
        return np.array(
            [self.solve(LinearSystem(system[:, :-1], system[:, -1])).objective for system in systems]
        )

    def score_correction(
        self,
        residual: Float[np.ndarray, " rows"],
        theta: Float[np.ndarray, " n"],
        _error_covariance: Float[np.ndarray, "n_plus_1 n_plus_1"] | None,
        /,
    ) -> ScoreCorrection:
        """Correction of the score of least squares, for direct equations; zero by default."""
        return ScoreCorrection(np.zeros((residual.size, theta.size)), np.zeros((theta.size, theta.size)))
