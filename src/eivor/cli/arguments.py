"""From what is typed to what the library takes: shared options, logs with windows, names, files."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from eivor.errors import EivorError, InputError, UsageError

#: Formats of a figure, by the file's extension.
FIGURE_FORMATS = (".png", ".svg", ".pdf")
#: The word for standard output.
STANDARD_OUTPUT = "-"

Window = tuple[float, float]

#: Options that several commands have.
MapOption = Annotated[
    str,
    typer.Option(
        "--map",
        metavar="FILE.toml",
        help="Channel map of a table, or the name of a shipped one: nanobench, rotorpy.",
        show_default=False,
    ),
]
JsonOption = Annotated[
    str,
    typer.Option(
        "--json",
        metavar="FILE|-",
        help="Write JSON; - prints it instead of the table.",
        show_default=False,
    ),
]


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
    start_text, colon, end_text = text.partition(":")
    try:
        start = float(start_text) if start_text.strip() else -math.inf
        end = float(end_text) if end_text.strip() else math.inf
    except ValueError:
        start = end = math.nan
    if not colon or not start < end:
        raise UsageError(
            "a window START:END with START before END",
            f"'{text}'",
            "Give both in seconds from the log's start, such as 4:67; one of them may be left out.",
        )
    return start, end


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


def output_file(text: str, *, option: str, logs: list[LogArgument]) -> Path:
    """Path of a file that can be written, as far as one can know beforehand.

    Raises
    ------
    UsageError
        When it is one of the logs, or a folder.
    InputError
        When its folder does not exist or may not be written.
    """
    path = Path(text)
    if path.is_dir() or not path.name:
        raise UsageError(f"a file for {option}", f"the folder '{text}'", "Add a file name.")
    if any(log.path.exists() and path.exists() and path.samefile(log.path) for log in logs):
        raise UsageError(
            f"a file for {option} other than the logs", f"'{text}'", "Choose another name: it would be lost."
        )
    folder = path.parent
    if not folder.is_dir() or not os.access(path if path.exists() else folder, os.W_OK):
        problem = "which may not be written" if folder.is_dir() else f"whose folder '{folder}' does not exist"
        raise InputError(
            f"a file for {option} that can be written", f"'{text}', {problem}", "Choose another."
        )
    return path


def figure_file(text: str, *, logs: list[LogArgument]) -> Path:
    """Path of a figure, see `output_file`.

    Raises
    ------
    UsageError
        When the extension is of no format that can be drawn.
    InputError
        See `output_file`.
    """
    if Path(text).suffix.lower() not in FIGURE_FORMATS:
        raise UsageError(
            f"a figure that ends in {', '.join(FIGURE_FORMATS)}",
            f"'{text}'",
            "The ending chooses the format.",
        )
    return output_file(text, option="--figure", logs=logs)


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn the system's error for an output file into one of Eivor's.

    Raises
    ------
    InputError
        When the file could not be written after all.
    """
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(
            "a file that can be written", f"'{path}', for which the system says: {reason}", "Choose another."
        ) from error


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
