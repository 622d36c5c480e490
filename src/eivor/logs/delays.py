"""How late filters are, far below their own frequencies."""

from __future__ import annotations

import numpy as np


def low_pass_delay_s(cutoff_hz: float) -> float:
    """How late a low-pass of the second order (Butterworth) is, far below its cutoff [s]."""
    return float(np.sqrt(2.0) / (2.0 * np.pi * cutoff_hz))


def notch_delay_s(frequency_hz: float, bandwidth_hz: float) -> float:
    """How late a notch is, far below its frequency [s]."""
    return float(bandwidth_hz / (2.0 * np.pi * frequency_hz**2))
