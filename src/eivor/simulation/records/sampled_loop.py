"""The loop of a sampled vehicle and its controller, as a linear recursion x[k+1] = M x[k] + forcing[k].

The state is the velocity, then, where the controller uses them, the altitude and the sum of the errors
before this sample. Everything from outside enters as an addition to the error d (the reference, and less
the errors of the measurements) or as an acceleration of the vehicle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dtbtrs

from eivor.errors import ParameterError
from eivor.shapes import Float
from eivor.simulation.records.control import Control, Feedback
from eivor.simulation.records.sampled_vehicle import SampledVehicle

Series = Float[np.ndarray, " samples"]


@dataclass(frozen=True, slots=True)
class SampledLoop:
    """Matrices of the recursion; u[k] = error_gain d[k] + (the sum's share).

    Parameters
    ----------
    matrix : ndarray, shape (states, states)
        M.
    error_effect : ndarray, shape (states,)
        Of an addition to the error d.
    push_effect : ndarray, shape (states,)
        Of an acceleration of the vehicle.
    input_from_state : ndarray, shape (states,)
        What the state contributes to u.
    error_gain : float
        What an addition to d contributes to u.
    """

    matrix: Float[np.ndarray, "states states"]
    error_effect: Float[np.ndarray, " states"]
    push_effect: Float[np.ndarray, " states"]
    input_from_state: Float[np.ndarray, " states"]
    error_gain: float


def sampled_loop(vehicle: SampledVehicle, feedback: Feedback) -> SampledLoop:
    """Loop of a vehicle under control, without the states that the controller does not use."""
    summed = feedback.integral * vehicle.step_s
    present = feedback.proportional + summed
    # All three states; the error is d = addition - seen x, the input u = present d + summed x[2].
    plant = np.array([[vehicle.decay, 0.0, 0.0], [vehicle.held, 1.0, 0.0], [0.0, 0.0, 1.0]])
    push = np.array([vehicle.held, vehicle.rise, 0.0])
    seen = np.array([1.0, feedback.altitude_gain, 0.0])
    from_state = np.array([0.0, 0.0, summed]) - present * seen
    sums = np.array([0.0, 0.0, 1.0])
    matrix = plant + np.outer(vehicle.input_gain * push, from_state) - np.outer(sums, seen)
    used = np.array([True, feedback.altitude_gain != 0.0, feedback.integral != 0.0])
    return SampledLoop(
        matrix[np.ix_(used, used)],
        (vehicle.input_gain * present * push + sums)[used],
        push[used],
        from_state[used],
        present,
    )


def check_stable(vehicle: SampledVehicle, control: Control) -> None:
    """Refuse gains with which the sampled loop is not stable.

    Raises
    ------
    ParameterError
        With the spectral radius of the loop.
    """
    feedback = control.feedback
    if feedback is None:
        return
    radius = float(np.abs(np.linalg.eigvals(sampled_loop(vehicle, feedback).matrix)).max())
    if not radius < 1.0:
        raise ParameterError(
            "gains with which the control loop is stable: every mode decays from sample to sample",
            f"{control} at input_gain={vehicle.input_gain} and {1.0 / vehicle.step_s:g} Hz, with a mode that "
            f"has a factor of {radius:.6g}",
            "Make the gains smaller, the velocity's of the sign of input_gain, or raise the rate.",
        )


def from_rest(
    matrix: Float[np.ndarray, "states states"], forcing: Float[np.ndarray, "steps states"]
) -> Float[np.ndarray, "samples states"]:
    """x[k+1] = M x[k] + forcing[k] from x[0] = 0, as the banded triangular system that it is.

    Performs no checks; linear in samples.
    """
    steps, states = forcing.shape
    band = np.zeros((2 * states, (steps + 1) * states))
    band[0] = 1.0
    for row in range(states):
        for column in range(states):
            band[states + row - column, column::states] = -matrix[row, column]
    known = np.concatenate([np.zeros(states), forcing.ravel()])[:, None]
    solved: Float[np.ndarray, "samples states"] = dtbtrs(band, known, uplo="L", diag="U")[0]
    return solved.reshape(steps + 1, states)


def driven_loop(
    loop: SampledLoop, additions: Series, pushes: Series
) -> tuple[Series, Float[np.ndarray, "samples states"]]:
    """Input and states of a loop from rest.

    Parameters
    ----------
    loop : SampledLoop
        The loop.
    additions : ndarray, shape (samples,)
        To the error d [m/s].
    pushes : ndarray, shape (samples,)
        Held accelerations of the vehicle [m/s^2].

    Returns
    -------
    input : ndarray, shape (samples,)
        u.
    states : ndarray, shape (samples, states)
        Velocity [m/s], then altitude [m] and the sum of errors where the controller uses them.
    """
    forcing = np.outer(additions[:-1], loop.error_effect) + np.outer(pushes[:-1], loop.push_effect)
    states = from_rest(loop.matrix, forcing)
    return loop.error_gain * additions + states @ loop.input_from_state, states
