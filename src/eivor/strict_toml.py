"""Strict reading of TOML tables: unknown keys and wrong types are refused."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from eivor.errors import InputError, did_you_mean, nearest_names

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

    def _take(self, key: str, expected: str, fits: Callable[[Any], bool], default: object = None) -> Any:
        self.taken.add(key)
        if key not in self.values and default is None:
            near = nearest_names(key, [name for name in self.values if name not in self.taken])
            meant = f" Is '{near[0]}' meant to be it?" if near else ""
            raise self.wrong(key, expected, "nothing", f"Add it.{meant}")
        value = self.values.get(key, default)
        if not fits(value):
            raise self.wrong(key, expected, repr(value))
        return value

    def text(self, key: str, default: str | None = None) -> str:
        """A text that is not empty."""
        return str(self._take(key, "a text in quotes", lambda v: _is_text(v) or v == default == "", default))

    def flag(self, key: str, *, default: bool) -> bool:
        """True or false."""
        return bool(self._take(key, "true or false", lambda value: isinstance(value, bool), default))

    def whole(self, key: str, default: int | None = None) -> int:
        """A whole number."""
        return int(self._take(key, "a whole number", lambda value: type(value) is int, default))

    def number(self, key: str, default: float | None = None) -> float:
        """A finite number, see `LARGEST_NUMBER`."""
        return self._sized(key, [self._take(key, "a finite number", _is_number, default)])[0]

    def numbers(self, key: str, default: tuple[float, ...] | None = None) -> tuple[float, ...]:
        """A list of finite numbers."""
        return self._sized(key, self._take(key, "a list of numbers", _list_of(_is_number), default))

    def _sized(self, key: str, values: Iterable[float]) -> tuple[float, ...]:
        for value in values:
            if value and not SMALLEST_NUMBER <= abs(value) <= LARGEST_NUMBER:
                expected = f"zero, or numbers of {SMALLEST_NUMBER:g} to {LARGEST_NUMBER:g} in size,"
                raise self.wrong(key, expected, repr(float(value)))
        return tuple(map(float, values))

    def texts(self, key: str) -> tuple[str, ...]:
        """A list of texts."""
        return tuple(self._take(key, "a list of texts", _list_of(_is_text)))

    def span(self, key: str) -> tuple[int, int]:
        """Two whole numbers, the first not above the second."""
        value = self._take(key, "[first, last], both whole numbers", _list_of(lambda item: type(item) is int))
        if len(value) != 2 or value[0] > value[1]:
            raise self.wrong(key, "[first, last], both whole numbers", repr(value))
        return value[0], value[1]

    def choice(self, key: str, among: tuple[str, ...], default: str | None = None) -> str:
        """One of some words."""
        expected = f"one of {', '.join(word or repr(word) for word in among)}"
        value = self._take(key, expected, lambda _: True, default)
        if value not in among:
            remedy = did_you_mean(str(value), among, "Choose one of them.")
            raise self.wrong(key, expected, repr(value), remedy)
        return str(value)

    def rows(self, key: str) -> TomlTable:
        """A list as a table whose keys are the places in it."""
        value = self._take(key, "a list", lambda value: isinstance(value, list))
        return self.part({f"{key}[{number}]": item for number, item in enumerate(value, start=1)}, self.path)

    def section(self, key: str) -> TomlTable:
        """A table in this one."""
        value = self._take(key, f"a table [{key}]", lambda value: isinstance(value, dict))
        return self.part(value, ".".join(part for part in (self.path, key) if part))

    def named_sections(self, key: str) -> dict[str, TomlTable]:
        """Tables in a table of this one, by name; none when there is no such key."""
        outer = self.section(key) if self.has(key) else self.part({}, key)
        return {name: outer.section(name) for name in outer.values}

    def sections(self, key: str) -> tuple[TomlTable, ...]:
        """A list of tables."""
        tables = _list_of(lambda item: isinstance(item, dict))
        value = self._take(key, f"one table [[{key}]] or more", lambda value: value and tables(value))
        return tuple(self.part(item, f"{key}[{number}]") for number, item in enumerate(value, start=1))

    def finish(self) -> None:
        """Refuse keys that nobody took."""
        for key in (key for key in self.values if key not in self.taken):
            known = sorted(self.taken)
            expected, remedy = f"no keys but {', '.join(known)}", did_you_mean(key, known, "Remove it.")
            raise self.wrong("", expected, f"the unknown key '{key}'", remedy)


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


def _is_text(value: object) -> bool:
    return isinstance(value, str) and value != ""


def _list_of(fits: Callable[[Any], bool]) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, list | tuple) and all(map(fits, value))
