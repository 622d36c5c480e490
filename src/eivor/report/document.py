"""Parts of a document, and printable text."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TypeAlias

from eivor.inference.verdict import Status

# -- Printable --

#: Names of logs are cut to so many letters in titles.
LONGEST_NAME = 48


def printable(text: str) -> str:
    r"""`text` with everything that a terminal or a figure would act on made visible.

    Control characters (the escape character, line breaks), marks that turn the reading direction and
    bytes that are no text become backslash escapes; letters of any script stay.
    """
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def short_name(name: str) -> str:
    """Name of a log, cut where it is too long for a title."""
    return name if len(name) <= LONGEST_NAME else f"{name[: LONGEST_NAME - 1]}…"


# -- Document --


class Tone(Enum):
    """How the second lines of a column are meant."""

    PLAIN = "plain"
    FAINT = "faint"
    WARNING = "warning"


@dataclass(frozen=True, slots=True)
class Bullets:
    """Sentences, one below the other.

    Parameters
    ----------
    sentences : tuple of str
        In their order.
    """

    sentences: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Fact:
    """Something told, with its label.

    Parameters
    ----------
    label : str
        A word; empty for what continues the fact above.
    told : str or Bullets
        The text.
    """

    label: str
    told: str | Bullets


@dataclass(frozen=True, slots=True)
class Facts:
    """Facts, one below the other.

    Parameters
    ----------
    facts : tuple of Fact
        In their order.
    """

    facts: tuple[Fact, ...]


@dataclass(frozen=True, slots=True)
class TableColumn:
    """A column of a table.

    Parameters
    ----------
    title : str
        May be empty.
    right : bool
        Texts end at the right.
    strong : bool
        Texts are what a reader looks for.
    whole : bool
        No line is broken, as numbers are not.
    below : Tone
        How second lines are meant.
    """

    title: str
    right: bool = False
    strong: bool = False
    whole: bool = False
    below: Tone = Tone.PLAIN


@dataclass(frozen=True, slots=True)
class Cell:
    """A cell of a table.

    Parameters
    ----------
    text : str
        The first line.
    below : str
        The second; may be empty.
    status : Status or None
        The verdict that the last line says.
    link : str
        Relative address of what the first line names, for media that have links; may be empty.
    """

    text: str
    below: str = ""
    status: Status | None = None
    link: str = ""


@dataclass(frozen=True, slots=True)
class TableOf:
    """Rows of cells under columns.

    Parameters
    ----------
    columns : tuple of TableColumn
        The first one says what a row is about.
    rows : tuple of tuple of Cell
        A cell for each column.
    """

    columns: tuple[TableColumn, ...]
    rows: tuple[tuple[Cell, ...], ...]


@dataclass(frozen=True, slots=True)
class Statement:
    """A verdict, in a line of its own.

    Parameters
    ----------
    text : str
        The verdict.
    status : Status
        What it amounts to.
    more : str
        What follows it in the line.
    """

    text: str
    status: Status
    more: str = ""


@dataclass(frozen=True, slots=True)
class Figure:
    """A place for a figure; a medium that has none leaves it out.

    Parameters
    ----------
    name : str
        Which one.
    """

    name: str


Part: TypeAlias = Facts | TableOf | Bullets | Statement | Figure


@dataclass(frozen=True, slots=True)
class Section:
    """Parts under a heading.

    Parameters
    ----------
    heading : str
        May be empty.
    parts : tuple of Part
        In their order.
    """

    heading: str
    parts: tuple[Part, ...]


@dataclass(frozen=True, slots=True)
class Document:
    """What is told, from its verdict to its details.

    Parameters
    ----------
    title : str
        What it is about; empty for a document that goes on with those before it.
    status : Status or None
        The overall verdict, when there is one.
    about : str
        What that verdict means; without one, what the title's subject is.
    sections : tuple of Section
        What matters most comes first.
    """

    title: str
    status: Status | None
    about: str
    sections: tuple[Section, ...]
