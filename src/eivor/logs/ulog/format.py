"""ULog as a row of the table of formats: how it is told, and what PX4 should log."""

from __future__ import annotations

from pathlib import Path

from eivor.logs.log_format import FolderParts, LogFormat, ReadOptions, begins_with
from eivor.logs.ulog.topics import (
    CHANNEL_SOURCES,
    EXTRA_TOPIC_LINES,
    PROFILE_BITS,
    TOPIC_LOGGING,
    TopicLogging,
)
from eivor.signals.recording import Recording

MAGIC = b"\x55\x4c\x6f\x67\x01\x12\x35"


def _read(file: Path, options: ReadOptions) -> Recording:
    from eivor.logs.ulog.reader import read_ulog

    return read_ulog(file, sha256=options.sha256)


def _read_csv_folder(folder: Path, options: ReadOptions) -> Recording:
    from eivor.logs.ulog.csv_folder import read_csv_folder

    return read_csv_folder(folder, options, ULOG_CSV.name)


def _is_csv_folder(_head: bytes, folder: Path) -> bool:
    """Whether a folder holds a table of a topic."""
    if not folder.is_dir():
        return False
    from eivor.logs.ulog.csv_names import tables_of

    return bool(tables_of(folder))


def _csv_parts(folder: Path) -> FolderParts:
    from eivor.logs.ulog.csv_names import csv_parts

    return csv_parts(folder)


def _advice(channel: str) -> tuple[str, ...]:
    """How to set PX4's logger; for a channel, at which rate its topics are logged."""
    if not channel:
        return _PX4_ADVICE
    topics = list(dict.fromkeys(source.topic for source in CHANNEL_SOURCES.get(channel, ())))
    known = {entry.topic: entry for entry in TOPIC_LOGGING}
    return tuple(_topic_sentence(known[topic]) for topic in topics if topic in known)


def _topic_sentence(entry: TopicLogging) -> str:
    """Say at which rate PX4 logs a topic, and what raises it."""
    rate = "at every message" if entry.default_rate_hz == float("inf") else f"at {entry.default_rate_hz:g} Hz"
    sentence = f"PX4's default profile (SDLOG_PROFILE bit 0) logs {entry.topic} {rate}"
    raising = [bit for bit in entry.full_rate_bits if bit != 0]
    if raising and entry.default_rate_hz != float("inf"):
        bits = " or ".join(f"bit {bit} ({PROFILE_BITS[bit]})" for bit in raising)
        return f"{sentence}; {bits} logs it at its full rate."
    return f"{sentence}."


_PX4_ADVICE = (
    "Set SDLOG_PROFILE to 25: bit 0 (default set), bit 3 (system identification: accelerations, rates and "
    "motor commands at full rate) and bit 4 (high rate: thrust setpoint, attitude and stick at full rate).",
    "No profile bit raises the rate of the position estimate and of its setpoints above 10 Hz: copy "
    "etc/logging/logger_topics.txt onto the card, with the topics of the profile and the lines "
    + ", ".join(f"'{line}'" for line in EXTRA_TOPIC_LINES)
    + " (topic, interval in ms). That file replaces the profile.",
    "Fly altitude steps, so that the height reference changes: a hover cannot be identified.",
)

_SETPOINTS = (
    "trajectory_setpoint or vehicle_local_position_setpoint (the height reference), "
    "vehicle_thrust_setpoint (the command), manual_control_setpoint (the stick, when a pilot flies)."
)

ULOG = LogFormat(
    "ulog",
    "ULog",
    begins_with(MAGIC),
    _read,
    advice=_advice,
    setpoints=_SETPOINTS,
    endings=(".ulg", ".ulog"),
)
#: A folder of the tables that `ulog2csv` makes of one.
ULOG_CSV = LogFormat(
    "ulog2csv",
    "ulog2csv folder",
    _is_csv_folder,
    _read_csv_folder,
    advice=_advice,
    setpoints=_SETPOINTS,
    parts=_csv_parts,
)
