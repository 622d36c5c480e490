"""Stamps that err: those of a regular clock that were written down late or early, so that some go backward.

Samples are in the order in which they were taken. Where stamps go back by less than the time between a few
samples, and again and again, it is not the samples that are out of order: each stamp has an error of its own.
Leaving such samples out would keep those that are stamped too late, and the whole channel would be late. A
line through the stamps around each sample, against their numbers, has those errors averaged out.
"""

from __future__ import annotations

import numpy as np

from eivor.shapes import Float

#: So many samples to each side make the line; a second of a slow log, and too short for a clock to drift.
REACH = 25
#: Fewer backward stamps than this share are slips.
BACKWARD_SHARE = 0.005
#: Stamps that go back by more than so many usual distances are of a clock that was set.
FURTHEST = 5.0
#: A distance of so many usual ones is a pause: lines end there.
PAUSE = 10.0


def evened(time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Stamps with their errors averaged out, where they err; else the same array.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Finite stamps in the order of the samples [s].
    """
    if time_s.size <= 2 * REACH:
        return time_s
    distances = np.diff(time_s)
    back = distances[distances < 0.0]
    if back.size < BACKWARD_SHARE * time_s.size:
        return time_s
    usual = float(np.mean(distances[np.abs(distances) <= PAUSE * np.median(np.abs(distances))]))
    if usual <= 0.0 or float(back.min()) < -FURTHEST * usual:
        return time_s
    return on_lines(time_s, PAUSE * usual)


def on_lines(time_s: Float[np.ndarray, " n"], longest_s: float) -> Float[np.ndarray, " n"]:
    """Each stamp on the line through those around it, whether they err or not.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Stamps in the order of the samples [s].
    longest_s : float
        Lines end where two stamps are further apart [s].
    """
    ends = np.flatnonzero(np.diff(time_s) > longest_s) + 1
    return np.concatenate([_on_lines(part) for part in np.split(time_s, ends)])


def _on_lines(time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Value at each sample of the least squares line through the stamps around it, against their numbers."""
    count = time_s.size
    if count < 3:
        return time_s
    number = np.arange(count, dtype=np.float64)
    low = np.maximum(np.arange(count) - REACH, 0)
    high = np.minimum(np.arange(count) + REACH + 1, count)
    # against numbers from the sample itself on, and times from those of an even clock: small sums
    even = time_s[0] + number * (time_s[-1] - time_s[0]) / (count - 1)
    away = time_s - even
    width = high - low

    def window(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        total = np.concatenate([[0.0], np.cumsum(values)])
        return np.asarray(total[high] - total[low])

    middle = window(number) / width
    spread = window(number**2) - width * middle**2
    mean = window(away) / width
    slope = (window(number * away) - width * middle * mean) / spread
    return np.asarray(even + mean + slope * (number - middle))
