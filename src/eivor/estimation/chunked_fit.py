"""Identify from data that do not fit in memory, in passes over their chunks: estimates, then intervals."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

from eivor import checks
from eivor.errors import UsageError
from eivor.estimation.estimate import Estimate
from eivor.estimation.fit import identify
from eivor.estimation.inferred import estimating_equation
from eivor.estimation.linear import LinearMethod
from eivor.estimation.streaming import check_chunked, chunk_problems, moments
from eivor.inference.covariances.estimators import (
    DEFAULT,
    CovarianceEstimator,
    check_covariance_estimator,
)
from eivor.models.column import Column
from eivor.models.regression import RowBlock
from eivor.models.signal_regression import SignalModel
from eivor.signals.signals import Signals


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
        found = 0
        for problem in chunk_problems(chunks(), model=model, instruments=instruments):
            for block in problem.blocks():
                found += block.response.size
                yield block
        if found != total.rows:
            raise UsageError(
                f"chunks of {total.rows:.0f} rows in every pass",
                f"{found} in a later one",
                "Give a function that starts the same chunks anew each time it is called.",
            )

    equation = estimating_equation(candidate.solved, blocks)
    streamed = replace(candidate, streamed_covariance=covariance.joint(equation))
    return replace(estimate, candidates=(streamed,))
