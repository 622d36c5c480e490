"""Words to what the library takes: logs with windows, lags, names."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from eivor.errors import EivorError, UsageError

if TYPE_CHECKING:
    from eivor.models.separable import Bounds, Prior

Window = tuple[float, float]


@dataclass(frozen=True, slots=True)
class LogArgument:
    """A log as given on the command line.

    Parameters
    ----------
    path : Path
        The file.
    window : tuple of float or None
        Its own window [s], when one was given as LOG@START:END.
    """

    path: Path
    window: Window | None = None


def log_argument(text: str) -> LogArgument:
    """Log of ``LOG`` or ``LOG@START:END``; a file that exists under the whole name wins.

    Raises
    ------
    UsageError
        When what follows the last @ has a colon and is no window.
    """
    name, at, tail = text.rpartition("@")
    if not at or not name or ":" not in tail or os.path.lexists(text):
        return LogArgument(Path(text))
    return LogArgument(Path(name), window(tail))


def window(text: str) -> Window:
    """Window of ``START:END`` in seconds; an end left out is that of the log.

    Raises
    ------
    UsageError
        When it is not two numbers, or START is not before END.
    """
    start, end = ends(text)
    if not start < end:
        raise UsageError(
            "a window START:END with START before END",
            f"'{text}'",
            "Give both in seconds from the log's start, such as 4:67; one of them may be left out.",
        )
    return start, end


def ends(text: str) -> Window:
    """Numbers on both sides of a colon, infinite where one is left out; NaN where there are none."""
    low_text, colon, high_text = text.partition(":")
    try:
        low = float(low_text) if low_text.strip() else -math.inf
        high = float(high_text) if high_text.strip() else math.inf
    except ValueError:
        colon = ""
    return (low, high) if colon else (math.nan, math.nan)


def lag(text: str) -> Prior | Bounds:
    """What is known of a lag [s], of ``MS:STD``, ``LOW..HIGH`` or ``none``.

    Raises
    ------
    UsageError
        When it is none of them: two numbers above zero, or two that are not below zero, in order.
    """
    from eivor.flights.given_lag import NO_LAG
    from eivor.models.separable import Bounds, Prior

    if text.strip().lower() == "none":
        return NO_LAG
    between = ".." in text
    first_text, _, second_text = text.partition(".." if between else ":")
    try:
        first, second = 1e-3 * float(first_text), 1e-3 * float(second_text)
    except ValueError:
        first = second = math.nan
    if between and 0.0 <= first <= second < math.inf:
        return Bounds(first, second)
    if not between and 0.0 < first < math.inf and 0.0 < second < math.inf:
        return Prior(first, second)
    raise UsageError(
        "a lag MS:STD, mean and standard deviation in milliseconds, both above zero; or bounds LOW..HIGH; or "
        "none",
        f"'{text}'",
        "Give 70:15 or 50..90, for example.",
    )


def names(text: str) -> tuple[str, ...]:
    """Names of a list with commas.

    Raises
    ------
    UsageError
        When the list is empty, or "references" or "lags" stand beside other names.
    """
    found = tuple(name.strip() for name in text.split(",") if name.strip())
    if not found or (len(found) > 1 and {"references", "lags"} & set(found)):
        raise UsageError(
            "instruments: references, lags, or names of channels with commas between them",
            f"'{text}'",
            "Give references or lags alone. `eivor inspect LOG` lists the channels.",
        )
    return found


@contextmanager
def named(name: str, *, several: bool) -> Iterator[None]:
    """Say in an error which of several logs it is about, unless it does so already.

    Raises
    ------
    EivorError
        The same kind that was raised inside.
    """
    try:
        yield
    except EivorError as error:
        if not several or Path(name).name in str(error):
            raise
        raise type(error)(error.expected, f"{error.received}, in {name}", error.remedy) from error
