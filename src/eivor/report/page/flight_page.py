"""The page of a result: one file, made of the same document as the terminal and the same JSON."""

from __future__ import annotations

from dataclasses import replace

from eivor.flights.result import FlightEstimate
from eivor.report.document import Bullets, Document, Facts, Part, Section
from eivor.report.flight_document import document_of
from eivor.report.json_document import json_of
from eivor.report.page.figures import Figures, lines_of
from eivor.report.page.markup import Markup, element, joined
from eivor.report.page.of_fit import pictures_of_fit
from eivor.report.page.of_rows import forests, pictures_ahead
from eivor.report.page.over_time import MOST_FLIGHTS, flights_over_time
from eivor.report.page.parts import badge, section_html, shape
from eivor.report.page.provenance import provenance
from eivor.report.page.shell import whole_page
from eivor.report.page.verdict_data import more_said, verdict_data
from eivor.report.told import ToldFlight, ToldQuantity, told_flight

#: Titles are cut to so many letters; provenance has the names as they are.
LONGEST_TITLE = 120
#: So many names of logs are in a title.
NAMED = 3
#: Headings of the document in fewer words, for the list of what is on the page.
SHORT = {
    "": "Numbers",
    "Predicted ahead, from many starts of this flight": "Predicted ahead",
    "What belongs to each flight of the pool": "By flight",
    "Noticed in the log": "Noticed",
    "Noticed in the logs": "Noticed",
    "Figure": "Pictures",
}


def flight_page(result: FlightEstimate) -> str:
    """Text of a page that tells a result: HTML without anything to fetch.

    Parameters
    ----------
    result : FlightEstimate
        With or without an estimate.
    """
    told = told_flight(result)
    document, numbers = document_of(told, card=True), json_of(told, result)
    over_time = list(flights_over_time(result))
    figures = Figures(lines_of(over_time))
    drawn = {
        "ahead": figures.html([pictures_ahead(told.ahead)] if told.ahead is not None else []),
        "flights": figures.html([forests(told, told.flights, "all together")] if told.flights else []),
        "methods": figures.html([forests(told, told.comparisons, "")] if told.comparisons else []),
        "flight": figures.html(
            [*over_time, *([] if result.fit is None else [pictures_of_fit(result, result.fit)])]
        ),
    }
    sections = [(_name(section), section) for section in document.sections]
    told_sections = [section_html(_shown(section, result), name, drawn) for name, section in sections]
    title = _title(told)
    body = joined(
        [
            element("a", {"class": "skip", "href": "#main"}, "To the verdict"),
            _header(result, title),
            element(
                "main",
                {"id": "main"},
                _verdict(document, told),
                _contents([*sections, ("provenance", Section("Provenance", ()))]),
                *told_sections,
                provenance(numbers),
            ),
        ]
    )
    data = {"result": numbers, "charts": figures.charts, "verdict": verdict_data(document, told)}
    return whole_page(f"{title}: {told.verdict.status.value}", body, data)


def _title(told: ToldFlight) -> str:
    names = ", ".join(told.logs[:NAMED])
    if len(told.logs) > NAMED:
        names = f"{len(told.logs)} flights: {names}, …"
    return names if len(names) <= LONGEST_TITLE else f"{names[: LONGEST_TITLE - 1]}…"


def _header(result: FlightEstimate, title: str) -> Markup:
    theme = element("button", {"type": "button", "id": "theme"}, "Dark")
    about = element("p", {"class": "about"}, f"Eivor · {result.motion.words.title}")
    return element("header", None, element("div", None, about, element("h1", None, title)), theme)


def _verdict(document: Document, told: ToldFlight) -> Markup:
    """What is taken home in three seconds: the verdict in a sentence, and the numbers that it is about."""
    status = told.verdict.status
    said = element(
        "p", {"class": "said"}, shape(status), element("strong", None, status.value), f": {document.about}"
    )
    more = [element("p", None, one) for one in more_said(told)]
    readings = [_reading(one) for one in told.brief]
    note = element("p", {"class": "note"}, "In brackets: 95 % intervals.")
    listed = [element("div", {"class": "readings"}, *readings), note] if readings else []
    return element("div", {"class": f"verdict {status.value}"}, said, *more, *listed)


def _reading(told: ToldQuantity) -> Markup:
    """One number with its interval."""
    value, interval = told.shown
    wording = told.wording
    unit = [element("span", {"class": "unit"}, f" {wording.shown_unit}")] if wording.shown_unit else []
    return element(
        "div",
        {"class": "reading", "data-quantity": told.name},
        element(
            "p", {"class": "name"}, f"{wording.words} ", element("span", {"class": "symbol"}, wording.symbol)
        ),
        element("p", {"class": "number"}, element("span", {"class": "value"}, value), *unit),
        element("p", {"class": "interval"}, interval),
        badge(told.quantity.verdict, told.quantity.verdict.value),
    )


def _contents(sections: list[tuple[str, Section]]) -> Markup:
    links = [
        element("li", None, element("a", {"href": f"#{name}"}, SHORT.get(section.heading, section.heading)))
        for name, section in sections
    ]
    return element("nav", {"aria-label": "On this page"}, element("ul", None, *links))


def _name(section: Section) -> str:
    """Identifier of a section."""
    words = SHORT.get(section.heading, section.heading).lower()
    return "-".join("".join(letter if letter.isalnum() else " " for letter in words).split())


def _shown(section: Section, result: FlightEstimate) -> Section:
    """Section under the heading that a page has for it."""
    if not section.heading:
        return replace(section, parts=tuple(_without_summary(part) for part in section.parts))
    if section.heading != "Figure":
        return section
    left_out = len(result.prepared) - MOST_FLIGHTS
    more = f"The first {MOST_FLIGHTS} flights are drawn over time; {left_out} more are in the tables."
    return Section("Pictures", (*((Bullets((more,)),) if left_out > 0 else ()), *section.parts))


def _without_summary(part: Part) -> Part:
    """Facts without what the verdict above has said."""
    if not isinstance(part, Facts):
        return part
    return Facts(tuple(fact for fact in part.facts if fact.label != "told"))
