"""Files that a command writes: looked at before the work begins, and written whole when it is done.

Nothing that a command reads may be lost to what it writes, and what it found is printed whatever happens
to its files.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from itertools import combinations
from pathlib import Path

from eivor.cli.arguments import STANDARD_OUTPUT
from eivor.cli.terminal import complain, write
from eivor.errors import EivorError, InputError, UsageError
from eivor.whole_file import try_place, write_whole

#: Formats of a figure, by the file's extension.
FIGURE_FORMATS = (".png", ".svg", ".pdf")
#: Folder of the package, whose examples, maps and scenarios are no place to write to.
PACKAGE = Path(__file__).resolve().parents[1]


def output_file(text: str, *, option: str) -> Path:
    """Path of a file that can be written.

    Raises
    ------
    UsageError
        When it is a folder, or lies inside Eivor itself.
    InputError
        When its folder does not exist or may not be written, or the system refuses for another reason.
    """
    path = Path(text)
    if os.path.isdir(path) or not path.name:  # noqa: PTH112 - that of Path fails for a name that is too long
        raise UsageError(f"a file for {option}", f"the folder '{text}'", "Add a file name.")
    if PACKAGE in Path(os.path.realpath(path)).parents:
        raise UsageError(
            f"a file for {option} of your own", f"'{text}', which belongs to Eivor", "Choose another."
        )
    try:
        folder_there = path.parent.is_dir()
        if folder_there:
            try_place(path)
            return path
        problem = f"whose folder '{path.parent}' does not exist"
    except PermissionError:
        problem = "which may not be written"
    except OSError as error:
        problem = f"for which the system says: {error.strerror or error}"
    raise InputError(f"a file for {option} that can be written", f"'{text}', {problem}", "Choose another.")


def figure_file(text: str) -> Path:
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
    return output_file(text, option="--figure")


def keep_apart(outputs: Mapping[str, Path], inputs: Mapping[str, Iterable[Path]]) -> None:
    """Refuse to write over what is read, or over another output.

    Parameters
    ----------
    outputs : mapping of str to Path
        What is written, by what it is for, such as an option.
    inputs : mapping of str to paths
        What is read, by what it is called; what does not exist is passed over.

    Raises
    ------
    UsageError
        For the first two that are one file.
    """
    for option, path in outputs.items():
        for what, files in inputs.items():
            if any(same_file(path, file) for file in files):
                raise UsageError(
                    f"a file for {option} other than {what}",
                    f"'{path}'",
                    "Choose another name: it would be lost.",
                )
    for (option, first), (other, second) in combinations(outputs.items(), 2):
        if same_file(first, second):
            raise UsageError(
                f"two files for {option} and {other}", f"'{second}' for both", "Choose another name."
            )


def same_file(first: Path, second: Path) -> bool:
    """Whether two paths lead to one file, under whatever names; a device is nobody's file."""
    try:
        if first.exists() and second.exists():
            return first.samefile(second) and first.is_file()
    except OSError:
        return False
    return os.path.normcase(os.path.realpath(first)) == os.path.normcase(os.path.realpath(second))


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


def write_out(text: str, place: str) -> None:
    """Write text to a file, whole, or to standard output where the place is "-".

    Raises
    ------
    InputError
        When the system refuses the file.
    """
    if place == STANDARD_OUTPUT:
        write(text)
        return
    with writing(Path(place)):
        write_whole(Path(place), text)


def deliver(*parts: Callable[[], None]) -> None:
    """Do every part, whatever happens to those before it.

    Parameters
    ----------
    *parts : callable
        What prints comes first, so that it is there when a file cannot be written.

    Raises
    ------
    EivorError, OSError
        The first that a part raised, once all were tried; the others are told on standard error.
    """
    errors: list[EivorError | OSError] = []
    for part in parts:
        try:
            part()
        except (EivorError, OSError) as error:
            errors.append(error)
    for later in errors[1:]:
        complain(str(later))
    if errors:
        raise errors[0]
