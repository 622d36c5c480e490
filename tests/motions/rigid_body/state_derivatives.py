"""Time derivatives of many states of the rigid body at once."""

from __future__ import annotations

import numpy as np

from eivor.motions.rigid_body.dynamics import BODY, body_derivative, speed_derivative


def state_derivative(coefficients, state, command, wind):
    """Of bodies and rotors; arrays of shape (*batch, components), (*batch, rotors), (*batch, 3)."""
    rotors = coefficients.rotors
    flat = state.reshape(-1, BODY + rotors).T
    speeds, requested, air = [flat[BODY:]], [command.reshape(-1, rotors).T], tuple(wind.reshape(-1, 3).T)
    change = speed_derivative(coefficients, speeds, requested)
    body = body_derivative(coefficients, flat[:BODY], speeds, change, air, (0.0, 0.0, 0.0))
    return np.vstack([*body, *change]).T.reshape(state.shape)
