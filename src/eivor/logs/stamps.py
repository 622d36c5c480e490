"""Which stamps of records can be, where nothing guards them against damage."""

from __future__ import annotations

import numpy as np

from eivor.shapes import Bool, Float

#: Stamps further than this from the log's others are damaged [s].
MAX_SPAN_S = 1e6
#: A stamp that is ahead of both its neighbours by so much is damaged, not the ones after it [s].
AHEAD_S = 1.0


def believable(time_s: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Which stamps can be: of the span of a log, and not far ahead of both their neighbours.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Stamps, of which those of a sound log are near zero [s].
    """
    within = bool(np.all(np.abs(time_s[:1]) <= MAX_SPAN_S) and np.all(np.abs(time_s[-1:]) <= MAX_SPAN_S))
    if within and np.all(time_s[1:] >= time_s[:-1]):
        return np.ones(time_s.size, dtype=np.bool_)
    usable = np.abs(time_s) <= MAX_SPAN_S
    usable[:-1][:1] &= time_s[:-1][:1] - time_s[1:][:1] <= AHEAD_S
    before, here, after = time_s[:-2], time_s[1:-1], time_s[2:]
    usable[1:-1] &= (here - np.maximum(before, after) <= AHEAD_S) | (before > after)
    return usable
