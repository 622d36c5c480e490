"""Uneven stamps: whether the samples were taken then, or were taken evenly and stamped late or early.

A smooth quantity says it. Its distance from the middle between its neighbours is, beside its bend, its slope
times the distance of its time from the middle between theirs. Where stamps are true, theirs show it; where
stamps err, nothing follows them. So the regression of the one on the other has the coefficient 1 or 0.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from eivor.shapes import Float
from eivor.signals.recording import Channel

#: Even stamps: the standard deviation of their distances, pauses left out, is below this share of the median.
EVEN_SHARE = 0.03
#: A distance of more medians than this is a pause.
PAUSE = 3.0
#: The slope is taken over so many samples to both sides.
REACH = 5
#: Fewer samples tell nothing.
FEWEST = 100
#: A coefficient is told from one half when it is so many standard errors from it.
TOLD = 3.0


def uneven(channel: Channel) -> bool:
    """Whether a channel's stamps are uneven."""
    steps = np.diff(channel.time_s)
    if steps.size < FEWEST:
        return False
    median = float(np.median(steps))
    return float(np.std(steps[steps <= PAUSE * median])) > EVEN_SHARE * median


def stamps_are_true(channels: Iterable[Channel]) -> bool | None:
    """Whether samples with uneven stamps were taken when these say; None when nothing tells it."""
    return truth_of(_coefficient(one) for one in channels if uneven(one))


def told_of_stamps(channel: Channel) -> tuple[float, float]:
    """What a channel tells: the coefficient, and its variance; no numbers where its stamps are even."""
    return _coefficient(channel) if uneven(channel) else (np.nan, np.nan)


def truth_of(found: Iterable[tuple[float, float]]) -> bool | None:
    """Whether stamps are true, by the coefficients and variances that channels tell; None for no answer."""
    told = [(value, variance) for value, variance in found if np.isfinite(value) and variance > 0.0]
    if not told:
        return None
    weights = np.array([1.0 / variance for _, variance in told])
    mean = float(weights @ np.array([value for value, _ in told]) / weights.sum())
    return mean > 0.5 if abs(mean - 0.5) * np.sqrt(weights.sum()) > TOLD else None


def _coefficient(channel: Channel) -> tuple[float, float]:
    """Coefficient of a channel's regression, and its variance; no numbers where it does not move."""
    known = np.isfinite(channel.values)
    time, values = channel.time_s[known], channel.values[known]
    if time.size < FEWEST:
        return np.nan, np.nan
    number = np.arange(1, time.size - 1)
    low, high = np.maximum(number - REACH, 0), np.minimum(number + REACH, time.size - 1)
    away = _from_middle(time)
    near = np.abs(away) <= np.median(np.diff(time))
    moved = (away * (values[high] - values[low]) / (time[high] - time[low]))[near]
    bend = _from_middle(values)[near]
    power = float(moved @ moved)
    if power <= 0.0:
        return np.nan, np.nan
    value = float(moved @ bend) / power
    return value, float(np.sum((moved * (bend - value * moved)) ** 2)) / power**2


def _from_middle(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " m"]:
    """Distance of each value from the middle between its neighbours."""
    return np.asarray(values[1:-1] - 0.5 * (values[:-2] + values[2:]))
