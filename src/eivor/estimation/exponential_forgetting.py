"""Moment products and covariances with exponential forgetting."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.linalg

from eivor import checks
from eivor.errors import InstrumentError, UsageError
from eivor.estimation.estimate import Candidate
from eivor.estimation.moments import Assembler, CrossMoments
from eivor.inference.covariance import COSINE_AVERAGES, CovariancePart, JointCovariance
from eivor.inference.products import ProductLayout, Products
from eivor.linalg.system import PASSED_ROWS, row_blocks
from eivor.models.regression import RowBlock
from eivor.models.signal_regression import SignalRegression, shared_noise_of_rows
from eivor.tools import Bool, Float

# -- Forgetting --

#: Memory [samples] when none is chosen: a factor of 0.995.
DEFAULT_MEMORY = 200.0
#: Shortest and longest memory [samples]: rows of a block wait in arrays, and a block is a part of the memory.
MEMORIES = (10.0, 1e7)
#: Blocks that a memory is divided into, and memories whose blocks are kept apart: older ones count e^-8.
BLOCKS_PER_MEMORY, MEMORIES_KEPT = 24, 8
#: Blocks that a change is looked for in at once: an eighth of the memory.
BLOCKS_PER_LOOK = 3


@dataclass(frozen=True, slots=True)
class Forgetting:
    """How fast rows are forgotten."""

    memory: float = DEFAULT_MEMORY  # Sum of the weights of all rows before, 1 / (1 - lambda) [samples]

    def __post_init__(self) -> None:
        checks.number("memory", self.memory)
        least, most = MEMORIES
        if not least <= self.memory <= most:
            raise UsageError(
                f"a memory of {least:g} to {most:g} samples",
                f"{self.memory:g}",
                "It is 1 / (1 - lambda): 200 for a forgetting factor of 0.995.",
            )

    @property
    def factor(self) -> float:
        """Weight of a row over that of the row after it, lambda."""
        return 1.0 - 1.0 / self.memory

    @property
    def effective_rows(self) -> float:
        """Rows of equal weight whose mean scatters as much."""
        return (1.0 + self.factor) / (1.0 - self.factor)

    @property
    def block(self) -> int:
        """Samples of a block."""
        return max(int(self.memory / BLOCKS_PER_MEMORY), 1)

    @property
    def kept_blocks(self) -> int:
        """Blocks that are kept apart."""
        return int(np.ceil(MEMORIES_KEPT * self.memory / self.block))

    @property
    def block_length(self) -> int:
        """Samples that a change is looked for in at once."""
        return self.block * BLOCKS_PER_LOOK

    def weights(self, count: int) -> Float[np.ndarray, " count"]:
        """Weights of successive samples after the last of them."""
        return self.factor ** np.arange(count - 1, -1, -1.0)


# -- Timed rows --

#: Places (instrument, column) of a table of noises that vary from row to row.
NoiseIndices = tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class TimedRows:
    """Rows of successive samples."""

    psi: Float[np.ndarray, "samples p"]
    right: Float[np.ndarray, "samples n_plus_1"]  # Regressors and response
    noise: Float[np.ndarray, "samples s"]
    counted: Float[np.ndarray, " samples"]
    noise_indices: NoiseIndices = ()  # Row and column of each noise

    @property
    def count(self) -> int:
        """Samples, those among them that do not count."""
        return self.counted.size

    @cached_property
    def columns(self) -> Float[np.ndarray, "samples columns"]:
        """[psi right noise counted]."""
        return np.column_stack([self.psi, self.right, self.noise, self.counted])

    def from_columns(self, columns: Float[np.ndarray, "samples columns"]) -> TimedRows:
        """Other rows of the same columns."""
        ends = np.cumsum([self.psi.shape[1], self.right.shape[1], self.noise.shape[1]])
        psi, right, noise, counted = np.split(columns, ends, axis=1)
        return replace(self, psi=psi, right=right, noise=noise, counted=counted[:, 0])

    def between(self, start: int, stop: int) -> TimedRows:
        """Rows of a stretch of samples."""
        here = slice(start, stop)
        return replace(
            self,
            psi=self.psi[here],
            right=self.right[here],
            noise=self.noise[here],
            counted=self.counted[here],
        )

    def then(self, other: TimedRows) -> TimedRows:
        """Rows of both, one after the other."""
        if not self.count:
            return other
        return self.from_columns(np.concatenate([self.columns, other.columns]))

    def stretches(self, first: int, look: int) -> Iterator[TimedRows]:
        """Stretches that end where a multiple of `look` samples is full, of which `first` came before."""
        start = 0
        while start < self.count:
            stop = min(start + look - (first + start) % look, self.count)
            yield self.between(start, stop)
            start = stop


def timed_rows(problem: SignalRegression, assembler: Assembler) -> Iterator[TimedRows]:
    """Rows of signals, stretch by stretch."""
    if assembler.plain_products and problem.instruments_share_noise():
        raise InstrumentError(
            "instruments whose measurement noise no regressor and no response shares",
            "an instrument of the same channel and lag as a noisy regressor",
            "Use lags from 1 on, another channel, or generalized_iv.",
        )
    signals, first = problem.signals, problem.first
    if signals.sample_count <= first:
        return
    tested = problem.instrument_columns if assembler.needs_instruments else problem.regressor_columns
    right = (*problem.regressor_columns, problem.equation.response)
    noises = shared_noise_of_rows(tested, right, signals, first) if assembler.compensates else {}
    for start, stop in row_blocks(first, signals.sample_count, PASSED_ROWS):
        here = slice(start - first, stop - first)
        used = np.ones(stop - start, dtype=np.bool_) if problem.used is None else problem.used[here]
        block = RowBlock(
            problem.samples_between([problem.equation.response], start, stop)[:, 0],
            problem.samples_between(problem.regressor_columns, start, stop),
            problem.samples_between(problem.instrument_columns, start, stop),
            np.zeros(stop - start, dtype=np.int64),
        )
        noise = np.stack([noises[item][here] for item in noises], axis=1) if noises else used[:, None][:, :0]
        yield counted_rows(
            assembler.test_functions(block),
            np.column_stack([block.regressors, block.response]),
            noise.astype(np.float64),
            used,
            tuple(noises),
        )


def counted_rows(
    psi: Float[np.ndarray, "samples p"],
    right: Float[np.ndarray, "samples n_plus_1"],
    noise: Float[np.ndarray, "samples s"],
    used: Bool[np.ndarray, " samples"],
    positions: NoiseIndices = (),
) -> TimedRows:
    """Rows with zeros where a sample does not count, whatever stands there."""
    if not used.all():
        psi, right, noise = (np.where(used[:, None], part, 0.0) for part in (psi, right, noise))
    return TimedRows(psi, right, noise, used.astype(np.float64), positions)


# -- Exponentially weighted products --


@dataclass(frozen=True)
class WeightedBlockSums:
    """Weighted sums of blocks of rows. Performs no checks."""

    products: Products
    noise: Float[np.ndarray, "K s"]
    squares: Float[np.ndarray, " K"]  # Sums of squared weights

    @property
    def blocks(self) -> int:
        """How many."""
        return self.squares.size

    def __add__(self, other: WeightedBlockSums) -> WeightedBlockSums:
        """Blocks of both, one after the other."""
        return WeightedBlockSums(
            self.products + other.products,
            np.concatenate([self.noise, other.noise]),
            np.concatenate([self.squares, other.squares]),
        )

    def between(self, start: int, stop: int) -> WeightedBlockSums:
        """Some of the blocks."""
        here = slice(start, stop)
        products = replace(self.products, counts=self.products.counts[here], sums=self.products.sums[here])
        return WeightedBlockSums(products, self.noise[here], self.squares[here])

    def weighted(self, factors: Float[np.ndarray, " K"]) -> WeightedBlockSums:
        """One sum of all, each block with a factor."""
        return WeightedBlockSums(
            self.products.weighted(factors),
            (factors @ self.noise)[None, :],
            np.array([factors**2 @ self.squares]),
        )


def sums_of_rows(rows: TimedRows, forgetting: Forgetting, length: int, *, whole: bool) -> WeightedBlockSums:
    """Sums of blocks of `length` rows each, weighted to the end of each block."""
    weights = forgetting.weights(length)
    blocks = rows.count // max(length, 1)
    left, right, noise = (
        part.reshape(blocks, length, part.shape[1]) for part in (rows.psi, rows.right, rows.noise)
    )
    if whole:
        left = right = np.concatenate([left, right], axis=2)
    sums = np.matmul((left * weights[:, None]).swapaxes(1, 2), right)
    counted = rows.counted.reshape(blocks, length)
    layout = ProductLayout(rows.psi.shape[1], rows.right.shape[1] - 1, whole)
    return WeightedBlockSums(
        Products(counted @ weights, sums, layout),
        np.tensordot(noise, weights, (1, 0)),
        counted @ weights**2,
    )


@dataclass(frozen=True)
class ExponentiallyWeightedProducts:
    """Products of all rows so far, exponentially weighted."""

    forgetting: Forgetting
    whole: bool
    full: WeightedBlockSums
    closed: WeightedBlockSums
    waiting: TimedRows  # Rows of the block that is not full yet
    samples: int = 0  # Samples so far, those among them that did not count

    def then(self, rows: TimedRows) -> ExponentiallyWeightedProducts:
        """With the rows that follow."""
        length = self.forgetting.block
        joined = self.waiting.then(rows)
        full = joined.count // length * length
        seen = replace(self, waiting=joined.between(full, joined.count), samples=self.samples + rows.count)
        if not full:
            return seen
        sums = sums_of_rows(joined.between(0, full), self.forgetting, length, whole=self.whole)
        products = np.append(self.forgetting.factor**full, self._block_factors(sums.blocks))
        closed = self.closed + sums
        first = max(closed.blocks - self.forgetting.kept_blocks, 0)
        return replace(
            seen, full=(self.full + sums).weighted(products), closed=closed.between(first, closed.blocks)
        )

    def last(self, blocks: int) -> ExponentiallyWeightedProducts:
        """The same with the last full blocks only, and the rows that wait: all else is forgotten."""
        kept = self.closed.between(max(self.closed.blocks - blocks, 0), self.closed.blocks)
        return replace(self, full=kept.weighted(self._block_factors(kept.blocks)), closed=kept)

    def _block_factors(self, blocks: int) -> Float[np.ndarray, " blocks"]:
        """Weights of successive full blocks at the end of the last."""
        ages = np.arange(blocks - 1, -1, -1.0)
        return self.forgetting.factor ** (self.forgetting.block * ages)

    @cached_property
    def _waiting_sums(self) -> WeightedBlockSums:
        return sums_of_rows(self.waiting, self.forgetting, self.waiting.count, whole=self.whole)

    @property
    def _since(self) -> float:
        """Weight of the last full block's end now."""
        return self.forgetting.factor**self.waiting.count

    @cached_property
    def recent(self) -> tuple[WeightedBlockSums, Float[np.ndarray, " K"]]:
        """Blocks that are kept apart, rows that wait as one of them."""
        factors = self._since * self._block_factors(self.closed.blocks)
        if not self.waiting.count:
            return self.closed, factors
        return self.closed + self._waiting_sums, np.append(factors, 1.0)

    @cached_property
    def total(self) -> WeightedBlockSums:
        """One sum of all rows, with the weights that they have now."""
        if not self.waiting.count:
            return self.full
        return (self.full + self._waiting_sums).weighted(np.array([self._since, 1.0]))

    @property
    def effective_rows(self) -> float:
        """Rows of equal weight whose mean scatters as much as that of all rows so far."""
        count, squares = self.total.products.count, float(self.total.squares[0])
        return count**2 / squares if squares > 0.0 else 0.0

    @property
    def moments(self) -> CrossMoments:
        """Weighted means; performs no check that there are rows."""
        total = self.total
        return CrossMoments(total.products, self.noise_table(total)[0] / total.products.count)

    def noise_table(self, sums: WeightedBlockSums) -> Float[np.ndarray, "K p n_plus_1"]:
        """What noises add to the products psi [phi' y] of blocks."""
        layout = sums.products.layout
        table = np.zeros((sums.blocks, layout.instruments, layout.regressors + 1))
        for number, noise_index in enumerate(self.waiting.noise_indices):
            table[:, *noise_index] = sums.noise[:, number]
        return table

    def compensated(self, sums: WeightedBlockSums) -> Float[np.ndarray, "K p n_plus_1"]:
        """Sums of psi [phi' y] of blocks, without what noises add to them."""
        return sums.products.equations - self.noise_table(sums)

    def scores(self, sums: WeightedBlockSums, theta: Float[np.ndarray, " n"]) -> Float[np.ndarray, "K p"]:
        """What an estimate leaves of each block: compensated sums of psi times the residual."""
        left = self.compensated(sums)
        return left[:, :, -1] - left[:, :, :-1] @ theta


def nothing_yet(rows: TimedRows, forgetting: Forgetting, *, whole: bool) -> ExponentiallyWeightedProducts:
    """Products of no rows, with the columns of some."""
    none = rows.between(0, 0)
    empty = sums_of_rows(none, forgetting, forgetting.block, whole=whole)
    return ExponentiallyWeightedProducts(forgetting, whole, _zero(empty), empty, none)


def _zero(sums: WeightedBlockSums) -> WeightedBlockSums:
    """One block of nothing."""
    layout = sums.products.layout
    products = Products(np.zeros(1), np.zeros((1, *layout.shape)), layout)
    return WeightedBlockSums(products, np.zeros((1, sums.noise.shape[1])), np.zeros(1))


# -- Exponentially weighted covariance --


def equation_map(solved: Candidate) -> Float[np.ndarray, "n p"]:
    """Return what a change of the mean scores changes the solution by, to first order: (A'WA)^-1 A'W."""
    A, factor = solved.system.matrix, solved.factor
    if factor is not None:
        A = scipy.linalg.solve_triangular(factor, A, lower=True)
    Q, R = np.linalg.qr(A)
    if factor is not None:
        Q = scipy.linalg.solve_triangular(factor, Q, lower=True, trans="T")
    return scipy.linalg.solve_triangular(R, Q.T)


def exponentially_weighted_covariance(
    exponentially_weighted_products: ExponentiallyWeightedProducts,
    theta: Float[np.ndarray, " n"],
    mapped: Float[np.ndarray, "n p"],
) -> JointCovariance:
    """Covariance of an estimate from exponentially weighted products."""
    scores, weights, leaks = _weighted_blocks(exponentially_weighted_products, theta, mapped)
    count = exponentially_weighted_products.total.products.count
    rows = scores / count
    cosines = _cosines(weights, leaks)
    averages = cosines.T @ rows
    used = averages.shape[0]
    power = float(weights @ weights)
    meat = power * (averages.T @ averages) / max(used, 1)
    weighted = weights[:, None] * rows
    single = weighted.T @ weighted
    effective = power**2 / float(np.sum(weights**4)) if power > 0.0 else 0.0
    degrees = max(effective - theta.size, 0.0)
    single = single * (effective / degrees if degrees > 0.0 else 1.0)
    return JointCovariance(
        (
            CovariancePart("equal_weighted_cosines", meat, float(used)),
            CovariancePart("blocks", single, degrees),
        )
    )


def _weighted_blocks(
    exponentially_weighted_products: ExponentiallyWeightedProducts,
    theta: Float[np.ndarray, " n"],
    mapped: Float[np.ndarray, "n p"],
) -> tuple[Float[np.ndarray, "K n"], Float[np.ndarray, " K"], Float[np.ndarray, " K"]]:
    """Scores of unit variance, weights and sensitivities of the blocks that have rows and are kept apart."""
    blocks, factors = exponentially_weighted_products.recent
    filled = blocks.squares > 0.0
    size = np.sqrt(np.where(filled, blocks.squares, 1.0))
    scores = exponentially_weighted_products.scores(blocks, theta) @ mapped.T / size[:, None]
    return scores[filled], (factors * size)[filled], (blocks.products.counts / size)[filled]


def _cosines(
    weights: Float[np.ndarray, " K"], leaks: Float[np.ndarray, " K"]
) -> Float[np.ndarray, "K averages"]:
    """Orthonormal cosines over the weights' own time, orthogonal to the weights and to the leaks."""
    averages = min(COSINE_AVERAGES, weights.size - 2)
    if averages < 1:
        return np.zeros((weights.size, 0))
    shares = weights**2
    time = (np.cumsum(shares) - 0.5 * shares) / shares.sum()
    waves = np.cos(np.pi * np.arange(1, averages + 1) * time[:, None])
    Q, _ = np.linalg.qr(np.column_stack([weights, leaks, weights[:, None] * waves]))
    return Q[:, 2:]
