"""One trial of the flight study: a flight of the grid, what the recipe and the controls make of it.

The recipe is `identify_flight` with its default options. Two controls must do badly in the same study, or
the study could not tell good from bad: the recipe with the actuator's lag ignored, and nonlinear least
squares, which takes no instruments. They are run on excited flights only.

Truth is the flight's effective parameters over the rows that the recipe used: what an estimator without
any error would give. In the own simulator these are the nominal ones.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from eivor.errors import EivorError
from eivor.estimation.methods import identify, reference_iv
from eivor.flights.options import FlightOptions
from eivor.flights.result import FlightEstimate
from eivor.inference.verdict import Status
from eivor.models.lagged_runs import lag_and_delay
from eivor.motions.identify import identify_flight
from eivor.motions.vertical.regression import VerticalFlights
from eivor.process_pool import Executor, in_order
from eivor.simulation.environment import FlightTruth, SimulatedFlight, effective_parameters
from eivor.simulation.vertical import VerticalFlightSpec, simulate_vertical_flights
from validation.flight_recipe.grid import FlightCase, FlightGrid
from validation.flight_recipe.rotorpy_flight import RotorpyFlightSpec, simulate_rotorpy_flight

#: What is scored, and the estimators: the recipe first, then the controls.
QUANTITIES = ("viscous_friction", "input_gain", "effective_lag", "hover_input")
RECIPE, LAG_IGNORED, NONLINEAR = "recipe", "lag_ignored", "least_squares"
ESTIMATORS: Mapping[str, tuple[str, ...]] = {
    RECIPE: QUANTITIES,
    LAG_IGNORED: ("viscous_friction", "input_gain"),
    NONLINEAR: ("viscous_friction", "input_gain", "effective_lag"),
}
#: The joint vector of the recipe.
JOINT = ("viscous_friction", "input_gain", "actuator_lag")
#: Verdict of a flight whose vehicle was lost in the simulator: there is nothing to score.
LOST = "lost"
#: Flights of the own simulator in one task.
FLIGHTS_TOGETHER = 12


@dataclass(frozen=True, slots=True)
class IntervalEstimate:
    """A number and its 95 % interval; NaN when there is none."""

    value: float = float("nan")  # In the quantity's unit
    low: float = float("nan")
    high: float = float("nan")


@dataclass(frozen=True, slots=True)
class FlightTrial:
    """One flight and what was made of it."""

    case: FlightCase  # The flight
    verdict: str  # The recipe's overall verdict, or "lost"
    truth: Mapping[str, float]  # Each of `QUANTITIES`; NaN for a lost flight
    estimates: Mapping[str, Mapping[str, IntervalEstimate]]  # By estimator and quantity, as in `ESTIMATORS`
    # Least conditional first-stage F and the p-value of the over-identification test of the recipe; NaN when
    # it had no instruments
    first_stage: float = float("nan")
    p_value: float = float("nan")

    @property
    def accepted(self) -> bool:
        """The recipe called the flight identified."""
        return self.verdict == Status.IDENTIFIED.value


def run_trials(grid: FlightGrid, executor: Executor) -> Iterator[FlightTrial]:
    """Fly and judge every flight of the grid, the own simulator's first."""
    for trials in in_order(executor.map(fly, flown_together(grid))):
        yield from trials


def flown_together(grid: FlightGrid) -> list[tuple[FlightCase, ...]]:
    """Tasks of a grid: flights of the own simulator, which flies them side by side, or one of RotorPy."""
    current = tuple(case for case in grid.cases if isinstance(case.spec, VerticalFlightSpec))
    tasks = [current[first : first + FLIGHTS_TOGETHER] for first in range(0, len(current), FLIGHTS_TOGETHER)]
    return tasks + [(case,) for case in grid.cases if isinstance(case.spec, RotorpyFlightSpec)]


def fly(cases: Sequence[FlightCase]) -> tuple[FlightTrial, ...]:
    """Fly and judge some flights."""
    specs = [case.spec for case in cases if isinstance(case.spec, VerticalFlightSpec)]
    together = simulate_vertical_flights(specs)
    return tuple(
        judged(
            case,
            simulate_rotorpy_flight(case.spec)
            if isinstance(case.spec, RotorpyFlightSpec)
            else next(together),
        )
        for case in cases
    )


def judged(case: FlightCase, flight: SimulatedFlight) -> FlightTrial:
    """Run the recipe and the controls on a flight and put the truth beside them."""
    nothing = {name: dict.fromkeys(scored, IntervalEstimate()) for name, scored in ESTIMATORS.items()}
    if not flight.flew:
        return FlightTrial(case, LOST, dict.fromkeys(QUANTITIES, float("nan")), nothing)
    result = identify_flight(flight.recording)
    estimates = nothing | {RECIPE: _displayed(result, RECIPE)}
    if case.kind == "excited":
        estimates[LAG_IGNORED] = _lag_ignored(result)
        direct = identify_flight(flight.recording, FlightOptions(method="least_squares"))
        estimates[NONLINEAR] = _displayed(direct, NONLINEAR)
    strengths = [result.diagnostics.get(f"first_stage_F_{name}", np.nan) for name in JOINT]
    return FlightTrial(
        case,
        result.verdict.status.value,
        _truth(flight.truth, result),
        estimates,
        float(np.min(strengths)),
        result.diagnostics.get("over_identification_p_value", np.nan)
        if result.instruments != "none"
        else np.nan,
    )


def _displayed(result: FlightEstimate, estimator: str) -> dict[str, IntervalEstimate]:
    quantities = {name: result.quantities[name] for name in ESTIMATORS[estimator]}
    return {
        name: IntervalEstimate(quantity.value, *quantity.interval) for name, quantity in quantities.items()
    }


def _lag_ignored(result: FlightEstimate) -> dict[str, IntervalEstimate]:
    """Return the recipe's estimate with the commands taken for the rotors' states."""
    scored = ESTIMATORS[LAG_IGNORED]
    if result.fit is None or not isinstance(result.fit.problem, VerticalFlights):
        return dict.fromkeys(scored, IntervalEstimate())
    problem = replace(result.fit.problem, nuisances=lag_and_delay([0.0], [0.0]))
    try:
        estimate = identify(problem, reference_iv())
    except EivorError:
        return dict.fromkeys(scored, IntervalEstimate())
    return {name: IntervalEstimate(estimate.parameters[name], *estimate.interval(name)) for name in scored}


def _truth(truth: FlightTruth, result: FlightEstimate) -> dict[str, float]:
    """Effective parameters over the rows that the recipe used; nominal ones where it used none."""
    used = result.prepared[0].used
    rows = np.zeros(truth.time_s.size, dtype=np.bool_)
    rows[: used.size] = used[: rows.size]
    friction, gain = truth.viscous_friction, truth.input_gain
    mapped = truth.hover_input**2
    try:
        effective = effective_parameters(truth, rows, np.square)
    except EivorError:  # A hover so still that its rows tell nothing.
        pass
    else:
        weight = gain * mapped
        friction, gain = effective.viscous_friction, effective.input_gain
        mapped = (weight - effective.intercept) / gain
    return {
        "viscous_friction": friction,
        "input_gain": gain,
        "effective_lag": truth.actuator_lag + truth.delay,
        "hover_input": float(np.sqrt(mapped)),
    }
