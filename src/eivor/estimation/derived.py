"""Quantities derived from an estimate, with intervals: ratios, and any smooth function of the parameters.

The delta method takes a function for linear over the interval. `derived` measures how far it is from that
and profiles it when it is not; `ratio` makes no such assumption about its denominator.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from eivor import checks
from eivor.errors import UsageError
from eivor.estimation.estimate import Estimate
from eivor.estimation.joint_estimate import JointEstimate
from eivor.inference.covariances.covariance import CovariancePart
from eivor.inference.quantiles import check_level, t_quantile
from eivor.inference.sets.confidence_set import ConfidenceSet
from eivor.inference.sets.fieller import fieller_set
from eivor.inference.sets.profile import gradient_of, principal_axes, profile_interval
from eivor.shapes import Float

#: Share of the half-width by which a function may bend before it is profiled.
LARGEST_BEND = 0.05

Function = Callable[[Mapping[str, float]], float]
OfVector = Callable[[Float[np.ndarray, " n"]], float]


@dataclass(frozen=True, slots=True)
class DerivedQuantity:
    """A function of the parameters.

    Parameters
    ----------
    value : float
        At the estimate.
    std_error : float
        By the delta method.
    interval : tuple of float
        Lowest and highest value.
    bend : float
        Largest departure from linear where the interval ends and at the ends of the ellipsoid's axes, as a
        share of the half-width; infinite for a function without a slope.
    profiled : bool
        Whether the interval follows the bend; by the delta method when not.
    """

    value: float
    std_error: float
    interval: tuple[float, float]
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
    check_level(level)
    _check_estimate(estimate)
    if not callable(function):
        raise UsageError(
            "a function of the parameters",
            checks.described(function),
            'Give lambda p: p["theta_1"] ** 2, for example.',
        )

    def of_vector(values: Float[np.ndarray, " n"]) -> float:
        found = function(dict(zip(estimate.names, (float(value) for value in values), strict=True)))
        checks.number("what the function gives", found)
        return float(found)

    found = derived_from(of_vector, joint_estimates(estimate, level), level)
    if math.isnan(found.bend) or not all(
        math.isfinite(number) for number in (found.value, found.std_error, *found.interval)
    ):
        raise UsageError(
            "a function that is finite within the interval",
            f"{found.value} with the interval {found.interval}",
            "For a ratio whose denominator may be zero use eivor.ratio.",
        )
    return found


def joint_estimates(estimate: Estimate, level: float) -> tuple[JointEstimate, ...]:
    """Vectors of the candidates that fit, the best first."""
    others = [one for one in estimate.tenable(level) if one is not estimate.best]
    return tuple(JointEstimate(one.values, one.covariance) for one in (estimate.best, *others))


def derived_from(
    function: OfVector,
    candidates: Sequence[JointEstimate],
    level: float,
    largest_bend: float = LARGEST_BEND,
) -> DerivedQuantity:
    """A smooth function of a vector of estimates, with an interval that is a union over candidates.

    Parameters
    ----------
    function : callable
        Of the vector.
    candidates : sequence of JointEstimate
        Vectors with their covariances; the first one's value counts.
    level : float
        Confidence level.
    largest_bend : float
        Share of the half-width by which the function may bend before it is profiled.

    Notes
    -----
    Performs no checks.
    """
    pieces = [
        _of_part(function, candidate, part, level, largest_bend)
        for candidate in candidates
        for part in candidate.covariance.parts
    ]
    found = [piece.interval for piece in pieces]
    interval = min(low for low, _ in found), max(high for _, high in found)
    best = candidates[0]
    scale = np.sqrt(np.diag(best.covariance.matrix))
    error = best.covariance.std_error(gradient_of(function, best.values, scale))
    bend = max(piece.bend for piece in pieces)
    return DerivedQuantity(
        function(best.values), error, interval, bend, any(piece.profiled for piece in pieces)
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
        Without a bound when the denominator cannot be told from zero. A union over the candidates that fit,
        and over the assumptions of the covariance.

    Raises
    ------
    UsageError
        When a name is unknown, or the level is not between 0 and 1.
    """
    check_level(level)
    _check_estimate(estimate)
    for name, one in (("numerator", numerator), ("denominator", denominator)):
        if not isinstance(one, str):
            checks.number(name, one)
    size = len(estimate.names)
    exact = np.array([0.0 if isinstance(one, str) else float(one) for one in (numerator, denominator)])
    rows = np.stack(
        [
            estimate.direction(one) if isinstance(one, str) else np.zeros(size)
            for one in (numerator, denominator)
        ]
    )
    intervals: list[tuple[float, float]] = []
    for candidate in estimate.tenable(level):
        for part in candidate.covariance.parts:
            pair, V = exact + rows @ candidate.values, rows @ part.matrix @ rows.T
            intervals.extend(fieller_set(pair, V, _half_widths(part, level)).intervals)
    return ConfidenceSet.union(intervals)


def _check_estimate(estimate: object) -> None:
    checks.kind("estimate", estimate, Estimate, "an estimate", "Make one by ev.identify(...).")


def _half_widths(part: CovariancePart, level: float) -> float:
    return t_quantile(level, part.degrees) / math.sqrt(part.share)


def _of_part(
    function: OfVector,
    candidate: JointEstimate,
    part: CovariancePart,
    level: float,
    largest_bend: float,
) -> DerivedQuantity:
    """Quantity of one candidate, under one assumption on the residual."""
    values, t = candidate.values, _half_widths(part, level)
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
