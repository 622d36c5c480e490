"""Strict reading of TOML tables into declared structures: unknown keys and wrong types are refused."""

from __future__ import annotations

import math
import os
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec
from msgspec import inspect

from eivor.errors import InputError, did_you_mean, nearest_names

T = TypeVar("T")
#: A text that is not empty.
Text = Annotated[str, msgspec.Meta(min_length=1)]

#: Larger files are not studies.
LARGEST_BYTES = 1_000_000
#: Size of numbers, apart from zero: beyond it products of a few of them overflow or vanish.
SMALLEST_NUMBER, LARGEST_NUMBER = 1e-30, 1e30
#: Of TOML's integers, the sign included.
INTEGER_BITS = 64
#: Types of values in words, one and several.
WORDS: Mapping[type[inspect.Type], tuple[str, str]] = {
    inspect.FloatType: ("a finite number", "numbers"),
    inspect.IntType: ("a whole number", "whole numbers"),
    inspect.StrType: ("a text in quotes", "texts"),
    inspect.BoolType: ("true or false", "flags"),
    inspect.ListType: ("a list", "lists"),
}
_PLACE = re.compile(r"(.*?)(?: - at `(?:key in )?\$(.*)`)?", re.DOTALL)
_STEP = re.compile(r"\.([^.\[]+)|\[(\d+)\]")


@dataclass(frozen=True, slots=True)
class TomlTable:
    """A table of a file."""

    values: Mapping[str, Any]  # Keys and values as read
    file: str  # Name of the file, for messages
    path: str = ""  # Keys of the tables that it is in
    folder: Path = Path()
    files: set[Path] = field(default_factory=set)  # Files that were read
    error: type[InputError] = InputError
    text: str = ""  # Of the file, where messages name lines
    remedy: str = "Correct the file."  # Of errors without another

    def convert(self, kind: type[T]) -> T:
        """Return the table as a structure, a `msgspec.Struct`; refuse what it does not declare."""
        try:
            return msgspec.convert(self.values, kind)
        except msgspec.ValidationError as error:
            raise self._refusal(kind, str(error)) from None

    def part(self, key: str, values: Any = None) -> TomlTable:
        """A table in this one, by default that of a key."""
        values = self.values.get(key) if values is None else values
        if not isinstance(values, dict):
            raise self.wrong(key, f"a table [{key}]", "nothing" if values is None else repr(values))
        return replace(self, values=values, path=".".join(filter(None, (self.path, key))))

    def parts(self, key: str) -> dict[str, TomlTable]:
        """Tables in the table of a key, by name; none when there is no such key."""
        if key not in self.values:
            return {}
        outer = self.part(key)
        return {name: outer.part(name) for name in outer.values}

    def neighbour(self, name: str, what: str) -> TomlTable:
        """Top table of a file beside this one, see `read_toml`."""
        table = read_toml(self.folder / name, what)
        self.files.update(table.files)
        return replace(table, files=self.files)

    def wrong(self, key: str, expected: str, received: str, remedy: str = "", line: int = 0) -> InputError:
        """Return the error for a key, on its own line or a known one."""
        where = ".".join(part for part in (self.path, key) if part) or "the top"
        line = line or self._line(where.partition("[")[0])
        position = f"{where} of {self.file}{f', line {line}' if line else ''}"
        return self.error(f"{expected} at {position}", received, remedy or self.remedy)

    def _line(self, where: str) -> int:
        """Number of the line that holds a key, or the table or key around it; zero where none is known."""
        heading, best, depth = "", 0, 0
        for number, line in enumerate(self.text.splitlines(), 1):
            stripped = line.strip()
            table = re.match(r"\[+([^\]]+)\]", stripped)
            key = re.match(r"([\w.\"'-]+)\s*=", stripped)
            heading = table[1].strip() if table else heading
            words = heading if table else ".".join(filter(None, (heading, key[1]))) if key else ""
            words = re.sub("[\"']", "", words)
            if words and f"{where}.".startswith(f"{words}.") and len(words) > depth:
                best, depth = number, len(words)
        return best

    def choose(self, key: str, value: str, choices: tuple[str, ...]) -> str:
        """The value of a key, which is one of some words."""
        if value not in choices:
            expected = f"one of {', '.join(word or repr(word) for word in choices)}"
            received, remedy = repr(value) if value else "nothing", "Choose one of them."
            raise self.wrong(key, expected, received, did_you_mean(str(value), choices, remedy))
        return value

    def _refusal(self, kind: type, text: str) -> InputError:
        """Error of a table that is not of a kind, from the message of msgspec."""
        match = _PLACE.fullmatch(text)
        reason, path = (text, "") if match is None else (match[1], match[2] or "")
        expected, received, remedy, line = reason, "another value", "", 0
        declared, value, where = inspect.type_info(kind), self.values, ""
        for name, number in _STEP.findall(path):
            declared = _type_inside(declared, name)
            value = value[name] if name else value[int(number)]  # type: ignore[index]
            where += f"[{int(number) + 1}]" if number else f".{name}" if where else name
        tables = [item for item in _members(declared) if isinstance(item, inspect.StructType)]
        keys = {item.encode_name: item.type for table in tables for item in table.fields}
        quoted = re.findall(r"`([^`]*)`", reason)
        choices = [item for item in _members(declared) if isinstance(item, inspect.EnumType)]
        if reason.startswith("Object contains unknown"):
            expected, received = f"no keys but {', '.join(sorted(keys))}", f"the unknown key '{quoted[0]}'"
            remedy = did_you_mean(quoted[0], keys, "Remove it.")
            line = self._line(".".join(filter(None, (self.path, where, quoted[0]))))
        elif reason.startswith("Object missing"):
            expected, received = _words(keys[quoted[0]]), "nothing"
            nearest = nearest_names(quoted[0], [name for name in value if name not in keys])
            remedy = f"Add it.{f''' Is '{nearest[0]}' meant to be it?''' if nearest else ''}"
            where = f"{where}.{quoted[0]}" if where else quoted[0]
        elif choices:
            allowed = [member.value for member in choices[0].cls]
            expected, received = f"one of {', '.join(allowed)}", repr(value)
            remedy = did_you_mean(str(value), allowed, "Choose one of them.")
        else:
            limit = re.search(r"of length .*|[<>]=? .*", reason.partition(" - ")[0])
            expected = f"{_words(declared)}{f' {limit[0]}' if limit else ''}"
            received = repr(value)[:200]
        return self.wrong(where, expected, received, remedy, line)


def _type_inside(declared: inspect.Type, name: str) -> inspect.Type:
    """Type of a key, or of the items where there is no name."""
    for item in _members(declared):
        if name and isinstance(item, inspect.StructType):
            return next(entry.type for entry in item.fields if entry.encode_name == name)
        if not name and isinstance(item, inspect.ListType | inspect.VarTupleType):
            return item.item_type
    return inspect.AnyType()


def _members(declared: inspect.Type) -> tuple[inspect.Type, ...]:
    return declared.types if isinstance(declared, inspect.UnionType) else (declared,)


def _words(declared: inspect.Type) -> str:
    """Type of a value in words."""
    words = []
    for item in _members(declared):
        word, _ = WORDS.get(type(item), ("a table", ""))
        if isinstance(item, inspect.ListType):
            plurals = {WORDS.get(type(entry), ("", "tables"))[1] for entry in _members(item.item_type)}
            word = f"a list of {' or '.join(sorted(plurals))}"
        if not isinstance(item, inspect.NoneType):
            words.append(word)
    return " or ".join(words)


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


def package_tables(package: str, file: str = "sources.toml") -> dict[str, Any]:
    """Tables of a file that comes with a package."""
    return tomllib.loads((resources.files(package) / file).read_text(encoding="utf-8"))


ENDING = ".toml"


@dataclass(frozen=True)
class TomlFiles:
    """Files of one kind: those that come with Eivor in a folder of a package, and a user's own."""

    package: str
    folder: str
    what: str  # A file of the kind, in words
    remedy: str  # What to do about a name that is none
    error: type[InputError] = InputError

    def names(self) -> tuple[str, ...]:
        """Names of those that come with Eivor."""
        names = (entry.name for entry in (resources.files(self.package) / self.folder).iterdir())
        return tuple(sorted(name.removesuffix(ENDING) for name in names if name.endswith(ENDING)))

    def text(self, source: str | os.PathLike[str]) -> str:
        """Text of such a name, or of a file."""
        shipped = resources.files(self.package) / self.folder / f"{source}{ENDING}"
        return (shipped if source in self.names() else Path(source)).read_text(encoding="utf-8")

    def table(self, source: str | os.PathLike[str]) -> TomlTable:
        """Top table of the same."""
        name, path, names = os.fspath(source), Path(source), self.names()
        if name in names:
            return toml_table(self.text(name), Path(f"{name}{ENDING}"), self.what, self.error)
        known = path.suffix == ENDING or path.parent != Path()
        if not known and not os.path.isfile(path):  # noqa: PTH113 - Path.is_file raises for long names
            expected = f"{self.what}: a file that ends in {ENDING}, or one of {', '.join(names)}"
            raise self.error(expected, f"'{name}', which is no file", did_you_mean(name, names, self.remedy))
        return read_toml(path, self.what, self.error)


def toml_table(text: str, path: Path, what: str, error: type[InputError] = InputError) -> TomlTable:
    """Top table of the text of a file; see `read_toml`."""
    try:
        values = tomllib.loads(text)
    except (ValueError, RecursionError) as cause:  # of a number with thousands of digits a plain ValueError
        raise error(f"{what} in TOML", f"'{path}', which is not: {cause}", "Correct the syntax.") from cause
    table = TomlTable(values, path.name, folder=path.parent, files={path}, error=error)
    _check_numbers(table)
    return table


def _check_numbers(table: TomlTable) -> None:
    """Refuse integers that TOML does not have, which the parser takes, and numbers that overflow."""
    waiting: list[tuple[str, object]] = list(table.values.items())
    while waiting:
        position, value = waiting.pop()
        if isinstance(value, dict):
            waiting += [(f"{position}.{key}", item) for key, item in value.items()]
        elif isinstance(value, list):
            waiting += [(f"{position}[{number + 1}]", item) for number, item in enumerate(value)]
        elif isinstance(value, int) and value.bit_length() >= INTEGER_BITS:
            received = f"one of {value.bit_length() + 1}"
            raise table.wrong(position, f"whole numbers of {INTEGER_BITS} bits", received)
        elif isinstance(value, float) and not math.isfinite(value):
            raise table.wrong(position, "a finite number", repr(value))
        elif isinstance(value, float) and value and not SMALLEST_NUMBER <= abs(value) <= LARGEST_NUMBER:
            expected = f"zero, or numbers of {SMALLEST_NUMBER:g} to {LARGEST_NUMBER:g} in size,"
            raise table.wrong(position, expected, repr(value))
