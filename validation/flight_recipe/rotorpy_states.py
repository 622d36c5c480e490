"""States and references in the words of RotorPy: dictionaries of arrays, quaternions [x, y, z, w]."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from eivor.simulation.environment import SensorErrors, Trajectory


def initial_state(
    reference: Trajectory, hover: Float[np.ndarray, " rotors"]
) -> dict[str, Float[np.ndarray, " _"]]:
    """Level, on the reference, rotors at hover speed."""
    return {
        "x": np.array([0.0, 0.0, reference.position[0]]),
        "v": np.array([0.0, 0.0, reference.velocity[0]]),
        "q": np.array([0.0, 0.0, 0.0, 1.0]),
        "w": np.zeros(3),
        "wind": np.zeros(3),
        "rotor_speeds": hover,
    }


def flat_output(reference: Trajectory, k: int) -> dict[str, Any]:
    """RotorPy's name for the reference: the vertical one, and none sideways or in yaw."""
    upward = np.array([0.0, 0.0, 1.0])
    return {
        "x": reference.position[k] * upward,
        "x_dot": reference.velocity[k] * upward,
        "x_ddot": reference.acceleration[k] * upward,
        "x_dddot": np.zeros(3),
        "x_ddddot": np.zeros(3),
        "yaw": 0.0,
        "yaw_dot": 0.0,
    }


def measured(state: Mapping[str, Float[np.ndarray, " _"]], errors: SensorErrors, k: int) -> dict[str, Any]:
    """Return the state as the sensors show it."""
    x, y, z, w = state["q"]
    a, b, c = 0.5 * errors.attitude[k]
    # q multiplied from the right by the small rotation [a, b, c, 1], first order in the angles.
    turned = np.array(
        [
            x + w * a + y * c - z * b,
            y + w * b + z * a - x * c,
            z + w * c + x * b - y * a,
            w - x * a - y * b - z * c,
        ]
    )
    return {
        "x": state["x"] + errors.position[k],
        "v": state["v"] + errors.velocity[k],
        "q": turned / np.sqrt(turned @ turned),
        "w": state["w"] + errors.angular_rate[k],
    }


def is_lost(state: Mapping[str, Float[np.ndarray, " _"]], altitude: float) -> bool:
    """Return whether the vehicle is beyond recovery: far from the reference, or tilted by 70 degrees."""
    away = np.abs(state["x"] - np.array([0.0, 0.0, altitude]))
    near = bool(away[0] < 50.0 and away[1] < 50.0 and away[2] < 5.0)
    x, y = float(state["q"][0]), float(state["q"][1])
    return not (near and 1.0 - 2.0 * (x * x + y * y) > np.cos(np.radians(70.0)))
