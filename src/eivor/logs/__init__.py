"""Readers of flight logs."""

from __future__ import annotations

from eivor.logs.channel_map import ChannelMap, load_channel_map, shipped_maps
from eivor.logs.common import LogFormat, ReadOptions
from eivor.logs.mapping import recording_from_columns
from eivor.logs.read import DEFAULT_MAX_BYTES, declare_format, log_format, logging_advice, read_log
from eivor.logs.table.columnar import write_recording

__all__ = [
    "DEFAULT_MAX_BYTES",
    "ChannelMap",
    "LogFormat",
    "ReadOptions",
    "declare_format",
    "load_channel_map",
    "log_format",
    "logging_advice",
    "read_log",
    "recording_from_columns",
    "shipped_maps",
    "write_recording",
]
