"""Results of flights whose motors have a known curve: logs of autopilots, read and identified."""

from __future__ import annotations

import json
import os
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import eivor as ev
import shape_checks
from coarse_search import coarse
from logs import dataflash_writer, ulog_writer

#: Share of the square in the thrust of every motor.
TRUE = 0.65
#: Share of thrust at hover, which every autopilot of the right curve hovers with.
HOVER = 0.25


@cache
def px4_log(in_force=0.3, outputs="actuator_motors", true=TRUE):
    """A ULog of a minute."""
    simulated = dataflash_writer.simulated(seed=3, duration=60.0)
    content: bytes = ulog_writer.flight_log(simulated, true, in_force, outputs).bytes()
    return content


@cache
def ardupilot_log(in_force=0.3, true=TRUE):
    """A DataFlash log of the same flight, motor outputs at 50 Hz."""
    simulated = dataflash_writer.simulated(seed=3, duration=60.0)
    content: bytes = dataflash_writer.flight_log(simulated, true=true, in_force=in_force, every=2).bytes()
    return content


def identified(log, **choices):
    """The document of its result."""
    document: dict[str, Any] = json.loads(_identified(log, **choices))
    return document


@cache
def _identified(log, **choices):
    with TemporaryDirectory() as folder, shape_checks.unchecked(), coarse():
        path = Path(folder) / ("flight.ulg" if log.startswith(b"ULog") else "flight.bin")
        path.write_bytes(log)
        return ev.identify_flight(ev.read_log(os.fspath(path)), **choices).to_json()


def curve_told(document):
    """What the report says of the curve."""
    return " ".join(item["message"] for item in document["findings"] if item["name"] == "thrust_curve")
