"""Quantities that motions share: parameters, ratios of them, the lag of actuators, the delay, their sum."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from eivor.estimation.candidate import Candidate
from eivor.estimation.derived import ratio
from eivor.estimation.estimate import Estimate
from eivor.flights.quantity import NAN, NO_INTERVAL, Choice, Kind, Unjudged, Wording
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY
from eivor.models.separable import Nuisance, SeparableProblem
from eivor.shapes import Float

#: Sum of lag and delay, which a flight tells better than either.
EFFECTIVE_LAG = "effective_lag"


#: How the three are called and shown.
LAG_WORDINGS = {
    ACTUATOR_LAG.name: Wording("actuator lag", "τ", "s", shown_unit="ms", scale=1e3, lowest=0.0),
    DELAY.name: Wording("delay", "d", "s", shown_unit="ms", scale=1e3),
    EFFECTIVE_LAG: Wording("effective lag", "τ + d", "s", Kind.DERIVED, shown_unit="ms", scale=1e3),
}


def joint_quantities(estimate: Estimate) -> dict[str, Unjudged]:
    """Every parameter of the joint vector."""
    return {
        name: Unjudged(estimate.parameters[name], unit, estimate.std_error(name), estimate.interval(name))
        for name, unit in zip(estimate.names, estimate.units, strict=True)
    }


def ratio_quantity(estimate: Estimate, numerator: str | float, denominator: str, unit: str) -> Unjudged:
    """Ratio of two parameters, or of a number and a parameter; see `eivor.ratio`.

    Its interval has no bound as soon as the denominator cannot be told from zero; the standard error is by
    the delta method.
    """
    at, below = estimate.parameters, estimate.parameters[denominator]
    above = at[numerator] if isinstance(numerator, str) else float(numerator)
    interval = ratio(estimate, numerator, denominator).hull
    if not below:
        return Unjudged(NAN, unit, NAN, interval)
    gradient = -above / below**2 * estimate.direction(denominator)
    if isinstance(numerator, str):
        gradient = gradient + estimate.direction(numerator) / below
    return Unjudged(above / below, unit, estimate.best.covariance.std_error(gradient), interval)


def reciprocal(of: Unjudged, unit: str) -> Unjudged:
    """One over a quantity; without bounds where its interval is not to one side of zero."""
    low, high = of.interval
    told = low > 0.0 or high < 0.0
    interval = (1.0 / high, 1.0 / low) if told else NO_INTERVAL
    if not of.value:
        return Unjudged(NAN, unit, NAN, interval)
    return Unjudged(1.0 / of.value, unit, of.std_error / of.value**2, interval)


def lag_quantities(problem: SeparableProblem, estimate: Estimate) -> dict[str, Unjudged]:
    """`actuator_lag`, `delay` and `effective_lag`, their sum; zero for what was not searched for.

    A sum that cannot be negative has no interval below zero; that of a measured state's delay may. One
    that is known between bounds has these for its interval.

    Parameters
    ----------
    problem : SeparableProblem
        With the nuisances actuator_lag and delay; the latter discrete, or continuous without a lag.
    estimate : Estimate
        Of it.
    """
    joint = joint_quantities(estimate)
    lag = joint.get(ACTUATOR_LAG.name, Unjudged(0.0, "s", 0.0, (0.0, 0.0)))
    if DELAY.name in joint and ACTUATOR_LAG.name in joint:
        return {
            ACTUATOR_LAG.name: lag,
            DELAY.name: joint[DELAY.name],
            EFFECTIVE_LAG: replace(_sum_of_both(estimate), lowest=0.0),
        }
    if DELAY.name in joint:
        return {ACTUATOR_LAG.name: lag, DELAY.name: joint[DELAY.name], EFFECTIVE_LAG: joint[DELAY.name]}
    effective = lag
    named = {nuisance.name: nuisance for nuisance in problem.nuisances}
    bounds = named[ACTUATOR_LAG.name].bounds
    if bounds is not None:
        lags = [candidate.at[ACTUATOR_LAG.name] for candidate in estimate.tenable()]
        at = estimate.best.at
        lag = Unjudged(at[ACTUATOR_LAG.name], "s", NAN, (min(lags), max(lags)))
        whole = named[ACTUATOR_LAG.name].with_others(at)
        effective = Unjudged(whole, "s", NAN, (bounds.low, bounds.high))
    if ACTUATOR_LAG.name in estimate.names:
        sum_of = _effective_lag(estimate)
        value, direction = sum_of(estimate.best)
        error = estimate.best.covariance.std_error(direction)
        effective = Unjudged(value, "s", error, estimate.interval_of(sum_of), lowest=0.0)
    delay = chosen(named[DELAY.name], estimate)
    return {ACTUATOR_LAG.name: lag, DELAY.name: delay, EFFECTIVE_LAG: effective}


def _sum_of_both(estimate: Estimate) -> Unjudged:
    """Lag and delay together, where both were searched for between their grids' values."""
    direction = estimate.direction(ACTUATOR_LAG.name) + estimate.direction(DELAY.name)
    interval = estimate.interval_of(lambda candidate: (float(direction @ candidate.values), direction))
    error = estimate.best.covariance.std_error(direction)
    return Unjudged(float(direction @ estimate.best.values), "s", error, interval)


def chosen(nuisance: Nuisance, estimate: Estimate) -> Unjudged:
    """A discrete nuisance: it has the values that fit in place of an interval."""
    fitting = tuple(sorted({candidate.at[nuisance.name] for candidate in estimate.tenable()}))
    tried = tuple(sorted({candidate.at[nuisance.name] for candidate in estimate.candidates}))
    choice = Choice(fitting, tried)
    unit = nuisance.parameter.unit
    return Unjudged(estimate.best.at[nuisance.name], unit, NAN, (fitting[0], fitting[-1]), choice)


def _effective_lag(estimate: Estimate) -> Callable[[Candidate], tuple[float, Float[np.ndarray, " n"]]]:
    """Lag plus delay and its gradient, at a candidate."""
    direction = estimate.direction(ACTUATOR_LAG.name)
    return lambda candidate: (float(direction @ candidate.values) + candidate.at[DELAY.name], direction)
