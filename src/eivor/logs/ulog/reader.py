"""PX4 ULog files.

Axes are as PX4 logs them: z down (`Frame.NED`), in positions, velocities, accelerations and setpoints
alike. One channel is turned: `input` is positive up, whatever the sign of the topic it comes from.
Time 0 is the log's `start_timestamp`; topics may carry stamps before it.
"""

from __future__ import annotations

import contextlib
import io
import mmap
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from eivor.errors import CorruptLogError, EmptyLogError
from eivor.logs.findings import channel_findings
from eivor.logs.ulog.channels import read_topics
from eivor.logs.ulog.frames import CleanLog, clean_log
from eivor.logs.ulog.instances import Topic, choose_instance
from eivor.logs.ulog.origin import ORIGIN_TOPICS, air_channels, ulog_origin
from eivor.logs.ulog.topics import LOOKED_FOR, NEEDED_TOPICS
from eivor.logs.ulog.vehicle import vehicle_of
from eivor.signals.recording import Finding, Frame, Recording

#: Every topic that is parsed.
PARSED = (*NEEDED_TOPICS, *(topic for topic in ORIGIN_TOPICS if topic not in NEEDED_TOPICS))


def read_ulog(file: Path, *, sha256: str = "") -> Recording:
    """Read a ULog file.

    Parameters
    ----------
    file : Path
        The file; `read_log` has checked its size and its first bytes.
    sha256 : str
        Hash of its bytes, for the Recording.

    Returns
    -------
    Recording
        In `Frame.NED`, `input` positive up.

    Raises
    ------
    CorruptLogError
        When the file cannot be decoded.
    EmptyLogError
        When it holds none of the topics that are needed.
    """
    try:
        with file.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
            clean = clean_log(data, PARSED, file.name)
    except OSError as error:
        raise _corrupt(file, error) from error
    ulog, printed = _decode(clean, file)
    findings = _file_findings(clean, ulog, printed)
    parameters = _parameters(ulog)
    topics = _topics(ulog, clean.rows, findings)
    beside = {name: topics.pop(name) for name in ORIGIN_TOPICS if name in topics}
    start = np.uint64(ulog.start_timestamp)
    channels = read_topics(topics, start, parameters, findings)
    if not channels:
        raise EmptyLogError(
            f"a ULog with flight data (one of the topics {', '.join(NEEDED_TOPICS)})",
            f"'{file.name}' without a value of any of them",
            "Check that logging was on during the flight, and the logging profile (SDLOG_PROFILE).",
        )
    channels |= air_channels(beside, start)
    return Recording(
        name=file.name,
        format="ulog",
        channels=channels,
        frame=Frame.NED,
        sha256=sha256,
        parameters=parameters,
        looked_for=LOOKED_FOR,
        findings=(*findings, *channel_findings(channels)),
        vehicle=vehicle_of(topics, parameters),
        origin=ulog_origin(clean.about, beside, start, parameters),
    )


def _corrupt(file: Path, error: Exception) -> CorruptLogError:
    return CorruptLogError(
        "a readable ULog",
        f"'{file.name}', which cannot be decoded ({type(error).__name__}: {error})",
        "The file is damaged; copy it from the vehicle again.",
    )


def _decode(clean: CleanLog, file: Path) -> tuple[Any, bool]:
    """Decode the clean messages; what still goes wrong is a damaged file, as is what the decoder prints."""
    from pyulog.core import ULog, ULogException

    printed = io.StringIO()
    try:
        with contextlib.redirect_stdout(printed):
            ulog = ULog(io.BytesIO(clean.content), list(PARSED), disable_str_exceptions=True)
    except (
        ULogException,
        ValueError,
        TypeError,
        IndexError,
        KeyError,
        OverflowError,
        OSError,
        struct.error,
        RecursionError,
        MemoryError,
    ) as error:
        raise _corrupt(file, error) from error
    return ulog, bool(printed.getvalue())


def _parameters(ulog: Any) -> dict[str, float]:
    """Numeric parameters that were set when the log began."""
    values = {str(key): float(value) for key, value in ulog.initial_parameters.items()}
    return {key: value for key, value in sorted(values.items()) if np.isfinite(value)}


def _file_findings(clean: CleanLog, ulog: Any, printed: bool) -> list[Finding]:
    """Damage and dropouts."""
    findings = []
    if clean.cut_bytes:
        findings.append(
            Finding("truncated", f"The log ends within a message ({clean.cut_bytes} bytes of it are there).")
        )
    if clean.skipped_bytes or clean.rejected_messages or ulog.file_corruption or printed:
        lost = f", with them all of {', '.join(clean.lost_topics)}" if clean.lost_topics else ""
        findings.append(
            Finding(
                "corrupt_parts",
                f"Damaged parts were left out: {clean.skipped_bytes} bytes and {clean.rejected_messages} "
                f"messages{lost}.",
            )
        )
    if ulog.dropouts:
        total = sum(dropout.duration for dropout in ulog.dropouts) * 1e-3
        findings.append(
            Finding("dropouts", f"The logger lost data {len(ulog.dropouts)} times, {total:.3g} s in total.")
        )
    return findings


def _topics(ulog: Any, rows: Mapping[int, list[bytes]], findings: list[Finding]) -> dict[str, Topic]:
    """The instance of each topic that is used."""
    instances: dict[str, list[Topic]] = {}
    for data in ulog.data_list:
        fields = _table(data.data, rows[data.msg_id])
        instances.setdefault(data.name, []).append(Topic(data.name, int(data.multi_id), fields))
    return {
        name: choose_instance(candidates, findings if name in NEEDED_TOPICS else [])
        for name, candidates in instances.items()
    }


def _table(first: Mapping[str, np.ndarray], rows: list[bytes]) -> dict[str, np.ndarray]:
    """Fields of all messages of a topic, of the decoder's fields of the first."""
    layout = np.dtype([(name, values.dtype) for name, values in first.items()])
    table = np.frombuffer(b"".join(rows), dtype=layout)
    return {name: table[name] for name in first}
