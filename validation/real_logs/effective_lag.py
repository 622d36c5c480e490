"""The lag that an estimator without any error would give to rotors that may have more than one."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float

from eivor.signals.filters import actuator_state
from eivor.simulation.environment import FlightTruth

#: A rotor has one lag when its states are within this share of the hover state of those that follow with one.
ONE_LAG = 1e-6
#: Accuracy of lag and delay [s].
TOLERANCE_S = 1e-5


def effective_lag(
    truth: FlightTruth,
    command: Float[np.ndarray, "n rotors"],
    thrust: Callable[[Float[np.ndarray, "n rotors"]], Float[np.ndarray, "n rotors"]],
    rows: Bool[np.ndarray, " n"],
) -> float:
    """Sum of the first-order lag and the delay that best describe the true thrust from the commands [s]."""
    from scipy.optimize import minimize

    step_s = float(truth.time_s[1] - truth.time_s[0])
    started = np.vstack([truth.rotor_state[:1], command])

    def state(lag_s: float, delay_s: float) -> Float[np.ndarray, "n rotors"]:
        return actuator_state(started, step_s=step_s, lag_s=lag_s, delay_s=delay_s)[1:]

    def lifted(states: Float[np.ndarray, "n rotors"]) -> Float[np.ndarray, " used"]:
        column = (truth.cos_tilt * thrust(states).mean(axis=1))[rows]
        return np.asarray(column - column.mean())

    nominal = truth.actuator_lag + truth.delay
    separated = np.abs(state(truth.actuator_lag, truth.delay) - truth.rotor_state).max()
    true = lifted(truth.rotor_state)
    if separated <= ONE_LAG * truth.hover_input or not true.any():
        return nominal

    def unexplained(nuisances: Float[np.ndarray, " 2"]) -> float:
        one_lag = lifted(state(*np.abs(nuisances).tolist()))
        return 1.0 - float((one_lag @ true) ** 2 / ((one_lag @ one_lag) * (true @ true)))

    start = np.array([truth.actuator_lag, truth.delay])
    settings = {"xatol": TOLERANCE_S, "fatol": np.inf}
    simplex = start + np.array([[0.0, 0.0], [0.2 * nominal, 0.0], [0.0, 0.2 * nominal]])
    solution = minimize(
        unexplained, start, method="Nelder-Mead", options={**settings, "initial_simplex": simplex}
    )
    return float(np.abs(solution.x).sum())
