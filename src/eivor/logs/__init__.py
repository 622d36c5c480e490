"""Readers of flight logs: one file per format, each makes a `Recording`."""

from eivor.logs.advice import logging_advice
from eivor.logs.arrays import recording_from_columns
from eivor.logs.channel_map import ChannelMap, load_channel_map, shipped_maps
from eivor.logs.read import DEFAULT_MAX_BYTES, read_log
from eivor.logs.written import write_recording

__all__ = [
    "DEFAULT_MAX_BYTES",
    "ChannelMap",
    "load_channel_map",
    "logging_advice",
    "read_log",
    "recording_from_columns",
    "shipped_maps",
    "write_recording",
]
