"""Velocity and acceleration on the body's axes, of velocity in the world and attitude."""

from __future__ import annotations

import numpy as np

from eivor.motions.vertical.model import GRAVITY
from eivor.shapes import Float
from eivor.signals.derivative import time_derivative
from eivor.signals.signals import Signals

NEEDED = (*(f"velocity_{axis}" for axis in "xyz"), *(f"attitude_{part}" for part in "wxyz"))


def body_velocity(signals: Signals) -> Float[np.ndarray, "n 3"] | None:
    """Velocity forward, left and up of the body [m/s]; None where velocity or attitude are not known."""
    if not set(NEEDED) <= set(signals.channels):
        return None
    return on_body_axes(signals, *(signals.channel(f"velocity_{axis}") for axis in "xyz"))


def force_by_velocity(signals: Signals) -> Float[np.ndarray, "n 3"] | None:
    """What an accelerometer would read where the velocity changes as it does [m/s^2]; None likewise.

    Its noise grows with frequency, where that of an accelerometer stays or falls: below a hertz or two it
    tells more.
    """
    if not set(NEEDED) <= set(signals.channels):
        return None
    forward, left, up = (
        time_derivative(signals.channel(f"velocity_{axis}"), signals.step_s) for axis in "xyz"
    )
    return on_body_axes(signals, forward, left, up + GRAVITY)


def on_body_axes(
    signals: Signals, u: Float[np.ndarray, " n"], v: Float[np.ndarray, " n"], s: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 3"]:
    """A vector of the world, turned into the body's axes."""
    w, x, y, z = (signals.channel(f"attitude_{part}") for part in "wxyz")
    length = np.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = (part / np.where(length > 0.0, length, 1.0) for part in (w, x, y, z))
    return np.column_stack(
        [
            (1.0 - 2.0 * (y * y + z * z)) * u + 2.0 * (x * y + w * z) * v + 2.0 * (x * z - w * y) * s,
            2.0 * (x * y - w * z) * u + (1.0 - 2.0 * (x * x + z * z)) * v + 2.0 * (y * z + w * x) * s,
            2.0 * (x * z + w * y) * u + 2.0 * (y * z - w * x) * v + (1.0 - 2.0 * (x * x + y * y)) * s,
        ]
    )


def swift_velocity(velocity: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Velocity times its size, what a body's own drag goes with."""
    return np.linalg.norm(velocity, axis=1)[:, None] * velocity
