"""DataFlash as a row of the table of formats: how it is told, and what ArduPilot should log."""

from __future__ import annotations

from pathlib import Path

from eivor.logs.dataflash.layouts import HEAD, begins_within
from eivor.logs.dataflash.sources import CHANNEL_SOURCES
from eivor.logs.dataflash.text import is_text
from eivor.logs.log_format import LogFormat, ReadOptions
from eivor.signals.recording import Recording

#: How often each message is logged, and what raises it.
RATES = {
    "RATE": "at 10 Hz; bit 0 (ATTITUDE_FAST) of LOG_BITMASK logs it at the loop's rate (400 Hz).",
    "ATT": "at 10 Hz; bit 0 (ATTITUDE_FAST) of LOG_BITMASK logs it at the loop's rate (400 Hz).",
    "IMU": "at 25 Hz; bit 18 (IMU_FAST) of LOG_BITMASK logs it at the loop's rate (400 Hz).",
    "XKF1": "at 10 Hz; bit 0 (ATTITUDE_FAST) of LOG_BITMASK logs it at 25 Hz.",
    "PSCD": "at 10 Hz, with bit 5 (NTUN) of LOG_BITMASK and in modes that hold the height.",
    "CTUN": "at 10 Hz, with bit 4 (CTUN) of LOG_BITMASK.",
    "BAT": "at 10 Hz, with bit 9 (CURRENT) of LOG_BITMASK.",
}
_ADVICE = (
    "Set bits 0 (ATTITUDE_FAST) and 18 (IMU_FAST) of LOG_BITMASK beside those that are set (176126 becomes "
    "438271): throttle, attitude and accelerations at the loop's rate, velocity at 25 Hz. The default logs "
    "nearly all at 10 Hz, which is too slow for the lag of the motors.",
    "Leave bit 5 (NTUN) set, which logs the height reference (PSCD, from firmware 4.1 on).",
    "Fly height steps in a mode that holds the height (AUTO, GUIDED, LOITER): a hover cannot be identified.",
)


def _read(file: Path, options: ReadOptions) -> Recording:
    from eivor.logs.dataflash.reader import read_dataflash

    return read_dataflash(file, sha256=options.sha256)


def _advice(channel: str) -> tuple[str, ...]:
    """How to set ArduPilot's logger; for a channel, at which rate its messages are logged."""
    if not channel:
        return _ADVICE
    messages = dict.fromkeys(source.message for source in CHANNEL_SOURCES.get(channel, ()))
    return tuple(f"ArduPilot logs {name} {RATES[name]}" for name in messages if name in RATES)


DATAFLASH = LogFormat(
    "dataflash",
    "ArduPilot DataFlash",
    lambda head, _: head.startswith(HEAD) or is_text(head) or begins_within(head),
    _read,
    advice=_advice,
    setpoints="PSCD.DPD, .DVD and .DAD (the height reference and its feed-forward), RATE.AOut (the command), "
    "RCIN.C3 (the stick, when a pilot flies).",
    endings=(".bin", ".log"),
)
