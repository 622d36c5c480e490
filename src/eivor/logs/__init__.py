"""Readers of flight logs."""

from __future__ import annotations

from eivor.logs.common import LogFormat, ReadOptions
from eivor.logs.read import DEFAULT_MAX_BYTES, log_format, read_log

__all__ = ["DEFAULT_MAX_BYTES", "LogFormat", "ReadOptions", "log_format", "read_log"]
