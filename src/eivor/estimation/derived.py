"""Functions of parameters by the delta method."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from eivor import checks
from eivor.errors import UsageError
from eivor.estimation.estimate import Estimate
from eivor.inference.confidence_set import ConfidenceSet, gradient_of, principal_axes, profile_interval
from eivor.inference.covariance import CovariancePart, JointEstimate, Vector
from eivor.inference.regions import fieller_set

#: Share of the half-width by which a function may bend before it is profiled.
LARGEST_BEND = 0.05

Function = Callable[[Mapping[str, float]], float]
OfVector = Callable[[Vector], float]


@dataclass(frozen=True, slots=True)
class DerivedQuantity:
    """A function of the parameters."""

    value: float  # At the estimate
    std_error: float
    interval: tuple[float, float]  # Lowest and highest value
    bend: float
    profiled: bool


def derived(estimate: Estimate, function: Function, level: float = 0.95) -> DerivedQuantity:
    """A smooth function of the parameters, with its interval.

    Parameters
    ----------
    estimate : Estimate
        With its covariance at hand.
    function : callable
        From the mapping of names to values, such as ``lambda p: p["gain"] / p["friction"]``.
        For a ratio whose denominator may be near zero use `ratio`.
    level : float
        Confidence level.

    Raises
    ------
    UsageError
        When the level is not between 0 and 1, or the function is not finite within the interval.
    """
    checks.level(level)
    checks.kind("estimate", estimate, Estimate, "an estimate", "Make one by ev.identify(...).")
    remedy = 'Give lambda p: p["theta_1"] ** 2, for example.'
    checks.function("a function of the parameters", function, remedy)

    def of_vector(values: Vector) -> float:
        result = function(dict(zip(estimate.names, (float(value) for value in values), strict=True)))
        checks.number("what the function gives", result)
        return float(result)

    results = derived_from(of_vector, JointEstimate(estimate.values, estimate.joint_covariance), level)
    numbers = (results.value, results.std_error, *results.interval)
    if math.isnan(results.bend) or not np.isfinite(numbers).all():
        expected = "a function that is finite within the interval"
        remedy = "For a ratio whose denominator may be zero use eivor.ratio."
        raise UsageError(expected, f"{results.value} with the interval {results.interval}", remedy)
    return results


def derived_from(
    function: OfVector, joint: JointEstimate, level: float, largest_bend: float = LARGEST_BEND
) -> DerivedQuantity:
    """A smooth function of a vector of estimates; its interval is a union over parts of the covariance."""
    values, covariance = joint.values, joint.covariance
    pieces = [_of_part(function, values, part, level, largest_bend) for part in covariance.parts]
    scale = np.sqrt(np.diag(covariance.matrix))
    return DerivedQuantity(
        value=function(values),
        std_error=covariance.std_error(gradient_of(function, values, scale)),
        interval=(min(piece.interval[0] for piece in pieces), max(piece.interval[1] for piece in pieces)),
        bend=max(piece.bend for piece in pieces),
        profiled=any(piece.profiled for piece in pieces),
    )


def ratio(
    estimate: Estimate, numerator: str | float | int, denominator: str | float | int, level: float = 0.95
) -> ConfidenceSet:
    """Confidence set of a ratio of parameters, or of a number and a parameter, by Fieller's method.

    Parameters
    ----------
    estimate : Estimate
        With its covariance at hand.
    numerator, denominator : str or float
        Name of a parameter, or an exact number: ``ratio(fit, 1.0, "friction")`` is the time
        constant 1/K [s].
    level : float
        Confidence level.

    Returns
    -------
    ConfidenceSet
        Without a bound when the denominator cannot be distinguished from zero. A union over the
        assumptions of the covariance.

    Raises
    ------
    UsageError
        When a name is unknown, or the level is not between 0 and 1.
    """
    checks.level(level)
    checks.kind("estimate", estimate, Estimate, "an estimate", "Make one by ev.identify(...).")
    for name, item in (("numerator", numerator), ("denominator", denominator)):
        if not isinstance(item, str):
            checks.number(name, item)
    pair, nothing = (numerator, denominator), np.zeros(len(estimate.names))
    exact = np.array([0.0 if isinstance(entry, str) else float(entry) for entry in pair])
    rows = np.stack([estimate.direction(entry) if isinstance(entry, str) else nothing for entry in pair])
    intervals: list[tuple[float, float]] = []
    for part in estimate.joint_covariance.parts:
        values, V = exact + rows @ estimate.values, rows @ part.matrix @ rows.T
        intervals.extend(fieller_set(values, V, part.half_widths(level)).intervals)
    return ConfidenceSet.union(intervals)


def _of_part(
    function: OfVector, values: Vector, part: CovariancePart, level: float, largest_bend: float
) -> DerivedQuantity:
    t = part.half_widths(level)
    gradient = gradient_of(function, values, np.sqrt(np.diag(part.matrix)))
    error = math.sqrt(part.variance(gradient))
    centre, half = function(values), t * error
    axes = list(principal_axes(part.matrix, t).T)
    if half > 0.0:
        axes.append(t * part.matrix @ gradient / error)
    away = max(
        abs(function(values + sign * axis) - centre - sign * float(gradient @ axis))
        for axis in axes
        for sign in (-1.0, 1.0)
    )
    bend = away / half if half > 0.0 else (0.0 if away == 0.0 else math.inf)
    if bend <= largest_bend:
        return DerivedQuantity(centre, error, (centre - half, centre + half), bend, profiled=False)
    interval = profile_interval(function, values, part.matrix, t)
    return DerivedQuantity(centre, error, interval, bend, profiled=True)
