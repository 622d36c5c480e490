"""Parts of a document, and quantities as its rows: their words, and their numbers as texts."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any, TypeAlias

import msgspec

from eivor.flights.quantity import Quantity, QuantitySpec
from eivor.inference.verdict import Status


def shortened(text: str, most: int = 48) -> str:
    """Text, such as a log's name in a title, cut where it is too long."""
    return text if len(text) <= most else f"{text[: most - 1]}…"


class Tone(Enum):
    """How the second lines of a column are meant."""

    PLAIN = "plain"
    FAINT = "faint"
    WARNING = "warning"


class Bullets(msgspec.Struct, frozen=True):
    """Sentences, one below the other."""

    sentences: tuple[str, ...]


def bullets(sentences: Iterable[str]) -> tuple[Bullets, ...]:
    """Sentences as a part of a section; no part of none."""
    there = tuple(sentences)
    return (Bullets(there),) if there else ()


class Facts(msgspec.Struct, frozen=True):
    """Texts with their labels, one below the other."""

    facts: tuple[tuple[str, str | Bullets], ...]


class TableColumn(msgspec.Struct, frozen=True):
    """A column of a table."""

    title: str  # May be empty
    right: bool = False  # Texts end at the right
    strong: bool = False
    whole: bool = False  # No line is broken, as numbers are not
    below: Tone = Tone.PLAIN


class Cell(msgspec.Struct, frozen=True):
    """A cell of a table."""

    text: str  # The first line
    below: str = ""
    status: Status | None = None
    link: str = ""


class TableOf(msgspec.Struct, frozen=True):
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


class Statement(msgspec.Struct, frozen=True):
    """A verdict, in a line of its own."""

    text: str
    look: Look
    more: str = ""


class Figure(msgspec.Struct, frozen=True):
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


class CardGroup(msgspec.Struct, frozen=True):
    """Lines of one look."""

    look: Look
    heading: str
    lines: tuple[CardLine, ...]


class Card(msgspec.Struct, frozen=True):
    """What comes first: the most useful number, and what else is and is not identified."""

    title: str
    look: Look
    groups: tuple[CardGroup, ...]


Part: TypeAlias = Facts | TableOf | Bullets | Statement | Figure


class Section(msgspec.Struct, frozen=True):
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


# -- Quantities --

#: What to print where there is no number.
NO_NUMBER = "–"
#: Values outside this range are written with an exponent.
PLAIN_RANGE = (1e-3, 1e6)
#: The verdict on what is identified to be at most so large.
BOUND = "bound"


class QuantityRow(msgspec.Struct, frozen=True):
    """A quantity of a result with its words: a row of every screen, page and JSON document."""

    name: str
    wording: QuantitySpec
    quantity: Quantity

    @property
    def texts(self) -> tuple[str, str]:
        """Value and interval in the shown unit: "0.186", "[0.162, 0.210]"."""
        if self.label == BOUND or self.quantity.value == 0.0:  # the equations are better without it
            return bounded_numbers(self.value, self.interval)
        return plain_numbers(self.value, self.interval)

    @property
    def label(self) -> str:
        return verdict_label(self.quantity.verdict, self.interval)

    @property
    def value(self) -> float:
        return self.quantity.value * self.wording.scale

    @property
    def interval(self) -> tuple[float, float]:
        low, high = self.quantity.interval
        return low * self.wording.scale, high * self.wording.scale


def quantity_rows(
    quantities: Mapping[str, Quantity], wording: Mapping[str, QuantitySpec]
) -> tuple[QuantityRow, ...]:
    """Rows of the quantities that there are, in the order of their words."""
    known = ((name, words) for name, words in wording.items() if name in quantities)
    return tuple(QuantityRow(name, words, quantities[name]) for name, words in known)


def plain_numbers(value: float, interval: tuple[float, float]) -> tuple[str, str]:
    """Value and interval as texts, of numbers in the unit that is shown."""
    low, high = interval
    bounded = math.isfinite(low) and math.isfinite(high)
    position = _decimals(0.5 * (high - low)) if bounded and high > low else _decimals(value, digits=4)
    exponent = _exponent(max(abs(x) for x in (value, low, high) if math.isfinite(x)) if bounded else value)
    number = _number(value, position, exponent)
    if not bounded:
        return number, NO_NUMBER
    return number, f"[{_number(low, position, exponent)}, {_number(high, position, exponent)}]"


def bounded_numbers(value: float, interval: tuple[float, float]) -> tuple[str, str]:
    """The same, with a bound of the size where an interval holds zero: "0.04", "size below 0.21"."""
    number, text = plain_numbers(value, interval)
    if not holds_zero(interval):
        return number, text
    bound = max(-interval[0], interval[1])
    exponent = _exponent(bound)
    words = "size below" if interval[0] < 0.0 else "below"
    return number, f"{words} {_number(bound, _decimals(bound), exponent)}"


def verdict_label(status: Status, interval: tuple[float, float]) -> str:
    """A verdict in words of screens and pages: what is identified and may be zero is a bound."""
    return BOUND if status is Status.IDENTIFIED and holds_zero(interval) else status.label


def holds_zero(interval: tuple[float, float]) -> bool:
    """Whether an interval with two ends holds zero and more."""
    low, high = interval
    return bool(-math.inf < low <= 0.0 <= high < math.inf and low < high)


def _decimals(spread: float, digits: int = 2) -> int:
    """Number of decimals that shows `spread` to so many significant digits; negative left of the point."""
    if not math.isfinite(spread) or spread == 0.0:
        return 0
    return digits - 1 - math.floor(math.log10(abs(spread)))


def _exponent(size: float) -> int:
    """Power of ten to take out; zero for sizes that are read without one."""
    if not math.isfinite(size) or size == 0.0 or PLAIN_RANGE[0] <= abs(size) < PLAIN_RANGE[1]:
        return 0
    return math.floor(math.log10(abs(size)))


def _number(value: float, position: int, exponent: int) -> str:
    if not math.isfinite(value):
        return NO_NUMBER
    decimals = position + exponent
    rounded = round(value / 10.0**exponent, decimals) + 0.0  # plus zero: no "-0"
    return f"{rounded:.{max(decimals, 0)}f}" + (f"e{exponent}" if exponent else "")


def symbol_of(wording: QuantitySpec) -> str:
    """Symbol and unit of a quantity."""
    return f"{wording.symbol} [{wording.shown_unit}]" if wording.shown_unit else wording.symbol


def axis_of(wording: QuantitySpec) -> str:
    """Words of an axis for a quantity in its shown unit."""
    return f"{wording.words} {wording.own_symbol}".rstrip() + f" [{wording.shown_unit or '-'}]"


def number_table(titles: Iterable[str], rows: Iterable[Iterable[float | str | Cell]]) -> TableOf:
    """Table of numbers, and of words where a row has them."""
    cells = [[_cell(item) for item in row] for row in rows]
    left = {index for row in cells for index, cell in enumerate(row) if cell.text[:1].isalpha()}
    columns = [(title, index not in left) for index, title in enumerate(titles)]
    return table((TableColumn(title, right=right, whole=right) for title, right in columns), cells)


def _cell(item: float | str | Cell) -> Cell:
    if isinstance(item, Cell | str):
        return item if isinstance(item, Cell) else Cell(item)
    return Cell(f"{item:.4g}".replace("-", "−") if math.isfinite(item) else NO_NUMBER)
