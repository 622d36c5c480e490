"""Estimating equations at a solution, and products of residuals and instruments there."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from eivor.errors import CollinearError, UsageError
from eivor.linalg.system import MULTIPLIED_ROWS, row_blocks
from eivor.tools import Float, Int


@dataclass(frozen=True)
class EquationRows:
    """Successive rows of an estimating equation, in coordinates of its own."""

    test_functions: Float[np.ndarray, "rows n"]
    residual: Float[np.ndarray, " rows"]
    scores: Float[np.ndarray, "samples n"]  # Terms of the equation in time order
    flight_of_row: Int[np.ndarray, " rows"]
    constant: Float[np.ndarray, " n"] | None = None


@dataclass(frozen=True)
class EstimatingEquation:
    """Sensitivity of an estimating equation, and its rows."""

    root: Float[np.ndarray, "n n"]  # R, upper triangular
    slope: Float[np.ndarray, "n n"]
    sample_count: int  # Number of scores
    blocks: Callable[[], Iterable[EquationRows]]
    #: Priors' part of the covariance of the sum of scores.
    prior_covariance: Float[np.ndarray, "n n"] | float = 0.0
    move: Float[np.ndarray, " n"] | None = None

    @property
    def unknowns(self) -> int:
        """Length of the joint vector, n."""
        return self.root.shape[0]

    @property
    def sensitivity(self) -> Float[np.ndarray, "n n"]:
        """M, minus the derivative of the sum of the method's own scores by the joint vector."""
        return np.asarray(self.root.T @ self.slope)

    @cached_property
    def rows(self) -> EquationRows:
        """All rows at once, in orthonormal coordinates."""
        parts = list(self.blocks())
        if len(parts) == 1:
            return parts[0]
        names = ("test_functions", "residual", "scores", "flight_of_row")
        joined = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
        return EquationRows(**joined, constant=parts[0].constant)

    @property
    def test_functions(self) -> Float[np.ndarray, "rows n"]:
        """The method's own test functions of all rows."""
        return np.asarray(self.rows.test_functions @ self.root)

    @property
    def residual(self) -> Float[np.ndarray, " rows"]:
        """Residual e of all rows."""
        return self.rows.residual

    @property
    def scores(self) -> Float[np.ndarray, "samples n"]:
        """The method's own scores of all samples, in time order."""
        return np.asarray(self.rows.scores @ self.root)

    @cached_property
    def variance(self) -> float:
        """Residual variance s^2 on rows - n degrees of freedom."""
        count, power = 0, 0.0
        for rows in self.blocks():
            count += rows.residual.size
            power += float(rows.residual @ rows.residual)
        return power / max(count - self.unknowns, 1)


def singular_sensitivity() -> CollinearError:
    """Refusal of equations that do not distinguish the parameters from one another."""
    received = "equations that one of them, or a combination of them, hardly enters"
    remedy = "Give data in which response and regressors move, each in its own way."
    return CollinearError("equations that distinguish every parameter from the others", received, remedy)


#: Blocks shorter than this many rows are multiplied many at once.
SHORT_BLOCK = 64


@dataclass(frozen=True)
class Products:
    """Sums of products of [psi phi y] over successive blocks of rows."""

    counts: Float[np.ndarray, " K"]  # Rows in each block
    sums: Float[np.ndarray, "K left right"]
    tested: int  # Number of instruments psi

    @property
    def equations(self) -> Float[np.ndarray, "K p n_plus_1"]:
        """Psi [phi' y] of each block."""
        return self.sums[:, : self.tested, self.tested :]

    @property
    def cross(self) -> Float[np.ndarray, "K p n"]:
        """Psi phi' of each block."""
        return self.equations[:, :, :-1]

    @property
    def instrument_response(self) -> Float[np.ndarray, "K p"]:
        """Psi y of each block; psi e at an estimate."""
        return self.equations[:, :, -1]

    @property
    def instruments(self) -> Float[np.ndarray, "K p p"]:
        """Psi psi' of each block."""
        return self.sums[:, : self.tested, : self.tested]

    @property
    def columns(self) -> Float[np.ndarray, "K n_plus_1 n_plus_1"]:
        """[phi y] [phi' y] of each block."""
        return self.sums[:, self.tested :, self.tested :]

    @property
    def power(self) -> Float[np.ndarray, " K"]:
        """y^2 of each block; e^2 at an estimate."""
        return self.columns[:, -1, -1]

    @cached_property
    def count(self) -> float:
        """Rows in all blocks."""
        return float(self.counts.sum())

    @cached_property
    def mean(self) -> Float[np.ndarray, "left right"]:
        """Mean over the rows of all blocks."""
        return np.asarray(self.sums.sum(axis=0) / self.count)

    @property
    def total(self) -> Products:
        """One block with all rows."""
        return replace(self, counts=self.counts.sum(keepdims=True), sums=self.sums.sum(axis=0, keepdims=True))

    def __add__(self, other: Products) -> Products:
        """Blocks of both, one after the other."""
        sizes = [(item.tested, *item.sums.shape[1:]) for item in (self, other)]
        if sizes[0] != sizes[1]:
            expected, received = (f"products of {p} instruments, {m} by {n}" for p, m, n in sizes)
            raise UsageError(expected, received, "Add the products of one problem.")
        counts, sums = np.concatenate([self.counts, other.counts]), np.concatenate([self.sums, other.sums])
        return replace(self, counts=counts, sums=sums)

    def resampled(self, blocks: Int[np.ndarray, " k"]) -> Products:
        """One block, with the rows of the drawn blocks, with repetitions."""
        return self.weighted(np.bincount(blocks, minlength=self.counts.size).astype(np.float64))

    def weighted(self, weights: Float[np.ndarray, " F"]) -> Products:
        """Sum of stretches of successive blocks, in which each stretch counts as often as its weight says."""
        counts = np.tensordot(weights, self.counts.reshape(weights.size, -1), 1)
        sums = np.tensordot(weights, self.sums.reshape(weights.size, -1, *self.sums.shape[1:]), 1)
        return replace(self, counts=counts, sums=sums)

    def with_residual(self, theta: Float[np.ndarray, " n"]) -> Products:
        """The same with the residual y - Phi theta in the response's place."""
        turned = np.eye(self.sums.shape[2])
        turned[-1 - theta.size : -1, -1] = -theta
        return replace(self, sums=turned.T @ self.sums @ turned)


def block_edges(rows: int, blocks: int) -> Int[np.ndarray, " blocks_plus_1"]:
    """First row of each of `blocks` blocks that differ by one row at most, and the end."""
    return np.asarray((np.arange(blocks + 1) * rows) // blocks)


def products_of_rows(
    instruments: Float[np.ndarray, "rows p"],
    regressors: Float[np.ndarray, "rows n"],
    response: Float[np.ndarray, " rows"],
    *,
    edges: Int[np.ndarray, " K_plus_1"],
) -> Products:
    """Products of rows in arrays. Performs no checks."""
    p, parts, counts = instruments.shape[1], (instruments, regressors, response[:, None]), np.diff(edges)
    width = p + regressors.shape[1] + 1
    sums = np.zeros((counts.size, width, width))
    if counts.size and counts.max() < SHORT_BLOCK:
        # all blocks at once, as if they had rows of zeros that they lack
        columns = np.zeros((len(response) + 1, width))
        np.concatenate(parts, axis=1, out=columns[:-1])
        row = edges[:-1, None] + np.arange(counts.max())
        rows = columns[np.where(row < edges[1:, None], row, len(response))]
        np.matmul(rows.swapaxes(1, 2).copy(), rows, out=sums)
        return Products(counts.astype(np.float64), sums, p)
    for k, ends in enumerate(pairwise(edges.tolist())):
        for stretch in row_blocks(*ends, MULTIPLIED_ROWS):
            columns = np.column_stack([part[slice(*stretch)] for part in parts])
            sums[k] += columns.T @ columns
    return Products(counts.astype(np.float64), sums, p)
