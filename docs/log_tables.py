"""Write the tables of docs/logs.md: where autopilots log each channel, how often, and units of maps.

    python -m docs.log_tables

A test compares the page with what this would write.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path

from eivor.logs.common import UNITS
from eivor.logs.crazyflie import LOOKED_FOR as VARIABLES
from eivor.logs.dataflash.sources import LOOKED_FOR as COLUMNS
from eivor.logs.rosbag.channels import ROS_SOURCES as FIELDS
from eivor.logs.ulog.channels import LOGGING, LOOKED_FOR, PROFILE_BITS
from validation.pages import markdown, page_with

PAGE = Path(__file__).resolve().parent / "logs.md"


def parts() -> dict[str, str]:
    """Generated parts of the page by name."""
    return {
        "ulog sources": ulog_sources(),
        "ulog rates": ulog_rates(),
        "dataflash sources": dataflash_sources(),
        "crazyflie sources": crazyflie_sources(),
        "ros sources": ros_sources(),
        "units": units(),
    }


def code(words: Iterable[str], joint: str = ", ") -> str:
    """Words as inline code."""
    return joint.join(f"`{word}`" for word in words)


def ulog_sources() -> str:
    """Where each channel is looked for in a ULog."""
    rows = (
        (code([name]), code((source.partition(" [")[0] for source in sources), "<br>"))
        for name, sources in LOOKED_FOR.items()
    )
    return markdown(("channel", "topics and fields, in order of preference"), rows)


def ulog_rates() -> str:
    """How often PX4 logs each topic."""
    rows = []
    for topic, row in LOGGING.items():
        always = row["default_rate_hz"] == float("inf")
        bits = [f"{bit} ({PROFILE_BITS[bit]})" for bit in row.get("full_rate_bits", ()) if bit != 0]
        raised = "-" if always else " or ".join(bits) or "none; see `logger_topics.txt` below"
        rows.append((code([topic]), "every message" if always else f"{row['default_rate_hz']:g} Hz", raised))
    return markdown(("topic", "default profile", "full rate with bit"), rows)


def dataflash_sources() -> str:
    """Where each channel is looked for in a DataFlash log."""
    rows = ((code([name]), code(columns, "<br>")) for name, columns in COLUMNS.items())
    return markdown(("channel", "messages and columns, in order of preference"), rows)


def crazyflie_sources() -> str:
    """Where each channel is looked for in a Crazyflie's log."""
    rows = ((code([name]), code(variables, "<br>")) for name, variables in VARIABLES.items())
    return markdown(("channel", "variables, in order of preference"), rows)


def ros_sources() -> str:
    """Where each channel is looked for in a bag of mavros, or of plain messages."""
    rows = (
        (code([name]), code(fields, "<br>"))
        for name, fields in FIELDS.items()
        if not name.rpartition("_")[2].isdigit() or name.endswith("_1")
    )
    return markdown(("channel", "topics or types, and fields, in order of preference"), rows)


def units() -> str:
    """Units that a channel map may name."""
    rows = ((code([unit or '""']), f"{factor:.6g} {si}".strip()) for unit, (si, factor) in UNITS.items())
    return markdown(("unit", "in SI"), rows)


if __name__ == "__main__":
    PAGE.write_text(page_with(PAGE.read_text(encoding="utf-8"), parts()), encoding="utf-8")
    sys.stdout.write(f"{PAGE}\n")
