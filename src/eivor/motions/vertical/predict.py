"""What numbers say of a flight: its vertical acceleration one step ahead, its climb rate in open loop.

One step ahead, z'' is predicted of the measured velocity and of the input up to now. In open loop the climb
rate of a run is the answer of v' = K_u U - K v + c, and of what terms add, to its input alone; trim c
and start v(0) belong to the run and are fitted, for every model alike.
"""

from __future__ import annotations

import numpy as np

from eivor.estimation.estimate import Estimate
from eivor.flights.predicted import Horizon, Predicted, SimpleModel
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY
from eivor.models.separable import Values
from eivor.motions.vertical.balance import balance_sums, hover_of_sums
from eivor.motions.vertical.dragged import dragged_run
from eivor.motions.vertical.flights import VerticalFlights
from eivor.motions.vertical.model import GRAVITY, INPUT_GAIN, VISCOUS_FRICTION
from eivor.motions.vertical.terms import QuadraticDrag
from eivor.shapes import Bool, Float


def simple_models(problem: VerticalFlights, estimate: Estimate) -> dict[str, SimpleModel]:
    """Least squares without lag and delay, and thrust over weight alone, of the same flights."""
    at = {**estimate.best.at, ACTUATOR_LAG.name: 0.0, DELAY.name: 0.0}
    rows = problem.rows(at)
    fitted = np.linalg.lstsq(rows.regressors, rows.response)[0].tolist()
    least_squares = {**at, **{p.name: theta for p, theta in zip(rows.parameters, fitted, strict=True)}}
    sums = {name: float(each.sum()) for name, each in balance_sums(problem, at).items()}
    linear = dict(zip((p.name for p in rows.parameters), estimate.best.theta.tolist(), strict=True))
    weight = GRAVITY / hover_of_sums(linear, sums)
    others = {parameter.name: 0.0 for parameter in rows.parameters}
    return {
        "least_squares": SimpleModel("least squares that ignores the lag", least_squares),
        "hover": SimpleModel("hover input only", {**at, **others, INPUT_GAIN.name: weight}),
    }


def predictions(problem: VerticalFlights, values: Values) -> tuple[Predicted, ...]:
    """Vertical acceleration one step ahead, and climb rate in open loop."""
    at = {nuisance.name: values[nuisance.name] for nuisance in problem.nuisances}
    rows = problem.rows(at)
    theta = np.array([values[parameter.name] for parameter in rows.parameters])
    velocities = [flight.cut(flight.velocity[:, None]) for flight in problem.flights]
    measured = np.concatenate([run[:, 0] for runs in velocities for run in runs])
    return (
        Predicted(Horizon.ONE_STEP, "vertical acceleration", "m/s²", rows.response, rows.regressors @ theta),
        Predicted(Horizon.OPEN_LOOP, "climb rate", "m/s", measured, _open_loop(problem, values)),
    )


def _open_loop(problem: VerticalFlights, values: Values) -> Float[np.ndarray, " samples"]:
    """Climb rates of every run, of the input alone; height and voltage, where terms have them, as logged."""
    friction, drag = values[VISCOUS_FRICTION.name], values.get(QuadraticDrag.parameter.name, 0.0)
    names = [INPUT_GAIN.name, *(term.parameter.name for term in problem.terms)]
    # drag acts on the climb rate that is predicted, and not on the one that was measured
    weights = np.array([0.0 if name == QuadraticDrag.parameter.name else values[name] for name in names])
    found: list[Float[np.ndarray, " _"]] = []
    for flight in problem.flights:
        driven = problem.moving(flight)(values) @ weights
        step_s = flight.signals.step_s
        for run in flight.runs:
            counted = slice(None) if flight.signals.valid is None else flight.signals.valid[run]
            told = driven[run], flight.velocity[run], counted, friction
            found.append(dragged_run(*told, drag, step_s) if drag else _run(*told, step_s))
    return np.concatenate(found)


def _run(
    driven: Float[np.ndarray, " n"],
    measured: Float[np.ndarray, " n"],
    counted: Bool[np.ndarray, " n"] | slice,
    friction: float,
    step_s: float,
) -> Float[np.ndarray, " counted"]:
    """Answer to the input of one run, with the trim and the start that suit what was measured best.

    With a friction below zero the same answers are taken from the end backward: forward they would grow.
    """
    if friction < 0.0:
        turned = counted[::-1] if isinstance(counted, np.ndarray) else counted
        return _run(-driven[::-1], measured[::-1], turned, -friction, step_s)[::-1]
    answer = _integrated(driven - driven.mean(), friction, step_s)
    trim = _integrated(np.ones(driven.size), friction, step_s)
    start = np.exp(-friction * step_s * np.arange(driven.size))
    own = np.column_stack([trim, start])[counted]
    left = (measured - answer)[counted]
    predicted: Float[np.ndarray, " counted"] = answer[counted] + own @ np.linalg.lstsq(own, left)[0]
    return predicted


def _integrated(force: Float[np.ndarray, " n"], friction: float, step_s: float) -> Float[np.ndarray, " n"]:
    """Velocity under a force that is linear between samples, from rest; exact to second order of the step."""
    from scipy.signal import lfilter

    decay = np.exp(-friction * step_s)
    gained = np.zeros(force.size)
    gained[1:] = 0.5 * step_s * (decay * force[:-1] + force[1:])
    velocity: Float[np.ndarray, " n"] = lfilter([1.0], [1.0, -decay], gained)
    return velocity
