"""The state of one reading of a DataFlash log: messages in, channels and findings out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from eivor.logs.dataflash.messages import Messages
from eivor.logs.dataflash.sources import LANDED_EVENTS, LAST_STICK_AXIS, SWEEP_MODE
from eivor.logs.silences import silenced
from eivor.shapes import Bool, Float
from eivor.signals.canonical import held_by_default, unit_of
from eivor.signals.recording import Channel, Finding, clean_channel


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
    """

    tables: Mapping[str, Messages]
    parameters: Mapping[str, float]
    findings: list[Finding]
    start_s: float
    end_s: float
    channels: dict[str, Channel] = field(default_factory=dict)
    silent: list[str] = field(default_factory=list)
    _clocks: dict[tuple[int, float], tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)

    @classmethod
    def of(
        cls, tables: Mapping[str, Messages], parameters: Mapping[str, float], findings: list[Finding]
    ) -> Reading:
        """Begin a reading."""
        clocks = [table.time_s() for table in tables.values() if table.clock]
        start = min((float(time.min()) for time in clocks), default=0.0)
        end = max((float(time.max()) for time in clocks), default=0.0)
        return cls(tables, parameters, findings, start, end)

    def time_s(self, table: Messages, delay_s: float = 0.0) -> Float[np.ndarray, " n"]:
        """Stamps of messages on the recording's clock, less a delay [s]: one array for all that ask."""
        asked = (id(table.places), delay_s)
        if asked not in self._clocks:
            # the places are kept too: what is alive keeps its identity
            self._clocks[asked] = (table.places, table.time_s() - self.start_s - delay_s)
        return self._clocks[asked][1]

    def add(
        self,
        name: str,
        table: Messages,
        values: Float[np.ndarray, " n"],
        label: str,
        *,
        estimated: bool = False,
        delay_s: float = 0.0,
        is_setpoint: bool = False,
    ) -> None:
        """Add a channel, when it has a value."""
        channel = clean_channel(
            name,
            self.time_s(table, delay_s),
            values,
            unit_of(name),
            source=label,
            held=held_by_default(name),
            estimated=estimated,
            delay_s=delay_s,
        )
        if not np.isfinite(channel.values).any():
            return
        if is_setpoint:
            until = silenced(channel, self.end_s - self.start_s)
            self.silent += [name] if until.time_s.size > channel.time_s.size else []
            channel = until
        self.channels[name] = channel

    def keep(self, name: str, channel: Channel) -> None:
        """Add a channel that is made of others."""
        self.channels[name] = replace(channel, name=name)

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
