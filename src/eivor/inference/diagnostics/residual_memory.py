"""Long memory of the residual: the order of a fractional noise that its lowest frequencies look like."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from eivor.signals.long_memory import LEAST_BANDWIDTH, LongMemory, estimate_long_memory

#: Longer records are averaged down to this many samples first.
LONGEST = 8192


def residual_memory(residual: Float[np.ndarray, " rows"]) -> LongMemory | None:
    """Local Whittle order of a residual in time order, with its standard error. Performs no checks.

    Parameters
    ----------
    residual : ndarray, shape (rows,)
        e.

    Returns
    -------
    LongMemory or None
        Order 0 without memory, negative for a residual that drifts, -1 for a random walk; its `std` is
        that of the averaged record. None for records of fewer than 17 samples, or constant ones.

    Notes
    -----
    The order is that of the spectrum's slope at low frequencies, which averages over blocks leave alone:
    a long record is averaged to about 8192 samples, so that the transform costs no more than the pass
    over the record. The order is sought between -1 and 1.
    """
    width = -(-residual.size // LONGEST)
    usable = residual.size // width
    means = residual[: usable * width].reshape(usable, width).mean(axis=1) if width > 1 else residual
    spread = float(np.ptp(means)) if means.size else 0.0
    if means.size <= 2 * LEAST_BANDWIDTH or spread <= 1e-12 * float(np.abs(means).max()):
        return None
    return estimate_long_memory(means)
