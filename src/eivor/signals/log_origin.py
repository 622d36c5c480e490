"""Where a log comes from: which machine wrote it, with what, and when."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from eivor import checks

#: A clock that was never set tells a time before this, and one that is damaged a time after [UTC].
EARLIEST, LATEST = datetime(2000, 1, 1, tzinfo=UTC), datetime(2100, 1, 1, tzinfo=UTC)


@dataclass(frozen=True, slots=True)
class LogOrigin:
    """What a log says of the machine that wrote it; empty where it says nothing.

    Parameters
    ----------
    board : str
        Unique id of the board.
    airframe : str
        Which kind of vehicle the firmware was set up for, by the firmware's own word.
    firmware : str
        Name and version.
    start : datetime, optional
        First second of the log (its time 0), UTC.
    """

    board: str = ""
    airframe: str = ""
    firmware: str = ""
    start: datetime | None = None

    def __post_init__(self) -> None:
        for name in ("board", "airframe", "firmware"):
            checks.text(name, getattr(self, name))
        if self.start is not None:
            checks.kind("start", self.start, datetime, "a datetime", "Give one with its time zone.")


def utc_time(seconds: float) -> datetime | None:
    """Time of seconds since 1970; None of a clock that was never set.

    Parameters
    ----------
    seconds : float
        Since 1970-01-01 UTC [s].
    """
    try:
        told = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=seconds)
    except (OverflowError, ValueError):
        return None
    return told if EARLIEST <= told <= LATEST else None
