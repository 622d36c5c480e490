"""The document of a result: its verdict, the numbers, why, what to do, and then what is behind them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from eivor.flights.motion import Motion
from eivor.flights.result import FlightEstimate, FlightRow
from eivor.report.card import flight_card
from eivor.report.checks import checks
from eivor.report.document import (
    Bullets,
    Cell,
    Column,
    Document,
    Fact,
    Facts,
    Figure,
    Part,
    Section,
    TableOf,
)
from eivor.report.wording import NO_NUMBER, equation, instruments, numbers, used
from eivor.signals.recording import Finding

#: Findings that only an inspection shows: they bear on no number.
QUIET_FINDINGS = ("epoch_time",)
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
    status = result.verdict.status
    return Document(
        ", ".join(flight.recording.name for flight in result.prepared),
        status,
        result.motion.words.meanings[status],
        tuple(_sections(result, card=card)),
    )


def _sections(result: FlightEstimate, *, card: bool) -> Iterator[Section]:
    yield Section("", (_facts(result), _quantity_table(result)))
    yield from _reasons(result, card=card)
    yield from section("Checks", Facts, (Fact(title, sentence) for title, sentence in checks(result)))
    if result.flights:
        table = _row_table(result.flights, "log", result.motion)
        yield Section("Flights one by one", (table, *_row_reasons(result.flights, result.motion)))
    if result.comparisons:
        table = _row_table(result.comparisons, "method", result.motion)
        yield Section("Methods side by side", (table,))
    where = "logs" if len(result.prepared) > 1 else "log"
    yield from section(f"Noticed in the {where}", Bullets, (f.message for f in _worth_telling(result)))
    if card:
        yield from card_section(result)
    yield Section("Figure", (Figure("flight"),))


def section(heading: str, part: type[Bullets] | type[Facts], told: Iterable[Any]) -> Iterator[Section]:
    """Section of one part, unless there is nothing to tell."""
    found = tuple(told)
    if found:
        yield Section(heading, (part(found),))


def card_section(result: FlightEstimate) -> Iterator[Section]:
    """The flight card, unless the flight is identified."""
    facts = (Fact(part.title, Bullets(part.sentences)) for part in flight_card(result))
    yield from section("Flight card", Facts, facts)


def _facts(result: FlightEstimate) -> Facts:
    model, meaning = equation(result)
    return Facts(
        (
            Fact("model", model),
            Fact("", meaning),
            Fact("method", f"{result.method}; {instruments(result)}"),
            Fact("used", used(result)),
        )
    )


def _quantity_table(result: FlightEstimate) -> TableOf:
    """Every quantity with its symbol, value, interval, unit and verdict."""
    columns = (
        Column("quantity"),
        Column(""),
        Column("value", right=True, strong=True, whole=True),
        Column("95 % interval", whole=True),
        Column("unit"),
        Column("verdict"),
    )
    rows = []
    for name in result.motion.shown:
        quantity, wording = result.quantities[name], result.motion.wording[name]
        status = quantity.verdict
        texts = (wording.words, wording.symbol, *numbers(quantity, wording), wording.shown_unit)
        rows.append((*map(Cell, texts), Cell(status.value, status=status)))
    return TableOf(columns, tuple(rows))


def _row_table(rows: tuple[FlightRow, ...], label: str, motion: Motion[Any]) -> TableOf:
    """One row for each flight or method; the interval stands below the value."""
    words = [motion.wording[name] for name in motion.rows]
    titles = [f"{w.symbol} [{w.shown_unit}]" if w.shown_unit else w.symbol for w in words]
    columns = (Column(label), *(Column(title, strong=True, whole=True) for title in titles))
    return TableOf(columns, tuple(_row(row, motion) for row in rows))


def _row(row: FlightRow, motion: Motion[Any]) -> tuple[Cell, ...]:
    cells = [Cell(row.label, row.verdict.value, row.verdict)]
    for name in motion.rows:
        quantity = row.quantities.get(name)
        shown = (NO_NUMBER, "") if quantity is None else numbers(quantity, motion.wording[name])
        cells.append(Cell(*shown))
    return tuple(cells)


def _row_reasons(rows: tuple[FlightRow, ...], motion: Motion[Any]) -> Iterator[Part]:
    """First reason of each flight that is not identified."""
    fly = motion.words.fly
    found = [f"{row.label}: {row.reasons[0].removesuffix(fly).strip()}" for row in rows if row.reasons]
    if found:
        yield Bullets(tuple(found))


def _reasons(result: FlightEstimate, *, card: bool) -> Iterator[Section]:
    """Why the verdict is not better, and what would change it, each remedy once."""
    reasons = result.verdict.reasons
    yield from section("Why", Bullets, (reason.sentence for reason in reasons))
    remedies = dict.fromkeys(reason.remedy for reason in reasons if reason.remedy)
    where = () if card or not flight_card(result) else (WHERE_THE_CARD_IS,)
    yield from section("What to do", Bullets, (*remedies, *where))


def _worth_telling(result: FlightEstimate) -> tuple[Finding, ...]:
    """Findings but the quiet ones and the reasons; what is said of several logs of a pool is said once."""
    logs = [flight.recording.name for flight in result.prepared]
    reasons = {reason.sentence for reason in result.verdict.reasons}
    said: dict[tuple[str, str], list[str]] = {}
    for finding in result.findings:
        if finding.name in QUIET_FINDINGS or finding.message in reasons:
            continue
        log = next((name for name in logs if finding.message.startswith(f"{name}: ")), "")
        message = finding.message.removeprefix(f"{log}: ") if log else finding.message
        said.setdefault((finding.name, message), []).extend([log] if log else [])
    told = []
    for (name, message), about in said.items():
        everywhere = len(about) == len(logs) > 1
        prefix = "Every log: " if everywhere else f"{', '.join(about)}: " if about else ""
        told.append(Finding(name, prefix + message))
    return tuple(told)
