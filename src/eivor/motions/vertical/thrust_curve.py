"""Thrust curve: its estimation, and the autopilot's parameter that it would set."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from operator import attrgetter

import numpy as np

from eivor.estimation.estimate import Estimate
from eivor.flights.lag_prior import linear_quantity
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import Quantity, QuantityEstimate
from eivor.inference.verdict import Status
from eivor.motions.vertical import model
from eivor.motions.vertical.regression import Balance, Linear, VerticalFlights, vertical_problem
from eivor.motions.vertical.select import FittedCurve
from eivor.signals.channels import CurveSide, common_side
from eivor.signals.recording import Finding
from eivor.signals.thrust_map import InputMap, input_map

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
    family = model.family_of(problem.motion.input_map, fitted=False)
    value, chosen, estimate = _by_intercept(problem, estimated, family)
    if math.isnan(value):
        return problem, estimate
    sides = [family.possible(value + step) for step in (-STEP, STEP)]
    below, above = ((side, estimated(with_map(problem, family.map(side)))) for side in sides)
    curve = FittedCurve(family, value, bias_std, below, above)
    return replace(chosen, curve=curve), estimate


def _by_intercept(
    problem: VerticalFlights, estimated: Estimated, family: model.CurveFamily
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
    problem: VerticalFlights, estimated: Estimated, best: Estimate, family: model.CurveFamily
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
        value = family.possible(model.share_of(exponent, hover) if family.of_share else exponent)
        if abs(value - before) < CONVERGED:
            break
        chosen = with_map(replace(problem, nuisances=known), family.map(value))
        best = estimated(chosen)
    return value


def curve_quantities(of: Balance, curve: FittedCurve) -> dict[str, QuantityEstimate]:
    """Quantities that the map's own error moves, and the map's parameter."""
    estimate = of.estimate
    pairs = [(with_map(of.problem, curve.family.map(at)), item) for at, item in (curve.below, curve.above)]
    sides = [Balance(*pair) for pair in pairs]

    def slope(quantity: Callable[[Balance], Linear]) -> float:
        low, high = (quantity(side)[0] for side in sides)
        return (high - low) / (curve.above[0] - curve.below[0])

    b, of_b, variance_b = of.intercept
    by_b = -1.0 / slope(attrgetter("intercept"))
    of_curve, variance_of_curve = by_b * of_b, variance_b + curve.bias_std**2

    def propagated(quantity: Callable[[Balance], Linear]) -> Linear:
        """A quantity with the error of the map in its gradient and its variance."""
        value, gradient, variance = quantity(of)
        by_curve = slope(quantity)
        return value, gradient + by_curve * of_curve, variance + (by_curve * by_b) ** 2 * variance_of_curve

    formulas: dict[str, tuple[Callable[[Balance], Linear], str]] = {
        "viscous_friction": (partial(_joint, 0), "1/s"),
        "input_gain": (partial(_joint, 1), "m/s^2"),
        "intercept": (attrgetter("intercept"), "m/s^2"),
        "hover_input": (attrgetter("hover_input"), ""),
    }
    rows = formulas.items()
    results = {name: linear_quantity(estimate, unit, *propagated(of_it)) for name, (of_it, unit) in rows}
    value = curve.value + by_b * b, of_curve, by_b**2 * variance_of_curve
    return {**results, "thrust_curve": linear_quantity(estimate, "", *value)}


def _joint(position: int, of: Balance) -> Linear:
    values = of.estimate.values
    return float(values[position]), np.eye(values.size)[position], 0.0


# -- Reported thrust curve --

NOT_IN_FORCE = (
    "The command is before the autopilot's thrust curve, and no value of it that is in force is known "
    "(THR_MDL_FAC, MOT_THST_EXPO): no parameter is proposed."
)


def curve_findings(
    flights: tuple[PreparedFlight, ...], quantities: Mapping[str, Quantity]
) -> tuple[Finding, ...]:
    """The parameter that a curve would set; none where the curve or the hover input is not identified."""
    curve, hover = quantities.get("thrust_curve"), quantities["hover_input"]
    if curve is None or not 0.0 < hover.value < 1.0 or flights[0].input.measured:
        return ()
    side = common_side(flight.curve_side for flight in flights)
    in_force = model.curve_in_force([flight.recording.parameters for flight in flights])
    if Status.REFUSED in (curve.verdict, hover.verdict):
        return _overdone(side, in_force, curve)
    if side is CurveSide.UNKNOWN:
        sentence = (
            f"The log does not say whether {flights[0].input.name} is before or behind the autopilot's "
            f"thrust curve: no parameter is proposed. {model.DECLARE}"
        )
        return (Finding("thrust_curve", sentence),)
    family = model.family_of(input_map(flights[0].input_map))
    before = side is CurveSide.BEFORE
    sentences = []
    for parameter in [
        item for item in model.CURVE_PARAMETERS if item.name in in_force or not (in_force or before)
    ]:
        value, name = in_force.get(parameter.name), parameter.name
        if before and value is not None and not parameter.takes(value):
            continue
        intervals = (curve.value, curve.interval), (hover.value, hover.interval)
        share, _ = model.proposed(parameter, family, *intervals, value if before else None)
        (middle, (low, high)), beyond = share, parameter.beyond(share)
        words = (
            f"No {name} is proposed: {beyond}"
            if beyond
            else (
                f"{name} ({parameter.autopilot}) would be set to {middle:.2f} [{low:.2f}, {high:.2f}] by "
                f"the thrust curve that was fitted, which is {curve.verdict.value}."
            )
        )
        sentences.append(words if value is None else f"{words} The log has {name} {value:.2g}.")
    return (Finding("thrust_curve", " ".join(sentences) or NOT_IN_FORCE),)


def _overdone(side: CurveSide, in_force: Mapping[str, float], curve: Quantity) -> tuple[Finding, ...]:
    """Say that a curve in force bends too much, which no share of the square brings back."""
    large = [f"{name} {value:.2g}" for name, value in in_force.items() if value > 0.0]
    if side is not CurveSide.BEFORE or not large or not curve.interval[1] < 0.0:
        return ()
    sentence = (
        f"Thrust grows more slowly than its setpoint: {' and '.join(large)}, which is in force, is too large "
        "for this vehicle, unless the supply sags. Identify with motor signals behind the curve, or fly with "
        "a smaller value."
    )
    return (Finding("thrust_curve", sentence),)
