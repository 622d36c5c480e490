"""Strict reading of TOML tables: unknown keys and wrong types are refused."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

from eivor.errors import InputError, did_you_mean, nearest_names

T = TypeVar("T")

#: Larger files are not studies.
LARGEST_BYTES = 1_000_000
#: Size of numbers, apart from zero: beyond it products of a few of them overflow or vanish.
SMALLEST_NUMBER, LARGEST_NUMBER = 1e-30, 1e30
#: Of TOML's integers, the sign included.
INTEGER_BITS = 64


@dataclass(frozen=True, slots=True)
class TomlTable:
    """A table whose keys are taken one by one."""

    values: Mapping[str, Any]  # Keys and values as read
    file: str  # Name of the file, for messages
    path: str = ""
    taken: set[str] = field(default_factory=set)
    folder: Path = Path()
    files: set[Path] = field(default_factory=set)
    error: type[InputError] = InputError

    def part(self, values: Mapping[str, Any], path: str) -> TomlTable:
        """Table of the same file, none of whose keys was requested yet."""
        return replace(self, values=values, path=path, taken=set())

    def neighbour(self, key: str, what: str) -> TomlTable:
        """Top table of the file that a text names, which stands beside this one, see `read_toml`."""
        table = read_toml(self.folder / self.text(key), what)
        self.files.update(table.files)
        return replace(table, files=self.files)

    def wrong(self, key: str, expected: str, received: str, remedy: str = "Correct the file.") -> InputError:
        """Return the error for a key."""
        where = ".".join(part for part in (self.path, key) if part) or "the top"
        return self.error(f"{expected} at {where} of {self.file}", received, remedy)

    def has(self, key: str) -> bool:
        """Whether there is a key."""
        return key in self.values

    def _take(self, key: str, expected: str, default: T | None) -> Any:
        self.taken.add(key)
        if key not in self.values and default is None:
            raise self.wrong(key, expected, "nothing", "Add it." + self._near(key))
        return self.values.get(key, default)

    def _near(self, key: str) -> str:
        """A key that was perhaps meant to be this one."""
        near = nearest_names(key, [name for name in self.values if name not in self.taken])
        return f" Is '{near[0]}' meant to be it?" if near else ""

    def text(self, key: str, default: str | None = None) -> str:
        """A text that is not empty."""
        value = self._take(key, "a text in quotes", default)
        if not isinstance(value, str) or not (value or default == ""):
            raise self.wrong(key, "a text in quotes", repr(value))
        return value

    def flag(self, key: str, *, default: bool) -> bool:
        """True or false."""
        value = self._take(key, "true or false", default)
        if not isinstance(value, bool):
            raise self.wrong(key, "true or false", repr(value))
        return value

    def whole(self, key: str, default: int | None = None) -> int:
        """A whole number."""
        value = self._take(key, "a whole number", default)
        if isinstance(value, bool) or not isinstance(value, int):
            raise self.wrong(key, "a whole number", repr(value))
        return value

    def number(self, key: str, default: float | None = None) -> float:
        """A finite number, see `LARGEST_NUMBER`."""
        value = self._take(key, "a finite number", default)
        if not _is_number(value):
            raise self.wrong(key, "a finite number", repr(value))
        return self._sized(key, [float(value)])[0]

    def numbers(self, key: str, default: tuple[float, ...] | None = None) -> tuple[float, ...]:
        """A list of finite numbers."""
        value = self._take(key, "a list of numbers", default)
        if not isinstance(value, list | tuple) or not all(_is_number(item) for item in value):
            raise self.wrong(key, "a list of numbers", repr(value))
        return self._sized(key, [float(item) for item in value])

    def _sized(self, key: str, values: list[float]) -> tuple[float, ...]:
        for value in values:
            if value and not SMALLEST_NUMBER <= abs(value) <= LARGEST_NUMBER:
                expected = f"zero, or numbers of {SMALLEST_NUMBER:g} to {LARGEST_NUMBER:g} in size,"
                raise self.wrong(key, expected, repr(value))
        return tuple(values)

    def texts(self, key: str) -> tuple[str, ...]:
        """A list of texts."""
        value = self._take(key, "a list of texts", None)
        if not isinstance(value, list) or not all(isinstance(item, str) and item for item in value):
            raise self.wrong(key, "a list of texts", repr(value))
        return tuple(value)

    def span(self, key: str) -> tuple[int, int]:
        """Two whole numbers, the first not above the second."""
        value = self._take(key, "[first, last]", None)
        whole = isinstance(value, list) and all(type(item) is int for item in value)
        if not whole or len(value) != 2 or value[0] > value[1]:
            raise self.wrong(key, "[first, last], both whole numbers", repr(value))
        return value[0], value[1]

    def choice(self, key: str, among: tuple[str, ...], default: str | None = None) -> str:
        """One of some words."""
        expected = f"one of {', '.join(word or repr(word) for word in among)}"
        value = self._take(key, expected, default)
        if value not in among:
            remedy = did_you_mean(str(value), among, "Choose one of them.")
            raise self.wrong(key, expected, repr(value), remedy)
        return str(value)

    def rows(self, key: str) -> TomlTable:
        """A list as a table whose keys are the places in it."""
        value = self._take(key, "a list", None)
        if not isinstance(value, list):
            raise self.wrong(key, "a list", repr(value))
        positions = {f"{key}[{number + 1}]": item for number, item in enumerate(value)}
        return self.part(positions, self.path)

    def section(self, key: str) -> TomlTable:
        """A table in this one."""
        value = self._take(key, f"a table [{key}]", None)
        if not isinstance(value, dict):
            raise self.wrong(key, f"a table [{key}]", repr(value))
        return self.part(value, ".".join(part for part in (self.path, key) if part))

    def named_sections(self, key: str) -> dict[str, TomlTable]:
        """Tables in a table of this one, by name; none when there is no such key."""
        outer = self.section(key) if self.has(key) else self.part({}, key)
        return {name: outer.section(name) for name in outer.values}

    def sections(self, key: str) -> tuple[TomlTable, ...]:
        """A list of tables."""
        value = self._take(key, f"tables [[{key}]]", None)
        if not isinstance(value, list) or not value or not all(isinstance(item, dict) for item in value):
            raise self.wrong(key, f"one table [[{key}]] or more", repr(value))
        return tuple(self.part(item, f"{key}[{n + 1}]") for n, item in enumerate(value))

    def finish(self) -> None:
        """Refuse keys that nobody asked for."""
        for key in self.values:
            if key not in self.taken:
                raise self.wrong(
                    "",
                    f"no keys but {', '.join(sorted(self.taken))}",
                    f"the unknown key '{key}'",
                    did_you_mean(key, sorted(self.taken), "Remove it."),
                )


def read_toml(path: Path, what: str, error: type[InputError] = InputError) -> TomlTable:
    """Top table of a file."""
    expected = f"{what} in TOML"
    try:
        if path.is_file() and path.stat().st_size > LARGEST_BYTES:
            raise error(expected, f"'{path}', larger than {LARGEST_BYTES} bytes", "Check the name.")
        text = path.read_text(encoding="utf-8")
    except (OSError, ValueError) as cause:
        reason = getattr(cause, "strerror", None) or str(cause)
        raise error(expected, f"'{path}', unreadable: {reason}", "Check the name.") from cause
    return toml_table(text, path, what, error)


def toml_table(text: str, path: Path, what: str, error: type[InputError] = InputError) -> TomlTable:
    """Top table of the text of a file; see `read_toml`."""
    try:
        values = tomllib.loads(text)
    except (ValueError, RecursionError) as cause:  # of a number with thousands of digits a plain ValueError
        raise error(f"{what} in TOML", f"'{path}', which is not: {cause}", "Correct the syntax.") from cause
    table = TomlTable(values, path.name, folder=path.parent, files={path}, error=error)
    _check_integers(table)
    return table


def _check_integers(table: TomlTable) -> None:
    """Refuse integers that TOML does not have: the parser takes them, and no float or array does."""
    waiting: list[tuple[str, object]] = list(table.values.items())
    while waiting:
        position, value = waiting.pop()
        if isinstance(value, dict):
            waiting += [(f"{position}.{key}", item) for key, item in value.items()]
        elif isinstance(value, list):
            waiting += [(f"{position}[{number + 1}]", item) for number, item in enumerate(value)]
        elif isinstance(value, int) and value.bit_length() >= INTEGER_BITS:
            raise table.wrong(
                position, f"whole numbers of {INTEGER_BITS} bits", f"one of {value.bit_length() + 1}"
            )


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
