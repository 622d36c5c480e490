"""What follows from an estimate and from what a user supplied: numbers that no flight tells by itself."""

from __future__ import annotations

from dataclasses import dataclass

Interval = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Implied:
    """One such number, or why it does not follow.

    Parameters
    ----------
    name, words : str
        For programs, and for people.
    symbol, unit : str
        Of the number.
    value : float or None
        None where it does not follow.
    std_error : float or None
        Of it.
    interval : tuple of float or None
        95 %, with the errors of what was supplied.
    sentence : str
        What it rests on; or what is missing, what there is in its place, and what to supply.
    """

    name: str
    words: str
    symbol: str
    unit: str
    value: float | None
    std_error: float | None
    interval: Interval | None
    sentence: str


@dataclass(frozen=True, slots=True)
class Implications:
    """All of them.

    Parameters
    ----------
    numbers : tuple of Implied
        In the order in which they are shown; none for a motion that has nothing of the kind.
    contradictions : tuple of str
        Sentences about what cannot be, or does not fit what was supplied.
    """

    numbers: tuple[Implied, ...] = ()
    contradictions: tuple[str, ...] = ()
