"""Crazyflie microSD logs: events of several types, each with a clock of its own, as one recording.

Axes are z up. Time 0 is the first record. Without a channel map the variables are what `channels` says;
a map names them as columns: ``acc.z``, or ``fixedFrequency:acc.z`` where several types of events hold it,
and the clock ``timestamp``, which is in seconds whatever the map says.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from eivor.errors import ChannelMapError, CorruptLogError, EmptyLogError
from eivor.logs.channel_map import ChannelMap, ChannelRule, load_channel_map
from eivor.logs.columns import Columns
from eivor.logs.crazyflie.channels import (
    LOOKED_FOR,
    PACKED_QUATERNION,
    SOURCES,
    UNPACKED,
    VELOCITY_SETPOINTS,
    Source,
    unpacked_quaternion,
)
from eivor.logs.crazyflie.channels import delay_findings as filter_findings
from eivor.logs.crazyflie.gaps import gap_findings
from eivor.logs.crazyflie.header import parse_header
from eivor.logs.crazyflie.records import Event, read_events
from eivor.logs.findings import channel_findings
from eivor.logs.log_format import ReadOptions
from eivor.logs.mapping import delay_findings, fitted_rules, listed, looked_for, mapped_channels
from eivor.shapes import Float
from eivor.signals.log_origin import LogOrigin
from eivor.signals.recording import Channel, Finding, Frame, Recording

CLOCK = "timestamp"
#: Name of the format.
NAME = "crazyflie"
_BUILT_IN = ChannelMap("crazyflie", CLOCK, "s", (), Frame.Z_UP, "square", {}, "the firmware")


@dataclass(slots=True)
class _Table:
    """The variables of one event as columns, which are converted when they are asked for."""

    event: Event
    names: dict[str, str]
    _values: dict[str, Float[np.ndarray, " n"]]

    @classmethod
    def of(cls, event: Event) -> _Table:
        """Return the table of an event."""
        variables = [*dict.fromkeys(event.variables)]
        if PACKED_QUATERNION in variables:
            variables += UNPACKED
        names = {name: name for name in (CLOCK, *variables)}
        return cls(event, names | {f"{event.name}:{name}": name for name in names}, {CLOCK: event.time_s})

    def has(self, columns: Sequence[str]) -> bool:
        """Say whether it has all of some columns."""
        return all(column in self.names for column in columns)

    def values(self, column: str) -> Float[np.ndarray, " n"]:
        """Return a column, in the logged unit."""
        name = self.names[column]
        if name not in self._values:
            if name in UNPACKED and name not in self.event.variables:
                self._values |= unpacked_quaternion(self.event.values(PACKED_QUATERNION))
            else:
                self._values[name] = self.event.values(name)
        return self._values[name]

    def columns(self, names: Sequence[str]) -> Columns:
        """Return some columns."""
        clocks = frozenset(name for name in names if self.names[name] == CLOCK)
        return Columns({name: self.values(name) for name in names}, seconds=clocks)


def read_crazyflie(file: Path, options: ReadOptions) -> Recording:
    """Read a Crazyflie microSD log.

    Parameters
    ----------
    file : Path
        The file; `read_log` has checked its size and its first bytes.
    options : ReadOptions
        A channel map, and the hash of the file's bytes.

    Returns
    -------
    Recording
        In `Frame.Z_UP`.

    Raises
    ------
    CorruptLogError
        When the head cannot be read.
    EmptyLogError
        When it holds no record, or none with a variable that is a channel.
    ChannelMapError
        When the map is wrong, or does not fit the log.
    """
    try:
        data = file.read_bytes()
    except OSError as error:
        raise CorruptLogError(
            "a Crazyflie microSD log that can be read",
            f"'{file.name}': {error}",
            "Copy it from the card again.",
        ) from error
    header = parse_header(data, file.name)
    events, findings = read_events(data, header)
    if not events:
        raise EmptyLogError(
            "a Crazyflie microSD log with records",
            f"'{file.name}' without a whole record of any (types of events: {len(header.types)})",
            "Check config.txt on the card, and end the logging before the power goes (usd.logging = 0).",
        )
    findings += gap_findings(events)
    tables = sorted(map(_Table.of, events), key=lambda one: -one.event.time_s.size)
    if options.channel_map is None:
        return _by_table(file.name, tables, findings, options.sha256)
    return _by_map(file.name, tables, findings, options.channel_map, options.sha256)


def _by_table(name: str, tables: Sequence[_Table], findings: list[Finding], sha256: str) -> Recording:
    """Return the recording of the variables that are known."""
    chosen = _chosen(tables, findings)
    channels: dict[str, Channel] = {}
    for table in tables:
        rules = [rule for source, place in chosen if place is table for rule in source.rules]
        if rules:
            needed = dict.fromkeys([CLOCK, *(column for rule in rules for column in rule.expression.columns)])
            made, found = mapped_channels(_BUILT_IN, rules, table.columns(list(needed)), name)
            channels |= made
            findings += found
    used = {column for source, _ in chosen for column in source.columns}
    used |= {PACKED_QUATERNION} if used.intersection(UNPACKED) else set()
    variables = dict.fromkeys(variable for table in tables for variable in table.event.variables)
    others = [variable for variable in variables if variable not in used]
    if not channels:
        raise EmptyLogError(
            "a Crazyflie microSD log with variables that are known (stateEstimate.vz, motor.m1, acc.z, ...)",
            f"'{name}' with {listed(list(variables)) or 'none'}",
            "Name them in a channel map (--map), or log others.",
        )
    if others:
        findings.append(
            Finding(
                "ignored_columns",
                f"Variables that no channel is made of: {listed(others)}. A map can name them.",
            )
        )
    findings += filter_findings(list(channels.values()))
    return _recording(name, channels, findings, _BUILT_IN, LOOKED_FOR, sha256)


def _chosen(tables: Sequence[_Table], findings: list[Finding]) -> list[tuple[Source, _Table]]:
    """Sources that are used, each with the event that has the most records of it."""
    chosen: dict[str, tuple[Source, _Table]] = {}
    silent: list[str] = []
    for source in SOURCES:
        table = next((one for one in tables if one.has(source.columns)), None)
        if table is None or source.quantity in chosen:
            continue
        if source.zero_is_absent and not any(
            np.any(np.nan_to_num(table.values(column))) for column in source.columns
        ):
            silent += source.columns
            continue
        answers = _answering(source, table)
        findings += [answers] if answers is not None else []
        used = source if answers is None else _as_feedback(source)
        chosen.setdefault(used.quantity, (used, table))
    if silent:
        findings.append(
            Finding("never_valid", f"Logged as zero throughout: {listed(list(dict.fromkeys(silent)))}.")
        )
    return list(chosen.values())


def _answering(source: Source, table: _Table) -> Finding | None:
    """Doubt a velocity setpoint that is not planned: it changes while the height setpoint stands still.

    Firmware of some years ago lets the position loop write its own velocity over the setpoint's.
    """
    column = source.columns[0]
    beside = VELOCITY_SETPOINTS.get(column)
    if beside is None or not table.has((beside,)):
        return None
    velocity, height = table.values(column), table.values(beside)
    changing = np.diff(velocity) != 0.0
    standing = (np.diff(height) == 0.0) & (height[1:] != 0.0)
    if not np.any(changing) or np.mean(standing[changing]) < 0.5:
        return None
    return Finding(
        "feedback_setpoint",
        f"{column} changes while {beside} stands still, so the position loop wrote it: it answers the "
        "vehicle, and is no reference.",
    )


def _as_feedback(source: Source) -> Source:
    name = "feedback_reference_velocity_z"
    return Source(name, tuple(replace(rule, name=name) for rule in source.rules), source.zero_is_absent)


def _by_map(
    name: str,
    tables: Sequence[_Table],
    findings: list[Finding],
    channel_map: str | os.PathLike[str],
    sha256: str,
) -> Recording:
    """Return the recording of the variables that a channel map names."""
    chosen = load_channel_map(channel_map)
    names = list(dict.fromkeys(column for table in tables for column in table.names))
    rules: dict[int, list[ChannelRule]] = {}
    for rule in fitted_rules(chosen, names, name):
        place = _place(rule, chosen, tables, name)
        rules.setdefault(place, []).append(rule)
    channels: dict[str, Channel] = {}
    for place, served in rules.items():
        needed = dict.fromkeys(
            [chosen.time_column, *(column for rule in served for column in rule.expression.columns)]
        )
        made, found = mapped_channels(chosen, served, tables[place].columns(list(needed)), name)
        channels |= made
        findings += found
    if not channels:
        raise EmptyLogError(
            "a log with values", f"'{name}', in which every mapped variable is empty", "Check the map."
        )
    findings += delay_findings(channels, chosen.origin)
    return _recording(name, channels, findings, chosen, looked_for(chosen), sha256)


def _place(rule: ChannelRule, chosen: ChannelMap, tables: Sequence[_Table], name: str) -> int:
    """Number of the event with the most records that has all that a rule needs.

    Raises
    ------
    ChannelMapError
        When no event has all of it: they have no clock in common.
    """
    needed = (chosen.time_column, *rule.expression.columns)
    for place, table in enumerate(tables):
        if table.has(needed):
            return place
    raise ChannelMapError(
        f"columns of one type of events for channels.{rule.name} ({chosen.origin})",
        f"{listed(needed)}, which no type of '{name}' has all of",
        f"Take columns of one type, and '{CLOCK}' for the time.",
    )


def _recording(
    name: str,
    channels: Mapping[str, Channel],
    findings: Sequence[Finding],
    chosen: ChannelMap,
    looked: Mapping[str, tuple[str, ...]],
    sha256: str,
) -> Recording:
    return Recording(
        name=name,
        format=NAME,
        channels=channels,
        frame=chosen.frame,
        sha256=sha256,
        input_map=chosen.input_map,
        looked_for=looked,
        findings=(*findings, *channel_findings(channels)),
        origin=LogOrigin(airframe="Crazyflie"),
    )
