"""Reader of Crazyflie microSD logs."""

from __future__ import annotations

import struct
import zlib
from array import array
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from eivor.errors import ChannelMapError, CorruptLogError, EmptyLogError
from eivor.logs import channel_map as maps
from eivor.logs import common
from eivor.logs.mapping import channels_by_clock, delay_findings, fitted_rules, listed, looked_for
from eivor.signals.channels import held_by_default
from eivor.signals.recording import LARGEST_VALUE, Channel, Finding, Frame, LogOrigin, Recording
from eivor.strict_toml import package_tables
from eivor.tools import Float

#: Value of a motor's duty cycle, and of the controllers' thrust, at full power.
FULL_POWER = 65535.0
#: Cutoffs of the low-passes behind which the sensors are [Hz].
ACCELEROMETER_HZ = 30.0
GYRO_HZ = 80.0

#: A quaternion in 32 bits, and the names of its parts once it is unpacked.
PACKED_QUATERNION = "stateEstimateZ.quat"
UNPACKED = tuple(f"{PACKED_QUATERNION}.{part}" for part in "xyzw")

#: Setpoints of the velocity, which old firmware overwrites with its feedback, and of the height beside them.
VELOCITY_SETPOINTS = {"ctrltarget.vz": "ctrltarget.z", "ctrltargetZ.vz": "ctrltargetZ.z"}


@dataclass(frozen=True, slots=True)
class VariableSource:
    """One place where a quantity may be."""

    quantity: str
    rules: tuple[maps.ChannelRule, ...]
    zero_is_absent: bool = True

    @property
    def columns(self) -> tuple[str, ...]:
        return tuple(maps.columns_of(self.rules))


#: Units of variables in SI units.
_UNITS = {"": 1.0, "milli": 1e-3, "power": 1.0 / FULL_POWER} | {
    unit: common.UNITS[unit][1] for unit in ("g", "deg", "rpm")
}


def _source(row: Mapping[str, Any]) -> VariableSource:
    name = row["channel"]
    rule = maps.ChannelRule(
        name,
        maps.Expression.of_column(row["variable"]),
        row.get("sign", 1.0) * _UNITS[row.get("unit", "")],
        held=held_by_default(name),
        estimated=row.get("estimated", False),
        delay_s=common.low_pass_delay_s(row.get("low_pass_hz", 0.0)),
    )
    return VariableSource(row.get("quantity", name), (rule,), row.get("zero_is_absent", True))


def _quaternion(columns: Sequence[str]) -> VariableSource:
    texts = (PACKED_QUATERNION if column in UNPACKED else column for column in columns)
    expressions = (maps.Expression(text, (name,)) for text, name in zip(texts, columns, strict=True))
    rules = (
        maps.ChannelRule(f"attitude_{part}", item) for part, item in zip("wxyz", expressions, strict=True)
    )
    return VariableSource("attitude", tuple(rules))


def _angles(group: str) -> VariableSource:
    signs = {"roll": "", "pitch": "-", "yaw": ""}
    halves = {angle: f'"{group}.{angle}" * {sign}{np.pi / 360.0!r}' for angle, sign in signs.items()}
    rules = []
    for part, text in _TABLES["angles"].items():
        parsed = maps.parse_expression(text.format(**halves), group)
        words = f"{group}.roll, .pitch and .yaw"
        rules.append(maps.ChannelRule(f"attitude_{part}", replace(parsed, text=words)))
    return VariableSource("attitude", tuple(rules))


def _tilt(group: str) -> VariableSource:
    columns = (f"{group}.roll", f"{group}.pitch")
    expression = replace(
        maps.tilt_of_angles(common.UNITS["deg"][1], *columns), text=f"{group}.roll and .pitch"
    )
    rule = maps.ChannelRule("cos_tilt", expression, angles=columns, angle_unit="deg")
    return VariableSource("attitude", (rule,))


_MAKERS: Mapping[str, Callable[[Any], VariableSource]] = {
    "quaternion": _quaternion,
    "angles": _angles,
    "tilt": _tilt,
}

_TABLES = package_tables("eivor.logs", "crazyflie.toml")
#: All sources; of one quantity the preferred first.
SOURCES = tuple(
    next((make(row[kind]) for kind, make in _MAKERS.items() if kind in row), None) or _source(row)
    for row in _TABLES["sources"]
)

LOOKED_FOR = {
    name: tuple(rule.expression.text for source in SOURCES for rule in source.rules if rule.name == name)
    for name in dict.fromkeys(rule.name for source in SOURCES for rule in source.rules)
}


def filter_findings(channels: Iterable[Channel]) -> list[Finding]:
    """Finding on the low-pass delays that were subtracted from stamps."""
    selected = []
    for cutoff in (ACCELEROMETER_HZ, GYRO_HZ):
        delay_s = common.low_pass_delay_s(cutoff)
        if late := [channel.source for channel in channels if channel.delay_s == delay_s]:
            selected.append(f"{', '.join(late)}: {1e3 * delay_s:.2g} ms (low-pass of {cutoff:g} Hz)")
    return common.noted("firmware_delays", "; ".join(selected))


def unpacked_quaternion(packed: Float[np.ndarray, " n"]) -> dict[str, Float[np.ndarray, " n"]]:
    """Return the parts of quaternions in 32 bits, by the names of `UNPACKED`."""
    sound = (packed > 0.0) & (packed < 2.0**32)
    bits = np.where(sound, packed, 0.0).astype(np.uint32)
    largest = bits >> 30
    parts = np.zeros((4, bits.size))
    for part in (3, 2, 1, 0):
        is_stored = largest != part
        size = np.sqrt(0.5) * (bits & 511) / 511.0
        parts[part] = np.where(is_stored, np.where(bits & 512, -size, size), 0.0)
        bits = np.where(is_stored, bits >> 10, bits)
    remainder = np.sqrt(np.maximum(1.0 - np.sum(parts**2, axis=0), 0.0))
    parts[largest, np.arange(bits.size)] = remainder
    parts[:, ~sound] = np.nan
    return dict(zip(UNPACKED, parts, strict=True))


MAGIC = b"\xbc"
#: Type of a stamp and its unit [s], by version.
STAMPS: Mapping[int, tuple[str, float]] = {1: ("<u4", 1e-3), 2: ("<u8", 1e-6)}
TYPES: Mapping[str, str] = {
    **{letter: f"<{letter}" for letter in "bBhHefdiIqQ"},
    "?": "<u1",
    "l": "<i4",
    "L": "<u4",
}

#: Bounds that no real log comes near.
MAX_EVENT_TYPES = 256
MAX_VARIABLES = 4096
MAX_NAME_BYTES = 255


@dataclass(frozen=True, slots=True)
class EventType:
    """A type of events."""

    number: int
    name: str
    variables: tuple[str, ...]
    record: np.dtype[np.void]


@dataclass(frozen=True, slots=True)
class Header:
    """The head of a log."""

    types: tuple[EventType, ...]
    tick_s: float  # Unit of the stamps [s]
    length: int  # [bytes]


def parse_header(data: bytes, name: str) -> Header:
    """Read the head of a log."""
    cursor = _Cursor(data, name, len(MAGIC))
    version, count = cursor.number(), cursor.number()
    if version not in STAMPS:
        expected = "a Crazyflie microSD log of version 1 or 2"
        remedy = "The file is damaged, or newer than this release; try a newer Eivor."
        raise CorruptLogError(expected, f"'{name}' of version {version}", remedy)
    if count > MAX_EVENT_TYPES:
        raise cursor.corrupt(f"announces {count} types of events (at most {MAX_EVENT_TYPES} are read)")
    stamp, tick_s = STAMPS[version]
    types = []
    for _ in range(count):
        types.append(_event_type(cursor, stamp))
        if sum(len(kind.variables) for kind in types) > MAX_VARIABLES:
            raise cursor.corrupt(f"announces more than {MAX_VARIABLES} variables")
    numbers = [kind.number for kind in types]
    if len(set(numbers)) < len(numbers):
        raise cursor.corrupt("gives the same id to two types of events")
    return Header(tuple(types), tick_s, cursor.offset)


def _event_type(cursor: _Cursor, stamp: str) -> EventType:
    number, name, count = cursor.number(), cursor.text(), cursor.number()
    if count > MAX_VARIABLES:
        raise cursor.corrupt(f"announces {count} variables of one event (at most {MAX_VARIABLES} are read)")
    variables, fields = [], [("id", "<u2"), ("stamp", stamp)]
    for index in range(count):
        variable, _, letter = cursor.text().rpartition("(")
        if not variable or letter[:-1] not in TYPES or letter[-1:] != ")":
            raise cursor.corrupt(f"names a variable {variable + '(' + letter!r}, whose type is not known")
        variables.append(variable)
        fields.append((str(index), TYPES[letter[:-1]]))
    return EventType(number, name, tuple(variables), np.dtype(fields))


@dataclass(slots=True)
class _Cursor:
    data: bytes
    name: str
    offset: int

    def number(self) -> int:
        if self.offset + 2 > len(self.data):
            raise self.corrupt("ends in its head")
        value: int = struct.unpack_from("<H", self.data, self.offset)[0]
        self.offset += 2
        return value

    def text(self) -> str:
        """Read a name, in which only printable letters of ASCII stay as they are."""
        end = self.data.find(b"\x00", self.offset, self.offset + MAX_NAME_BYTES + 1)
        if end < 0:
            cut = self.offset + MAX_NAME_BYTES >= len(self.data)
            raise self.corrupt(
                "ends in its head" if cut else f"has a name of more than {MAX_NAME_BYTES} bytes"
            )
        raw = self.data[self.offset : end]
        self.offset = end + 1
        return "".join(chr(byte) if 32 <= byte < 127 else f"\\x{byte:02x}" for byte in raw)

    def corrupt(self, reason: str) -> CorruptLogError:
        expected = "a Crazyflie microSD log with a sound head"
        received = f"'{self.name}', which {reason}"
        return CorruptLogError(expected, received, "The file is cut or damaged; copy it from the card again.")


#: Variables that make each channel, as config.txt names them: the preferred ones of channels that are needed.
_NOT_NEEDED = {"position_x", "position_y", "velocity_x", "velocity_y", "specific_force_z"}
TO_LOG = {
    **{
        name: texts[0]
        for name, texts in LOOKED_FOR.items()
        if name not in _NOT_NEEDED and not name.startswith("feedback_")
    },
    "input": "motor.m1 to motor.m4",
    "cos_tilt": "stateEstimate.qw, .qx, .qy and .qz",
}


def _advice(channel: str) -> tuple[str, ...]:
    if channel not in TO_LOG:
        return ()
    sentence = f"Add {TO_LOG[channel]} to config.txt on the card."
    return (sentence, *_TABLES["advice"]["all"][:1]) if channel == "velocity_z" else (sentence,)


CHECKSUM_BYTES = 4
#: Records of one type in a row after which they are read in blocks.
RUN = 32
BLOCK = 4096
#: How many records must follow each other where the walk goes on, how long after the log's start they may be
#: [s], and how far it looks, at how much a time [bytes].
CHAIN = 4
LONGEST_LOG_S = 86400.0
MAX_SEARCH_BYTES = 1 << 22
SEARCH_BLOCK = 512

CLOCK = "timestamp"


@dataclass(frozen=True)
class Event:
    """The records of one type, whose variables are converted when they are requested."""

    name: str
    variables: tuple[str, ...]
    records: np.ndarray  # shape (n,)
    time_s: Float[np.ndarray, " n"]  # Stamps from the log's start on [s]
    _values: dict[str, Float[np.ndarray, " n"]] = field(default_factory=dict)

    @cached_property
    def names(self) -> dict[str, str]:
        """The variable, or clock, that each name of a column means."""
        unpacked = UNPACKED if PACKED_QUATERNION in self.variables else ()
        names = dict.fromkeys((CLOCK, *self.variables, *unpacked))
        return {name: name for name in names} | {f"{self.name}:{name}": name for name in names}

    def has(self, columns: Sequence[str]) -> bool:
        return all(column in self.names for column in columns)

    def values(self, column: str) -> Float[np.ndarray, " n"]:
        """Return a column as logged; NaN for what nothing measures."""
        name = self.names[column]
        if name == CLOCK:
            return self.time_s
        if name not in self._values and name not in self.variables:
            self._values.update(unpacked_quaternion(self.values(PACKED_QUATERNION)))
        if name not in self._values:
            with np.errstate(invalid="ignore"):
                values = self.records[str(self.variables.index(name))].astype(np.float64)
            values[~(np.abs(values) <= LARGEST_VALUE)] = np.nan
            self._values[name] = values
        return self._values[name]

    def columns(self, names: Sequence[str]) -> common.Columns:
        clocks = frozenset(name for name in names if self.names[name] == CLOCK)
        return common.Columns({name: self.values(name) for name in names}, seconds=clocks)


def read_events(data: bytes, header: Header) -> tuple[list[Event], list[Finding]]:
    """Return the events of a log that have a record, on one clock, and what is wrong with the file."""
    body = memoryview(data)[:-CHECKSUM_BYTES]
    sound = len(data) >= header.length + CHECKSUM_BYTES and (
        zlib.crc32(body) == struct.unpack_from("<I", data, len(data) - CHECKSUM_BYTES)[0]
    )
    walk = _RecordWalk(data, header, len(body) if sound else len(data))
    findings = _damage(walk, sound)
    results = {}
    for kind in header.types:
        if positions := walk.offsets[kind.number]:
            anywhere = (len(data) - kind.record.itemsize + 1,)
            records = np.ndarray(anywhere, dtype=kind.record, buffer=data, strides=(1,))
            results[kind.number] = records[np.asarray(positions, dtype=np.int64)]
    if not results:
        return [], findings
    # the median of the stamps, which one that is damaged does not move far
    stamps = (records["stamp"] for records in results.values())
    start = min(int(np.partition(kind, kind.size // 2)[kind.size // 2]) for kind in stamps)
    times = {key: _seconds(records["stamp"], start, header.tick_s) for key, records in results.items()}
    usable = {key: common.believable(time_s) for key, time_s in times.items()}
    begins = min(float(times[key][which][0]) for key, which in usable.items() if which.any())
    dropped = sum(int((~which).sum()) for which in usable.values())
    findings += common.noted("wrong_record_stamps", dropped)
    events = [
        Event(kind.name, kind.variables, results[key][usable[key]], times[key][usable[key]] - begins)
        for kind in header.types
        if (key := kind.number) in results and usable[key].any()
    ]
    return events, findings


_id_at = struct.Struct("<H").unpack_from


class _RecordWalk:
    """Where records begin, by id, and the bytes that belong to none."""

    def __init__(self, data: bytes, header: Header, end: int) -> None:
        self.data, self.header, self.end = data, header, end
        self.sizes = sizes = {kind.number: kind.record.itemsize for kind in header.types}
        self.offsets = offsets = {number: array("q") for number in sizes}
        self.skipped = self.searched = 0
        position, run, last = header.length, 0, -1
        while position + 2 <= end:
            number = _id_at(data, position)[0]
            size = sizes.get(number)
            if size is None:
                resumed = self._next_chain(position + 1)
                if resumed is None:
                    break
                self.skipped += resumed - position
                position, run = resumed, 0
                continue
            if position + size > end:
                break
            offsets[number].append(position)
            position += size
            run = run + 1 if number == last else 0
            last = number
            if run >= RUN:  # whole records of this type, many at a time
                count = min((end - position) // size, BLOCK)
                others = np.flatnonzero(self._view("<u2", position, count, size) != number)
                stop = position + (int(others[0]) if others.size else count) * size
                offsets[number].extend(range(position, stop, size))
                position, run = stop, 0
        self.remaining = max(end - position, 0)

    def _view(self, kind: str | np.dtype[Any], position: int, count: int, step: int) -> np.ndarray:
        return np.ndarray((count,), kind, self.data, position, (step,))

    def _next_chain(self, position: int) -> int | None:
        """Position of the next chain of records; None when none is found."""
        while self.sizes and self.searched < MAX_SEARCH_BYTES and position < self.end:
            self.searched += SEARCH_BLOCK
            for candidate in self._candidates(position):
                if self._is_chain(candidate):
                    return candidate
            position += SEARCH_BLOCK
        return None

    def _candidates(self, position: int) -> list[int]:
        """Positions in a block of a known id before a plausible stamp."""
        stamp = self.header.types[0].record["stamp"]
        count = min(SEARCH_BLOCK, self.end - position - 1 - stamp.itemsize)
        if count <= 0:
            return []
        plausible = np.isin(self._view("<u2", position, count, 1), list(self.sizes))
        started = [item[0] for item in self.offsets.values() if item]
        if started:
            first = int(self._view(stamp, min(started) + 2, 1, 1)[0])
            time_s = _seconds(self._view(stamp, position + 2, count, 1), first, self.header.tick_s)
            plausible &= (time_s >= 0.0) & (time_s <= LONGEST_LOG_S)
        return (position + np.flatnonzero(plausible)).tolist()

    def _is_chain(self, position: int) -> bool:
        """Say whether several records follow each other from a place on, or up to the end."""
        for _ in range(CHAIN):
            if position + 2 > self.end:
                return position == self.end
            size = self.sizes.get(_id_at(self.data, position)[0])
            if size is None or position + size > self.end:
                return False
            position += size
        return True


def _damage(walk: _RecordWalk, sound: bool) -> list[Finding]:
    findings: list[Finding] = []
    is_another = not sound and walk.remaining == CHECKSUM_BYTES
    tail = 0 if is_another else walk.remaining
    if not sound and not is_another:
        remark = (
            f"{tail} bytes at its end, of no whole record, were left out" if tail else "no record is broken"
        )
        findings += common.noted("cut_records", remark)
    skipped = walk.skipped + (tail if sound else 0)
    return findings + common.noted("checksum", is_another) + common.noted("lost_record_bytes", skipped)


def _seconds(stamps: np.ndarray, start: int, tick_s: float) -> Float[np.ndarray, " n"]:
    """Seconds since a stamp, by the shorter way round where the counter has wrapped."""
    signed = np.dtype(f"<i{stamps.dtype.itemsize}")
    with np.errstate(over="ignore"):
        ticks = (stamps - stamps.dtype.type(start)).view(signed)
    return np.asarray(ticks.astype(np.float64) * tick_s)


#: A step of so many usual ones is a gap: three records or more are missing.
GAP = 3.5
#: Events of which so many steps are within half of the usual one are of a fixed frequency.
REGULAR_SHARE = 0.9


def _gaps(event: Event) -> str:
    """Gaps in events of a fixed frequency: how many there are, and how long they are."""
    steps = np.diff(event.time_s)
    usual = float(np.median(steps)) if steps.size >= 3 else 0.0
    is_regular = usual > 0.0 and np.mean(np.abs(steps - usual) <= 0.5 * usual) >= REGULAR_SHARE
    gaps = 1e3 * steps[steps > GAP * usual]
    if not is_regular or not gaps.size:
        return ""
    length = f"{gaps.min():.3g} to {gaps.max():.3g} ms" if gaps.size > 1 else f"{gaps[0]:.3g} ms"
    word = "gaps" if gaps.size > 1 else "gap"
    return f"'{event.name[:60]}' ({gaps.size} {word} of {length}, steps of {1e3 * usual:.3g} ms otherwise)"


NAME = "crazyflie"
_BUILT_IN = maps.ChannelMap("crazyflie", CLOCK, "s", (), Frame.Z_UP, "square", {}, "the firmware")


def read_crazyflie(file: Path, options: common.ReadOptions) -> Recording:
    """Read a Crazyflie microSD log."""
    data = file.read_bytes()
    header = parse_header(data, file.name)
    events, findings = read_events(data, header)
    if not events:
        received = f"'{file.name}' without a whole record of any (types of events: {len(header.types)})"
        remedy = "Check config.txt on the card, and end the logging before the power goes (usd.logging = 0)."
        raise EmptyLogError("a Crazyflie microSD log with records", received, remedy)
    texts = [text for event in events if (text := _gaps(event))]
    findings += common.noted("lost_records", "; ".join(texts))
    events.sort(key=lambda event: -event.time_s.size)
    if options.channel_map is None:
        chosen, columns_of = _BUILT_IN, LOOKED_FOR
        channels = _known_channels(file.name, events, findings)
    else:
        chosen = maps.load_channel_map(options.channel_map)
        columns_of = looked_for(chosen)
        channels = _map_channels(chosen, file.name, events, findings)
    return Recording(
        name=file.name,
        format=NAME,
        channels=channels,
        frame=chosen.frame,
        input_map=chosen.input_map,
        looked_for=columns_of,
        findings=(*findings, *common.channel_findings(channels)),
        origin=LogOrigin(airframe="Crazyflie"),
    )


def _known_channels(name: str, events: Sequence[Event], findings: list[Finding]) -> dict[str, Channel]:
    chosen = _choose_sources(events, findings)
    of_events = (
        (event, [rule for source, item in chosen if item is event for rule in source.rules])
        for event in events
    )
    served = ((rules, event.columns(_BUILT_IN.needed_by(rules))) for event, rules in of_events if rules)
    channels = channels_by_clock(_BUILT_IN, served, name, findings)
    used = {column for source, _ in chosen for column in source.columns}
    used |= {PACKED_QUATERNION} if used.intersection(UNPACKED) else set()
    variables = dict.fromkeys(variable for event in events for variable in event.variables)
    others = [variable for variable in variables if variable not in used]
    if not channels:
        raise EmptyLogError(
            "a Crazyflie microSD log with variables that are known (stateEstimate.vz, motor.m1, acc.z, ...)",
            f"'{name}' with {listed(list(variables)) or 'none'}",
            "Name them in a channel map (--map), or log others.",
        )
    findings += common.noted("ignored_variables", listed(others))
    findings += filter_findings(list(channels.values()))
    return channels


def _choose_sources(events: Sequence[Event], findings: list[Finding]) -> list[tuple[VariableSource, Event]]:
    """Sources that are used, each with the event that has the most records of it."""
    chosen: dict[str, tuple[VariableSource, Event]] = {}
    zeros: list[str] = []
    for source in SOURCES:
        event = next((item for item in events if item.has(source.columns)), None)
        if event is None or source.quantity in chosen:
            continue
        values = map(event.values, source.columns)
        if source.zero_is_absent and not any(np.any(np.nan_to_num(item)) for item in values):
            zeros += source.columns
            continue
        used, feedback = source, _feedback_findings(source, event)
        findings += feedback
        if feedback:
            name = "feedback_reference_velocity_z"
            used = VariableSource(name, tuple(replace(rule, name=name) for rule in source.rules))
        chosen.setdefault(used.quantity, (used, event))
    findings += common.noted("always_zero", listed(list(dict.fromkeys(zeros))))
    return list(chosen.values())


def _feedback_findings(source: VariableSource, event: Event) -> list[Finding]:
    """Doubt a velocity setpoint that is not planned: it changes while the height setpoint stands still."""
    column = source.columns[0]
    planned = VELOCITY_SETPOINTS.get(column)
    if planned is None or not event.has((planned,)):
        return []
    velocity, height = event.values(column), event.values(planned)
    changing = np.diff(velocity) != 0.0
    standing = (np.diff(height) == 0.0) & (height[1:] != 0.0)
    answers = bool(np.any(changing)) and np.mean(standing[changing]) >= 0.5
    return common.noted("feedback_setpoint", f"{column} changes while {planned}" if answers else "")


def _map_channels(
    chosen: maps.ChannelMap, name: str, events: Sequence[Event], findings: list[Finding]
) -> dict[str, Channel]:
    names = list(dict.fromkeys(column for event in events for column in event.names))
    rules: dict[int, list[maps.ChannelRule]] = {}
    for rule in fitted_rules(chosen, names, name):
        rules.setdefault(_position(rule, chosen, events, name), []).append(rule)
    served = ((items, events[position].columns(chosen.needed_by(items))) for position, items in rules.items())
    channels = channels_by_clock(chosen, served, name, findings)
    if not channels:
        expected = "a log with values"
        raise EmptyLogError(expected, f"'{name}', in which every mapped variable is empty", "Check the map.")
    findings += delay_findings(channels, chosen.origin)
    return channels


def _position(rule: maps.ChannelRule, chosen: maps.ChannelMap, events: Sequence[Event], name: str) -> int:
    """Number of the event with the most records that has all that a rule needs."""
    needed = chosen.needed_by([rule])
    for index, event in enumerate(events):
        if event.has(needed):
            return index
    expected = f"columns of one type of events for channels.{rule.name} ({chosen.origin})"
    received = f"{listed(needed)}, which no type of '{name}' has all of"
    raise ChannelMapError(expected, received, f"Take columns of one type, and '{CLOCK}' for the time.")


FORMATS = (
    common.LogFormat(
        NAME,
        "Crazyflie microSD",
        # a version of one byte follows the first one, which no text has
        lambda head, _file: head.startswith(MAGIC) and head[2:3] in (b"", b"\x00"),
        read_crazyflie,
        takes_map=True,
        **common.advised(_TABLES["advice"], _advice),
    ),
)
