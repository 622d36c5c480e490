"""Which board wrote a DataFlash log, with which firmware and when, and how warm its barometer was."""

from __future__ import annotations

import re
from collections.abc import Mapping
from datetime import datetime

import numpy as np

from eivor.logs.dataflash.messages import Messages
from eivor.signals.log_origin import LogOrigin, utc_time

#: Messages that are looked at for it.
ORIGIN_MESSAGES = frozenset({"GPS"})
#: What the firmware says of itself when a log begins: its name and version, the board's id, the frame.
_FIRMWARE = re.compile(r"(?:APM:|Ardu)\w+ V\d\S*")
_BOARD = re.compile(r"\S+ ((?:[0-9A-F]{8} ){2}[0-9A-F]{8})")
_FRAME = re.compile(r"Frame: (\S.*)")
#: 1980-01-06 in seconds since 1970, seconds of a week, and by how many GPS is ahead of UTC since 2017.
GPS_EPOCH_S, WEEK_S, LEAP_S = 315_964_800.0, 604_800.0, 18.0


def dataflash_origin(tables: Mapping[str, Messages], parameters: Mapping[str, float]) -> LogOrigin:
    """Origin of a log.

    Parameters
    ----------
    tables : mapping of str to Messages
        By name.
    parameters : mapping of str to float
        Of the vehicle; its own serial number comes before the board's id.
    """
    told = tables.get("MSG")
    texts = told.texts("Message") if told is not None and told.has("Message") else []
    serial = parameters.get("BRD_SERIAL_NUM", 0.0)
    frame = _first(_FRAME, texts)
    return LogOrigin(
        board=f"{serial:.0f}" if serial > 0.0 else _first(_BOARD, texts),
        airframe=f"ArduPilot {frame}" if frame else "",
        firmware=_first(_FIRMWARE, texts),
        start=_start(tables.get("GPS")),
    )


def _first(pattern: re.Pattern[str], texts: list[str]) -> str:
    """What the first text that fits says: its group, or all of it."""
    found = (pattern.match(text) for text in texts if text.isprintable())
    return next((match[match.lastindex or 0].strip() for match in found if match), "")


def _start(table: Messages | None) -> datetime | None:
    """Time of the log's time 0 by satellites; None while there are none.

    Logs before 2017 are told up to two seconds early.
    """
    if table is None or not table.has("GMS", "GWk") or not table.clock:
        return None
    weeks, milliseconds = table.values("GWk"), table.values("GMS")
    told = weeks > 0.0
    if not told.any():
        return None
    utc = GPS_EPOCH_S + weeks * WEEK_S + milliseconds * 1e-3 - LEAP_S
    return utc_time(float(np.median((utc - table.time_s())[told])))
