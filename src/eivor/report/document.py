"""Parts of a document, and printable text."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import Enum
from typing import Any, TypeAlias

from eivor.inference.verdict import Status


def shortened(text: str, most: int = 48) -> str:
    """Text, such as a log's name in a title, cut where it is too long."""
    return text if len(text) <= most else f"{text[: most - 1]}…"


class Tone(Enum):
    """How the second lines of a column are meant."""

    PLAIN = "plain"
    FAINT = "faint"
    WARNING = "warning"


@dataclass(frozen=True, slots=True)
class Bullets:
    """Sentences, one below the other."""

    sentences: tuple[str, ...]


def bullets(sentences: Iterable[str]) -> tuple[Bullets, ...]:
    """Sentences as a part of a section; no part of none."""
    there = tuple(sentences)
    return (Bullets(there),) if there else ()


@dataclass(frozen=True, slots=True)
class Facts:
    """Texts with their labels, one below the other."""

    facts: tuple[tuple[str, str | Bullets], ...]


@dataclass(frozen=True, slots=True)
class TableColumn:
    """A column of a table."""

    title: str  # May be empty
    right: bool = False  # Texts end at the right
    strong: bool = False
    whole: bool = False  # No line is broken, as numbers are not
    below: Tone = Tone.PLAIN


@dataclass(frozen=True, slots=True)
class Cell:
    """A cell of a table."""

    text: str  # The first line
    below: str = ""
    status: Status | None = None
    link: str = ""


@dataclass(frozen=True, slots=True)
class TableOf:
    """Rows of cells under columns."""

    columns: tuple[TableColumn, ...]
    rows: tuple[tuple[Cell, ...], ...]  # A cell for each column


def table(columns: Iterable[str | TableColumn], rows: Iterable[Iterable[str | Cell]]) -> TableOf:
    """Table of cells and columns, each of which may be its text alone."""
    titled = tuple(TableColumn(item) if isinstance(item, str) else item for item in columns)
    cells = (tuple(Cell(item) if isinstance(item, str) else item for item in row) for row in rows)
    return TableOf(titled, tuple(cells))


class Look(Enum):
    """How the lines of a card look: green, amber, grey; red of contradictions and damage."""

    IDENTIFIED = Status.IDENTIFIED.value
    ROUGH = Status.WEAK.value
    MISSING = Status.REFUSED.value
    CONTRADICTED = "contradicted"


@dataclass(frozen=True, slots=True)
class Statement:
    """A verdict, in a line of its own."""

    text: str
    look: Look
    more: str = ""


@dataclass(frozen=True, slots=True)
class Figure:
    """A place for a figure; a medium that has none leaves it out."""

    name: str


@dataclass(frozen=True, slots=True)
class CardLine:
    """A quantity with its number, or quantities with the reason why they have none."""

    words: str
    text: str  # The number, or the reason
    interval: str = ""
    unit: str = ""
    setting: str = ""  # The autopilot's parameter, old and new
    remark: str = ""  # What is said of the setting, or what to do
    command: str = ""  # That sets the parameter
    quantity: str = ""  # Name of the one that has a number
    symbol: str = ""

    @property
    def number(self) -> str:
        return f"{self.text} {self.interval} {self.unit}".rstrip()


@dataclass(frozen=True, slots=True)
class CardGroup:
    """Lines of one look."""

    look: Look
    heading: str
    lines: tuple[CardLine, ...]


@dataclass(frozen=True, slots=True)
class Card:
    """What comes first: the most useful number, and what else is and is not identified."""

    title: str
    look: Look
    groups: tuple[CardGroup, ...]


Part: TypeAlias = Facts | TableOf | Bullets | Statement | Figure


@dataclass(frozen=True, slots=True)
class Section:
    """Parts under a heading."""

    heading: str  # May be empty
    parts: tuple[Part, ...]


def section(heading: str, part: type[Bullets] | type[Facts], record: Iterable[Any]) -> Iterator[Section]:
    """Section of one part, unless there is nothing to report."""
    result = tuple(record)
    if result:
        yield Section(heading, (part(result),))


@dataclass(frozen=True, slots=True)
class Document:
    """What is identified, from its card to its details."""

    title: str
    about: str
    sections: tuple[Section, ...]
    card: Card | None = None
