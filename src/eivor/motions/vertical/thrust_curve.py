"""Estimation of a thrust curve."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from operator import attrgetter

import numpy as np

from eivor.estimation.estimate import Estimate
from eivor.estimation.profile_sets import DEGREES
from eivor.flights.quantity import NAN, NO_INTERVAL, QuantityEstimate
from eivor.inference.distributions import t_quantile
from eivor.motions.vertical.model import CurveFamily, family_of
from eivor.motions.vertical.regression import Balance, Linear, VerticalFlights, vertical_problem
from eivor.motions.vertical.select import FittedCurve
from eivor.signals.thrust_map import InputMap

#: The map is found when another round would change its parameter by less than this; so many rounds are made.
CONVERGED, ROUNDS = 3e-4, 10
#: Lag and delay are searched again so often with the map that was found.
SEARCHES = 3
#: Half of what maps are changed by for derivatives.
STEP = 0.02

Estimated = Callable[[VerticalFlights], Estimate]


def with_map(problem: VerticalFlights, chosen: InputMap) -> VerticalFlights:
    """Return the same flights with another input map."""
    motion = replace(problem.motion, input_map=chosen)
    return vertical_problem(problem.flights, motion, problem.rule, problem.nuisances, problem.terms)


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
    below, above = ((side, estimated(with_map(problem, family.map(side)))) for side in sides)
    curve = FittedCurve(family, value, bias_std, below, above, curvature_error)
    return replace(chosen, curve=curve), estimate


def _by_intercept(
    problem: VerticalFlights, estimated: Estimated, family: CurveFamily
) -> tuple[float, VerticalFlights, Estimate]:
    """Parameter with which the intercept vanishes, or the nearest that is possible, NaN for none."""
    value, chosen, estimate = math.nan, problem, estimated(problem)
    for _ in range(SEARCHES):
        before, value = value, _at_nuisances(chosen, estimated, estimate, family)
        if math.isnan(value) or abs(value - before) < CONVERGED:
            break
        chosen = with_map(problem, family.map(value))
        estimate = estimated(chosen)
    return value, chosen, estimate


def _at_nuisances(
    problem: VerticalFlights, estimated: Estimated, best: Estimate, family: CurveFamily
) -> float:
    """The same with lag and delay where they are: the map hardly moves them."""
    value, chosen = math.nan, problem
    known = tuple(nuisance.known_at(best.nuisances[nuisance.name]) for nuisance in problem.nuisances)
    for _ in range(ROUNDS):
        before = value
        of = Balance(chosen, best)
        hover, exponent = chosen.motion.input_map.inverse(of.hover[0]), of.exponents[1]
        if not (math.isfinite(exponent) and hover > 0.0):
            return math.nan
        value = family.possible(family.of_exponent(exponent, hover))
        if abs(value - before) < CONVERGED:
            break
        chosen = with_map(replace(problem, nuisances=known), family.map(value))
        best = estimated(chosen)
    return value


def _by_curvature(problem: VerticalFlights, estimated: Estimated, family: CurveFamily) -> tuple[float, float]:
    """Parameter with the least criterion, and its standard error; infinite where an end of the grid fits."""
    grid = family.grid
    criterion = np.array(
        [estimated(with_map(problem, family.map(value))).criterion for value in grid.tolist()]
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


def linear_quantity(estimate: Estimate, linear: Linear, unit: str) -> QuantityEstimate:
    """Quantity of an estimate that is linear in its parameters."""
    (value, gradient, variance), covariance = linear, estimate.joint_covariance
    half = covariance.half_width(gradient, 0.95, variance)
    error = math.sqrt(covariance.std_error(gradient) ** 2 + variance)
    return QuantityEstimate(value, unit, error, (value - half, value + half))


def curve_quantities(of: Balance, curve: FittedCurve) -> dict[str, QuantityEstimate]:
    """Quantities that the map's own error moves, and the map's parameter."""
    estimate = of.estimate
    sides = [
        Balance(with_map(of.problem, curve.family.map(value)), item)
        for value, item in (curve.below, curve.above)
    ]
    by_curvature = math.isinf(curve.bias_std)

    def slope(quantity: Callable[[Balance], Linear]) -> float:
        """Derivative of a quantity by the map's parameter."""
        low, high = (quantity(side)[0] for side in sides)
        return (high - low) / (curve.above[0] - curve.below[0])

    b, of_b, variance_b = of.intercept
    by_b = 0.0 if by_curvature else -1.0 / slope(attrgetter("intercept"))
    of_curve, own = by_b * of_b, variance_b + curve.bias_std**2

    def propagated(quantity: Callable[[Balance], Linear]) -> Linear:
        """A quantity with the error of the map in its gradient and its variance."""
        value, gradient, variance = quantity(of)
        by_curve = slope(quantity)
        if by_curvature:
            error = 0.0 if math.isinf(curve.curvature_error) else curve.curvature_error
            return value, gradient, variance + (by_curve * error) ** 2
        return value, gradient + by_curve * of_curve, variance + (by_curve * by_b) ** 2 * own

    formulas: dict[str, tuple[Callable[[Balance], Linear], str]] = {
        "viscous_friction": (partial(_joint, 0), "1/s"),
        "input_gain": (partial(_joint, 1), "m/s^2"),
        "intercept": (attrgetter("intercept"), "m/s^2"),
        "hover_input": (attrgetter("hover_input"), ""),
    }
    results = {
        name: linear_quantity(estimate, propagated(quantity), unit)
        for name, (quantity, unit) in formulas.items()
    }
    if not by_curvature:
        value = curve.value + by_b * b, of_curve, by_b**2 * own
        return {**results, "thrust_curve": linear_quantity(estimate, value, "")}
    if math.isinf(curve.curvature_error):
        return {**results, "thrust_curve": QuantityEstimate(curve.value, "", NAN, NO_INTERVAL)}
    value = curve.value, np.zeros(estimate.values.size), curve.curvature_error**2
    return {**results, "thrust_curve": linear_quantity(estimate, value, "")}


def _joint(position: int, of: Balance) -> Linear:
    values = of.estimate.values
    return float(values[position]), np.eye(values.size)[position], 0.0
