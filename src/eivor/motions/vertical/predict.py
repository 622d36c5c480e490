"""Prediction of the vertical motion, with drag and in closed loop."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import scipy

from eivor.errors import EstimationError
from eivor.estimation.estimate import Estimate
from eivor.flights.grid import on_grid
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import Horizon, PredictedQuantity, SimpleModel
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY
from eivor.models.separable import Values
from eivor.models.spectral import densities
from eivor.motions.vertical import regression
from eivor.motions.vertical.model import INPUT_GAIN, VISCOUS_FRICTION
from eivor.motions.vertical.regression import QUADRATIC_DRAG, VerticalFlights
from eivor.signals.recording import GRAVITY, LARGEST_VALUE
from eivor.tools import Bool, Float

#: Most steps towards the best trim and start, and when they have arrived.
STEPS, ARRIVED = 8, 1e-9
#: Speed beyond which drag grows no more [m/s].
FASTEST = 100.0
#: Its exponential is a number yet.
LARGEST_EXPONENT = 700.0


def dragged_run(
    driven: Float[np.ndarray, " n"],
    measured: Float[np.ndarray, " n"],
    counted: Bool[np.ndarray, " n"] | slice,
    friction: float,
    drag: float,
    step_s: float,
) -> Float[np.ndarray, " counted"]:
    """Response to the input of one run, at the samples that count."""
    force, target = driven - driven.mean(), measured[counted]
    trim, start = 0.0, float(target[0])
    for _ in range(STEPS):
        response, by_trim, by_start = (
            row[counted] for row in _responses(force + trim, start, friction, drag, step_s)
        )
        step = np.linalg.lstsq(np.column_stack([by_trim, by_start]), target - response, rcond=None)[0]
        trim, start = trim + float(step[0]), start + float(step[1])
        if np.abs(step).max() < ARRIVED:
            break
    return np.asarray(_responses(force + trim, start, friction, drag, step_s)[0][counted])


def _responses(
    force: Float[np.ndarray, " n"], start: float, friction: float, drag: float, step_s: float
) -> Float[np.ndarray, "3 n"]:
    """Climb rate, and its derivatives by the trim and by the start."""
    v, by_trim, by_start = start, 0.0, 1.0
    results = [(v, by_trim, by_start)]
    halves = (0.5 * step_s * force).tolist()
    for first_half, second_half in pairwise(halves):
        drag_rate = drag * min(abs(v), FASTEST)
        decay = math.exp(min(-step_s * (friction + drag_rate), LARGEST_EXPONENT))
        decay_of_trim = decay * math.exp(min(-step_s * drag_rate, LARGEST_EXPONENT))
        v = decay * (v + first_half) + second_half
        by_trim = decay_of_trim * (by_trim + 0.5 * step_s) + 0.5 * step_s
        by_start *= decay_of_trim
        results.append((v, by_trim, by_start))
    responses = np.array(results).T
    if not (np.abs(responses) <= LARGEST_VALUE).all():
        received = f"a friction of {friction:.3g} 1/s and a drag of {drag:.3g} 1/m, with which it grows"
        remedy = "Identify the flight without the term quadratic-drag, or fly faster."
        raise EstimationError("numbers with which the predicted climb rate stays finite", received, remedy)
    return responses


#: Frequencies at which densities are kept [Hz].
NODES_HZ = np.geomspace(0.06, 4.5, 11)
#: The velocity's own error is white, and known from this frequency on [Hz]: below it its derivative is quiet.
VELOCITY_FROM_HZ = 1.0
#: Half-widths up to which an estimate is taken as it is [1/s, s, share], and what is usual otherwise.
TRUSTED_FRICTION, TRUSTED_LAG_S, TRUSTED_GAIN = 0.25, 0.03, 0.1
USUAL_FRICTION, USUAL_LAG_S = 0.3, 0.05
#: A controller explains at least this share of the command's variance.
LEAST_EXPLAINED = 0.5


def closed_loop_record(
    problem: VerticalFlights, estimate: Estimate, flights: tuple[PreparedFlight, ...]
) -> dict[str, object]:
    """Numbers of flights for JSON: parameters taken, residual densities, controller and tilt."""
    tilt = np.concatenate(
        [flight.signals.channel("cos_tilt")[run] for flight in flights for run in flight.runs]
    )
    climbs = np.concatenate([item.fixed[run] for item in problem.columns for run in item.runs])
    numbers = taken(problem, estimate)
    return {
        "taken": {
            "viscous_friction": numbers[VISCOUS_FRICTION.name],
            "lag_s": numbers[ACTUATOR_LAG.name] + numbers[DELAY.name],
        },
        "residual": residual_densities(problem, numbers),
        "controller": controller_gains(problem, numbers, flights),
        "tilt_rms": float(np.sqrt(np.mean(np.arccos(np.clip(tilt, -1.0, 1.0)) ** 2) / 2.0)),
        "climb_rms": float(climbs.std()),
        "issue_times_known": not any(flight.command_slack_s for flight in flights),
    }


def taken(problem: VerticalFlights, estimate: Estimate) -> dict[str, float]:
    """Every parameter and nuisance that a flight is simulated with: the estimate's where identified."""

    def is_wider(name: str, limit: float) -> bool:
        low, high = estimate.interval(name)
        return not 0.5 * (high - low) <= limit

    friction, gain = estimate.theta[:2].tolist()
    index = estimate.nuisances
    lag, delay = index[ACTUATOR_LAG.name], index[DELAY.name]
    if is_wider(VISCOUS_FRICTION.name, TRUSTED_FRICTION) or not friction > 0.0:
        friction = USUAL_FRICTION
    if ACTUATOR_LAG.name in estimate.names and is_wider(ACTUATOR_LAG.name, TRUSTED_LAG_S):
        lag, delay = USUAL_LAG_S, 0.0
    if is_wider(INPUT_GAIN.name, TRUSTED_GAIN * abs(gain)):
        sums = regression.balance_sums(problem, {**index, ACTUATOR_LAG.name: lag, DELAY.name: delay})
        gain = GRAVITY * float(sums["samples"].sum() / sums["mapped"].sum())
    identified = {VISCOUS_FRICTION.name: friction, INPUT_GAIN.name: gain}
    return {**index, **estimate.parameters, **identified, ACTUATOR_LAG.name: lag, DELAY.name: delay}


def residual_densities(problem: VerticalFlights, numbers: Values) -> dict[str, list[float]]:
    """One-sided densities at `NODES_HZ`: of the force on the vehicle, and of each sensor's own error."""
    bins = problem.bins({nuisance.name: numbers[nuisance.name] for nuisance in problem.nuisances})
    residuals = bins.residuals(np.array([numbers[parameter.name] for parameter in bins.parameters]))
    first, second = residuals[:, 0], residuals[:, -1]
    products = np.abs(first) ** 2, np.abs(second) ** 2, (first * second.conj()).real
    first_power, second_power, shared = (densities(bins.layout.runs, values, NODES_HZ) for values in products)
    pulsation = 2.0 * np.pi * NODES_HZ
    if residuals.shape[1] == 1:
        noise = second_power[-1] / pulsation[-1] ** 2
        force = np.maximum(second_power - noise * pulsation**2, 0.05 * second_power)
        sensor_noise = np.zeros(NODES_HZ.size)
    else:
        force = np.maximum(shared, 0.02 * np.minimum(first_power, second_power))
        sensor_noise = np.maximum(first_power - force, 0.0)
        known = NODES_HZ >= VELOCITY_FROM_HZ
        noise = float(np.median((np.maximum(second_power - force, 0.0) / pulsation**2)[known]))
    return {
        "frequency_hz": NODES_HZ.tolist(),
        "force": force.tolist(),
        "accelerometer": sensor_noise.tolist(),
        "velocity": [float(noise)] * NODES_HZ.size,
    }


def controller_gains(
    problem: VerticalFlights, numbers: Values, flights: tuple[PreparedFlight, ...]
) -> dict[str, float] | None:
    """Gains of the height controller [1/s, 1/s, 1/s^2]; None where the command does not follow one."""
    rows, responses = [], []
    for flight, cut in zip(flights, problem.flights, strict=True):
        errors = _tracking_errors(flight)
        if errors is None or flight.input.measured:
            return None
        command = numbers[INPUT_GAIN.name] * regression.mapped_input(cut)
        feed_forward = flight.signals.channels.get("reference_acceleration_z", np.zeros(command.size))
        for run in flight.runs:
            integral = np.cumsum(errors[run, 1]) * flight.signals.step_s
            columns = np.column_stack([errors[run], integral])
            rows.append(columns - columns.mean(axis=0))
            response = command[run] - GRAVITY - feed_forward[run]
            responses.append(response - response.mean())
    columns, response = np.concatenate(rows), np.concatenate(responses)
    if not np.isfinite(columns).all() or not float(response @ response) > 0.0:
        return None
    fitted = np.linalg.lstsq(columns, response)[0]
    residual = response - columns @ fitted
    if float(residual @ residual) > (1.0 - LEAST_EXPLAINED) * float(response @ response):
        return None
    by_velocity, by_height, by_integral = fitted.tolist()
    if not 0.3 <= by_velocity <= 15.0 or by_height <= 0.0:
        return None  # no controller holds with these
    root = by_height**2 - 4.0 * by_velocity * max(by_integral, 0.0)
    position = (by_height + np.sqrt(max(root, 0.0))) / (2.0 * by_velocity)
    return {
        "position_gain": float(np.clip(position, 0.1, 5.0)),
        "velocity_gain": by_velocity,
        "integral_gain": float(np.clip(by_height - by_velocity * position, 0.0, 10.0)),
    }


def _tracking_errors(flight: PreparedFlight) -> Float[np.ndarray, "n 2"] | None:
    """Errors of velocity and height on the grid; None unless the height and its reference are logged."""
    channels, signals = flight.recording.channels, flight.signals.channels
    reference_height = flight.reference_on_grid("reference_position_z")
    if "position_z" not in channels or "reference_position_z" not in signals or reference_height is None:
        return None
    height = on_grid(channels["position_z"], flight.grid)[0]
    reference = signals.get("reference_velocity_z", np.zeros(height.size))
    return np.column_stack([reference - signals["velocity_z"], reference_height - height])


def simple_models(problem: VerticalFlights, estimate: Estimate) -> dict[str, SimpleModel]:
    """Least squares without lag and delay, and thrust over weight alone, of the same flights."""
    index = {**estimate.nuisances, ACTUATOR_LAG.name: 0.0, DELAY.name: 0.0}
    rows = problem.rows(index)
    fitted = np.linalg.lstsq(rows.regressors, rows.response)[0].tolist()
    least_squares = {**index, **{p.name: theta for p, theta in zip(rows.parameters, fitted, strict=True)}}
    sums = {name: float(column.sum()) for name, column in regression.balance_sums(problem, index).items()}
    weight = GRAVITY / regression.hover_of_sums(estimate.parameters, sums)
    zeros = {parameter.name: 0.0 for parameter in rows.parameters}
    return {
        "least_squares": SimpleModel("least squares that ignores the lag", least_squares),
        "hover": SimpleModel("hover input only", {**index, **zeros, INPUT_GAIN.name: weight}),
    }


def predictions(problem: VerticalFlights, values: Values) -> tuple[PredictedQuantity, ...]:
    """Vertical acceleration one step ahead, and climb rate in open loop."""
    rows = problem.rows({nuisance.name: values[nuisance.name] for nuisance in problem.nuisances})
    one_step = rows.response, rows.regressors @ np.array([values[item.name] for item in rows.parameters])
    measured = np.concatenate([run for item in problem.columns for run in item.cut(-item.fixed[:, 0])])
    return (
        PredictedQuantity(Horizon.ONE_STEP, "vertical acceleration", "m/s²", *one_step),
        PredictedQuantity(Horizon.OPEN_LOOP, "climb rate", "m/s", measured, _open_loop(problem, values)),
    )


def _open_loop(problem: VerticalFlights, values: Values) -> Float[np.ndarray, " samples"]:
    """Open-loop climb rates of every run, with height and voltage of terms as logged."""
    friction, drag = values[VISCOUS_FRICTION.name], values.get(QUADRATIC_DRAG.parameter.name, 0.0)
    names = [INPUT_GAIN.name, *(term.parameter.name for term in problem.terms)]
    # drag acts on the climb rate that is predicted, and not on the one that was measured
    weights = np.array([0.0 if name == QUADRATIC_DRAG.parameter.name else values[name] for name in names])
    results: list[Float[np.ndarray, " _"]] = []
    for item in problem.columns:
        driven, velocity, step_s = item.moving(values) @ weights, -item.fixed[:, 0], item.step_s
        for run in item.runs:
            counted = item.counted(run)
            series = driven[run], velocity[run], slice(None) if counted is None else counted, friction
            results.append(dragged_run(*series, drag, step_s) if drag else _response_of_run(*series, step_s))
    return np.concatenate(results)


def _response_of_run(
    driven: Float[np.ndarray, " n"],
    measured: Float[np.ndarray, " n"],
    counted: Bool[np.ndarray, " n"] | slice,
    friction: float,
    step_s: float,
) -> Float[np.ndarray, " counted"]:
    """Response to the input of one run, with the least-squares trim and start."""
    if friction < 0.0:
        backward = counted[::-1] if isinstance(counted, np.ndarray) else counted
        return _response_of_run(-driven[::-1], measured[::-1], backward, -friction, step_s)[::-1]
    response = _integrated(driven - driven.mean(), friction, step_s)
    trim = _integrated(np.ones(driven.size), friction, step_s)
    start = np.exp(-friction * step_s * np.arange(driven.size))
    transients = np.column_stack([trim, start])[counted]
    residual = (measured - response)[counted]
    return np.asarray(response[counted] + transients @ np.linalg.lstsq(transients, residual)[0])


def _integrated(force: Float[np.ndarray, " n"], friction: float, step_s: float) -> Float[np.ndarray, " n"]:
    """Velocity under a force that is linear between samples, from rest; exact to second order of the step."""
    decay = np.exp(-friction * step_s)
    increments = np.zeros(force.size)
    increments[1:] = 0.5 * step_s * (decay * force[:-1] + force[1:])
    return np.asarray(scipy.signal.lfilter([1.0], [1.0, -decay], increments))
