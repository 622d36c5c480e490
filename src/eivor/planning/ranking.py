"""A formula that ranks shapes; it is too bold for what is printed, which is flown in simulation.

Of the height setpoint's spectrum, of how the vehicle follows it and of what no model predicts, the covariance
of (K, K_u, lag) is the inverse of the sum over the band of G* G / S, G = [-V, U, K_u dU/dlag].
"""

from __future__ import annotations

import numpy as np

from eivor.planning.setpoints import STEP_S, Shape
from eivor.planning.vehicle import VehicleGuess
from eivor.shapes import Complex, Float

#: Band of the recipe [Hz].
BAND_HZ = (0.04, 5.0)


def ranked_std_errors(shape: Shape, vehicle: VehicleGuess) -> Float[np.ndarray, " 3"]:
    """Standard errors of friction [1/s], gain (as a share) and lag [s] by the formula, infinite for none."""
    count = shape.offset.size
    frequency = np.fft.rfftfreq(count, STEP_S)
    inside = (frequency >= BAND_HZ[0]) & (frequency <= BAND_HZ[1])
    f = frequency[inside]
    s = 2j * np.pi * f
    velocity = _following(s, vehicle) * s * np.fft.rfft(shape.offset)[inside]
    drive = (s + vehicle.viscous_friction) * velocity
    columns = np.column_stack([-velocity, drive, -s / (1.0 + s * vehicle.lag_s) * drive])
    left = vehicle.left
    own = 1.0 / (
        1.0 / np.maximum(left.at("accelerometer", f), 1e-9)
        + 1.0 / np.maximum(np.abs(s) ** 2 * left.at("velocity", f), 1e-9)
    )
    density = (left.at("force", f) + own) * count / (2.0 * STEP_S)
    whitened = columns / np.sqrt(density)[:, None]
    rows = np.concatenate([whitened.real, whitened.imag])
    triangle = np.linalg.qr(rows, mode="r")
    try:
        inverse = np.linalg.solve(triangle, np.eye(3))
    except np.linalg.LinAlgError:
        return np.full(3, np.inf)
    return np.linalg.norm(inverse, axis=1)


def _following(s: Complex[np.ndarray, " n"], vehicle: VehicleGuess) -> Complex[np.ndarray, " n"]:
    """From the setpoint's velocity to the vehicle's, with feed-forward of velocity and acceleration."""
    gains = vehicle.follows
    plant = 1.0 / ((1.0 + s * vehicle.lag_s) * (s + vehicle.viscous_friction))
    feedback = (gains.velocity_gain + gains.integral_gain / s) * (1.0 + gains.position_gain / s)
    followed: Complex[np.ndarray, " n"] = plant * (s + feedback) / (1.0 + plant * feedback)
    return followed
