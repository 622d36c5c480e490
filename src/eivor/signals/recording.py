"""A recording: channels, origin, findings and data sheets."""

from __future__ import annotations

import math
import re
from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from enum import Enum
from typing import Any

import numpy as np

from eivor import checks
from eivor.errors import MissingChannelError, NonFiniteError, ShapeError, UsageError, did_you_mean
from eivor.signals.channels import CurveSide, family_members
from eivor.signals.filters import evened, in_bursts
from eivor.tools import Bool, Float, html_table


@dataclass(frozen=True, slots=True)
class DataSheet:
    """White noise and rounding of a sensor, as a data sheet determines them."""

    density: float = 0.0  # Noise density, in the channel's unit per square root of a hertz
    bandwidth_hz: float | None = None
    step: float = 0.0  # Quantisation step, in the channel's unit

    def __post_init__(self) -> None:
        stated = {"density": self.density, "step": self.step}
        if self.bandwidth_hz is not None:
            stated["bandwidth_hz"] = self.bandwidth_hz
        for name, value in stated.items():
            checks.number(name, value)
            if not 0.0 <= value < math.inf:
                raise UsageError(f"a {name} of zero or more", f"{value:g}", "Correct what the sheet says.")
        if not (self.density > 0.0 or self.step > 0.0):
            remedy = "Give DataSheet(density=0.002, bandwidth_hz=50.0), for example."
            raise UsageError("a noise density or a quantisation step above zero", "neither", remedy)

    def std(self, rate_hz: float) -> float:
        """Standard deviation of one sample of a channel that is logged at that rate, in its unit."""
        bandwidth = 0.5 * rate_hz if self.bandwidth_hz is None else self.bandwidth_hz
        return math.sqrt(self.density**2 * bandwidth + self.step**2 / 12.0)


#: A clock that was never set determines a time before this, and one that is damaged a time after [UTC].
EARLIEST, LATEST = datetime(2000, 1, 1, tzinfo=UTC), datetime(2100, 1, 1, tzinfo=UTC)


@dataclass(frozen=True, slots=True)
class LogOrigin:
    """What a log says of the machine that wrote it; empty where it says nothing."""

    board: str = ""  # Unique id of the board
    airframe: str = ""
    firmware: str = ""  # Name and version
    start: datetime | None = None

    def __post_init__(self) -> None:
        for name in ("board", "airframe", "firmware"):
            checks.text(name, getattr(self, name))
        if self.start is not None:
            checks.kind("start", self.start, datetime, "a datetime", "Give one with its time zone.")


def utc_time(seconds: float) -> datetime | None:
    """Time of seconds since 1970; None of a clock that was never set."""
    try:
        moment = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=seconds)
    except (OverflowError, ValueError):
        return None
    return moment if EARLIEST <= moment <= LATEST else None


#: A longer gap is silence: the logger paused or its clock jumped, and the time is no part of the record [s].
SILENCE_S = 10.0
#: Least share of a sensor's values at a limit of its range that is no coincidence.
LIMITED_SHARE = 0.001
#: Entry of `Recording.parameters` of simulated flights: rate of the controller's commands [Hz].
CONTROLLER_RATE = "controller_rate_hz"
#: Words of `Recording.vehicle`: rotors alone, rotors whose blades turn, and wings too.
ROTARY_WING, HELICOPTER, VTOL = "rotary wing", "helicopter", "VTOL"
#: Standard acceleration of gravity [m/s^2].
GRAVITY = 9.80665
#: No sensor gives more, in any unit: its square is a number yet, and so is a sum of such.
LARGEST_VALUE = 1e100
#: Stamps beyond these are none, in any unit of a clock, and those as close are of one time [s].
LAST_STAMP_S, SHORTEST_STEP_S = 1e19, 1e-12


class Frame(Enum):
    """Which way the axes of the world and of the body point."""

    Z_UP = "z up (world east-north-up, body forward-left-up)"
    NED = "z down (world north-east-down, body forward-right-down)"


@dataclass(frozen=True, slots=True)
class Finding:
    """A named diagnostic: something about the data that a reader of the result should know."""

    name: str
    message: str


@dataclass(frozen=True, slots=True)
class ChannelQuality:
    """What had to be set right, or was found wrong, while a channel was read. Counts of samples."""

    duplicated_stamps: int = 0
    backward_stamps: int = 0
    missing_values: int = 0
    overflowed: int = 0
    saturated: int = 0
    evened_stamps: int = 0


@dataclass(frozen=True, slots=True)
class Channel:
    """One quantity as logged, on its own clock."""

    name: str  # Canonical name, see `eivor.signals.channels`
    time_s: Float[np.ndarray, " n"]  # Stamps [s], finite and strictly increasing
    values: Float[np.ndarray, " n"]
    unit: str  # SI unit, empty for a pure number
    source: str = ""
    held: bool = False  # True when the value holds until the next stamp (commands, setpoints, states)
    quality: ChannelQuality = field(default_factory=ChannelQuality)
    #: True for what an estimator makes, False for what a sensor measures; None where nothing is said
    estimated: bool | None = None
    delay_s: float = 0.0
    noise: float | DataSheet | None = None
    curve_side: CurveSide = CurveSide.UNKNOWN

    def __post_init__(self) -> None:
        if self.time_s.shape != self.values.shape or self.time_s.ndim != 1:
            expected = f"one stamp for each value of channel '{self.name}'"
            received = f"stamps of shape {self.time_s.shape} and values of shape {self.values.shape}"
            raise ShapeError(expected, received, "Give both as one-dimensional arrays of the same length.")
        if not _rise(self.time_s):
            expected = f"finite, strictly increasing time stamps in channel '{self.name}'"
            remedy = "Use `clean_channel`, which drops such samples and counts them."
            raise NonFiniteError(expected, "stamps that are not finite, repeat, or go backward", remedy)

    @property
    def rate_hz(self) -> float:
        """Mean rate over the channel's own span, gaps left out [Hz]; 0 with fewer than two samples."""
        if self.time_s.size < 2:
            return 0.0
        gaps = self.gaps()
        logged = float(self.time_s[-1] - self.time_s[0]) - sum(end - start for start, end in gaps)
        return float((self.time_s.size - 1 - len(gaps)) / logged)

    @property
    def limited(self) -> Bool[np.ndarray, " n"]:
        """Values at a limit of the sensor's range; none below `LIMITED_SHARE` of them.

        A limit is an extreme that is reached five times or more, and more often than neared; ranges are even.
        """
        limited, known = np.zeros(self.values.size, dtype=np.bool_), self.values[np.isfinite(self.values)]
        for series in (known, -known):
            at = series == (extreme := series.max(initial=-np.inf))
            if extreme > 0.0 and (np.diff(np.flatnonzero(at)) > 1).sum() >= 4:
                levels = np.unique(series)[-3:]  # the next two, where steps are coarse
                near = series >= min(levels[0], extreme - 0.1 * (extreme - float(np.median(series))))
                if levels.size == 3 and 2 * at.sum() > near.sum():
                    limited |= np.abs(self.values) > 0.999 * extreme
        return limited & (limited.sum() >= LIMITED_SHARE * limited.size)

    def at_limit(self) -> str:
        """Say how often values are at a limit."""
        return f"Channel {self.name} is at a limit of its range in {self.limited.mean():.1%} of its samples"

    def silences(self) -> list[tuple[float, float]]:
        """Gaps [s] that are longer than `SILENCE_S`."""
        return self.gaps(at_least_s=SILENCE_S)

    def gaps(self, factor: float = 5.0, at_least_s: float = 0.1) -> list[tuple[float, float]]:
        """Intervals [s] without a sample, longer than `factor` median steps and than `at_least_s`."""
        if self.time_s.size < 2 or np.diff(self.time_s).max() <= at_least_s:
            return []
        # differences twice: one array of a channel's length at a time
        usual = float(np.median(np.diff(self.time_s), overwrite_input=True))
        wide = np.flatnonzero(np.diff(self.time_s) > max(factor * usual, at_least_s))
        return [(float(self.time_s[i]), float(self.time_s[i + 1])) for i in wide]


class MadeChannels(Mapping[str, Channel]):
    """Channels by name, not all of which are in memory: take one at a time, and let it go."""

    @abstractmethod
    def __contains__(self, name: object) -> bool:
        """Say whether there is such a channel, without making it."""

    @property
    @abstractmethod
    def span_s(self) -> tuple[float, float]:
        """First and last stamp over all channels of the log [s], without making them."""

    @abstractmethod
    def part(self, start_s: float, end_s: float, step_s: float = 0.0) -> MadeChannels:
        """Return the channels of a part of the log, or of more of it where its reader cannot cut."""

    @abstractmethod
    def changed(self, change: Callable[[Channel], Channel]) -> MadeChannels:
        """Return the same channels, each changed when it is made."""


def clean_channel(
    name: str,
    time_s: Float[np.ndarray, " n"],
    values: Float[np.ndarray, " n"],
    unit: str,
    *,
    overflowed: int = 0,
    saturated: int = 0,
    **known: Any,
) -> Channel:
    """Channel of raw stamps and values, and of what is known of it: stamps that do not rise are dropped."""
    time = checks.real_array(f"stamps of channel '{name}'", time_s)
    series = np.array(checks.real_array(f"channel '{name}'", values))
    if time.shape != series.shape:
        expected = f"one stamp for each value of channel '{name}'"
        received = f"{time.size} stamps and {series.size} values"
        raise ShapeError(expected, received, "Give both as one-dimensional arrays of the same length.")
    finite = np.abs(time) <= LAST_STAMP_S
    if not finite.all():
        time, series = time[finite], series[finite]
    series[~((series >= -LARGEST_VALUE) & (series <= LARGEST_VALUE))] = np.nan
    quality = ChannelQuality(backward_stamps=int((~finite).sum()), overflowed=overflowed, saturated=saturated)
    if not _rise(time) or in_bursts(np.diff(time)):
        time, first, quality = _rising(time, quality)
        series = series[first]
    quality = replace(quality, missing_values=int(np.isnan(series).sum()))
    return Channel(name, time, series, unit, quality=quality, **known)


def _rise(time_s: Float[np.ndarray, " n"]) -> bool:
    """Whether stamps are in range and strictly increase."""
    ends = (np.abs(time_s[:1]) <= LAST_STAMP_S).all() and (np.abs(time_s[-1:]) <= LAST_STAMP_S).all()
    return bool(ends and (time_s[1:] - time_s[:-1] >= SHORTEST_STEP_S).all())


def _rising(
    time_s: Float[np.ndarray, " n"], quality: ChannelQuality
) -> tuple[Float[np.ndarray, " m"], Bool[np.ndarray, " n"], ChannelQuality]:
    """Finite stamps that rise, evened where they err, their mask, and the quality."""
    time = evened(time_s)
    latest = np.maximum.accumulate(time)
    first = np.ones(time.size, dtype=np.bool_)
    ahead = time[1:] - latest[:-1]
    first[1:] = ahead >= SHORTEST_STEP_S
    duplicated = int((np.abs(ahead) < SHORTEST_STEP_S).sum())
    result = replace(
        quality,
        duplicated_stamps=duplicated,
        evened_stamps=0 if time is time_s else int(time.size),
        backward_stamps=quality.backward_stamps + int((~first).sum()) - duplicated,
    )
    return time[first], first, result


@dataclass(frozen=True, slots=True)
class Recording:
    """Everything Eivor uses of one log."""

    name: str  # What to call the log in reports: its file name
    format: str  # "ulog", "crazyflie", "csv", "parquet", "frame" (made from arrays) or "simulation", for some
    channels: Mapping[str, Channel]  # By canonical name
    frame: Frame = Frame.Z_UP  # Which way z points in `channels`
    sha256: str = ""  # Hash of the file's bytes (hexadecimal), empty when there was no file
    #: Vehicle parameters that the log carries, by the autopilot's own names
    parameters: Mapping[str, float] = field(default_factory=dict)
    #: Name of the input map that the channel map states ("square"), empty when it does not
    input_map: str = ""
    #: For each canonical channel the reader knows: the topics or columns it looked for
    looked_for: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()  # Named diagnostics of the reader
    vehicle: str = ""  # Kind of vehicle by the log ("rotary wing", "fixed wing"); empty when it says nothing
    #: Which machine wrote the log, with which firmware, and when, as far as it says
    origin: LogOrigin = field(default_factory=LogOrigin)

    def __post_init__(self) -> None:
        for name in ("name", "format", "sha256", "input_map", "vehicle"):
            checks.text(name, getattr(self, name))
        if not isinstance(self.channels, MadeChannels):
            checks.mapping("channels", self.channels, Channel, "channels")
        checks.kind("frame", self.frame, Frame, "a Frame", "Give Frame.Z_UP or Frame.NED.")
        checks.mapping("parameters", self.parameters, checks.NUMBERS, "numbers")
        checks.mapping("looked_for", self.looked_for, tuple, "tuples of names")
        checks.items("findings", self.findings, Finding, "findings")
        checks.kind("origin", self.origin, LogOrigin, "a LogOrigin", "Leave it out when nothing is known.")

    def __repr__(self) -> str:
        start, end = self.span_s
        span = f"{len(self.channels)} channels, {start:.1f} to {end:.1f} s"
        return f"<Recording {self.name!r} ({self.format}): {span if self.channels else 'no channels'}>"

    def _repr_html_(self) -> str:
        rows = [
            (name, channel.unit, f"{channel.values.size}", f"{channel.rate_hz:.4g}", channel.source)
            for name, channel in self.channels.items()
        ]
        return html_table(repr(self), ("channel", "unit", "samples", "rate [Hz]", "source"), rows)

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last stamp over all channels [s]."""
        if isinstance(self.channels, MadeChannels):
            return self.channels.span_s
        stamps = [channel.time_s for channel in self.channels.values() if channel.time_s.size]
        ends = [(float(time_s[0]), float(time_s[-1])) for time_s in stamps] or [(0.0, 0.0)]
        return min(first for first, _ in ends), max(last for _, last in ends)

    def part(self, start_s: float, end_s: float, step_s: float = 0.0) -> Recording:
        """Return the same log with the channels of a part of it [s], where they do not fit into memory.

        Samples that are closer than `step_s` [s] are thinned to this distance; zero keeps all.
        """
        if not isinstance(self.channels, MadeChannels):
            return self
        return replace(self, channels=self.channels.part(start_s, end_s, step_s))

    def family(self, name: str) -> list[Channel]:
        """Channels called `name`, or `name` and a rotor's number or an axis, see `family_members`."""
        return [self.channels[member] for member in family_members(name, self.channels)]

    def channel(self, name: str) -> Channel:
        """Return the channel called `name`; a `MissingChannelError` has the topics that were looked for."""
        checks.text("a channel", name)
        if name in self.channels:
            return self.channels[name]
        sources = ", ".join(self.looked_for.get(name, ())) or "no source of it is known for this format"
        expected = f"the channel '{name}' in {self.name}"
        received = f"a log without it (looked for: {sources})"
        remedy = "Log it; in a table or a bag, a channel map may name its column (--map)."
        unused = " ".join(item.message for item in self.findings if item.name == "ignored_columns")
        near = did_you_mean(name, re.findall(r"'([^']+)'", unused), remedy)
        raise MissingChannelError(expected, received, near)


def interval_within(window: tuple[float, float], span: tuple[float, float]) -> tuple[float, float]:
    """Return the part of `window` [s] that lies in `span` [s]."""
    start, end = max(window[0], span[0]), min(window[1], span[1])
    if not window[0] < window[1] or not start < end:
        expected = f"a window START:END inside the log, which spans {span[0]:.2f} to {span[1]:.2f} s"
        received = f"{window[0]:g}:{window[1]:g}"
        raise UsageError(expected, received, "Give the start and the end in seconds from the log's start.")
    return start, end
