"""Quantities of a result: words, units, allowances and what is shown of them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from enum import Enum

import msgspec
import numpy as np

from eivor.inference.verdict import Reason, Status, Verdict
from eivor.logs.read import advising_format
from eivor.models.lagged_runs import LaggedRuns
from eivor.models.separable import Prior
from eivor.tools import Float


class Covariate(msgspec.Struct, frozen=True):
    """Covariate of a quantity across flights."""

    name: str  # Column of a fleet's table
    slope: float = 0.0
    uncertainty: float = math.inf


@dataclass(frozen=True, slots=True)
class AcrossFlights:
    """A quantity that flights of one vehicle share but for chance."""

    name: str
    logarithm: bool = False
    largest: float = math.inf  # Bound of a quantity that is a share, such as 1
    covariates: tuple[Covariate, ...] = ()
    identified_by: tuple[str, ...] = ()


Interval = tuple[float, float]


class Counts(Enum):
    """Effect of a systematic part on an interval."""

    ADDED = "added"  # On top of what scatters: the interval is longer by it at both ends
    AT_LEAST = "at least"  # The interval reaches so far to both sides: no model is truer than that
    INDEPENDENT = "independent"  # An error of its own, half of a 95 % interval: squares of halves add up
    FACTOR = "factor"  # The interval is so many times as long, before anything else is added


class SystematicUncertainty(msgspec.Struct, frozen=True):
    """Possible error of a quantity by one systematic cause."""

    counts: Counts
    below: float  # In the unit of the quantity; a factor is a number
    above: float
    sentence: str


def widened(
    interval: Interval, value: float, systematic_uncertainties: Iterable[SystematicUncertainty]
) -> Interval:
    """Interval of a quantity with every allowance in it; one whose value is no number stays as it is."""
    low, high = interval
    if not math.isfinite(value):
        return interval
    parts = list(systematic_uncertainties)
    independent = [item for item in parts if item.counts is Counts.INDEPENDENT]
    for item in (item for item in parts if item.counts is Counts.FACTOR):
        low = value + (low - value) * (item.below if low < value else 1.0)
        high = value + (high - value) * (item.above if high > value else 1.0)
    if independent and low <= value <= high:
        low = value - math.hypot(value - low, *(item.below for item in independent))
        high = value + math.hypot(high - value, *(item.above for item in independent))
    for item in (item for item in parts if item.counts is Counts.ADDED):
        low, high = low - item.below, high + item.above
    for item in (item for item in parts if item.counts is Counts.AT_LEAST):
        low, high = min(low, value - item.below), max(high, value + item.above)
    return low, high


class CoupledAxis(msgspec.Struct, frozen=True):
    """A quantity of another motion of the same flight that belongs to a motion's result."""

    motion: str
    quantity: str
    called: str
    input: str
    input_map: str
    needs: Mapping[str, tuple[str, ...]]


@dataclass(frozen=True, slots=True)
class Implied:
    """A number that follows from a vehicle's description, or why it does not."""

    name: str
    words: str
    symbol: str
    unit: str
    value: float | None
    std_error: float | None
    interval: Interval | None
    sentence: str
    verdict: Status = Status.REFUSED
    needs: tuple[str, ...] = ()  # Quantities that it rests on: its verdict is no better than theirs


@dataclass(frozen=True, slots=True)
class Implications:
    """All implied numbers, and contradictions to the description."""

    numbers: tuple[Implied, ...] = ()
    contradictions: tuple[str, ...] = ()


class Horizon(Enum):
    """Horizon of a prediction."""

    ONE_STEP = "one_step"  # What is measured at a sample, of everything else that is measured there
    OPEN_LOOP = "open_loop"  # The state over a whole run, of its input alone

    @property
    def words(self) -> str:
        """In words."""
        return {"one_step": "one step ahead", "open_loop": "in open loop"}[self.value]


@dataclass(frozen=True)
class PredictedQuantity:
    """A measured quantity over the samples of all runs, run after run, and what given numbers say of it."""

    horizon: Horizon
    quantity: str
    unit: str
    measured: Float[np.ndarray, " samples"]
    predicted: Float[np.ndarray, " samples"]


class KeyFigure(msgspec.Struct, frozen=True):
    """A number of flights that is no quantity of the motion: it has no verdict, and decides nothing."""

    name: str
    words: str
    value: float
    unit: str  # Empty for a share or a ratio
    interval: Interval | None = None  # 95 %, where it can have one
    sentence: str = ""  # What it means, or holds for


class SimpleModel(msgspec.Struct, frozen=True):
    """Numbers that a simpler way of looking at the same flight gives, to be held against an estimate."""

    words: str
    values: Mapping[str, float]  # Every linear parameter and every nuisance


@dataclass(frozen=True)
class Trace:
    """One axis over the samples of all runs, run after run: what was measured and what the model says."""

    axis: str  # What is measured, in words
    unit: str  # As it is shown
    model: str  # The prediction, and the part of it that the input makes, in symbols
    drive: str  # The prediction, and the part of it that the input makes, in symbols
    measured: Float[np.ndarray, " samples"]  # In that unit; mean and line of each run may be missing
    predicted: Float[np.ndarray, " samples"]  # In that unit; mean and line of each run may be missing
    driven: Float[np.ndarray, " samples"]  # In that unit; mean and line of each run may be missing
    #: Band that they are of, where it is another than that of the flights
    band_hz: tuple[float, float] | None = None


@dataclass(frozen=True)
class PlotData:
    """A series of a flight to look at, whether or not something could be estimated."""

    label: str  # With its unit
    values: Float[np.ndarray, " n"]  # On the flight's grid
    reference: Float[np.ndarray, " n"] | None = None  # What was requested of the vehicle, in the same unit


class TrackedParameter(msgspec.Struct, frozen=True):
    """A parameter that is followed over a flight, and the rows that identify it."""

    name: str
    runs: LaggedRuns  # Columns of the flight
    known: Mapping[str, Prior]
    intercept: Prior | None
    descriptions: tuple[str, ...]  # The same in sentences


@dataclass(frozen=True, slots=True)
class Words:
    """How reports speak of a motion."""

    title: str  # Name of the motion, as a heading
    model: str  # Name in JSON documents
    fly: str  # What to fly when nothing else helps, one sentence
    limited_by: str = "window and gaps"  # The same as a list of nouns
    loosen: str = "Widen the window."  # What to do when those limits leave nothing
    no_reference: str = "None is logged."  # What is missing when no reference is logged
    #: Why there is no lag to find when the input is measured
    no_lag: str = "The input was measured:\nthere is no lag to find."
    where: str = "in the air"  # Where the vehicle is while the motion holds
    begins: str = "takes off"  # What it does to get there
    another_log: str = "Give a log of a flight."  # What to do when it never does
    manoeuvres: tuple[str, ...] = ()  # What to fly, for a flight card
    needed: tuple[str, ...] = ()  # What to log, before what a log's format advises
    setpoints: str = ""  # Which of them are setpoints. Default: those of the format
    card: tuple[CardSection, ...] = ()  # In place of a card of these
    planned: tuple[str, ...] = ()  # Quantities that flights of `eivor plan` are made for
    log_reference: str = ""  # What to log where there is no reference
    log_planned: str = ""  # And where the reference answers the vehicle
    moves: str = "moves"  # What something that the model does not have does to the vehicle
    undisturbed: str = ""  # What to do about that
    of_answers: Status = Status.WEAK  # What a reference that is declared to answer the vehicle leaves

    def advice(self, log_format: str) -> tuple[CardSection, ...]:
        """What to fly and to log; about logs of a format without advice, that of tables."""
        if not self.manoeuvres:
            return self.card
        advised = advising_format(log_format)
        return (
            CardSection("Fly", self.manoeuvres),
            CardSection("Log", (*self.needed, *advised.advice(""))),
            CardSection("Setpoints", (self.setpoints or advised.setpoints,)),
        )


class CardSection(msgspec.Struct, frozen=True):
    """One part of a flight card."""

    title: str  # A few words
    sentences: tuple[str, ...]  # What to do


NAN = float("nan")
NO_INTERVAL = (float("-inf"), float("inf"))


@dataclass(frozen=True, slots=True)
class QuantitySpec:
    """How a quantity is called, measured, shown and used."""

    words: str  # In words
    symbol: str  # As in the equation of motion
    unit: str  # SI unit; empty for the unit of the input
    derived: bool = False  # It is no parameter of the equation, but follows from parameters
    shown_unit: str = ""  # Unit of tables and figures
    scale: float = 1.0  # From the SI unit to the shown one
    lowest: float = -math.inf  # What no such quantity can be below; intervals are cut there
    by_run: bool = False  # The quantity has a value of its own in each run
    optional: bool = False  # Results have it only where it was requested
    headline: bool = False  # Its reasons make the overall verdict
    in_rows: bool = False  # Tables of flights or of methods show it
    #: It belongs to the flight (wind, load) and not to the vehicle: flights of a pool have each their own
    of_flight: bool = False
    reciprocal_of: str = ""  # The quantity that it is one over
    needs: tuple[str, ...] = ()  # Quantities that it rests on: what speaks against them speaks against it
    need: str = ""  # Word by which a caller may require it, such as "hover"; others decide no exit code
    across: AcrossFlights | None = None  # How reports of fleets pool it
    field_symbol: str = ""  # What flight mechanics calls it, with its sign: -L_p

    @property
    def own_symbol(self) -> str:
        """The symbol, where it says more than the words."""
        return "" if self.symbol == self.words else self.symbol

    def possible(self, interval: tuple[float, float]) -> tuple[float, float]:
        """Part of an interval that is not below `lowest`; one without a lower bound stays as it is."""
        low, high = interval
        return (self.lowest, high) if math.isfinite(low) and low < self.lowest <= high else interval


class QuantityTable(dict[str, QuantitySpec]):
    """Quantities of a motion by name, in the order of results and reports."""

    @property
    def headline(self) -> tuple[str, ...]:
        """Quantities whose reasons make the overall verdict."""
        return tuple(name for name, spec in self.items() if spec.headline)

    @property
    def rows(self) -> tuple[str, ...]:
        """Quantities that a table of flights or of methods shows."""
        return tuple(name for name, spec in self.items() if spec.in_rows)

    @property
    def of_flight(self) -> tuple[str, ...]:
        """Linear parameters that belong to the flight and not to the vehicle."""
        return tuple(name for name, spec in self.items() if spec.of_flight)

    @property
    def across(self) -> tuple[AcrossFlights, ...]:
        """Pooling rules for reports of fleets."""
        return tuple(spec.across for spec in self.values() if spec.across is not None)


@dataclass(frozen=True, slots=True)
class QuantityEstimate:
    """A number with its interval, and no verdict yet."""

    value: float  # NaN when it could not be estimated
    unit: str  # SI unit
    std_error: float  # NaN when there is none
    interval: tuple[float, float]  # 95 %
    by_run: tuple[float, ...] = ()  # Its value in each run, for what belongs to a run
    #: What it cannot be below in this problem, beside what its wording says of every one
    lowest: float = -math.inf
    systematic_uncertainties: tuple[SystematicUncertainty, ...] = ()

    @property
    def half_width(self) -> float:
        """Half the interval's width."""
        return 0.5 * (self.interval[1] - self.interval[0])

    def times(self, factor: float) -> QuantityEstimate:
        """Return a multiple of the number, by a factor that is known."""
        low, high = sorted(factor * end for end in self.interval)
        error = abs(factor) * self.std_error
        return replace(self, value=factor * self.value, std_error=error, interval=(low, high))

    def judged(self, judgement: Verdict, wording: QuantitySpec) -> Quantity:
        """Return the quantity with its verdict; its interval holds possible values only."""
        lowest = max(wording.lowest, self.lowest)
        interval = replace(wording, lowest=lowest).possible(self.interval)
        known = (self.value, self.unit, self.std_error, interval, self.by_run, lowest)
        return Quantity(*known, self.systematic_uncertainties, judgement.status, judgement.reasons)


@dataclass(frozen=True, slots=True)
class Quantity(QuantityEstimate):
    """One result: the number with its verdict."""

    verdict: Status = Status.REFUSED
    reasons: tuple[Reason, ...] = ()  # Why no further, worst first

    def widened(self, interval: tuple[float, float]) -> tuple[float, float]:
        """Another interval of the same, such as one of another level, with the systematic parts in it."""
        return widened(interval, self.value, self.systematic_uncertainties)
