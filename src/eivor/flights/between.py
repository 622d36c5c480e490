"""What a measured channel was between its stamps: a line, or a curve.

A line between stamps makes amplitudes at a frequency f smaller by sinc^2(f h), h the distance of stamps: 3 %
at 1 Hz for a velocity that is logged at 10 Hz. An equation can bear it where both of its sides are spread
alike (`eivor.flights.spread`). A cubic curve with the slopes of parabolas through three stamps (Catmull-Rom)
leaves them as they are up to a tenth of the rate, to half a per cent, and follows noise below it as a line
does.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from eivor.shapes import Float

#: A piece whose neighbours are longer or shorter than it by this factor is a line: noise of two stamps that
#: lie close would tilt the curve far.
UNEVEN = 2.0

#: Values at times `t`, of stamps that increase, their values, and `t`.
Between = Callable[
    [Float[np.ndarray, " m"], Float[np.ndarray, " m"], Float[np.ndarray, " n"]], Float[np.ndarray, " n"]
]


def line_between(
    time: Float[np.ndarray, " m"], values: Float[np.ndarray, " m"], t: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Lines between stamps, beyond the ends the last value."""
    return np.interp(t, time, values)


def curve_between(
    time: Float[np.ndarray, " m"], values: Float[np.ndarray, " m"], t: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Cubic curves between even stamps; lines at the ends and between uneven ones.

    With h the length of a piece, x the share of it that has passed, c its chord's slope and s_0, s_1 the
    slopes at its ends, the curve is off the line by h x (1 - x) [(1 - x)(s_0 - c) - x (s_1 - c)].
    """
    line = line_between(time, values, t)
    if time.size < 4:
        return line
    h = np.diff(time)
    with np.errstate(over="ignore", invalid="ignore"):
        chord = np.diff(values) / h
        slope = (h[1:] * chord[:-1] + h[:-1] * chord[1:]) / (h[1:] + h[:-1])
        begin, end = slope[:-1] - chord[1:-1], slope[1:] - chord[1:-1]
        beside = np.stack([h[:-2], h[1:-1], h[2:]])
        even = beside.max(axis=0) <= UNEVEN * beside.min(axis=0)
        even &= np.isfinite(begin) & np.isfinite(end)
        piece = np.searchsorted(time, t, side="right") - 2
        inside = np.flatnonzero((piece >= 0) & (piece < even.size))
        inside = inside[even[piece[inside]]]
        k = piece[inside]
        x = (t[inside] - time[k + 1]) / h[k + 1]
        bent = h[k + 1] * x * (1.0 - x) * ((1.0 - x) * begin[k] - x * end[k])
    line[inside] += np.where(np.isfinite(bent), bent, 0.0)
    return line
