"""The document of a result: its verdict, the numbers, why, what to do, and then what is behind them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

from eivor.flights.implied import Implications
from eivor.flights.result import FlightEstimate
from eivor.flights.words import CardSection
from eivor.report.ahead_parts import ahead_parts
from eivor.report.document import (
    Bullets,
    Cell,
    Document,
    Fact,
    Facts,
    Figure,
    Part,
    Section,
    TableColumn,
    TableOf,
)
from eivor.report.told import ToldFlight, ToldRow, told_flight
from eivor.report.wording import NO_NUMBER, plain_numbers

#: Where the card is, when it is not shown.
WHERE_THE_CARD_IS = "What to fly and what to log, step by step: the same command with --card."


def flight_document(result: FlightEstimate, *, card: bool = False) -> Document:
    """Document of a result.

    Parameters
    ----------
    result : FlightEstimate
        With or without an estimate.
    card : bool
        Whether the flight card is part of it, or only a line that says where it is.
    """
    return document_of(told_flight(result), card=card)


def document_of(told: ToldFlight, *, card: bool = False) -> Document:
    """Document of what is told of a result, see `flight_document`."""
    return Document(
        ", ".join(told.logs), told.verdict.status, told.meaning, tuple(_sections(told, card=card))
    )


def _sections(told: ToldFlight, *, card: bool) -> Iterator[Section]:
    yield Section("", (_facts(told), _quantity_table(told)))
    if told.implications.numbers:
        yield Section("What follows for the vehicle", tuple(_implied(told.implications)))
    further = (f"{symbols}: {reason.sentence}" for symbols, reason in told.further)
    yield from section("Why", Bullets, (*(reason.sentence for reason in told.reasons), *further))
    where = () if card or not told.card else (WHERE_THE_CARD_IS,)
    yield from section("What to do", Bullets, (*told.remedies, *where))
    yield from section("Checks", Facts, (Fact(title, sentence) for title, sentence in told.checks))
    if told.ahead is not None:
        parts_ahead = (*ahead_parts(told.ahead), Figure("ahead"))
        yield Section("Predicted ahead, from many starts of this flight", parts_ahead)
    parts = (Fact(words, sentence) for words, sentence in told.systematic)
    yield from section("Systematic parts", Facts, parts)
    if told.by_flight:
        yield Section("What belongs to each flight of the pool", (_own_table(told),))
    if told.flights:
        reasons = _row_reasons(told)
        table = _row_table(told.flights, "log")
        yield Section("Flights one by one", (table, Figure("flights"), *reasons))
    if told.comparisons:
        table = _row_table(told.comparisons, "method")
        yield Section("Methods side by side", (table, Figure("methods")))
    noticed = f"Noticed in the {'logs' if len(told.logs) > 1 else 'log'}"
    yield from section(noticed, Bullets, (finding.message for finding in told.worth_telling))
    if card:
        yield from card_section(told.card)
    yield Section("Figure", (Figure("flight"),))


def section(heading: str, part: type[Bullets] | type[Facts], told: Iterable[Any]) -> Iterator[Section]:
    """Section of one part, unless there is nothing to tell."""
    found = tuple(told)
    if found:
        yield Section(heading, (part(found),))


def card_section(card: tuple[CardSection, ...]) -> Iterator[Section]:
    """The flight card, unless there is none."""
    facts = (Fact(part.title, Bullets(part.sentences)) for part in card)
    yield from section("Flight card", Facts, facts)


def _facts(told: ToldFlight) -> Facts:
    with_what = "no instruments" if told.instruments == "none" else f"instruments: {told.instruments}"
    summary = (Fact("told", told.summary),) if told.summary else ()
    return Facts(
        (
            *summary,
            Fact("model", told.equation[0].replace(" - ", " − ")),
            Fact("", told.symbols),
            Fact("method", f"{told.method}; {with_what}"),
            Fact("used", told.used),
        )
    )


def _quantity_table(told: ToldFlight) -> TableOf:
    """Every quantity with its symbol, value, interval, unit and verdict."""
    columns = (
        TableColumn("quantity"),
        TableColumn(""),
        TableColumn("value", right=True, strong=True, whole=True),
        TableColumn("95 % interval", whole=True),
        TableColumn("unit"),
        TableColumn("verdict"),
    )
    rows = []
    for one in told.reported:
        status, wording = one.quantity.verdict, one.wording
        texts = (wording.words, wording.symbol, *one.shown, wording.shown_unit)
        rows.append((*map(Cell, texts), Cell(status.value, status=status)))
    return TableOf(columns, tuple(rows))


def _implied(implications: Implications) -> Iterator[Part]:
    """Numbers that follow, then in sentences those that do not, and what cannot be."""
    columns = (
        TableColumn(""),
        TableColumn(""),
        TableColumn("value", right=True, strong=True, whole=True),
        TableColumn("95 % interval", whole=True),
        TableColumn("unit"),
    )
    rows = [
        tuple(map(Cell, (one.words, one.symbol, *plain_numbers(one.value, one.interval), one.unit)))
        for one in implications.numbers
        if one.value is not None and one.interval is not None
    ]
    if rows:
        yield TableOf(columns, tuple(rows))
    untold = (f"{one.words}: {one.sentence}" for one in implications.numbers if one.value is None)
    sentences = (*untold, *implications.contradictions)
    if sentences:
        yield Bullets(sentences)


def _row_table(rows: tuple[ToldRow, ...], label: str) -> TableOf:
    """One row for each flight or method; the interval stands below the value."""
    words = [one.wording for one in rows[0].quantities]
    titles = [f"{w.symbol} [{w.shown_unit}]" if w.shown_unit else w.symbol for w in words]
    columns = (TableColumn(label), *(TableColumn(title, strong=True, whole=True) for title in titles))
    return TableOf(columns, tuple(_row(row) for row in rows))


def _own_table(told: ToldFlight) -> TableOf:
    """One row for each flight of a pool, with the quantities that are its own."""
    rows = [
        replace(row, quantities=tuple(one for one in row.quantities if one.name in told.own))
        for row in told.by_flight
    ]
    return _row_table(tuple(rows), "log")


def _row(row: ToldRow) -> tuple[Cell, ...]:
    cells = [Cell(row.label, row.status.value, row.status)]
    for one in row.quantities:
        value, interval = one.shown
        cells.append(Cell(value, "" if value == NO_NUMBER else interval))
    return tuple(cells)


def _row_reasons(told: ToldFlight) -> Iterator[Part]:
    """First reason of each flight that is not identified."""
    found = [f"{row.label}: {row.first_reason(told.fly)}" for row in told.flights if row.reasons]
    if found:
        yield Bullets(tuple(found))
