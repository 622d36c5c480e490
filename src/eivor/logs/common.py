"""What all formats share: columns, units, stamps, delays, silences and findings."""

from __future__ import annotations

import hashlib
import os
import re
import struct
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from heapq import nsmallest
from math import inf
from operator import attrgetter
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import numpy as np

from eivor.signals.channels import CanonicalChannel, held_by_default, unit_of
from eivor.signals.filters import Series, on_lines
from eivor.signals.recording import (
    GRAVITY,
    Channel,
    ChannelQuality,
    Finding,
    MadeChannels,
    Recording,
    clean_channel,
)
from eivor.strict_toml import package_tables
from eivor.tools import Bool, Float


@dataclass(frozen=True, slots=True)
class Columns:
    """Columns of a table as numbers."""

    values: Mapping[str, Series]
    unreadable: Mapping[str, int] = field(default_factory=dict)
    seconds: frozenset[str] = frozenset()
    lists: Mapping[str, str] = field(default_factory=dict)


def low_pass_delay_s(cutoff_hz: float) -> float:
    """How late a low-pass of the second order (Butterworth) is, far below its cutoff [s]; 0 without any."""
    return float(np.sqrt(2.0) / (2.0 * np.pi * cutoff_hz)) if cutoff_hz > 0.0 else 0.0


def notch_delay_s(frequency_hz: float, bandwidth_hz: float) -> float:
    """How late a notch is, far below its frequency [s]; 0 without any."""
    is_set = frequency_hz > 0.0 and bandwidth_hz > 0.0
    return float(bandwidth_hz / (2.0 * np.pi * frequency_hz**2)) if is_set else 0.0


#: What content may become: numbers for each byte and those that are free, numbers at most, groups and
#: variables, and how deep they stand in each other.
CELLS_PER_BYTE, FREE_CELLS, MAX_CELLS = 25, 10_000_000, 100_000_000
MAX_OBJECTS, MAX_DEPTH = 10_000, 16


def most_cells(size: int, max_bytes: int) -> int:
    """How many numbers may be read of a file of a size."""
    return min(MAX_CELLS, max(FREE_CELLS, CELLS_PER_BYTE * size), max_bytes // 8)


_ELEMENT = re.compile(r"(.+)\[(\d{1,6})\]")


def element_of(name: str, columns: Sequence[str]) -> tuple[str, int] | None:
    """Return the column and the place that a name means; None for a column of its own, or of none."""
    match = _ELEMENT.fullmatch(name)
    return None if match is None or name in columns or match[1] not in columns else (match[1], int(match[2]))


_WRONG = (ValueError, TypeError, LookupError, ArithmeticError, AttributeError, AssertionError, NameError)
#: Errors that decoders raise for damaged bytes.
DECODER_ERRORS = (*_WRONG, OSError, EOFError, RuntimeError, MemoryError, struct.error, zlib.error)


#: Name and sentence of what readers report; what is found goes into the braces.
FINDINGS: Mapping[str, tuple[str, str]] = package_tables("eivor.logs", "findings.toml")


def noted(key: str, subject: float | str | Iterable[str] = True, **words: object) -> list[Finding]:
    """Finding of a key of `FINDINGS` on a count or on names, with words; none of zero or of nothing."""
    text = subject if isinstance(subject, (float, int, str)) else ", ".join(subject)
    name, sentence = FINDINGS[key]
    return [Finding(name, sentence.format(text, **words))] if text else []


#: Fewest rows of a line, fewest columns that begin one together, and their largest distance [rows].
MIN_ROWS = 50
MIN_COLUMNS = 3
TOGETHER_ROWS = 5


def without_extrapolation(
    time_s: Series, columns: Mapping[str, Series], findings: list[Finding]
) -> dict[str, Series]:
    """Return the columns with made-up values as NaN."""
    starts = {name: _line_start(time_s, values) for name, values in columns.items()}
    started = {name: start for name, start in starts.items() if start is not None}
    if len(started) < MIN_COLUMNS:
        return dict(columns)
    middle = int(np.median(list(started.values())))
    aligned = [name for name, start in started.items() if abs(start - middle) <= TOGETHER_ROWS]
    # four rotors on one commanded ramp are one line, not four
    different = {tuple(columns[name][-2:]) for name in aligned}
    if len(different) < MIN_COLUMNS:
        return dict(columns)
    cleaned = dict(columns)
    for name in aligned:
        cleaned[name] = np.where(np.arange(time_s.size) > started[name], np.nan, columns[name])
    findings += noted("extrapolated", map(repr, aligned), start_s=time_s[middle], count=len(aligned))
    return cleaned


def _line_start(time_s: Series, values: Series) -> int | None:
    """Row at which an exact sloping line to the last row begins; None when there is none of `MIN_ROWS`."""
    if values.size < 2 * MIN_ROWS:
        return None
    with np.errstate(all="ignore"):
        slopes = np.diff(values) / np.diff(time_s)
        last = slopes[-1]
        on_line = np.abs(slopes - last) <= 1e-5 * np.abs(last)
    if not np.isfinite(last) or last == 0.0 or on_line.all():
        return None
    start = int(np.flatnonzero(~on_line)[-1]) + 1
    return start if values.size - start >= MIN_ROWS else None


#: So many values of a long channel have the median of all: no more are looked at.
ENOUGH = 1 << 17
_FORCES, _PARTS, _RATES = (
    tuple(f"{family}_{member}" for member in members)
    for family, members in (("specific_force_body", "xyz"), ("attitude", "wxyz"), ("angular_rate", "xyz"))
)
#: Channels whose size is doubted.
_SIZED = frozenset({*_FORCES, *_PARTS, *_RATES, "specific_force_z", "cos_tilt"})
_Values = Mapping[str, Float[np.ndarray, " _"]]


def channel_findings(channels: Mapping[str, Channel]) -> tuple[Finding, ...]:
    """Return everything that stands out in a set of channels."""
    return findings_of({name: look(channel) for name, channel in channels.items()}, channels)


@dataclass(frozen=True, slots=True)
class ChannelProfile:
    """What findings need of every channel."""

    quality: ChannelQuality
    step_s: float  # Median step of a sampled channel, NaN where there is none [s]
    values: Series


def look(channel: Channel) -> ChannelProfile:
    """Look at a channel."""
    every = -(-channel.time_s.size // ENOUGH) or 1
    steps = channel.time_s[1::every] - channel.time_s[:-1:every]
    sampled = channel.time_s.size > 2 and not channel.held
    values = np.array(channel.values[::every]) if channel.name in _SIZED else np.empty(0)
    return ChannelProfile(channel.quality, float(np.median(steps)) if sampled else np.nan, values)


def findings_of(
    profiles: Mapping[str, ChannelProfile], channels: Mapping[str, Channel]
) -> tuple[Finding, ...]:
    """Return what `channel_findings` does, of channels that were looked at as they were made."""
    qualities = {name: item.quality for name, item in profiles.items()}
    # a flight is sampled between once per second and 100 kHz
    step_s = min((item.step_s for item in profiles.values() if np.isfinite(item.step_s)), default=1.0)
    values = {name: item.values for name, item in profiles.items() if name in _SIZED}
    doubts = (*_force_doubts(values), *_attitude_doubts(values), *_velocity_doubts(channels))
    return (
        *_count_findings(qualities),
        *([] if 1e-5 <= step_s <= 1.0 else noted("time_unit", step_s)),
        *(Finding("mixed_units", doubt) for doubt in doubts),
    )


#: What is counted of each channel, by the key of its finding.
COUNTS: Mapping[str, Callable[[ChannelQuality], int]] = {
    "missing_values": lambda q: q.missing_values,
    "overflow": lambda q: q.overflowed,
    "saturation": lambda q: q.saturated,
    "dropped_stamps": lambda q: q.duplicated_stamps + q.backward_stamps,
    "evened_stamps": lambda q: q.evened_stamps,
}


def _count_findings(qualities: Mapping[str, ChannelQuality]) -> list[Finding]:
    findings = []
    for name, count in COUNTS.items():
        concerned = [
            f"{key} {count(quality)}"
            for key, quality in qualities.items()
            # a setpoint without a value is one that is not in force, hence nothing to report
            if count(quality) and not (name == "missing_values" and "reference_" in key)
        ]
        findings += noted(name, concerned)
    return findings


def _median(values: Series) -> float:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else float("nan")


def _norm(values: _Values, names: Sequence[str]) -> Series | None:
    """Norm of channels that share one clock; None when one is absent or the lengths differ."""
    parts = [values[name] for name in names if name in values]
    if len(parts) < len(names) or len({part.size for part in parts}) > 1 or not parts[0].size:
        return None
    return np.asarray(np.sqrt(np.sum(np.square(parts), axis=0)))


def _force_doubts(values: _Values) -> Iterator[str]:
    """Doubt a median specific force other than one g: that of rest, of hover and of most flights."""
    forces = {
        "The norm of specific_force_body": _norm(values, _FORCES),
        "specific_force_z": values.get("specific_force_z"),
    }
    for label, force in forces.items():
        if force is None:
            continue
        median = abs(_median(force))
        if 0.8 < median < 1.25:
            yield f"{label} has a median of {median:.3g} m/s^2, which looks like a value in g."
        elif 800.0 < median < 1250.0:
            yield f"{label} has a median of {median:.4g} m/s^2, which looks like a value in milli-g."
        elif median < 0.5 * GRAVITY or median > 2.0 * GRAVITY:
            yield f"{label} has a median of {median:.3g} m/s^2, where about 9.8 is expected."


def _attitude_doubts(values: _Values) -> Iterator[str]:
    norm = _norm(values, _PARTS)
    if norm is not None and abs(_median(norm) - 1.0) > 0.05:
        yield f"The attitude quaternion has a median norm of {_median(norm):.3g} instead of 1."
    if np.any(np.abs(values.get("cos_tilt", 0.0)) > 1.0 + 1e-6):
        yield "cos_tilt leaves [-1, 1]; is it an angle?"
    # no gyro of a drone measures 35 rad/s (2000 deg/s) for more than a moment
    fast = [name for name in _RATES if name in values and _median(np.abs(values[name])) > 10.0]
    if fast:
        yield f"Typical values of {', '.join(fast)} are above 10 rad/s; are they in deg/s?"


def _velocity_doubts(channels: Mapping[str, Channel]) -> Iterator[str]:
    """Doubt a vertical velocity that is not the slope of the position, in size and in sign."""
    position, velocity = channels.get("position_z"), channels.get("velocity_z")
    fastest = 0.0 if velocity is None else float(np.nanmax(np.abs(velocity.values), initial=0.0))
    if fastest > 40.0:  # no rotorcraft climbs or falls faster
        yield f"velocity_z reaches {fastest:.3g} m/s: its estimator has diverged, or its unit is another."
        return
    if position is None or velocity is None or not np.array_equal(position.time_s, velocity.time_s):
        return
    valid = np.isfinite(position.values) & np.isfinite(velocity.values)
    if valid.sum() < 20:
        return
    z, v, t = position.values[valid], velocity.values[valid], position.time_s[valid]
    slope, middle = np.diff(z) / np.diff(t), 0.5 * (v[1:] + v[:-1])
    if np.std(slope) == 0.0 or np.std(middle) == 0.0:
        return
    correlation = float(np.corrcoef(slope, middle)[0, 1])
    ratio = float(np.std(middle) / np.std(slope)) * float(np.sign(correlation))
    if abs(correlation) >= 0.9 and not 0.5 < ratio < 2.0:
        yield f"velocity_z is {ratio:.3g} times the slope of position_z; check their units and signs."


#: More files than a folder of one log has; the others do not count.
MAX_FILES = 10_000


def file_names(folder: Path) -> Iterator[str]:
    """Names of the regular files of a folder, in any order, one after the other: it may have very many."""
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.is_file():
                yield entry.name


def folder_files(folder: Path) -> list[Path]:
    """Return the regular files of a folder, by their names; those of folders in it are not looked at."""
    return [folder / name for name in nsmallest(MAX_FILES, file_names(folder))]


def folder_size(folder: Path) -> int:
    """Return the size of all its files [bytes]."""
    return sum(file.stat().st_size for file in folder_files(folder))


def folder_sha256(folder: Path) -> str:
    """Return a hash of the names and of the hashes of its files, hexadecimal."""
    digest = hashlib.sha256()
    for file in folder_files(folder):
        with file.open("rb") as stream:
            digest.update(f"{file.name}\0{hashlib.file_digest(stream, 'sha256').hexdigest()}\n".encode())
    return digest.hexdigest()


#: Reads a part of a log, see `KeptChannels`.
Cut = Callable[[float, float, float], "KeptChannels"]
#: What stays in memory: all channels of most logs [bytes].
KEPT_BYTES = 48 << 20


@dataclass(slots=True)
class KeptChannels(MadeChannels):
    """Channels by name, the first of which are kept."""

    limit: int = KEPT_BYTES  # [bytes]
    cut: Cut | None = None  # Reads a part of the log
    change: Callable[[Channel], Channel] = lambda channel: channel
    _makers: dict[str, Callable[[], Channel]] = field(default_factory=dict)
    _stored: dict[str, Channel] = field(default_factory=dict)
    _array_bytes: dict[int, int] = field(default_factory=dict)
    _span_s: tuple[float, float] = (inf, -inf)

    def put(self, channel: Channel, make: Callable[[], Channel]) -> None:
        """Add a channel, or put it in the place of another."""
        self._stored.pop(channel.name, None)
        self._makers[channel.name] = make
        if channel.time_s.size:
            first, last = self._span_s
            self._span_s = min(first, float(channel.time_s[0])), max(last, float(channel.time_s[-1]))
        # channels of one clock share its array
        arrays = {id(array): array.nbytes for array in (channel.time_s, channel.values)}
        if sum((self._array_bytes | arrays).values()) <= self.limit:
            self._array_bytes |= arrays
            self._stored[channel.name] = channel

    def finished(self) -> Mapping[str, Channel]:
        """Return the channels: as a dictionary when all of them are kept."""
        if len(self._stored) < len(self._makers):
            return self
        return {name: self._stored[name] for name in self._makers}

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last stamp over all channels [s]."""
        first, last = self._span_s
        return (first, last) if first <= last else (0.0, 0.0)

    def part(self, start_s: float, end_s: float, step_s: float = 0.0) -> MadeChannels:
        """Return the channels of a part of the log, all of it where it cannot be cut."""
        if self.cut is None:
            return self
        result = self.cut(start_s, end_s, step_s)
        result._span_s, result.change = self._span_s, self.change
        return result

    def changed(self, change: Callable[[Channel], Channel]) -> MadeChannels:
        """Return the same channels, each changed when it is made."""
        return replace(self, change=change)

    def __getitem__(self, name: str) -> Channel:
        channel = self._stored.get(name)
        return self.change(self._makers[name]() if channel is None else channel)

    def __contains__(self, name: object) -> bool:
        return name in self._makers

    def __iter__(self) -> Iterator[str]:
        return iter(self._makers)

    def __len__(self) -> int:
        return len(self._makers)


#: Bytes of a file's start that `LogFormat.sniff` is given.
HEAD_BYTES = 65536


class ReadOptions(msgspec.Struct, frozen=True):
    """What a reader receives besides the file."""

    channel_map: str | os.PathLike[str] | None = None
    max_bytes: int = 1 << 30  # Largest file that is read, which bounds what its content may become


def advised(advice: Mapping[str, Any], of_channel: Callable[[str], tuple[str, ...]]) -> dict[str, Any]:
    """Fields of a `LogFormat` that advise: a table's, whose `all` is on all channels, and what is on one."""
    of_all = tuple(advice["all"])
    others = {name: words for name, words in advice.items() if name != "all"}
    return {"advice": lambda channel: of_channel(channel) if channel else of_all, **others}


def begins_with(*magic: bytes) -> Callable[[bytes, Path], bool]:
    """Return the `LogFormat.sniff` of a format whose files begin with some bytes, or others."""
    return lambda head, _file: head.startswith(magic)


class FolderParts(msgspec.Struct, frozen=True):
    """Files of a folder that are no logs themselves."""

    members: frozenset[str] = frozenset()
    derived: frozenset[str] = frozenset()


class LogFormat(msgspec.Struct, frozen=True):
    """A format of logs, one row of the table in `eivor.logs.read`."""

    name: str  # The word of `Recording.format`
    label: str
    sniff: Callable[[bytes, Path], bool]
    read: Callable[[Path, ReadOptions], Recording]
    is_read: bool = True
    takes_map: bool = False
    advice: Callable[[str], tuple[str, ...]] = lambda _channel: ()  # What to log, of all or of a channel
    setpoints: str = ""  # Sentence that names the setpoints and commands to log
    sweeps: str = ""  # The autopilot's mode that injects sweeps, in words
    faster: str = ""  # What makes the autopilot log faster, in words
    endings: tuple[str, ...] = ()
    parts: Callable[[Path], FolderParts] = lambda _folder: FolderParts()  # Of a folder; none of most formats


#: A setpoint that is silent for longer than this, and than five of its steps, is not in force [s].
SILENCE_S = 1.0


def silenced(channel: Channel, end_s: float, inactive: list[str] | None = None) -> Channel:
    """Return the channel with NaN where its topic falls silent, and name it; a setpoint outlives no topic."""
    limit = SILENCE_S
    if channel.time_s.size > 1:
        limit = max(limit, 5.0 * float(np.median(np.diff(channel.time_s))))
    following = np.append(channel.time_s[1:], end_s)
    # a millisecond more, or the sample that is put in meets the next one
    last = np.flatnonzero((following - channel.time_s > limit + 1e-3) & np.isfinite(channel.values))
    if last.size and inactive is not None:
        inactive.append(channel.name)
    time = np.insert(channel.time_s, last + 1, channel.time_s[last] + limit)
    values = np.insert(channel.values, last + 1, np.nan)
    return replace(channel, time_s=time, values=values)


Source = TypeVar("Source")
#: Another source comes before the preferred one when it was logged so many times as often.
MUCH_MORE = 1.5


#: Words of the readers of all formats.
LOG_TABLES = package_tables("eivor.logs", "tables.toml")


def by_number(tables: Mapping[str, Any], *names: str) -> Iterator[dict[float, str]]:
    """Tables of words whose keys are numbers."""
    return ({float(number): word for number, word in tables[name].items()} for name in names)


def channel_sources(
    tables: Mapping[str, Any], kind: Callable[..., Source]
) -> Mapping[str, tuple[Source, ...]]:
    """Sources of each channel, the preferred one first."""
    return {name: tuple(kind(**row) for row in rows) for name, rows in tables["channels"].items()}


def looked_for(
    tables: Mapping[str, Any],
    sources: Mapping[str, tuple[Source, ...]],
    label: Callable[[Source], str] = attrgetter("label"),
) -> Mapping[str, tuple[str, ...]]:
    """Where each channel is looked for: labels of its sources, and what tables say of others."""
    of_sources = {name: tuple(map(label, every)) for name, every in sources.items()}
    return of_sources | {name: tuple(texts) for name, texts in tables.get("looked_for", {}).items()}


def in_preference(
    sources: Mapping[str, tuple[Source, ...]], by_rate: Sequence[str], count: Callable[[Source], int]
) -> Iterator[tuple[str, Source]]:
    """Sources of channels in their order; of some channels first the one that was logged much more often."""
    for name, candidates in sources.items():
        busiest = max(candidates, key=count)
        first = next((source for source in candidates if count(source)), busiest)
        much_more = name in by_rate and count(busiest) > MUCH_MORE * count(first)
        others = (source for source in candidates if source is not busiest)
        yield from ((name, source) for source in ((busiest, *others) if much_more else candidates))


def held_at(times: Series, values: np.ndarray, stamp: Float[np.ndarray, " m"], initial: float) -> np.ndarray:
    """Values in force at `stamp`, each set at one of `times`; `initial` before the first of these."""
    order = np.argsort(times, kind="stable")
    in_force = np.concatenate([np.full(1, initial, dtype=values.dtype), values[order]])
    return np.asarray(in_force[np.searchsorted(times[order], stamp, side="right")])


def logged_channel(name: str, time_s: Series, values: Series, source: str, **options: Any) -> Channel:
    """Channel with the unit of its name, held where its name is that of what is held; see `clean_channel`."""
    unit, held = unit_of(name), held_by_default(name)
    return clean_channel(name, time_s, values, unit, source=source, held=held, **options)


#: A column has a clock of its own where at least this share of the steps between its values skips rows. What
#: is lost now and then skips fewer, and a setpoint that is not in force for a while skips many rows at once.
SKIPPING_SHARE = 0.1
#: Fewer values carry no information about a clock.
FEWEST_VALUES = 10
#: A column at even stamps repeats the values of a slower logger where there are so many runs of equal values,
#: and this share of them is about as long as their mean. Rounded values repeat in runs of any length; what
#: changes more rarely than this steps by itself [s].
FEWEST_RUNS, ALIKE_SHARE, ALIKE, RAREST_S = 30, 0.9, (0.7, 1.4), 0.25
#: Runs longer than so many medians are constant values.
CONSTANT_RUN = 3.0
#: Stamps are even where their distances, pauses left out, spread by less than this share of the median.
EVEN_SHARE, PAUSE = 0.03, 3.0


def on_channel_clock(channel: Channel) -> Channel:
    """Return the channel at the rows that it has values of its own in, where these are not all rows."""
    finite = np.isfinite(channel.values)
    if finite.all():
        return _without_repeats(channel)
    rows = np.flatnonzero(finite)
    if rows.size < FEWEST_VALUES or np.mean(np.diff(rows) > 1) < SKIPPING_SHARE:
        return channel
    quality = replace(channel.quality, missing_values=0)
    on_own = replace(channel, time_s=channel.time_s[finite], values=channel.values[finite], quality=quality)
    return silenced(on_own, float(channel.time_s[-1])) if channel.held else on_own


def _without_repeats(channel: Channel) -> Channel:
    """The channel at the stamps of a slower logger whose values fill the rows between; else as it is."""
    starts = np.flatnonzero(np.diff(channel.values, prepend=np.nan) != 0.0)
    if starts.size < FEWEST_RUNS or starts.size > ALIKE[0] * channel.values.size:  # usual runs are shorter
        return channel
    steps = np.diff(channel.time_s)
    step_s = float(np.median(steps))
    if np.std(steps[steps <= PAUSE * step_s]) > EVEN_SHARE * step_s:
        return channel
    lengths = np.diff(starts, append=channel.values.size)
    usual = float(lengths[lengths <= CONSTANT_RUN * np.median(lengths)].mean())
    alike = (lengths >= ALIKE[0] * usual) & (lengths <= ALIKE[1] * usual)
    if not 1.0 / ALIKE[0] <= usual <= RAREST_S / step_s or alike.mean() < ALIKE_SHARE:
        return channel
    times = np.maximum(np.rint(lengths / usual), 1.0).astype(np.int64)  # of a value that was logged again
    again = np.arange(times.sum()) - np.repeat(np.cumsum(times) - times, times)
    rows = np.repeat(starts, times) + again * np.repeat(lengths, times) // np.repeat(times, times)
    time_s = channel.time_s[rows]
    if np.ptp(lengths[alike]) == 1:  # of a rate that the rows' is no multiple of
        time_s = on_lines(time_s, np.inf)
    return replace(channel, time_s=time_s, values=channel.values[rows])


#: Stamps further than this from the log's others are damaged [s].
MAX_SPAN_S = 1e6
#: A stamp that is ahead of both its neighbours by so much is damaged, not the ones after it [s].
HORIZON_S = 1.0


def believable(time_s: Series) -> Bool[np.ndarray, " n"]:
    """Mask of plausible stamps: within the span of a log, and not far ahead of both neighbours."""
    ends_fit = bool(np.all(np.abs(time_s[:1]) <= MAX_SPAN_S) and np.all(np.abs(time_s[-1:]) <= MAX_SPAN_S))
    if ends_fit and np.all(time_s[1:] >= time_s[:-1]):
        return np.ones(time_s.size, dtype=np.bool_)
    usable = np.abs(time_s) <= MAX_SPAN_S
    usable[:-1][:1] &= time_s[:-1][:1] - time_s[1:][:1] <= HORIZON_S
    previous, current, following = time_s[:-2], time_s[1:-1], time_s[2:]
    usable[1:-1] &= (current - np.maximum(previous, following) <= HORIZON_S) | (previous > following)
    return usable


#: Unit as written in a map: its SI unit, and how many of that one of it is.
UNITS: Mapping[str, tuple[str, float]] = {
    unit: (si_unit, factor)
    for si_unit, units in LOG_TABLES["units"].items()
    for unit, factor in units.items()
}
TIME_UNITS: Mapping[str, float] = LOG_TABLES["time_units"]


def unit_fits(channel: CanonicalChannel, si_unit: str) -> bool:
    """Say whether a quantity of `si_unit` can be the channel."""
    return si_unit == channel.unit or channel.free_unit
