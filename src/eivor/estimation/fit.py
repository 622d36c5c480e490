"""Identify: run a method on a problem."""

from __future__ import annotations

from dataclasses import replace

from eivor.errors import UsageError
from eivor.estimation.estimate import Estimate
from eivor.estimation.method import Method, Problem
from eivor.estimation.moments import ProblemMoments
from eivor.models.regression import LinearProblem
from eivor.models.separable import SeparableProblem


def identify(problem: Problem, method: Method) -> Estimate:
    """Estimate the parameters of `problem` by `method`.

    Parameters
    ----------
    problem : Regression, SignalRegression, SeparableProblem or ProblemMoments
        Rows; signals that rows are cut from; one set of rows for each value of nuisance parameters, such as
        the lag and the delay of an actuator; or moments, whose estimate has no residuals and no intervals.
    method : Method
        One of `eivor.methods`, or your own.

    Returns
    -------
    Estimate
        With the continuous nuisances that were searched for, such as the lag, among its parameters. A method
        without instruments is tested by those that a linear problem holds: weak where they contradict it.

    Raises
    ------
    UsageError
        When an argument is of another type, or the method cannot use the problem.
    InstrumentError
        When the method needs instruments that the problem does not have, or they share noise with it.
    MissingNoiseError
        When a compensated method needs a noise that is not declared.
    TooFewSamplesError
        When there are no more rows than unknowns.
    EstimationError
        When the equations have no unique solution.
    """
    if not isinstance(problem, LinearProblem | SeparableProblem | ProblemMoments):
        raise UsageError(
            "a problem: regression(...), a model's regression, or moments(...)",
            f"{type(problem).__name__}",
            "For a flight log use identify_flight.",
        )
    if not isinstance(method, Method):
        raise UsageError(
            "a method, such as eivor.methods.least_squares()",
            repr(method) if isinstance(method, str) else type(method).__name__,
            "Call the function of eivor.methods that is named so.",
        )
    estimate = method.estimate(problem)
    if method.needs_instruments or not isinstance(problem, LinearProblem) or not problem.instrument_count:
        return estimate
    from eivor.estimation.diagnose import contradiction  # late: other estimates need none of it

    return replace(estimate, reasons=(*estimate.reasons, *contradiction(problem, estimate)))
