"""Where the numbers of a page come from: logs with their checksums, options, versions, licences."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from eivor.report.document import Cell, Fact, Facts, Section, TableColumn, TableOf
from eivor.report.page.markup import Markup, element
from eivor.report.page.parts import part_html, section_html
from eivor.report.page.vendored import uplot
from eivor.report.wording import NO_NUMBER

TITLES = ("log", "format", "span [s]", "used [s]", "runs", "samples", "rate [Hz]")


def provenance(numbers: Mapping[str, Any]) -> Markup:
    """Section of a page, of the document as JSON."""
    made = numbers["provenance"]
    facts = (Fact("made by", f"Eivor {made['version']}"), Fact("schema", numbers["schema"]))
    section = Section("Provenance", (Facts(facts), _logs(numbers)))
    words = [
        Fact(name, _option(one)) for name, one in made["options"].items() if one not in (None, "", [], {})
    ]
    drawing = uplot()
    licence = drawing.licence.strip().split("\n\n")
    return element(
        "div",
        None,
        section_html(section, "provenance", {}),
        _unfolded("Options", part_html(Facts(tuple(words)), {})),
        _unfolded(
            f"Licence of {drawing.name} {drawing.version}, which draws the charts and is part of this file",
            *(element("p", {"class": "licence"}, paragraph.replace("\n", " ")) for paragraph in licence),
        ),
        element(
            "p", {"class": "saving"}, element("button", {"type": "button", "id": "save"}, "Save as JSON")
        ),
    )


def _unfolded(summary: str, *content: Markup) -> Markup:
    return element("details", None, element("summary", None, summary), *content)


def _logs(numbers: Mapping[str, Any]) -> TableOf:
    rows = []
    for log, source in zip(numbers["logs"], numbers["provenance"]["logs"], strict=True):
        checksum = f"SHA-256 {source['sha256']}" if source["sha256"] else ""
        counts = (str(log["runs"]), str(log["samples"]), f"{log['rate_hz']:g}")
        told = (log["format"], _span(log["span"]), _span(log["window"]), *counts)
        rows.append((Cell(log["name"], checksum), *map(Cell, told)))
    columns = (*map(TableColumn, TITLES[:2]), *(TableColumn(title, whole=True) for title in TITLES[2:]))
    return TableOf(columns, tuple(rows))


def _span(pair: list[float] | None) -> str:
    return NO_NUMBER if pair is None else f"{pair[0]:.2f} to {pair[1]:.2f}"


def _option(value: object) -> str:
    match value:
        case bool():
            return "yes" if value else "no"
        case float():
            return f"{value:g}"
        case list() | tuple():
            return ", ".join(map(_option, value))
        case _:
            return str(value)
