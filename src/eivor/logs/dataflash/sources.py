"""Sources of DataFlash channels: estimators, origin and which message is read."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime

import numpy as np

from eivor.logs import common
from eivor.logs.dataflash.messages import Messages, rows_of
from eivor.signals.channels import CurveSide
from eivor.signals.recording import Channel, Finding, LogOrigin, utc_time
from eivor.strict_toml import package_tables
from eivor.tools import Bool, Float

#: What the firmware says of itself when a log begins: its name and version, the board's id, the frame.
_FIRMWARE = re.compile(r"(?:APM:|Ardu)\w+ V\d\S*")
_BOARD = re.compile(r"\S+ ((?:[0-9A-F]{8} ){2}[0-9A-F]{8})")
_FRAME = re.compile(r"Frame: (\S.*)")
#: 1980-01-06 in seconds since 1970, seconds of a week, and by how many GPS is ahead of UTC since 2017.
GPS_EPOCH_S, WEEK_S, LEAP_S = 315_964_800.0, 604_800.0, 18.0


def dataflash_origin(tables: Mapping[str, Messages], parameters: Mapping[str, float]) -> LogOrigin:
    """Origin of a log."""
    texts = [text for (text,) in rows_of(tables, "MSG", "Message")]
    serial = parameters.get("BRD_SERIAL_NUM", 0.0)
    frame = _first(_FRAME, texts)
    return LogOrigin(
        board=f"{serial:.0f}" if serial > 0.0 else _first(_BOARD, texts),
        airframe=f"ArduPilot {frame}" if frame else "",
        firmware=_first(_FIRMWARE, texts),
        start=_start(tables.get("GPS")),
    )


def _first(pattern: re.Pattern[str], texts: list[str]) -> str:
    """Group of the pattern in the first text that matches, or all of that text."""
    results = (pattern.match(text) for text in texts if text.isprintable())
    return next((match[match.lastindex or 0].strip() for match in results if match), "")


def _start(table: Messages | None) -> datetime | None:
    """Time of the log's time 0 by satellites; None while there are none."""
    if table is None or not table.has("GMS", "GWk") or not table.clock:
        return None
    weeks, milliseconds = table.values("GWk"), table.values("GMS")
    dated = weeks > 0.0
    if not dated.any():
        return None
    utc = GPS_EPOCH_S + weeks * WEEK_S + milliseconds * 1e-3 - LEAP_S
    return utc_time(float(np.median((utc - table.time_s())[dated])))


#: Message of each estimator's first core, the preferred one first.
ESTIMATORS = ("XKF1", "NKF1", "EKF1")
#: Columns of CTUN with the climb rate by barometer and accelerometer, of firmware before the EKF's.
CLIMBS = ("CRt", "CRate")
#: Old firmware logs throttles in thousandths, as floating-point numbers too: no share is above this.
THOUSANDTH, LARGEST_SHARE = 0.001, 5.0
#: Messages that the position controller writes while it is in force.
CONTROLLERS = ("PSCN", "PSCE", "PSC", "PSCD", "PSCZ")


@dataclass(frozen=True, slots=True)
class MessageSource:
    """One place where a channel may be."""

    message: str
    column: str
    factor: float = 1.0
    old_factor: float = 1.0
    zero_is_absent: bool = False
    needs_height_loop: bool = False

    @property
    def estimated(self) -> bool:
        return self.message in ESTIMATORS or self.column in CLIMBS

    @property
    def is_setpoint(self) -> bool:
        """Whether it is in force only while it is logged."""
        return self.message in CONTROLLERS

    def factor_in(self, table: Messages) -> float:
        """Return what one of the column's unit is in the channel's, by the firmware that wrote a log."""
        stored = table.layout.fields[self.column]
        is_old = table.clock == "TimeMS" or (stored.kind.kind in "iu" and stored.factor == 1.0)
        if self.old_factor == THOUSANDTH and not is_old:
            is_old = bool(np.nanmax(table.values(self.column), initial=0.0) > LARGEST_SHARE)
        return self.factor * (self.old_factor if is_old else 1.0)

    @property
    def label(self) -> str:
        return f"{'-' if self.factor < 0.0 else ''}{self.message}.{self.column}"


TABLES = package_tables("eivor.logs.dataflash")
CHANNEL_SOURCES = common.channel_sources(TABLES, MessageSource)
#: How often each message is logged, and what raises it.
RATES: Mapping[str, str] = TABLES["rates"]

#: Channels whose source is the one that was logged most often, when much more often.
CHOSEN_BY_RATE = tuple(f"angular_rate_{axis}" for axis in "xyz")

#: Angles of the attitude in ATT [deg], turned about one after the other from the last to the first.
ATTITUDE = ("Roll", "Pitch", "Yaw")

#: Modes in which sticks set the attitude or the rates.
STICKS: Mapping[str, Sequence[int]] = TABLES["sticks"]
#: In system identification sticks set throttle and attitude as in stabilize, while the sweep is on an axis up
#: to this one; sweeps of position and velocity, behind it, have a loop for all.
SWEEP_MODE = 25
LAST_STICK_AXIS = 13
#: Modes without a loop that holds the height: stabilize, acro, drift and flip.
WITHOUT_HEIGHT_MODES = (0, 1, 11, 14)

#: Events: disarmed and landed, and what ends either.
LANDED_EVENTS = {11: 1.0, 18: 1.0, 28: 0.0}

#: Messages that say what holds until the next of them.
STATES = frozenset({"MODE", "EV", "ARM", "SIDS", "MSG", "VER", "PARM"})
NEEDED = frozenset(
    {source.message for sources in CHANNEL_SOURCES.values() for source in sources}
    | {"NKF6", "XKF6", "EKF6", "NKF4", "XKF4", "XKFS", "ATT", "RCOU", "RCIN", "MOTB", "ESC"}
    | {"MODE", "EV", "ARM", "MSG", "VER", "PARM", "SIDD", "SIDS", "GPS"}
)

LOOKED_FOR = common.looked_for(TABLES, CHANNEL_SOURCES)

#: ATT.AEKF and AHRS_EKF_TYPE of each estimator.
_TYPES = {3: "XKF1", 2: "NKF1", 1: "EKF1"}
#: Where the core in use is logged, by estimator.
_PRIMARY = {"XKF1": ("XKFS", "XKF4"), "NKF1": ("NKF4",), "EKF1": ()}


def choose_estimator(
    tables: dict[str, Messages], parameters: Mapping[str, float], findings: list[Finding]
) -> None:
    """Keep the estimator that flew, under the name of its first core."""
    logged = [name for name in ESTIMATORS if name in tables]
    if not logged:
        return
    estimator = _most_common(tables.get("ATT"), "AEKF") or int(parameters.get("AHRS_EKF_TYPE", 0.0))
    chosen = next((name for name in logged if name == _TYPES.get(estimator)), logged[0])
    for name in set(logged) - {chosen}:
        del tables[name]
    core = _core(tables, chosen, findings)
    table = tables[chosen]
    if table.has("C"):
        cores = table.stored("C")
        selected = core if np.any(cores == core) else int(cores.min())
        tables[chosen] = table.where(cores == selected)
    elif core == 1:
        tables[chosen] = tables.get(f"{chosen[:3]}6", table)


def _core(tables: Mapping[str, Messages], chosen: str, findings: list[Finding]) -> int:
    """Number of the core that was in use for most of the log; 0 where it is not identified."""
    for name in _PRIMARY[chosen]:
        table = tables.get(name)
        if table is None or not table.has("PI"):
            continue
        core = _most_common(table, "PI")
        unused = float(np.mean(table.stored("PI") != core))
        findings += common.noted("estimator_core", unused, table=name, core=core)
        return max(core, 0)
    return 0


def _most_common(table: Messages | None, column: str) -> int:
    if table is None or not table.has(column) or not table.count:
        return 0
    values, counts = np.unique(table.stored(column), return_counts=True)
    return int(values[np.argmax(counts)])


#: Of stamps that take more, those of one table at a time are kept [bytes].
LONG_BYTES = 1 << 23


@dataclass(slots=True)
class MessageReading:
    """Channels built from messages."""

    tables: Mapping[str, Messages]
    parameters: Mapping[str, float]
    findings: list[Finding]
    start_s: float
    end_s: float
    channels: common.KeptChannels = field(default_factory=common.KeptChannels)
    heads: dict[str, Channel] = field(default_factory=dict)  # The same without their arrays
    profiles: dict[str, common.ChannelProfile] = field(default_factory=dict)
    inactive_setpoints: list[str] = field(default_factory=list)  # Setpoints that are not in force throughout
    _clocks: dict[tuple[int, float], tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)

    @classmethod
    def from_tables(
        cls, tables: Mapping[str, Messages], parameters: Mapping[str, float], findings: list[Finding]
    ) -> MessageReading:
        ends = [
            (time.min(), time.max()) for table in tables.values() if table.clock for time in [table.time_s()]
        ]
        start = min((float(first) for first, _ in ends), default=0.0)
        return cls(tables, parameters, findings, start, max((float(last) for _, last in ends), default=0.0))

    def part(self, start_s: float, end_s: float, step_s: float) -> MessageReading:
        """Return a reading of the messages of a part of the log, on the same clock."""
        tables = {}
        for name, table in self.tables.items():
            if not table.clock or name in STATES:
                tables[name] = table
                continue
            time_s = self.time_s(table)
            chosen = (time_s >= start_s) & (time_s <= end_s)
            rows = np.flatnonzero(chosen) if chosen.any() else np.searchsorted(time_s, [start_s, start_s])
            # what is in force at the beginning, and what comes next: silence is no end of the log
            neighbours = [max(int(rows[0]) - 1, 0), min(int(rows[-1]) + 1, time_s.size - 1)]
            if step_s > 0.0 and time_s.size > 1:
                every = int(step_s * (time_s.size - 1) / max(float(time_s[-1] - time_s[0]), step_s))
                chosen &= np.arange(time_s.size) % max(every, 1) == 0
            chosen[neighbours] = True
            tables[name] = table.where(chosen)
        self.forget_clocks()
        return MessageReading(tables, self.parameters, [], self.start_s, self.end_s)

    def table(self, name: str, *columns: str) -> Messages | None:
        """Messages of a type; None without stamps, or without one of some columns."""
        table = self.tables.get(name)
        return table if table is not None and table.clock and table.has(*columns) else None

    def forget_clocks(self) -> None:
        """Drop the cached stamps of messages."""
        self._clocks.clear()

    def time_s(self, table: Messages, delay_s: float = 0.0) -> Float[np.ndarray, " n"]:
        """Stamps of messages on the recording's clock, less a delay [s]: one array for all in a row."""
        clock_key = (id(table.offsets), delay_s)
        if clock_key not in self._clocks:
            stamps = table.time_s()
            stamps -= self.start_s + delay_s
            if stamps.nbytes > LONG_BYTES:
                self._clocks.clear()
            # the places are kept too: what is alive keeps its identity
            self._clocks[clock_key] = (table.offsets, stamps)
        return self._clocks[clock_key][1]

    def add(
        self,
        name: str,
        table: Messages,
        values: Float[np.ndarray, " n"] | Callable[[], Float[np.ndarray, " n"]],
        label: str,
        curve_side: CurveSide = CurveSide.UNKNOWN,
        *,
        estimated: bool = False,
        delay_s: float = 0.0,
        is_setpoint: bool = False,
    ) -> None:
        """Add a channel, when it has a value; its values are made again where they are not kept."""

        def build(inactive: list[str] | None = None) -> Channel:
            channel = common.logged_channel(
                name,
                self.time_s(table, delay_s),
                values() if callable(values) else values,
                label,
                estimated=estimated,
                delay_s=delay_s,
                curve_side=curve_side,
            )
            is_valid = is_setpoint and np.isfinite(channel.values).any()
            return common.silenced(channel, self.end_s - self.start_s, inactive) if is_valid else channel

        channel = build(self.inactive_setpoints)
        if np.isfinite(channel.values).any():
            self.put(channel, build)

    def put(self, channel: Channel, make: Callable[[], Channel]) -> None:
        """Add a channel, or put it in the place of another."""
        self.channels.put(channel, make)
        nothing = np.empty(0)
        self.heads[channel.name] = replace(channel, time_s=nothing, values=nothing)
        self.profiles[channel.name] = common.look(channel)

    def with_sweeps(self, modes: Sequence[int]) -> Sequence[int]:
        """Modes of sticks, and system identification where its sweeps leave throttle and attitude to them."""
        selected = [axis for (axis,) in rows_of(self.tables, "SIDS", "Ax")]
        selected = selected or [self.parameters.get("SID_AXIS", 0.0)]
        return (*modes, SWEEP_MODE) if all(0 < axis <= LAST_STICK_AXIS for axis in selected) else modes

    def landed_at(self, table: Messages) -> Bool[np.ndarray, " n"]:
        """Whether the vehicle was on the ground at each message, by its events; no where they do not say."""
        landed = [number for number, value in LANDED_EVENTS.items() if value > 0.0]
        events = self.table("EV", "Id")
        if events is not None:
            events = events.where(np.isin(events.values("Id"), list(LANDED_EVENTS)))
        return self._state_at(table, events, "Id", landed, initial=False)

    def modes_at(
        self, table: Messages, modes: Sequence[int], *, initial: bool = False
    ) -> Bool[np.ndarray, " n"]:
        """Whether the vehicle was in one of some modes at each message, `initial` ahead of the first mode."""
        return self._state_at(table, self.table("MODE", "ModeNum"), "ModeNum", modes, initial=initial)

    def _state_at(
        self, table: Messages, states: Messages | None, column: str, holding: Sequence[int], *, initial: bool
    ) -> Bool[np.ndarray, " n"]:
        if states is None:
            return np.full(table.count, initial)
        holds = np.isin(states.values(column), holding)
        return common.held_at(self.time_s(states), holds, self.time_s(table), initial)
