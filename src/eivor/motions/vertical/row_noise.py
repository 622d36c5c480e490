"""What measurement noises do to the rows of a flight, and to what instruments share with them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from eivor.models.instruments import LaggedInputs
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY, RowNoise
from eivor.models.separable import Values
from eivor.shapes import Float
from eivor.signals.actuator import actuator_state, shifted_by
from eivor.signals.families import family_members
from eivor.signals.input_map import InputMap
from eivor.signals.noise import WhiteNoise

if TYPE_CHECKING:
    from eivor.motions.vertical.flights import VerticalFlight, VerticalFlights

#: Share of the largest state over which the slope of an input map is taken.
SLOPE_STEP = 1e-5
#: Samples that an actuator's response is followed over: 25 of the longest lags on a grid of 5 ms.
RESPONSE_SAMPLES = 1_500
#: Samples before the impulse, so that a state may be early.
BEFORE = 50


def row_noise(problem: VerticalFlights, at: Values) -> RowNoise:
    """Variances of the errors in z', U, the terms and z'', and what past inputs share with U.

    Each is averaged over the samples that flights use. A commanded input is exact unless something is
    declared of it, references are, and terms are taken to be. Noise of the input goes through the map's slope
    and the actuator. Without an accelerometer z'' is the central difference of z', whose white noise of
    variance s^2 it turns into one of variance s^2 / (2 h^2); with z' itself it shares nothing.
    """
    n, weights, own, shared = len(problem.parameters), [], [], []
    for flight in problem.flights:
        noise = {name: one.std**2 for name, one in flight.signals.noise.items()}
        if "velocity_z" in noise and flight.acceleration is None:
            noise["specific_force_z"] = noise["velocity_z"] / (2.0 * flight.signals.step_s**2)
        variance = input_variance(flight, problem.motion.input_map)
        response = _response(flight, at) if variance else np.zeros(1)
        variances = np.full(n + 1, np.nan)
        variances[0], variances[-1] = noise.get("velocity_z", np.nan), noise.get("specific_force_z", np.nan)
        variances[1], variances[2:-1] = variance * float(response @ response), 0.0
        own.append(variances)
        shared.append(_shared(problem, response * variance))
        weights.append(float(sum(one.shape[0] for one in flight.cut(flight.velocity[:, None]))))
    mean = np.average(own, axis=0, weights=weights)
    regressors = None if np.isnan(mean).any() else np.diag(mean)
    return RowNoise(regressors, np.average(shared, axis=0, weights=weights))


def input_variance(flight: VerticalFlight, level: InputMap) -> float:
    """Variance of the mapped input's error, the actuators' response left aside."""
    names, noise = family_members(flight.input, flight.signals.channels), flight.signals.noise
    variances = np.array([noise[name].std ** 2 if name in noise else 0.0 for name in names])
    if not variances.any():
        return 0.0
    state = flight.signals.family(flight.input)
    step = SLOPE_STEP * max(float(np.abs(state).max()), SLOPE_STEP)
    slopes = (level(state + step) - level(state - step)) / (2.0 * step)
    tilt = flight.signals.channel("cos_tilt")[:, None]
    each = np.concatenate(flight.cut((tilt * slopes / len(names)) ** 2))
    return float(each.mean(axis=0) @ variances)


def noise_powers(flight: VerticalFlight, level: InputMap) -> tuple[float, float, float]:
    """Powers per Hz of the errors in z', U and z'' at low frequencies; NaN for what nothing is declared of.

    There the actuators' response is one. An input that nothing is declared of is exact.
    """
    noise = {name: WhiteNoise(density) for name, density in flight.densities.items()}
    driving = input_variance(replace(flight, signals=replace(flight.signals, noise=noise)), level)
    velocity, response = (flight.densities.get(name, np.nan) for name in ("velocity_z", "specific_force_z"))
    return velocity**2, driving, response**2


def _response(flight: VerticalFlight, at: Values) -> Float[np.ndarray, " lags"]:
    """Samples after an impulse of the input, of the state that enters the equation."""
    impulse = np.zeros((BEFORE + RESPONSE_SAMPLES, 1))
    impulse[BEFORE] = 1.0
    step_s, delay_s = flight.signals.step_s, at[DELAY.name]
    if flight.measured:
        state = shifted_by(impulse, step_s=step_s, delay_s=delay_s)
    else:
        state = actuator_state(impulse, step_s=step_s, lag_s=at[ACTUATOR_LAG.name], delay_s=delay_s)
    after: Float[np.ndarray, " lags"] = state[BEFORE:, 0]
    return after


def _shared(
    problem: VerticalFlights, response: Float[np.ndarray, " lags"]
) -> Float[np.ndarray, "p n_plus_1"]:
    """Covariance of the instruments' noises with those of [Phi y]."""
    count = problem.instrument_count
    shared = np.zeros((count, len(problem.parameters) + 1))
    if isinstance(problem.rule, LaggedInputs) and response.any():
        first, last = problem.rule.first, problem.rule.last
        shared[: last - first + 1, 1] = response[first : last + 1]
    return shared
