"""The level of a channel's white measurement noise, read off its fastest part."""

from __future__ import annotations

import numpy as np

from eivor.shapes import Float


def white_noise_std(values: Float[np.ndarray, " n"]) -> float:
    """Standard deviation of the white noise on a smooth signal; zero for fewer than four samples.

    Third differences of white noise of variance s^2 have variance 20 s^2, and those of a motion that is
    smooth over a few samples almost none; the median makes gaps and outliers harmless.
    """
    if values.size < 4:
        return 0.0
    third = np.diff(values, n=3)
    return float(np.median(np.abs(third)) / 0.6744897501960817 / np.sqrt(20.0))
