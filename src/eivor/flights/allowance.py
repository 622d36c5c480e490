"""Systematic parts of intervals: what a flight's own scatter cannot show, each with its sentence.

An interval is made of what scatters within a flight. A clock that is late all the time, an estimator whose
dynamics look like the vehicle's, or air that no flight has twice do not scatter. A motion knows of them, and
says for each quantity how much is to be allowed for.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

Interval = tuple[float, float]


class Counts(Enum):
    """How a systematic part counts."""

    ADDED = "added"
    """It comes on top of what scatters: the interval is longer by it at both ends."""
    AT_LEAST = "at least"
    """The interval reaches at least so far to both sides: no model of the vehicle is truer than that."""
    INDEPENDENT = "independent"
    """It is an error of its own, of which this is the half of a 95 % interval: squares of halves add up."""
    RESERVED = "reserved"
    """The interval is that of the effective value and stays; the verdict keeps the part in reserve."""


@dataclass(frozen=True, slots=True)
class Allowance:
    """What one systematic cause may do to a quantity.

    Parameters
    ----------
    counts : Counts
        How it counts.
    below, above : float
        How far the quantity may lie below and above what the data say, in its unit; not negative.
    sentence : str
        What it is for.
    """

    counts: Counts
    below: float
    above: float
    sentence: str


def widened(interval: Interval, value: float, allowances: Iterable[Allowance]) -> Interval:
    """Interval of a quantity with every allowance in it; one whose value is no number stays as it is."""
    low, high = interval
    if not math.isfinite(value):
        return interval
    known = tuple(allowances)
    own = [one for one in known if one.counts is Counts.INDEPENDENT]
    if own and low <= value <= high:
        low = value - math.hypot(value - low, *(one.below for one in own))
        high = value + math.hypot(high - value, *(one.above for one in own))
    for one in known:
        if one.counts is Counts.ADDED:
            low, high = low - one.below, high + one.above
    for one in known:
        if one.counts is Counts.AT_LEAST:
            low, high = min(low, value - one.below), max(high, value + one.above)
    return low, high


def reserved(allowances: Iterable[Allowance]) -> float:
    """What a verdict keeps in reserve: the larger side of each part that it alone counts, added up."""
    return sum((max(one.below, one.above) for one in allowances if one.counts is Counts.RESERVED), 0.0)


def clock_allowance(slack_s: float) -> tuple[Allowance, ...]:
    """What commands that may have been issued between those that are logged leave open of a lag.

    A command that is late throughout is a shorter lag, and moves no other parameter.

    Parameters
    ----------
    slack_s : float
        What the command may be late or early by [s].
    """
    if not slack_s:
        return ()
    sentence = (
        "The log does not tell how often its command was issued: the lag may be "
        f"{1e3 * slack_s:.2g} ms longer or shorter than the data say."
    )
    return (Allowance(Counts.ADDED, slack_s, slack_s, sentence),)
