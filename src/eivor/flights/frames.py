"""Frames: turn a recording's axes to z up.

From north-east-down and forward-right-down to north-west-up and forward-left-up is half a turn about x
for the world and the body alike: y and z of every vector change sign, and so do y and z of the attitude
quaternion. The vertical model needs no particular heading of the horizontal axes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from eivor.errors import ShapeError
from eivor.signals.recording import Channel, Frame, Recording

#: Channels whose sign changes when z down becomes z up.
FLIPPED = frozenset(
    {
        "position_z",
        "velocity_y",
        "velocity_z",
        "acceleration_z",
        "specific_force_z",
        "specific_force_body_y",
        "specific_force_body_z",
        "angular_rate_y",
        "angular_rate_z",
        "attitude_y",
        "attitude_z",
        "reference_position_z",
        "reference_velocity_z",
        "reference_acceleration_z",
        "feedback_reference_velocity_z",
    }
)


def upward(recording: Recording) -> Recording:
    """Return the same recording with z up."""
    if recording.frame is Frame.Z_UP:
        return recording
    channels = {
        name: replace(channel, values=-channel.values) if name in FLIPPED else channel
        for name, channel in recording.channels.items()
    }
    return replace(recording, channels=channels, frame=Frame.Z_UP)


def vertical_row(attitude: list[Channel]) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
    """Stamps [s], and the last row of the rotation from body to world at each.

    Its last element is the cosine of the tilt. Quaternions are normalised; those of no length give NaN.

    Raises
    ------
    ShapeError
        When the four parts are on different clocks.
    """
    if any(not np.array_equal(channel.time_s, attitude[0].time_s) for channel in attitude[1:]):
        raise ShapeError(
            "the four parts of an attitude on one clock",
            f"{', '.join(f'{channel.time_s.size} stamps of {channel.name}' for channel in attitude)}",
            "Bring them to the same stamps first: quaternions are not interpolated part by part.",
        )
    w, x, y, z = (channel.values for channel in attitude)
    square = w**2 + x**2 + y**2 + z**2
    square = np.where(square > 0.0, square, np.nan)
    row = np.stack([2.0 * (x * z - w * y), 2.0 * (y * z + w * x), square - 2.0 * (x**2 + y**2)], axis=1)
    return attitude[0].time_s, row / square[:, None]
