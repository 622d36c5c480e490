"""The state of one reading of a DataFlash log: messages in, channels and findings out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from eivor.logs.dataflash.messages import Messages
from eivor.logs.dataflash.sources import LANDED_EVENTS, LAST_STICK_AXIS, STATES, SWEEP_MODE
from eivor.logs.findings import Look, look
from eivor.logs.kept_channels import KeptChannels
from eivor.logs.silences import silenced
from eivor.shapes import Bool, Float
from eivor.signals.canonical import CurveSide, held_by_default, unit_of
from eivor.signals.recording import Channel, Finding, clean_channel

#: Of stamps that take more, those of one table at a time are kept [bytes].
LONG_BYTES = 1 << 23


@dataclass(slots=True)
class Reading:
    """Channels that are being made of messages.

    Parameters
    ----------
    tables : mapping of str to Messages
        By name, on the autopilot's clock.
    parameters : mapping of str to float
        Of the log.
    findings : list of Finding
        What is to be said of the log.
    start_s, end_s : float
        First and last stamp [s], on the autopilot's clock.
    channels : KeptChannels
        Made so far.
    heads : dict of str to Channel
        The same without their arrays.
    looks : dict of str to Look
        What findings need of each.
    silent : list of str
        Setpoints that are not in force throughout.
    """

    tables: Mapping[str, Messages]
    parameters: Mapping[str, float]
    findings: list[Finding]
    start_s: float
    end_s: float
    channels: KeptChannels = field(default_factory=KeptChannels)
    heads: dict[str, Channel] = field(default_factory=dict)
    looks: dict[str, Look] = field(default_factory=dict)
    silent: list[str] = field(default_factory=list)
    _clocks: dict[tuple[int, float], tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)

    @classmethod
    def of(
        cls, tables: Mapping[str, Messages], parameters: Mapping[str, float], findings: list[Finding]
    ) -> Reading:
        """Begin a reading."""
        ends = [
            (time.min(), time.max()) for table in tables.values() if table.clock for time in [table.time_s()]
        ]
        start = min((float(first) for first, _ in ends), default=0.0)
        end = max((float(last) for _, last in ends), default=0.0)
        return cls(tables, parameters, findings, start, end)

    def part(self, start_s: float, end_s: float, step_s: float) -> Reading:
        """Return a reading of the messages of a part of the log, on the same clock.

        Parameters
        ----------
        start_s, end_s : float
            The part [s]. Messages of states, and those without a clock, are all in it.
        step_s : float
            Messages that are closer are thinned to this distance [s]; zero keeps all.
        """
        tables = {}
        for name, table in self.tables.items():
            if not table.clock or name in STATES:
                tables[name] = table
                continue
            time_s = self.time_s(table)
            chosen = (time_s >= start_s) & (time_s <= end_s)
            inside = np.flatnonzero(chosen) if chosen.any() else np.searchsorted(time_s, [start_s, start_s])
            # what is in force at the beginning, and what comes next: silence is no end of the log
            beside = [max(int(inside[0]) - 1, 0), min(int(inside[-1]) + 1, time_s.size - 1)]
            if step_s > 0.0 and time_s.size > 1:
                every = int(step_s * (time_s.size - 1) / max(float(time_s[-1] - time_s[0]), step_s))
                chosen &= np.arange(time_s.size) % max(every, 1) == 0
            chosen[beside] = True
            tables[name] = table.where(chosen)
        self.forget_clocks()
        return Reading(tables, self.parameters, [], self.start_s, self.end_s)

    def forget_clocks(self) -> None:
        """Let go of stamps that may be wanted by other channels of their messages."""
        self._clocks.clear()

    def time_s(self, table: Messages, delay_s: float = 0.0) -> Float[np.ndarray, " n"]:
        """Stamps of messages on the recording's clock, less a delay [s]: one array for all in a row."""
        asked = (id(table.places), delay_s)
        if asked not in self._clocks:
            stamps = table.time_s()
            stamps -= self.start_s + delay_s
            if stamps.nbytes > LONG_BYTES:
                self._clocks.clear()
            # the places are kept too: what is alive keeps its identity
            self._clocks[asked] = (table.places, stamps)
        return self._clocks[asked][1]

    def add(
        self,
        name: str,
        table: Messages,
        values: Float[np.ndarray, " n"],
        label: str,
        curve_side: CurveSide = CurveSide.UNKNOWN,
    ) -> None:
        """Add a channel of values that are at hand, when it has one."""
        self.add_made(name, table, lambda: values, label, curve_side=curve_side)

    def add_made(
        self,
        name: str,
        table: Messages,
        values: Callable[[], Float[np.ndarray, " n"]],
        label: str,
        *,
        estimated: bool = False,
        delay_s: float = 0.0,
        is_setpoint: bool = False,
        curve_side: CurveSide = CurveSide.UNKNOWN,
    ) -> None:
        """Add a channel, when it has a value; its values are made again where they are not kept."""

        def logged() -> Channel:
            return clean_channel(
                name,
                self.time_s(table, delay_s),
                values(),
                unit_of(name),
                source=label,
                held=held_by_default(name),
                estimated=estimated,
                delay_s=delay_s,
                curve_side=curve_side,
            )

        def in_force() -> Channel:
            return silenced(logged(), self.end_s - self.start_s)

        channel = logged()
        if not np.isfinite(channel.values).any():
            return
        count = channel.time_s.size
        if is_setpoint:
            channel = silenced(channel, self.end_s - self.start_s)
            self.silent += [name] if channel.time_s.size > count else []
        self._put(channel, in_force if is_setpoint else logged)

    def keep(self, channel: Channel) -> None:
        """Put a channel that is made of others, or in the place of one."""
        self._put(channel, lambda: channel)

    def _put(self, channel: Channel, make: Callable[[], Channel]) -> None:
        self.channels.put(channel, make)
        nothing = np.empty(0)
        self.heads[channel.name] = replace(channel, time_s=nothing, values=nothing)
        self.looks[channel.name] = look(channel)

    def modes_at(
        self, table: Messages, modes: tuple[int, ...], *, before: bool = False
    ) -> Bool[np.ndarray, " n"]:
        """Whether the vehicle was in one of some modes at each message.

        Parameters
        ----------
        table : Messages
            With a clock.
        modes : tuple of int
            Numbers of modes.
        before : bool
            The answer where the mode is not known.
        """
        return self._stated(table, "MODE", "ModeNum", {float(mode): 1.0 for mode in modes}, before)

    def with_sweeps(self, modes: tuple[int, ...]) -> tuple[int, ...]:
        """Modes of sticks, and system identification where its sweeps leave throttle and attitude to them."""
        settings = self.tables.get("SIDS")
        told = [self.parameters.get("SID_AXIS", 0.0)]
        if settings is not None and settings.has("Ax") and settings.count:
            told = settings.values("Ax").tolist()
        return (*modes, SWEEP_MODE) if all(0 < axis <= LAST_STICK_AXIS for axis in told) else modes

    def landed_at(self, table: Messages) -> Bool[np.ndarray, " n"]:
        """Whether the vehicle was on the ground at each message, by its events; no where they do not say."""
        told = {float(number): value for number, value in LANDED_EVENTS.items()}
        return self._stated(table, "EV", "Id", told, False, others_stay=True)

    def _stated(
        self,
        table: Messages,
        name: str,
        column: str,
        meanings: Mapping[float, float],
        before: bool,
        *,
        others_stay: bool = False,
    ) -> Bool[np.ndarray, " n"]:
        """Whether a state holds that messages of another type set; `before` the first of them as given."""
        states = self.tables.get(name)
        if states is None or not states.has(column) or not states.clock:
            return np.full(table.count, before)
        stated = states.values(column)
        known = np.isin(stated, list(meanings)) if others_stay else np.ones(stated.size, dtype=np.bool_)
        times, stated = self.time_s(states)[known], stated[known]
        order = np.argsort(times, kind="stable")
        value = np.array([meanings.get(one, 0.0) > 0.0 for one in stated[order].tolist()], dtype=np.bool_)
        place = np.searchsorted(times[order], self.time_s(table), side="right")
        return np.asarray(np.append(before, value)[place])
