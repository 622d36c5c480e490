"""The quantities of a flight's result, from an estimate and the balance of the equation of motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from eivor.estimation.candidate import Candidate
from eivor.estimation.derived import ratio
from eivor.estimation.estimate import Estimate
from eivor.flights.derived import (
    Balance,
    balance,
    effective_lag,
    hover_mapped,
    intercept,
    intercepts_by_run,
)
from eivor.flights.result import Quantity
from eivor.flights.rule import Circumstances, friction_reasons, gain_reasons, hover_reasons, lag_reasons
from eivor.inference.verdict import Reason, Status, Verdict, verdict
from eivor.models.vertical_flights import VerticalFlights

NAN = float("nan")
NO_INTERVAL = (float("-inf"), float("inf"))


def all_quantities(problem: VerticalFlights, estimate: Estimate) -> dict[str, Quantity]:
    """Every quantity, without verdicts yet (all are marked identified)."""
    searched = "actuator_lag" in estimate.names
    terms = {c.delay_s: balance(problem, c, lag_searched=searched) for c in estimate.candidates}
    quantities = {
        name: Quantity(
            estimate.parameters[name],
            unit,
            estimate.std_error(name),
            estimate.interval(name),
            Status.IDENTIFIED,
        )
        for name, unit in zip(estimate.names, estimate.units, strict=True)
    }
    if not searched:
        quantities["actuator_lag"] = Quantity(0.0, "s", 0.0, (0.0, 0.0), Status.IDENTIFIED)
    quantities["intercept"] = _intercept(estimate, terms)
    quantities["delay"] = _delay(estimate)
    quantities["effective_lag"] = _effective_lag(estimate) if searched else quantities["actuator_lag"]
    quantities["hover_input"] = _hover(problem, estimate, terms)
    quantities["time_constant"] = _time_constant(estimate)
    return quantities


def segment_intercepts(problem: VerticalFlights, estimate: Estimate) -> Float[np.ndarray, " runs"]:
    """Intercept of each run at the best delay [m/s^2]."""
    return intercepts_by_run(estimate.best, balance(problem, estimate.best, lag_searched=False))


def judged(
    estimate: Estimate, quantities: dict[str, Quantity], at: Circumstances
) -> tuple[Verdict, dict[str, Quantity]]:
    """The overall verdict, and the quantities with their own."""
    overall = verdict(friction_reasons(estimate, quantities, at))
    reasons: dict[str, list[Reason]] = {
        "input_gain": gain_reasons(estimate, quantities["input_gain"], at),
        "hover_input": hover_reasons(quantities["hover_input"], at),
        "actuator_lag": lag_reasons(estimate, quantities, at),
    }
    reasons["intercept"] = reasons["input_gain"]
    reasons["delay"] = reasons["effective_lag"] = reasons["actuator_lag"]
    statuses = {name: verdict(found).status for name, found in reasons.items()}
    statuses["viscous_friction"] = statuses["time_constant"] = overall.status
    return overall, {name: replace(q, verdict=statuses[name]) for name, q in quantities.items()}


def nothing_estimated(input_unit: str, hover: float) -> dict[str, Quantity]:
    """Quantities of a flight that gives no estimate; the mean input may still be known."""
    units = {
        "viscous_friction": "1/s",
        "input_gain": "m/s^2",
        "intercept": "m/s^2",
        "actuator_lag": "s",
        "delay": "s",
        "effective_lag": "s",
        "time_constant": "s",
    }
    empty = {name: Quantity(NAN, unit, NAN, NO_INTERVAL, Status.REFUSED) for name, unit in units.items()}
    empty["hover_input"] = Quantity(hover, input_unit, NAN, NO_INTERVAL, Status.REFUSED)
    return empty


def _intercept(estimate: Estimate, terms: dict[float, Balance]) -> Quantity:
    interval = estimate.interval_of(
        lambda c: intercept(c, terms[c.delay_s]), extra_variance=lambda c: terms[c.delay_s].residual_variance
    )
    value, gradient = intercept(estimate.best, terms[estimate.best.delay_s])
    extra = terms[estimate.best.delay_s].residual_variance
    return Quantity(value, "m/s^2", _std_error(estimate.best, gradient, extra), interval, Status.IDENTIFIED)


def _delay(estimate: Estimate) -> Quantity:
    delays = [candidate.delay_s for candidate in estimate.tenable()]
    return Quantity(estimate.best.delay_s, "s", NAN, (min(delays), max(delays)), Status.IDENTIFIED)


def _effective_lag(estimate: Estimate) -> Quantity:
    value, direction = effective_lag(estimate, estimate.best)
    interval = estimate.interval_of(lambda c: effective_lag(estimate, c))
    return Quantity(value, "s", estimate.best.covariance.std_error(direction), interval, Status.IDENTIFIED)


def _time_constant(estimate: Estimate) -> Quantity:
    """1/K: without a bound as soon as the friction cannot be told from zero."""
    friction, error = estimate.parameters["viscous_friction"], estimate.std_error("viscous_friction")
    value = 1.0 / friction if friction else NAN
    interval = ratio(estimate, 1.0, "viscous_friction").hull
    return Quantity(value, "s", error / friction**2 if friction else NAN, interval, Status.IDENTIFIED)


def _hover(problem: VerticalFlights, estimate: Estimate, terms: dict[float, Balance]) -> Quantity:
    """Hover input: the interval of U_h through the input map's inverse."""

    def extra(candidate: Candidate) -> float:
        return terms[candidate.delay_s].residual_variance / float(candidate.theta[1]) ** 2

    low, high = estimate.interval_of(lambda c: hover_mapped(c, terms[c.delay_s]), extra_variance=extra)
    mapped, gradient = hover_mapped(estimate.best, terms[estimate.best.delay_s])
    inverse = problem.motion.input_map.inverse
    value = inverse(mapped)
    slope = problem.motion.input_map.slope(value)
    error = _std_error(estimate.best, gradient, extra(estimate.best))
    std_error = error / slope if slope > 0.0 else NAN
    return Quantity(value, "", std_error, (inverse(low), inverse(high)), Status.IDENTIFIED)


def _std_error(candidate: Candidate, gradient: Float[np.ndarray, " n"], extra: float) -> float:
    return float(np.sqrt(candidate.covariance.std_error(gradient) ** 2 + extra))
