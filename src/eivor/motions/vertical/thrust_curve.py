"""Estimation of a thrust curve."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from eivor.estimation.derived import DEGREES
from eivor.estimation.estimate import Candidate, Estimate
from eivor.estimation.variable_projection import DECIMALS, with_values_tried
from eivor.flights.quantity import NAN, NO_INTERVAL, QuantityEstimate
from eivor.inference.distributions import t_quantile
from eivor.motions.vertical.model import GRAVITY, CurveFamily, family_of
from eivor.motions.vertical.regression import Balance, VerticalFlights, balance, hover_mapped, intercept
from eivor.motions.vertical.select import FittedCurve
from eivor.signals.thrust_map import InputMap
from eivor.tools import Float

#: The map is found when another round would change its parameter by less than this; so many rounds are made.
CONVERGED, ROUNDS = 3e-4, 10
#: Lag and delay are searched again so often with the map that was found.
SEARCHES = 3
#: Half of what maps are changed by for derivatives.
STEP = 0.02

Estimated = Callable[[VerticalFlights], Estimate]
#: A quantity at a candidate: its value, its gradient by the joint vector, and variance besides.
Linear = tuple[float, Float[np.ndarray, " n"], float]


def with_map(problem: VerticalFlights, chosen: InputMap) -> VerticalFlights:
    """Return the same flights with another input map."""
    return replace(problem, motion=replace(problem.motion, input_map=chosen), curve=None)


def hover_and_exponent(problem: VerticalFlights, candidate: Candidate) -> tuple[float, float]:
    """Command at hover, and the exponent of thrust there; NaN where the numbers make none."""
    mapped = hover_mapped(candidate, balance(problem, candidate))[0]
    chosen = problem.motion.input_map
    if not mapped > 0.0:
        return NAN, NAN
    hover = chosen.inverse(mapped)
    current = hover * chosen.slope(hover) / mapped
    return hover, current * float(candidate.theta[1]) * mapped / GRAVITY


def refined_curve(
    problem: VerticalFlights, estimated: Estimated, bias_std: float
) -> tuple[VerticalFlights, Estimate]:
    """Find the map, and estimate with it."""
    family = family_of(problem.motion.input_map)
    curvature_error = math.inf
    if math.isinf(bias_std):
        value, curvature_error = _by_curvature(problem, estimated, family)
        chosen = with_map(problem, family.map(value))
        estimate = estimated(chosen)
    else:
        value, chosen, estimate = _by_intercept(problem, estimated, family)
        if math.isnan(value):
            return problem, estimate
    sides = [family.possible(value + step) for step in (-STEP, STEP)]
    same = with_values_tried(problem.nuisances, (candidate.nuisances for candidate in estimate.candidates))
    equal = replace(problem, nuisances=same)
    below, above = ((side, estimated(with_map(equal, family.map(side)))) for side in sides)
    curve = FittedCurve(family, value, bias_std, below, above, curvature_error)
    return replace(chosen, curve=curve), estimate


def _by_intercept(
    problem: VerticalFlights, estimated: Estimated, family: CurveFamily
) -> tuple[float, VerticalFlights, Estimate]:
    """Parameter with which the intercept vanishes, or the nearest that is possible, NaN for none."""
    value, chosen, estimate = math.nan, problem, estimated(problem)
    for _ in range(SEARCHES):
        before, value = value, _at_nuisances(chosen, estimated, estimate.best, family)
        if math.isnan(value) or abs(value - before) < CONVERGED:
            break
        chosen = with_map(problem, family.map(value))
        estimate = estimated(chosen)
    return value, chosen, estimate


def _at_nuisances(
    problem: VerticalFlights, estimated: Estimated, best: Candidate, family: CurveFamily
) -> float:
    """The same with lag and delay where they are: the map hardly moves them."""
    value, chosen = math.nan, problem
    known = tuple(nuisance.known_at(best.nuisances[nuisance.name]) for nuisance in problem.nuisances)
    for _ in range(ROUNDS):
        before = value
        hover, exponent = hover_and_exponent(chosen, best)
        if not (math.isfinite(exponent) and hover > 0.0):
            return math.nan
        value = family.possible(family.of_exponent(exponent, hover))
        if abs(value - before) < CONVERGED:
            break
        chosen = with_map(replace(problem, nuisances=known), family.map(value))
        best = estimated(chosen).best
    return value


def _by_curvature(problem: VerticalFlights, estimated: Estimated, family: CurveFamily) -> tuple[float, float]:
    """Parameter with the least criterion, and its standard error; infinite where an end of the grid fits."""
    grid = family.grid
    criterion = np.array(
        [estimated(with_map(problem, family.map(value))).best.criterion for value in grid.tolist()]
    )
    least = int(np.argmin(criterion))
    quantile = t_quantile(0.95, DEGREES)
    allowed = grid[criterion <= criterion[least] + quantile**2]
    if least in (0, grid.size - 1) or allowed[0] == grid[0] or allowed[-1] == grid[-1]:
        return float(grid[least]), math.inf
    # a parabola through the least and its neighbours
    step = grid[1] - grid[0]
    left, middle, right = criterion[least - 1 : least + 2]
    bend = (left - 2.0 * middle + right) / step**2
    value = family.possible(float(grid[least] - 0.5 * (right - left) / (step * bend)))
    half = max(0.5 * (allowed[-1] - allowed[0]), quantile * math.sqrt(2.0 / bend))
    return value, half / quantile


@dataclass(frozen=True)
class AtCandidate:
    """A candidate with its balance, and the same combination of nuisances with maps to either side."""

    problem: VerticalFlights
    candidate: Candidate
    terms: Balance
    sides: tuple[tuple[VerticalFlights, Candidate, Balance], ...]  # With the maps below and above


#: From flights, a candidate and its balance.
Of = Callable[[VerticalFlights, Candidate, Balance], Linear]


def curve_quantities(
    problem: VerticalFlights, estimate: Estimate, curve: FittedCurve
) -> dict[str, QuantityEstimate]:
    """Quantities that the map's own error moves, and the map's parameter."""
    points = _points(problem, estimate, curve)
    unknown = math.isinf(curve.bias_std) and math.isinf(curve.curvature_error)
    results = {
        name: _with_curve(estimate, points, curve, of, unit)
        for name, of, unit in (
            ("viscous_friction", _joint(0), "1/s"),
            ("input_gain", _joint(1), "m/s^2"),
            ("intercept", _intercept, "m/s^2"),
            ("hover_input", _hover, ""),
        )
    }
    value = QuantityEstimate(curve.value, "", NAN, NO_INTERVAL)
    return {**results, "thrust_curve": value if unknown else _of_curve(estimate, points, curve)}


def _points(
    problem: VerticalFlights, estimate: Estimate, curve: FittedCurve
) -> dict[tuple[float, ...], AtCandidate]:
    results = {}
    sides = [
        (
            with_map(problem, curve.family.map(value)),
            {_chosen(estimate, each): each for each in item.candidates},
        )
        for value, item in (curve.below, curve.above)
    ]
    for candidate in estimate.candidates:
        same = [(flights, item[_chosen(estimate, candidate)]) for flights, item in sides]
        neighbours = tuple((flights, item, balance(flights, item)) for flights, item in same)
        at_candidate = AtCandidate(problem, candidate, balance(problem, candidate), neighbours)
        results[tuple(candidate.nuisances.values())] = at_candidate
    return results


def _chosen(estimate: Estimate, candidate: Candidate) -> tuple[float, ...]:
    """Values of a candidate's discrete nuisances."""
    return tuple(
        round(value, DECIMALS) for name, value in candidate.nuisances.items() if name not in estimate.names
    )


def _slope(at_candidate: AtCandidate, curve: FittedCurve, of: Of) -> float:
    """Derivative of a quantity by the map's parameter."""
    low, high = (of(*side)[0] for side in at_candidate.sides)
    return (high - low) / (curve.above[0] - curve.below[0])


def _propagated(at_candidate: AtCandidate, curve: FittedCurve, of: Of) -> Linear:
    """A quantity with the error of the map in its gradient and its variance."""
    value, gradient, variance = of(at_candidate.problem, at_candidate.candidate, at_candidate.terms)
    slope = _slope(at_candidate, curve, of)
    if math.isinf(curve.bias_std):
        error = 0.0 if math.isinf(curve.curvature_error) else curve.curvature_error
        return value, gradient, variance + (slope * error) ** 2
    by_b, of_b, current = _curve_error(at_candidate, curve)
    return value, gradient + slope * of_b, variance + (slope * by_b) ** 2 * current


def _curve_error(
    at_candidate: AtCandidate, curve: FittedCurve
) -> tuple[float, Float[np.ndarray, " n"], float]:
    """Change of the map's parameter by the intercept, its gradient, and the intercept's variance besides."""
    _, gradient, variance = _intercept(at_candidate.problem, at_candidate.candidate, at_candidate.terms)
    by_b = -1.0 / _slope(at_candidate, curve, _intercept)
    return by_b, by_b * gradient, variance + curve.bias_std**2


def _with_curve(
    estimate: Estimate,
    points: dict[tuple[float, ...], AtCandidate],
    curve: FittedCurve,
    of: Of,
    unit: str,
) -> QuantityEstimate:
    results = {name: _propagated(point, curve, of) for name, point in points.items()}
    return _quantity_estimate(estimate, results, unit)


def _of_curve(
    estimate: Estimate, points: dict[tuple[float, ...], AtCandidate], curve: FittedCurve
) -> QuantityEstimate:
    results: dict[tuple[float, ...], Linear] = {}
    for name, point in points.items():
        if math.isinf(curve.bias_std):
            results[name] = curve.value, np.zeros(point.candidate.values.size), curve.curvature_error**2
        else:
            # a candidate with an intercept of its own has a map of its own
            by_b, gradient, variance = _curve_error(point, curve)
            b = _intercept(point.problem, point.candidate, point.terms)[0]
            results[name] = curve.value + by_b * b, gradient, by_b**2 * variance
    return _quantity_estimate(estimate, results, "")


def _quantity_estimate(
    estimate: Estimate, result: dict[tuple[float, ...], Linear], unit: str
) -> QuantityEstimate:
    def linear(candidate: Candidate) -> tuple[float, Float[np.ndarray, " n"]]:
        return result[tuple(candidate.nuisances.values())][:2]

    def extra(candidate: Candidate) -> float:
        return result[tuple(candidate.nuisances.values())][2]

    interval = estimate.interval_of(linear, extra_variance=extra)
    value, gradient = linear(estimate.best)
    error = math.sqrt(estimate.best.covariance.std_error(gradient) ** 2 + extra(estimate.best))
    return QuantityEstimate(value, unit, error, interval)


def _joint(position: int) -> Of:
    def of(_problem: VerticalFlights, candidate: Candidate, _terms: Balance) -> Linear:
        return float(candidate.values[position]), np.eye(candidate.values.size)[position], 0.0

    return of


def _intercept(_problem: VerticalFlights, candidate: Candidate, terms: Balance) -> Linear:
    return *intercept(candidate, terms), terms.residual_variance


def _hover(problem: VerticalFlights, candidate: Candidate, terms: Balance) -> Linear:
    """Hover input in the unit of commands."""
    mapped, gradient = hover_mapped(candidate, terms)
    chosen = problem.motion.input_map
    hover = chosen.inverse(mapped)
    slope = chosen.slope(hover)
    variance = terms.residual_variance / float(candidate.theta[1]) ** 2
    return hover, gradient / slope, variance / slope**2
