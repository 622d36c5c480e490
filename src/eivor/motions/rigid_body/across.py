"""How fast each rotor moves across its axis: what translational lift goes with."""

from __future__ import annotations

import numpy as np

from eivor.motions.rigid_body.layout import RotorLayout
from eivor.shapes import Float


def squares_across(
    layout: RotorLayout, velocity: Float[np.ndarray, "3 n"], yaw_rate: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "rotors n"]:
    """Square of the velocity across each rotor [(m/s)^2], of a body's velocity on its own axes."""
    x, y = -layout.pitch, layout.roll
    forward, left = velocity[0] - np.outer(y, yaw_rate), velocity[1] + np.outer(x, yaw_rate)
    return forward**2 + left**2


def lift_moments(
    layout: RotorLayout, velocity: Float[np.ndarray, "3 n"], yaw_rate: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "2 n"]:
    """Moments of these squares about x and y: what lift turns, but for a constant."""
    return np.stack([layout.roll, layout.pitch]) @ squares_across(layout, velocity, yaw_rate)
