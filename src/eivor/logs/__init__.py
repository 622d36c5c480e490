"""Readers of flight logs: a table of formats, each makes a `Recording`."""

from eivor.logs.arrays import recording_from_columns
from eivor.logs.channel_map import ChannelMap, load_channel_map, shipped_maps
from eivor.logs.formats import declare_format, log_format, logging_advice
from eivor.logs.log_format import LogFormat, ReadOptions
from eivor.logs.read import DEFAULT_MAX_BYTES, read_log
from eivor.logs.table.written import write_recording

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
