"""Data that come in chunks: their moments, identification from them, and exponential forgetting."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from eivor import checks
from eivor.errors import TooFewSamplesError, UsageError
from eivor.estimation.estimate import Estimate, estimating_equation
from eivor.estimation.linear import LinearMethod, check_method
from eivor.estimation.methods import identify
from eivor.estimation.moments import Assembler, CrossMoments, ProblemMoments
from eivor.inference import covariance as cov
from eivor.inference.estimating_equation import Products
from eivor.linalg.system import PASSED_ROWS, row_blocks
from eivor.models.regression import Column, RowBlock, check_columns
from eivor.models.signal_regression import SignalModel, SignalRegression, shared_noise_of_rows
from eivor.signals.signals import Signals
from eivor.tools import Bool, Float


def moments(
    chunks: Iterable[Signals],
    *,
    model: SignalModel,
    method: LinearMethod,
    instruments: tuple[Column, ...] = (),
) -> ProblemMoments:
    """Moments of one record that is given in chunks.

    Parameters
    ----------
    chunks : iterable of Signals
        Successive stretches of one record, in order, with the same channels and rate. Each chunk's rows
        reach back into the chunk before it as far as the largest lag.
    model : SignalModel
        The equation, such as `eivor.VerticalMotion`.
    method : LinearMethod
        Its assembler says which moments to keep.
    instruments : tuple of Column
        Such as ``lags("input", 0, 10)``.

    Returns
    -------
    ProblemMoments
        Equal, but for rounding, to the moments of the whole record. Memory is that of one chunk.

    Raises
    ------
    UsageError
        When chunks differ in channels or rate.
    TooFewSamplesError
        When there is no row.
    """
    check_chunked(model, method, instruments)
    checks.kind("chunks", chunks, Iterable, "several Signals", "Give [signals], or ev.read_chunks(file).")
    total: ProblemMoments | None = None
    for problem in chunk_problems(chunks, model=model, instruments=instruments):
        result = ProblemMoments(problem.parameters, method.moments(problem))
        total = result if total is None else total.merge(result)
    if total is None:
        remedy = "Give longer chunks, or fewer lags."
        raise TooFewSamplesError("chunks with more samples than the largest lag", "none", remedy)
    return total


def check_chunked(model: object, method: object, instruments: object) -> None:
    """Refuse arguments of other types than a model, a method and columns."""
    check_method(method)
    checks.kind("model", model, SignalModel, "a model", "Make one: ev.VerticalMotion().")
    check_columns("instruments", instruments)


def chunk_problems(
    chunks: Iterable[Signals], *, model: SignalModel, instruments: tuple[Column, ...]
) -> Iterator[SignalRegression]:
    """Problem of each chunk that has rows, with the samples before it that lags need."""
    lag, joined = model.regression_lag(instruments), None
    for chunk in chunks:
        checks.kind("a chunk", chunk, Signals, "Signals", "Give the stretches of one record in their order.")
        joined = chunk if joined is None else continued(joined, chunk, lag)
        problem = model.regression(joined, instruments)
        if joined.sample_count > problem.first and (problem.used is None or problem.used.any()):
            yield problem


def last_samples(signals: Signals, count: int) -> Signals:
    """Last samples of signals."""
    start = max(signals.sample_count - count, 0)
    return replace(
        signals,
        channels={name: values[start:].copy() for name, values in signals.channels.items()},
        valid=None if signals.valid is None else signals.valid[start:].copy(),
        start_s=signals.start_s + start * signals.step_s,
        offset=signals.offset + start,
    )


def continued(previous: Signals, chunk: Signals, lag: int) -> Signals:
    """Chunk with the last `lag` samples before it."""
    if chunk.rate_hz != previous.rate_hz or set(chunk.channels) != set(previous.channels):
        expected = f"chunks of one record: {previous.rate_hz:g} Hz, {', '.join(sorted(previous.channels))}"
        received = f"a chunk of {chunk.rate_hz:g} Hz with {', '.join(sorted(chunk.channels))}"
        raise UsageError(expected, received, "Give the chunks of one record in their order.")
    follows = previous.offset + previous.sample_count
    if chunk.offset not in (0, follows):
        expected = f"a chunk that begins where the one before it ends, at sample {follows}"
        remedy = "Give every chunk, in order; mark samples that are missing as not valid."
        raise UsageError(expected, f"one that says it begins at sample {chunk.offset}", remedy)
    end = last_samples(previous, lag)
    valid = None
    if end.valid is not None or chunk.valid is not None:
        valid = np.concatenate(
            [np.ones(s.sample_count, dtype=np.bool_) if s.valid is None else s.valid for s in (end, chunk)]
        )
    channels = {name: np.concatenate([end.channels[name], values]) for name, values in chunk.channels.items()}
    return replace(chunk, channels=channels, valid=valid, start_s=end.start_s, offset=end.offset)


def identify_chunks(
    chunks: Callable[[], Iterable[Signals]],
    *,
    model: SignalModel,
    method: LinearMethod,
    instruments: tuple[Column, ...] = (),
    covariance: cov.CovarianceEstimator = cov.DEFAULT,
) -> Estimate:
    """Estimate the parameters of a record that is given in chunks, with intervals.

    Parameters
    ----------
    chunks : callable
        Gives the chunks, in order, as `eivor.moments` takes them; each call starts anew, as in
        ``lambda: read_chunks("flight.parquet")``. The first pass makes the estimate; robust covariances
        need its residuals, hence a second one, and instrumental methods a third.
    model, method, instruments : SignalModel, LinearMethod, tuple of Column
        See `eivor.moments`.
    covariance : CovarianceEstimator
        One of `eivor.covariances`.

    Returns
    -------
    Estimate
        With the values and intervals of the whole record, but for rounding; residuals are not kept.
        Memory is that of one chunk, unless the covariance is a kernel without an end.

    Raises
    ------
    UsageError
        When a later pass has other rows than the first, chunks differ in channels or rate, or the
        method's weighting needs all rows at once.
    TooFewSamplesError
        When there is no row.
    """
    check_chunked(model, method, instruments)
    cov.check_covariance_estimator(covariance)
    remedy = "Give lambda: ev.read_chunks(file, ...), for example."
    checks.function("a function that gives the chunks anew in every pass", chunks, remedy)
    first = moments(chunks(), model=model, method=method, instruments=instruments)
    estimate = identify(first, method)
    total = first.moments

    def blocks() -> Iterator[RowBlock]:
        size = 0
        for problem in chunk_problems(chunks(), model=model, instruments=instruments):
            for block in problem.blocks():
                size += block.response.size
                yield block
        if size != total.rows:
            expected = f"chunks of {total.rows:.0f} rows in every pass"
            remedy = "Give a function that starts the same chunks anew each time it is called."
            raise UsageError(expected, f"{size} in a later one", remedy)

    return replace(estimate, streamed_covariance=covariance.joint(estimating_equation(estimate, blocks)))


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
        shortest, longest = MEMORIES
        if not shortest <= self.memory <= longest:
            remedy = "It is 1 / (1 - lambda): 200 for a forgetting factor of 0.995."
            raise UsageError(f"a memory of {shortest:g} to {longest:g} samples", f"{self.memory:g}", remedy)

    @property
    def factor(self) -> float:
        """Weight of a row over that of the row after it, lambda."""
        return 1.0 - 1.0 / self.memory

    @property
    def block(self) -> int:
        """Samples of a block."""
        return max(int(self.memory / BLOCKS_PER_MEMORY), 1)

    @property
    def block_length(self) -> int:
        """Samples that a change is looked for in at once."""
        return self.block * BLOCKS_PER_LOOK

    def weights(self, count: int) -> Float[np.ndarray, " count"]:
        """Weights of successive samples after the last of them."""
        return self.factor ** np.arange(count - 1, -1, -1.0)


#: Places (instrument, column) of a table of noises that vary from row to row.
NoiseIndices = tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class TimedRows:
    """Rows of successive samples."""

    columns: Float[np.ndarray, "samples columns"]  # [psi phi y noise counted]
    tested: int  # Number of instruments psi
    right: int  # Number of columns [phi y]
    noise_indices: NoiseIndices = ()  # Row and column of each noise

    @property
    def count(self) -> int:
        """Number of samples, with those that do not count."""
        return self.columns.shape[0]

    @property
    def parts(self) -> list[Float[np.ndarray, "samples _"]]:
        """psi, [phi y], noises, and whether samples count."""
        first = self.tested, self.tested + self.right, self.columns.shape[1] - 1
        return np.split(self.columns, first, axis=1)

    def select(self, start: int, stop: int) -> TimedRows:
        return replace(self, columns=self.columns[start:stop])

    def append(self, other: TimedRows) -> TimedRows:
        return replace(self, columns=np.concatenate([self.columns, other.columns])) if self.count else other

    def stretches(self, first: int, look: int) -> Iterator[TimedRows]:
        """Stretches that end where a multiple of `look` samples is full, of which `first` came before."""
        start = 0
        while start < self.count:
            stop = min(start + look - (first + start) % look, self.count)
            yield self.select(start, stop)
            start = stop


def timed_rows(problem: SignalRegression, assembler: Assembler) -> Iterator[TimedRows]:
    """Rows of signals, stretch by stretch."""
    assembler.check_noise(problem)
    signals, first = problem.signals, problem.first
    if signals.sample_count <= first:
        return
    tested = problem.instrument_columns if assembler.needs_instruments else problem.regressor_columns
    right = (*problem.regressor_columns, problem.equation.response)
    noises = shared_noise_of_rows(tested, right, signals, first) if assembler.compensates else {}
    for start, stop in row_blocks(first, signals.sample_count, PASSED_ROWS):
        here = slice(start - first, stop - first)
        used = np.ones(stop - start, dtype=np.bool_) if problem.used is None else problem.used[here]
        noise = [values[here] for values in noises.values()]
        yield counted_rows(
            problem.samples_between(tested, start, stop),
            problem.samples_between(right, start, stop),
            np.stack(noise, axis=1) if noise else np.zeros((used.size, 0)),
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
    columns = np.column_stack([psi, right, noise])
    if not used.all():
        columns = np.where(used[:, None], columns, 0.0)
    return TimedRows(np.column_stack([columns, used]), psi.shape[1], right.shape[1], positions)


@dataclass(frozen=True)
class WeightedBlockSums:
    """Weighted sums of blocks of rows. Performs no checks."""

    packed: Float[np.ndarray, "K w"]  # Of products, of noises, of weights, and of squared weights
    width: int  # Columns of [psi phi y]
    tested: int  # Number of instruments psi

    @property
    def products(self) -> Products:
        sums = self.packed[:, : self.width**2].reshape(-1, self.width, self.width)
        return Products(self.packed[:, -2], sums, self.tested)

    @property
    def noise(self) -> Float[np.ndarray, "K s"]:
        """Sums of noises that vary from row to row."""
        return self.packed[:, self.width**2 : -2]

    @property
    def squares(self) -> Float[np.ndarray, " K"]:
        """Sums of squared weights."""
        return self.packed[:, -1]

    @property
    def blocks(self) -> int:
        return self.packed.shape[0]

    def __add__(self, other: WeightedBlockSums) -> WeightedBlockSums:
        """Blocks of both, one after the other."""
        return WeightedBlockSums(np.concatenate([self.packed, other.packed]), self.width, self.tested)

    def select(self, start: int, stop: int) -> WeightedBlockSums:
        return WeightedBlockSums(self.packed[start:stop], self.width, self.tested)

    def weighted(self, factors: Float[np.ndarray, " K"]) -> WeightedBlockSums:
        """One sum of all, each block with a factor."""
        packed = np.append(factors @ self.packed[:, :-1], factors**2 @ self.packed[:, -1])
        return WeightedBlockSums(packed[None], self.width, self.tested)


def sums_of_rows(rows: TimedRows, forgetting: Forgetting, length: int) -> WeightedBlockSums:
    """Sums of blocks of `length` rows each, weighted to the end of each block."""
    weights = forgetting.weights(length)
    blocks = rows.count // max(length, 1)
    psi, right, noise, counted = (part.reshape(blocks, length, part.shape[1]) for part in rows.parts)
    columns = np.concatenate([psi, right], axis=2)
    sums = np.matmul((columns * weights[:, None]).swapaxes(1, 2), columns)
    used, noises = counted[:, :, 0], np.einsum("klj,l->kj", noise, weights)
    width = columns.shape[2]
    flat = sums.reshape(blocks, width**2)
    packed = np.column_stack([flat, noises, used @ weights, used @ weights**2])
    return WeightedBlockSums(packed, width, rows.tested)


@dataclass(frozen=True)
class ExponentiallyWeightedProducts:
    """Products of all rows so far, exponentially weighted."""

    forgetting: Forgetting
    full: WeightedBlockSums
    closed: WeightedBlockSums
    waiting: TimedRows  # Rows of the block that is not full yet
    samples: int = 0  # Samples so far, those among them that did not count

    def updated(self, rows: TimedRows) -> ExponentiallyWeightedProducts:
        length = self.forgetting.block
        joined = self.waiting.append(rows)
        full = joined.count // length * length
        waiting = replace(self, waiting=joined.select(full, joined.count), samples=self.samples + rows.count)
        if not full:
            return waiting
        sums = sums_of_rows(joined.select(0, full), self.forgetting, length)
        products = np.append(self.forgetting.factor**full, self._block_factors(sums.blocks))
        closed = self.closed + sums
        first = max(
            closed.blocks - int(np.ceil(MEMORIES_KEPT * self.forgetting.memory / self.forgetting.block)), 0
        )
        return replace(
            waiting, full=(self.full + sums).weighted(products), closed=closed.select(first, closed.blocks)
        )

    def last(self, blocks: int) -> ExponentiallyWeightedProducts:
        """The same with the last full blocks only, and the rows that wait: all else is forgotten."""
        closed = self.closed.select(max(self.closed.blocks - blocks, 0), self.closed.blocks)
        return replace(self, full=closed.weighted(self._block_factors(closed.blocks)), closed=closed)

    def _block_factors(self, blocks: int) -> Float[np.ndarray, " blocks"]:
        """Weights of successive full blocks at the end of the last."""
        return self.forgetting.factor ** (self.forgetting.block * np.arange(blocks - 1, -1, -1.0))

    @cached_property
    def _waiting_sums(self) -> WeightedBlockSums:
        return sums_of_rows(self.waiting, self.forgetting, self.waiting.count)

    @cached_property
    def recent(self) -> tuple[WeightedBlockSums, Float[np.ndarray, " K"]]:
        """Blocks that are kept apart, rows that wait as one of them."""
        factors = self.forgetting.factor**self.waiting.count * self._block_factors(self.closed.blocks)
        if not self.waiting.count:
            return self.closed, factors
        return self.closed + self._waiting_sums, np.append(factors, 1.0)

    @cached_property
    def total(self) -> WeightedBlockSums:
        """One sum of all rows, with the weights that they have now."""
        if not self.waiting.count:
            return self.full
        decay = self.forgetting.factor**self.waiting.count
        return (self.full + self._waiting_sums).weighted(np.array([decay, 1.0]))

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
        """Noises' part of the products psi [phi' y] of blocks."""
        table = np.zeros((sums.blocks, self.waiting.tested, self.waiting.right))
        for number, noise_index in enumerate(self.waiting.noise_indices):
            table[:, *noise_index] = sums.noise[:, number]
        return table

    def compensated(self, sums: WeightedBlockSums) -> Float[np.ndarray, "K p n_plus_1"]:
        """Sums of psi [phi' y] of blocks, without the noises' part."""
        return sums.products.equations - self.noise_table(sums)

    def scores(self, sums: WeightedBlockSums, theta: Float[np.ndarray, " n"]) -> Float[np.ndarray, "K p"]:
        """Compensated sums of psi times the residual of each block."""
        products = self.compensated(sums)
        return products[:, :, -1] - products[:, :, :-1] @ theta


def empty_products(rows: TimedRows, forgetting: Forgetting) -> ExponentiallyWeightedProducts:
    """Products of no rows, with the columns of some."""
    no_rows = rows.select(0, 0)
    empty = sums_of_rows(no_rows, forgetting, forgetting.block)
    zero = replace(empty, packed=np.zeros((1, empty.packed.shape[1])))
    return ExponentiallyWeightedProducts(forgetting, zero, empty, no_rows)


def exponentially_weighted_covariance(
    weighted: ExponentiallyWeightedProducts, theta: Float[np.ndarray, " n"], mapped: Float[np.ndarray, "n p"]
) -> cov.JointCovariance:
    """Covariance of an estimate from exponentially weighted products."""
    # Scores of unit variance, weights and sensitivities of the blocks that have rows and are kept apart.
    blocks, factors = weighted.recent
    filled = blocks.squares > 0.0
    size = np.sqrt(np.where(filled, blocks.squares, 1.0))
    scores = (weighted.scores(blocks, theta) @ mapped.T / size[:, None])[filled]
    weights, leaks = (factors * size)[filled], (blocks.products.counts / size)[filled]
    rows = scores / weighted.total.products.count
    averages = _cosines(weights, leaks).T @ rows
    used = averages.shape[0]
    power = float(weights @ weights)
    meat = power * (averages.T @ averages) / max(used, 1)
    products = weights[:, None] * rows
    single = products.T @ products
    effective = power**2 / float(np.sum(weights**4)) if power > 0.0 else 0.0
    degrees = max(effective - theta.size, 0.0)
    single = single * (effective / degrees if degrees > 0.0 else 1.0)
    cosines = cov.CovariancePart("equal_weighted_cosines", meat, float(used))
    return cov.JointCovariance((cosines, cov.CovariancePart("blocks", single, degrees)))


def _cosines(
    weights: Float[np.ndarray, " K"], leaks: Float[np.ndarray, " K"]
) -> Float[np.ndarray, "K averages"]:
    """Orthonormal cosines over the weights' own time, orthogonal to the weights and to the leaks."""
    averages = min(cov.COSINE_AVERAGES, weights.size - 2)
    if averages < 1:
        return np.zeros((weights.size, 0))
    shares = weights**2
    time = (np.cumsum(shares) - 0.5 * shares) / shares.sum()
    waves = np.cos(np.pi * np.arange(1, averages + 1) * time[:, None])
    Q, _ = np.linalg.qr(np.column_stack([weights, leaks, weights[:, None] * waves]))
    return Q[:, 2:]
