"""Which board wrote a ULog, with which firmware and when, and what the autopilot knows of the air."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime

import numpy as np

from eivor.logs.ulog.instances import Topic
from eivor.signals.canonical import unit_of
from eivor.signals.log_origin import LogOrigin, utc_time
from eivor.signals.recording import Channel, clean_channel

#: Topics with the time of satellites, the preferred one first, and that with the air.
CLOCKS, AIR = ("vehicle_gps_position", "sensor_gps"), "vehicle_air_data"
ORIGIN_TOPICS = (*CLOCKS, AIR)
#: Channels of the air and their fields. The barometer's own temperature, where nothing else is logged, is
#: above that of the air.
AIR_FIELDS = {"air_density": ("rho",), "air_temperature": ("ambient_temperature", "baro_temp_celcius")}
#: What the last byte of a release is, PX4's FIRMWARE_TYPE; smaller ones are of development.
KINDS = {64: " alpha", 128: " beta", 192: " rc", 255: ""}


def ulog_origin(
    about: Mapping[str, bytes],
    topics: Mapping[str, Topic],
    start: np.uint64,
    parameters: Mapping[str, float],
) -> LogOrigin:
    """Origin of a log.

    Parameters
    ----------
    about : mapping of str to bytes
        What it says of itself, see `eivor.logs.ulog.frames.ABOUT`.
    topics : mapping of str to Topic
        `ORIGIN_TOPICS`, as far as the log has them.
    start : uint64
        Stamp of the log's time 0 [us].
    parameters : mapping of str to float
        Of the vehicle.
    """
    name = _text(about.get("sys_name", b""))
    airframe = parameters.get("SYS_AUTOSTART", 0.0)
    version = int.from_bytes(about.get("ver_sw_release", b"")[:4], "little")
    release = f" {_release(version)}" if version else ""
    return LogOrigin(
        board=_text(about.get("sys_uuid", b"")),
        airframe=f"{name} airframe {airframe:.0f}".strip() if airframe > 0.0 else "",
        firmware=f"{name}{release}",
        start=next(filter(None, (_start(topics.get(name), start) for name in CLOCKS)), None),
    )


def air_channels(topics: Mapping[str, Topic], start: np.uint64) -> dict[str, Channel]:
    """Channels of the air, on the log's clock."""
    topic = topics.get(AIR)
    if topic is None:
        return {}
    found = {}
    for name, fields in AIR_FIELDS.items():
        for field in fields:
            values = topic.fields.get(field)
            if name not in found and values is not None and np.any(np.nan_to_num(values)):
                time_s = _since(topic.fields["timestamp"], start)
                source = f"{AIR}.{field}"
                found[name] = clean_channel(name, time_s, values.astype(float), unit_of(name), source=source)
    return found


def _start(topic: Topic | None, start: np.uint64) -> datetime | None:
    """Time of the log's start by a receiver of satellites; None while it has none."""
    if topic is None or "time_utc_usec" not in topic.fields:
        return None
    utc = topic.fields["time_utc_usec"].astype(float) * 1e-6
    told = utc > 0.0
    if not told.any():
        return None
    since = _since(topic.fields["timestamp"], start)
    return utc_time(float(np.median(utc[told] - since[told])))


def _since(stamps: np.ndarray, start: np.uint64) -> np.ndarray:
    with np.errstate(over="ignore"):
        return np.asarray((stamps.astype(np.uint64) - start).view(np.int64) * 1e-6)


def _text(content: bytes) -> str:
    text = content.decode("latin-1").strip("\0 ")
    return text if text.isprintable() else ""


def _release(number: int) -> str:
    """Version of a release: bytes of its major, minor and patch number and of its kind."""
    major, minor, patch, kind = number.to_bytes(4, "big")
    return f"{major}.{minor}.{patch}{KINDS.get(kind, ' development')}"
