"""The quantities of a flight's result, from an estimate and the balance of the equation of motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from eivor.estimation.candidate import Candidate
from eivor.estimation.estimate import Estimate
from eivor.flights.drawn import Drawn
from eivor.flights.estimated import (
    EFFECTIVE_LAG,
    joint_quantities,
    lag_quantities,
    ratio_quantity,
    reciprocal,
)
from eivor.flights.quantity import NAN, Unjudged
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY
from eivor.motions.vertical.balance import (
    Balance,
    balance,
    balance_sums,
    hover_mapped,
    hover_of_sums,
    intercept,
    intercepts_by_run,
)
from eivor.motions.vertical.flights import VerticalFlights
from eivor.motions.vertical.map_rule import IS_THRUST, MAP_EXPONENT, THRUST_EXPONENT
from eivor.motions.vertical.model import GRAVITY, INPUT_GAIN
from eivor.shapes import Float
from eivor.signals.input_map import Mixed

#: Values of all nuisances, which tell a candidate from the others.
Place = tuple[float, ...]


def all_quantities(problem: VerticalFlights, estimate: Estimate) -> dict[str, Unjudged]:
    """Every quantity, in the order of results; none has a verdict yet."""
    terms = {_place(c): balance(problem, c) for c in estimate.candidates}
    joint = joint_quantities(estimate)
    found = {
        "viscous_friction": joint["viscous_friction"],
        "input_gain": joint["input_gain"],
        "intercept": _intercept(estimate, terms),
        **{term.parameter.name: joint[term.parameter.name] for term in problem.terms},
        **lag_quantities(problem, estimate),
        "hover_input": _hover(problem, estimate, terms),
        "time_constant": ratio_quantity(estimate, 1.0, "viscous_friction", "s"),
    }
    if problem.curve is None:
        return found
    from eivor.motions.vertical.curve import curve_quantities  # late: few have a curve

    moved = curve_quantities(problem, estimate, problem.curve)
    moved["intercept"] = replace(moved["intercept"], by_run=found["intercept"].by_run)
    return {**found, **moved, "time_constant": reciprocal(moved["viscous_friction"], "s")}


def drawn_quantities(problem: VerticalFlights, drawn: Drawn) -> dict[str, float]:
    """Quantities of a draw of flights; lags only where they were searched for."""
    K, K_u = drawn.parameters["viscous_friction"], drawn.parameters["input_gain"]
    found = {
        "viscous_friction": K,
        "input_gain": K_u,
        **{term.parameter.name: drawn.parameters[term.parameter.name] for term in problem.terms},
        "hover_input": problem.motion.input_map.inverse(hover_of_sums(drawn.parameters, drawn.sums)),
    }
    lag_s, delay_s = drawn.at[ACTUATOR_LAG.name], drawn.at[DELAY.name]
    if problem.lag.searched:
        found[ACTUATOR_LAG.name] = lag_s
    if problem.lag.searched or problem.delay.searched:
        found[EFFECTIVE_LAG] = lag_s + delay_s
    return found


def _intercept(estimate: Estimate, terms: dict[Place, Balance]) -> Unjudged:
    """Intercept over all runs, and that of each."""
    interval = estimate.interval_of(
        lambda c: intercept(c, terms[_place(c)]),
        extra_variance=lambda c: terms[_place(c)].residual_variance,
    )
    value, gradient = intercept(estimate.best, terms[_place(estimate.best)])
    extra = terms[_place(estimate.best)].residual_variance
    by_run = tuple(intercepts_by_run(estimate.best, terms[_place(estimate.best)]).tolist())
    error = _std_error(estimate.best, gradient, extra)
    return Unjudged(value, "m/s^2", error, interval, by_run=by_run)


def _hover(problem: VerticalFlights, estimate: Estimate, terms: dict[Place, Balance]) -> Unjudged:
    """Hover input: the interval of U_h through the input map's inverse."""

    def extra(candidate: Candidate) -> float:
        return terms[_place(candidate)].residual_variance / float(candidate.theta[1]) ** 2

    low, high = estimate.interval_of(lambda c: hover_mapped(c, terms[_place(c)]), extra_variance=extra)
    mapped, gradient = hover_mapped(estimate.best, terms[_place(estimate.best)])
    inverse = problem.motion.input_map.inverse
    value = inverse(mapped)
    slope = problem.motion.input_map.slope(value)
    error = _std_error(estimate.best, gradient, extra(estimate.best))
    std_error = error / slope if slope > 0.0 else NAN
    return Unjudged(value, "", std_error, (inverse(low), inverse(high)))


def thrust_curve(problem: VerticalFlights, estimate: Estimate) -> dict[str, float]:
    """Exponents at hover: of thrust, m K_u U_h / g, see `map_rule`, and of the input map."""
    best = estimate.best
    linear = dict(zip((p.name for p in problem.parameters), best.theta.tolist(), strict=True))
    sums = {name: float(each.sum()) for name, each in balance_sums(problem, best.at).items()}
    mapped = hover_of_sums(linear, sums)
    chosen = problem.motion.input_map
    hover = chosen.inverse(mapped)
    of_map = hover * chosen.slope(hover) / mapped if mapped > 0.0 else NAN
    return {
        THRUST_EXPONENT: of_map * linear[INPUT_GAIN.name] * mapped / GRAVITY,
        MAP_EXPONENT: of_map,
        IS_THRUST: float(isinstance(chosen, Mixed) or chosen.name == "linear"),
    }


def _place(candidate: Candidate) -> Place:
    return tuple(candidate.at.values())


def _std_error(candidate: Candidate, gradient: Float[np.ndarray, " n"], extra: float) -> float:
    return float(np.sqrt(candidate.covariance.std_error(gradient) ** 2 + extra))
