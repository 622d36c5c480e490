"""Readers of flight logs."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from eivor.logs.common import LogFormat, ReadOptions
from eivor.logs.read import DEFAULT_MAX_BYTES, declare_format, log_format, logging_advice, read_log

if TYPE_CHECKING:
    from eivor.logs.channel_map import ChannelMap, load_channel_map, shipped_maps
    from eivor.logs.mapping import recording_from_columns
    from eivor.logs.table.columnar import write_recording


#: Where each name of tables lives.
_HOMES = {
    "ChannelMap": "eivor.logs.channel_map",
    "load_channel_map": "eivor.logs.channel_map",
    "recording_from_columns": "eivor.logs.mapping",
    "shipped_maps": "eivor.logs.channel_map",
    "write_recording": "eivor.logs.table.columnar",
}

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


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'eivor.logs' has no attribute '{name}'")
    value = globals()[name] = getattr(import_module(_HOMES[name]), name)
    return value
