"""Moments of data that come in chunks, and identification from them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

import numpy as np

from eivor import checks
from eivor.errors import TooFewSamplesError, UsageError
from eivor.estimation.estimate import Estimate, estimating_equation
from eivor.estimation.linear import LinearMethod, check_linear
from eivor.estimation.methods import identify
from eivor.estimation.moments import Moments, ProblemMoments
from eivor.inference.covariance import DEFAULT, CovarianceEstimator, check_covariance_estimator
from eivor.models.regression import Column, RowBlock, check_columns
from eivor.models.signal_regression import SignalModel, SignalRegression
from eivor.signals.signals import Signals

# -- Streaming --


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
    total: Moments | None = None
    problem: SignalRegression | None = None
    for problem in chunk_problems(chunks, model=model, instruments=instruments):
        result = method.moments(problem)
        total = result if total is None else total.merge(result)
    if total is None or problem is None:
        raise TooFewSamplesError(
            "chunks with more samples than the largest lag", "none", "Give longer chunks, or fewer lags."
        )
    return ProblemMoments(problem.parameters, total)


def check_chunked(model: object, method: object, instruments: object) -> None:
    """Refuse arguments of other types than a model, a method and columns."""
    check_linear(method)
    checks.kind("model", model, SignalModel, "a model", "Make one: ev.VerticalMotion().")
    check_columns("instruments", instruments)


def chunk_problems(
    chunks: Iterable[Signals], *, model: SignalModel, instruments: tuple[Column, ...]
) -> Iterator[SignalRegression]:
    """Problem of each chunk that has rows, see `moments`."""
    for joined in overlapping(chunks, model.regression_lag(instruments)):
        problem = model.regression(joined, instruments)
        if joined.sample_count > problem.first and (problem.used is None or problem.used.any()):
            yield problem


def overlapping(chunks: Iterable[Signals], lag: int) -> Iterator[Signals]:
    """Each chunk with the last `lag` samples before it, and its place in the record as offset."""
    before: Signals | None = None
    for chunk in chunks:
        checks.kind("a chunk", chunk, Signals, "Signals", "Give the stretches of one record in their order.")
        before = chunk if before is None else continued(before, chunk, lag)
        yield before


def continued(before: Signals, chunk: Signals, lag: int) -> Signals:
    """Return a chunk with the last `lag` samples before it."""
    _check_successor(before, chunk)
    start = max(before.sample_count - lag, 0)
    channels = {
        name: np.concatenate([before.channels[name][start:], values])
        for name, values in chunk.channels.items()
    }
    valid = None
    if before.valid is not None or chunk.valid is not None:
        parts = [
            np.ones(s.sample_count, dtype=np.bool_) if s.valid is None else s.valid for s in (before, chunk)
        ]
        valid = np.concatenate([parts[0][start:], parts[1]])
    return Signals(
        chunk.rate_hz,
        channels,
        noise=chunk.noise,
        valid=valid,
        start_s=before.start_s + start * before.step_s,
        offset=before.offset + start,
    )


def _check_successor(before: Signals, chunk: Signals) -> None:
    if chunk.rate_hz != before.rate_hz or set(chunk.channels) != set(before.channels):
        raise UsageError(
            f"chunks of one record: {before.rate_hz:g} Hz, {', '.join(sorted(before.channels))}",
            f"a chunk of {chunk.rate_hz:g} Hz with {', '.join(sorted(chunk.channels))}",
            "Give the chunks of one record in their order.",
        )
    expected = before.offset + before.sample_count
    if chunk.offset not in (0, expected):
        raise UsageError(
            f"a chunk that begins where the one before it ends, at sample {expected}",
            f"one that says it begins at sample {chunk.offset}",
            "Give every chunk, in order; mark samples that are missing as not valid.",
        )


# -- Chunked fit --


def identify_chunks(
    chunks: Callable[[], Iterable[Signals]],
    *,
    model: SignalModel,
    method: LinearMethod,
    instruments: tuple[Column, ...] = (),
    covariance: CovarianceEstimator = DEFAULT,
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
    check_covariance_estimator(covariance)
    if not callable(chunks):
        raise UsageError(
            "a function that gives the chunks anew in every pass",
            checks.described(chunks),
            "Give lambda: ev.read_chunks(file, ...), for example.",
        )
    first = moments(chunks(), model=model, method=method, instruments=instruments)
    estimate = identify(first, method)
    total = first.moments
    (candidate,) = estimate.candidates

    def blocks() -> Iterator[RowBlock]:
        size = 0
        for problem in chunk_problems(chunks(), model=model, instruments=instruments):
            for block in problem.blocks():
                size += block.response.size
                yield block
        if size != total.rows:
            raise UsageError(
                f"chunks of {total.rows:.0f} rows in every pass",
                f"{size} in a later one",
                "Give a function that starts the same chunks anew each time it is called.",
            )

    equation = estimating_equation(candidate, blocks)
    streamed = replace(candidate, streamed_covariance=covariance.joint(equation))
    return replace(estimate, candidates=(streamed,))
