"""Readers of flight logs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from eivor.tools import late_names

if TYPE_CHECKING:
    from eivor.logs.channel_map import ChannelMap, load_channel_map, shipped_maps
    from eivor.logs.common import LogFormat, ReadOptions
    from eivor.logs.mapping import recording_from_columns
    from eivor.logs.read import DEFAULT_MAX_BYTES, declare_format, log_format, logging_advice, read_log
    from eivor.logs.table.columnar import write_recording

_PLACES = {
    "eivor.logs.channel_map": "ChannelMap load_channel_map shipped_maps",
    "eivor.logs.common": "LogFormat ReadOptions",
    "eivor.logs.mapping": "recording_from_columns",
    "eivor.logs.read": "DEFAULT_MAX_BYTES declare_format log_format logging_advice read_log",
    "eivor.logs.table.columnar": "write_recording",
}
__getattr__ = late_names(__name__, {name: home for home, names in _PLACES.items() for name in names.split()})

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
