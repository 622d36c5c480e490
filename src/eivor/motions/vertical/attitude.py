"""What an attitude says of the vertical: the row of its rotation that points up."""

from __future__ import annotations

import numpy as np

from eivor.errors import ShapeError
from eivor.shapes import Float
from eivor.signals.recording import Channel


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
