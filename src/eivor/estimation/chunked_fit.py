"""Identify from data that do not fit in memory, in passes over their chunks: estimates, then intervals."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

import numpy as np

from eivor.errors import UsageError
from eivor.estimation.equation_rows import MethodEquations, estimating_equation
from eivor.estimation.estimate import Estimate
from eivor.estimation.fit import identify
from eivor.estimation.method import Method
from eivor.estimation.moments import CrossMoments
from eivor.estimation.solve import solve_moments
from eivor.estimation.streaming import chunk_problems, moments
from eivor.inference.covariances.estimators import DEFAULT, CovarianceEstimator
from eivor.models.column import Column
from eivor.models.regression import RowBlock
from eivor.models.vertical import VerticalMotion
from eivor.signals.signals import Signals


def identify_chunks(
    chunks: Callable[[], Iterable[Signals]],
    *,
    model: VerticalMotion,
    method: Method,
    instruments: tuple[Column, ...] = (),
    covariance: CovarianceEstimator = DEFAULT,
) -> Estimate:
    """Estimate the parameters of a record that is given in chunks, with intervals.

    Parameters
    ----------
    chunks : callable
        Gives the chunks, in order, as `eivor.moments` takes them; each call starts anew, as in
        ``lambda: read_chunks("flight.parquet")``. The first pass makes the estimate; robust covariances
        need its residuals, hence a second one, and direct methods a third.
    model, method, instruments : VerticalMotion, Method, tuple of Column
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
    first = moments(chunks(), model=model, method=method, instruments=instruments)
    estimate = identify(first, method)
    total = first.moments
    solved = solve_moments(method, total, None)
    theta = solved.solution.theta
    constant = np.zeros(solved.system.right.size)
    if isinstance(total, CrossMoments) and total.noise is not None:
        constant = total.noise[:, :-1] @ theta - total.noise[:, -1]

    def blocks() -> Iterator[RowBlock]:
        found = 0
        for problem in chunk_problems(chunks(), model=model, instruments=instruments):
            for block in problem.blocks():
                found += block.response.size
                yield block
        if found != total.rows:
            raise UsageError(
                f"chunks of {total.rows} rows in every pass",
                f"{found} in a later one",
                "Give a function that starts the same chunks anew each time it is called.",
            )

    equations = MethodEquations(method, solved.system, solved.factor, solved.solution)
    equation = estimating_equation(equations, constant, blocks, total.rows, np.empty((0, 0)))
    (candidate,) = estimate.candidates
    streamed = replace(candidate, streamed_covariance=covariance.joint(equation))
    return replace(estimate, candidates=(streamed,))
