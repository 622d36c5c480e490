"""Attitudes as angles."""

from __future__ import annotations

import numpy as np

from eivor.shapes import Float


def roll_pitch_yaw(quaternions: Float[np.ndarray, "4 n"]) -> Float[np.ndarray, "3 n"]:
    """Roll, pitch and yaw of attitudes [rad]: about z first, then the new y, then the new x.

    Parameters
    ----------
    quaternions : ndarray, shape (4, n)
        From body to world, w, x, y, z, of length 1. Yaw has no jumps by whole turns; where a component is
        missing so are all angles.
    """
    w, x, y, z = quaternions
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    known = np.isfinite(yaw)
    yaw[known] = np.unwrap(yaw[known])
    return np.stack([roll, pitch, yaw])
