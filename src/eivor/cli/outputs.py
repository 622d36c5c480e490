"""Files that a command writes: checked before the work begins, and written whole when it is done.

No output replaces a file that the command reads, and the report is printed whatever happens to the files.
"""

from __future__ import annotations

import inspect
import os
import stat
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from fnmatch import fnmatchcase
from glob import escape
from itertools import combinations
from pathlib import Path
from typing import Any
from unicodedata import normalize

from eivor.cli.arguments import STANDARD_OUTPUT, Reads, Writes
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
    """Path of a figure.

    Raises
    ------
    UsageError
        When the extension is of no format that can be drawn.
    """
    path = Path(text)
    if path.suffix.lower() not in FIGURE_FORMATS:
        raise UsageError(
            f"a figure that ends in {', '.join(FIGURE_FORMATS)}",
            f"'{text}'",
            "The ending chooses the format.",
        )
    return path


@dataclass(frozen=True, slots=True)
class _Output:
    """A file or a folder that the command writes, and the option that names it."""

    option: str
    path: Path
    inside: tuple[str, ...]

    def replaced(self) -> Iterator[Path]:
        """Files that exist and that the command may replace."""
        if str(self.path) != STANDARD_OUTPUT:
            yield self.path
            for pattern in self.inside:
                yield from self.path.glob(pattern)

    def writes(self, other: Path) -> bool:
        """Whether the command writes a path through this option, as the file or as one of the folder."""
        own, path = _spelling(self.path), _spelling(other)
        if any(fnmatchcase(path, f"{escape(own)}/{one}") for one in self.inside):
            return True
        keys = _key(self.path), _key(other)
        return keys[0] == keys[1] if None not in keys else own == path and not _is_device(other)


#: Existing files that the command may replace, with the option that names each.
_replaced: ContextVar[Mapping[tuple[int, int], tuple[_Output, Path]]] = ContextVar("replaced")


def guard_outputs(context: Any) -> None:
    """Refuse a command whose outputs would replace a file that it reads, or each other.

    The parameters declare what they name (`Reads`, `Writes`); those of the groups above the command count.

    Parameters
    ----------
    context : typer.Context
        Of the command, with its parameters read.

    Raises
    ------
    UsageError
        When an output is a file that the command reads, another output, a folder, or a file of Eivor.
    InputError
        When an output cannot be written.
    """
    outputs = [
        _Output(name, Path(text), place.inside)
        for name, place, text in declared(context)
        if isinstance(place, Writes)
    ]
    existing = ((_key(path), (output, path)) for output in outputs for path in output.replaced())
    _replaced.set({key: found for key, found in existing if key is not None})
    above = context
    while above is not None:
        for name, place, text in declared(above):
            if isinstance(place, Reads):
                keep_inputs(name, place.paths(text))
        above = above.parent
    for first, second in combinations(outputs, 2):
        if first.writes(second.path) or second.writes(first.path):
            raise UsageError(
                f"different files for {first.option} and {second.option}",
                f"'{second.path}', which both would write",
                f"Give {second.option} another name.",
            )
    for output in outputs:
        if not output.inside and str(output.path) != STANDARD_OUTPUT:
            output_file(str(output.path), option=output.option)


def keep_inputs(name: str, paths: Iterable[Path]) -> None:
    """Refuse the outputs of the command that would replace one of these files.

    `guard_outputs` calls it for what the parameters name, a command for files that those files name.

    Parameters
    ----------
    name : str
        What names the files, for the message.
    paths : iterable of Path
        Files that the command reads; those that do not exist are ignored.

    Raises
    ------
    UsageError
        For the first one.
    """
    replaced = _replaced.get({})
    for source in paths if replaced else ():
        key = _key(source)
        if key is not None and key in replaced:
            output, path = replaced[key]
            raise UsageError(
                f"a name for {output.option} that replaces no file that the command reads",
                f"'{path}', which would replace '{source}' of {name}",
                f"Give {output.option} another name.",
            )


def declared(context: Any) -> Iterator[tuple[str, Reads | Writes, str]]:
    """Name, declaration and text of every parameter of a command that names files."""
    places = declarations(context.command)
    for parameter in context.command.params:
        place = places.get(parameter.name)
        given = context.params.get(parameter.name)
        if isinstance(place, Writes | Reads) and not given and place.default is not None:
            given = place.default(context.params)
        for text in given if isinstance(given, list | tuple) else (given,):
            if place is not None and text:
                yield _name(parameter), place, str(text)


def declarations(command: Any) -> dict[str, Reads | Writes]:
    """What the parameters of a command declare, by their names in the function."""
    known = inspect.signature(command.callback, eval_str=True).parameters if command.callback else {}
    return {
        name: place
        for name, parameter in known.items()
        for place in getattr(parameter.annotation, "__metadata__", ())
        if isinstance(place, Reads | Writes)
    }


def _name(parameter: Any) -> str:
    """How messages name a parameter: an option by its long form, an argument as the help shows it."""
    if parameter.param_type_name == "argument":
        return str(parameter.metavar).strip("[]")
    return max(map(str, parameter.opts), key=len)


def _key(path: Path) -> tuple[int, int] | None:
    """Device and number of an existing regular file; None of anything else."""
    try:
        status = path.stat()
    except (OSError, ValueError):
        return None
    return (status.st_dev, status.st_ino) if stat.S_ISREG(status.st_mode) else None


def _is_device(path: Path) -> bool:
    return path.exists() and not path.is_file() and not path.is_dir()


def _spelling(path: Path) -> str:
    """One spelling of a path: links followed, and names that some file systems take for one are one."""
    return normalize("NFC", os.path.realpath(path)).replace(os.sep, "/").casefold()


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
