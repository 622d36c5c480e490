"""An estimator of vertical velocity that learns the accelerometer's bias, as autopilots have one.

    v' = a - b + L (v_fused - v),   b' = -(L / T) (v_fused - v)

A constant error of the accelerometer is learnt with the time constant T. A velocity that is fused late and
taken as present makes errors of its own.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

#: How quickly the velocity follows what is fused, L [1/s].
FUSING_RATE = 3.0


def estimated(
    time_s: Float[np.ndarray, " n"],
    acceleration: Float[np.ndarray, " n"],
    fused: Float[np.ndarray, " n"],
    *,
    bias_time: float,
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Velocity [m/s] and acceleration [m/s^2] that the estimator gives."""
    velocity, bias = float(fused[0]), 0.0
    velocities, accelerations = np.empty(time_s.size), np.empty(time_s.size)
    steps = np.diff(time_s, prepend=time_s[0]).tolist()
    for k, (step, measured, seen) in enumerate(
        zip(steps, acceleration.tolist(), fused.tolist(), strict=True)
    ):
        innovation = seen - velocity
        current = measured - bias
        velocity += step * (current + FUSING_RATE * innovation)
        bias -= step * FUSING_RATE / bias_time * innovation
        velocities[k], accelerations[k] = velocity, current
    return velocities, accelerations
