"""Reader of DataFlash logs."""

from __future__ import annotations

import mmap
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from eivor.errors import EmptyLogError
from eivor.logs import common
from eivor.logs.dataflash import channels
from eivor.logs.dataflash import sources as ardupilot
from eivor.logs.dataflash.messages import (
    HEAD,
    Messages,
    begins_within,
    is_text,
    read_lines,
    read_messages,
    rows_of,
)
from eivor.signals.channels import CurveSide
from eivor.signals.recording import Finding, Frame, Recording
from eivor.tools import Float


def _advice(channel: str) -> tuple[str, ...]:
    messages = dict.fromkeys(source.message for source in ardupilot.CHANNEL_SOURCES.get(channel, ()))
    return tuple(
        f"ArduPilot logs {name} {ardupilot.RATES[name]}" for name in messages if name in ardupilot.RATES
    )


#: An instance with a smaller share of the messages of the most frequent one is damage, or was lost at once.
SELDOM = 0.1


def read_dataflash(file: Path, _options: common.ReadOptions) -> Recording:
    """Read a DataFlash log."""
    with file.open("rb") as stream:
        content = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
    tables, findings = _tables(content)
    parameters = _parameters(tables)
    ardupilot.choose_estimator(tables, parameters, findings)
    reading = ardupilot.MessageReading.of(tables, parameters, findings)
    _add_all(reading)
    if not reading.channels:
        raise EmptyLogError(
            "a DataFlash log with flight data (XKF1, NKF1, RATE, CTUN, IMU, ATT, ...)",
            f"'{file.name}' without a value of any of them",
            "Check LOG_BITMASK and LOG_BACKEND_TYPE, that the vehicle was armed, and that the beginning of "
            "the file is there, where messages are described (FMT).",
        )
    findings += channels.unit_findings(tables)
    findings += channels.delay_findings(reading.heads.values(), parameters)
    sentence = "Not in force while its message is silent: {}."
    findings += common.noted("setpoint_silent", sentence, reading.inactive_setpoints)
    return Recording(
        name=file.name,
        format="dataflash",
        channels=reading.channels.finished(),
        frame=Frame.NED,
        parameters=parameters,
        looked_for=ardupilot.LOOKED_FOR,
        findings=(*findings, *common.findings_of(reading.profiles, reading.channels)),
        vehicle=channels.vehicle_of(tables, parameters),
        origin=ardupilot.dataflash_origin(tables, parameters),
    )


def _add_all(reading: ardupilot.MessageReading) -> common.KeptChannels:
    counts = {name: table.count for name, table in reading.tables.items()}
    sources = ardupilot.CHANNEL_SOURCES, ardupilot.CHOSEN_BY_RATE
    for name, source in common.in_preference(*sources, lambda source: counts.get(source.message, 0)):
        if name not in reading.channels:
            _add(reading, name, source)
    for add, message, columns in channels.MAKERS:
        table = reading.table(message, *columns)
        if table is not None:
            add(reading, table)
    reading.forget_clocks()
    reading.channels.cut = lambda *part: _add_all(reading.part(*part))
    return reading.channels


def _tables(content: mmap.mmap) -> tuple[dict[str, Messages], list[Finding]]:
    read = read_lines if is_text(content[: common.HEAD_BYTES]) else read_messages
    messages, findings = read(content, ardupilot.NEEDED)
    unusable = sorted(message.name for message in messages if not message.layout.fields)
    sentence = "Left out, because codes, names and length of their fields disagree: {}."
    findings += common.noted("message_formats", sentence, unusable)
    misfits: list[str] = []
    tables: dict[str, Messages] = {}
    lost = 0
    for message in messages:
        left_out = message.layout.misfits()
        misfits += [f"{message.name}.{name}" for name in left_out]
        fields = {name: item for name, item in message.layout.fields.items() if name not in left_out}
        if not fields or message.name in tables:
            continue
        lowest = _lowest(replace(message, layout=replace(message.layout, fields=fields)))
        if lowest.clock and lowest.count:
            time_s = lowest.time_s()
            sound = common.believable(time_s - float(np.median(time_s)))
            lost += int((~sound).sum())
            lowest = lowest.where(sound)
        if lowest.count:
            tables[lowest.name] = lowest
    sentence = "Columns left out, in which texts or lists stand for numbers, or numbers for texts: {}."
    findings += common.noted("message_formats", sentence, sorted(misfits))
    findings += common.noted("time_stamps", "Messages left out, because their stamp cannot be: {}.", lost)
    return tables, findings


def _lowest(table: Messages) -> Messages:
    """Messages of the lowest instance of a sensor or a battery that has many of them."""
    if table.name not in ("IMU", "BAT", "CURR", "BARO", "GPS"):
        return table
    column = table.first("I", "Inst", "Instance")
    if not column or not table.count:
        return table
    instances = table.stored(column)
    result, counts = np.unique(instances, return_counts=True)
    lowest = result[counts >= SELDOM * counts.max()].min()
    return table.where(instances == lowest)


def _parameters(tables: Mapping[str, Messages]) -> dict[str, float]:
    values: dict[str, float] = {}
    for name, value in rows_of(tables, "PARM", "Name", "Value"):
        if np.isfinite(value) and name.isprintable() and name:
            values.setdefault(name, value)
    return dict(sorted(values.items()))


def _add(reading: ardupilot.MessageReading, name: str, source: ardupilot.MessageSource) -> None:
    table = reading.table(source.message, source.column)
    if table is None:
        return
    factor = source.factor_in(table)
    if source.zero_is_absent and not np.any(np.nan_to_num(table.values(source.column))):
        return

    def values() -> Float[np.ndarray, " n"]:
        result = table.values(source.column)
        result *= factor
        if source.needs_height_loop:
            manual = reading.with_sweeps(ardupilot.WITHOUT_HEIGHT_MODES)
            result[reading.modes_at(table, manual, before=True)] = np.nan
            result[reading.landed_at(table)] = np.nan
        return result

    reading.add(
        name,
        table,
        values,
        f"{'-' if factor < 0.0 else ''}{table.name}.{source.column}",
        estimated=source.estimated,
        delay_s=channels.delay_of(name, reading.parameters),
        is_setpoint=source.is_setpoint,
        curve_side=CurveSide.BEFORE if name == "input" else CurveSide.UNKNOWN,
    )


FORMATS = (
    common.LogFormat(
        "dataflash",
        "ArduPilot DataFlash",
        lambda head, _: head.startswith(HEAD) or is_text(head) or begins_within(head),
        read_dataflash,
        endings=(".bin", ".log"),
        **common.advised(ardupilot.TABLES["advice"], _advice),
    ),
)
