"""Quantities of a result: numbers with intervals, before and after they are judged, and how they are called.

An `Unjudged` number has no verdict; a `Quantity` has one. They are two types, so that no number passes for
identified before its grounds were looked at.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum

from eivor.flights.allowance import Allowance, reserved, widened
from eivor.inference.verdict import Reason, Status, Verdict

NAN = float("nan")
NO_INTERVAL = (float("-inf"), float("inf"))


class Kind(Enum):
    """Whether a quantity is a parameter of the equation or follows from parameters."""

    PARAMETER = "parameter"
    DERIVED = "derived"


@dataclass(frozen=True, slots=True)
class Wording:
    """How a quantity is called, measured and shown.

    Parameters
    ----------
    words : str
        In words.
    symbol : str
        As in the equation of motion.
    unit : str
        SI unit; empty for the unit of the input.
    kind : Kind
        Parameter or derived.
    shown_unit : str
        Unit of tables and figures.
    scale : float
        From the SI unit to the shown one.
    lowest : float
        What no such quantity can be below; intervals are cut there.
    by_run : bool
        The quantity has a value of its own in each run.
    optional : bool
        Results have it only where it was asked for.
    """

    words: str
    symbol: str
    unit: str
    kind: Kind = Kind.PARAMETER
    shown_unit: str = ""
    scale: float = 1.0
    lowest: float = -math.inf
    by_run: bool = False
    optional: bool = False

    def possible(self, interval: tuple[float, float]) -> tuple[float, float]:
        """Part of an interval that is not below `lowest`; one without a lower bound stays as it is."""
        low, high = interval
        return (self.lowest, high) if math.isfinite(low) and low < self.lowest <= high else interval


@dataclass(frozen=True, slots=True)
class Choice:
    """Values of a quantity that takes only a few.

    Parameters
    ----------
    fitting : tuple of float
        Those that the data cannot tell from the best one.
    tried : tuple of float
        All.
    """

    fitting: tuple[float, ...]
    tried: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Unjudged:
    """A number with its interval, and no verdict yet.

    Parameters
    ----------
    value : float
        NaN when it could not be estimated.
    unit : str
        SI unit.
    std_error : float
        At the best candidate; NaN when there is none.
    interval : tuple of float
        95 %, a union over the candidates that fit.
    choice : Choice, optional
        For what was chosen out of a few values; the interval spans those that fit.
    by_run : tuple of float
        Its value in each run, for what belongs to a run.
    lowest : float
        What it cannot be below in this problem, beside what its wording says of every one.
    allowances : tuple of Allowance
        Systematic parts; the interval has those that belong to it.
    """

    value: float
    unit: str
    std_error: float
    interval: tuple[float, float]
    choice: Choice | None = None
    by_run: tuple[float, ...] = ()
    lowest: float = -math.inf
    allowances: tuple[Allowance, ...] = ()

    @property
    def half_width(self) -> float:
        """Half the interval's width."""
        return 0.5 * (self.interval[1] - self.interval[0])

    @property
    def reserved(self) -> float:
        """What a verdict is to allow for beyond the interval."""
        return reserved(self.allowances)

    def times(self, factor: float) -> Unjudged:
        """Return a multiple of the number, by a factor above zero that is known."""
        low, high = self.interval
        return replace(
            self,
            value=factor * self.value,
            std_error=factor * self.std_error,
            interval=(factor * low, factor * high),
        )

    def judged(self, found: Verdict, wording: Wording) -> Quantity:
        """Return the quantity with its verdict; its interval holds possible values only."""
        return Quantity(
            self.value,
            self.unit,
            self.std_error,
            replace(wording, lowest=max(wording.lowest, self.lowest)).possible(self.interval),
            found.status,
            self.choice,
            self.by_run,
            found.reasons,
            self.allowances,
        )


@dataclass(frozen=True, slots=True)
class Quantity:
    """One result.

    Parameters
    ----------
    value, unit, std_error, interval, choice, by_run, allowances
        See `Unjudged`; the interval is cut where the quantity cannot be.
    verdict : Status
        How far it may be trusted.
    reasons : tuple of Reason
        Why no further, worst first.
    """

    value: float
    unit: str
    std_error: float
    interval: tuple[float, float]
    verdict: Status
    choice: Choice | None = None
    by_run: tuple[float, ...] = ()
    reasons: tuple[Reason, ...] = ()
    allowances: tuple[Allowance, ...] = ()

    @property
    def half_width(self) -> float:
        """Half the interval's width."""
        return 0.5 * (self.interval[1] - self.interval[0])

    def widened(self, interval: tuple[float, float]) -> tuple[float, float]:
        """Another interval of the same, such as one of another level, with the systematic parts in it."""
        return widened(interval, self.value, self.allowances)
