"""Parts of a document as HTML."""

from __future__ import annotations

import re
from collections.abc import Mapping

from eivor.inference.verdict import Status
from eivor.report.document import (
    Bullets,
    Cell,
    Fact,
    Facts,
    Figure,
    Part,
    Section,
    Statement,
    TableColumn,
    TableOf,
)
from eivor.report.page.markup import Markup, element, joined

#: A shape for each verdict, drawn in a square of 20: colour is never alone.
SHAPES = {
    Status.IDENTIFIED: "M4.5 10.5l3.6 3.8 7.4-8.6",
    Status.WEAK: "M5 11.5c2-3.2 3.6-3.2 5-1.2s3 2 5-1.2",
    Status.PROVISIONAL: "M10 5.2v5.4M10 14.2v.8",
    Status.REFUSED: "M6 6l8 8M14 6l-8 8",
}
#: Numbers with a power of ten, which a browser would break after their hyphen.
_POWERS = re.compile(r"(\[?-?[\d.]{1,20}e-\d{1,3}[\],]?)")


def section_html(section: Section, name: str, figures: Mapping[str, Markup]) -> Markup:
    """Section with its heading, and figures where the document has a place for them."""
    parts = [part_html(part, figures) for part in section.parts]
    if not section.heading:
        return element("section", {"id": name}, *parts)
    heading = element("h2", {"id": f"{name}-heading"}, section.heading)
    return element("section", {"id": name, "aria-labelledby": f"{name}-heading"}, heading, *parts)


def part_html(part: Part, figures: Mapping[str, Markup]) -> Markup:
    """One part."""
    match part:
        case Facts():
            return element("dl", {"class": "facts"}, *(_fact(fact) for fact in part.facts))
        case TableOf():
            return table_html(part)
        case Bullets():
            return element("ul", None, *(element("li", None, one) for one in part.sentences))
        case Statement():
            return element("p", None, badge(part.status, part.text), part.more)
        case Figure():
            return figures.get(part.name, joined(()))


def _fact(fact: Fact) -> Markup:
    told = part_html(fact.told, {}) if isinstance(fact.told, Bullets) else fact.told
    return element("div", None, element("dt", None, fact.label), element("dd", None, told))


def badge(status: Status, words: str) -> Markup:
    """A verdict as a word with its shape."""
    return element("span", {"class": f"badge {status.value}"}, shape(status), words)


def shape(status: Status) -> Markup:
    """The shape of a verdict; a screen reader reads the word beside it."""
    box = {"viewBox": "0 0 20 20", "class": "shape", "aria-hidden": "true"}
    ring = element("circle", {"cx": "10", "cy": "10", "r": "8.6"})
    return element("svg", box, ring, element("path", {"d": SHAPES[status]}))


def table_html(table: TableOf, caption: str = "") -> Markup:
    """Table whose rows become blocks where columns have no room; with a caption it may be scrolled."""
    heads = [_head(column) for column in table.columns]
    rows = [
        element(
            "tr",
            None,
            *(
                _cell(*pair, first=not place)
                for place, pair in enumerate(zip(row, table.columns, strict=True))
            ),
        )
        for row in table.rows
    ]
    head = element("thead", None, element("tr", None, *heads))
    whole = element("table", None, head, element("tbody", None, *rows))
    scrolled = {"tabindex": "0", "role": "region", "aria-label": caption} if caption else {}
    return element("div", {"class": "table", **scrolled}, whole)


def _head(column: TableColumn) -> Markup:
    look = {"class": "right"} if column.right else {}
    if not column.title:
        return element("td", look)
    return element("th", {"scope": "col", **look}, column.title)


def _cell(cell: Cell, column: TableColumn, *, first: bool) -> Markup:
    words = {"right": column.right, "strong": column.strong, "whole": column.whole, column.below.value: True}
    look = {"class": " ".join(word for word, wanted in words.items() if wanted), "data-title": column.title}
    first_line: Markup | str = _unbroken(cell.text)
    below = [element("span", {"class": "below"}, _unbroken(cell.below))] if cell.below else []
    if cell.status is not None and below:
        below = [badge(cell.status, cell.below)]
    elif cell.status is not None:
        first_line = badge(cell.status, cell.text)
    elif cell.link:
        first_line = element("a", {"href": cell.link}, cell.text)
    name, extra = ("th", {"scope": "row"}) if first and cell.text else ("td", {})
    return element(name, {**look, **extra}, element("span", {"class": "text"}, first_line), *below)


def _unbroken(text: str) -> Markup:
    """Text whose numbers stay in one line each."""
    pieces = enumerate(_POWERS.split(text))
    return joined(element("span", {"class": "one"}, one) if place % 2 else one for place, one in pieces)
