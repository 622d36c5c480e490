"""The report of a result for a terminal: Rich renderables that stay legible at 80 columns and in a pipe.

Every string is a Rich `Text`, never markup, and what a log brought along is made printable, so that a
file name cannot colour or rewrite the screen.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from rich.console import Group, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from eivor.flights.result import FlightEstimate, FlightRow
from eivor.flights.rule import FLY
from eivor.inference.verdict import Status
from eivor.report.card import CardSection, flight_card
from eivor.report.checks import Check, checks
from eivor.report.wording import NO_NUMBER, QUANTITIES, equation, instruments, numbers, printable, used
from eivor.signals.recording import Finding

COLOURS = {
    Status.IDENTIFIED: "bold green",
    Status.WEAK: "bold yellow",
    Status.PROVISIONAL: "bold magenta",
    Status.REFUSED: "bold red",
}
#: What each verdict means, in words.
MEANINGS = {
    Status.IDENTIFIED: "the flight tells the viscous friction within the interval.",
    Status.WEAK: "the numbers are indications; something keeps the intervals from being trusted.",
    Status.PROVISIONAL: "no instrument: the numbers may be biased more than the intervals say.",
    Status.REFUSED: "the flight cannot tell the viscous friction.",
}
#: Names up to this length keep their line in the tables of flights and of methods.
LONGEST_WHOLE = 20
#: Findings that only an inspection shows: they bear on no number.
QUIET_FINDINGS = ("epoch_time",)
#: Columns of the tables of flights and of methods.
ROW_QUANTITIES = ("viscous_friction", "input_gain", "effective_lag", "hover_input")


def identification_report(result: FlightEstimate) -> Group:
    """Everything that `eivor identify` prints about a result."""
    return Group(*_parts(result))


def _parts(result: FlightEstimate) -> Iterator[RenderableType]:
    yield verdict_line(result)
    yield Text()
    yield _facts(result)
    yield Text()
    yield quantity_table(result)
    if result.flights:
        yield heading("Flights one by one")
        yield row_table(result.flights, "log")
        yield from _row_reasons(result.flights)
    if result.comparisons:
        yield heading("Methods side by side")
        yield row_table(result.comparisons, "method")
    yield from reasons(result)
    yield from findings(_worth_telling(result), several=len(result.prepared) > 1)
    yield from _checks(checks(result))
    yield from _card(flight_card(result))


def heading(title: str) -> RenderableType:
    """Title of a part, with an empty line above it."""
    return Padding(Text(title, style="bold"), (1, 0, 0, 0))


def status_text(status: Status) -> Text:
    """Verdict in words and colour."""
    return Text(status.value, style=COLOURS[status])


def bullets(sentences: Iterable[str]) -> RenderableType:
    """Sentences with a dash before each, wrapped under their own beginning."""
    grid = Table.grid(padding=(0, 1))
    grid.add_column(width=1)
    grid.add_column(overflow="fold")
    for sentence in sentences:
        grid.add_row(Text("-"), Text(printable(sentence)))
    return grid


def verdict_line(result: FlightEstimate) -> Text:
    """Logs, the overall verdict and what it means."""
    names = ", ".join(printable(flight.recording.name) for flight in result.prepared)
    status = result.verdict.status
    line = Text(names, style="bold", overflow="fold")
    line.append("\n")
    line.append(status.value.upper(), style=COLOURS[status])
    line.append(f": {MEANINGS[status]}", style="not bold")
    return line


def _facts(result: FlightEstimate) -> Table:
    grid = Table.grid(padding=(0, 2))
    grid.add_column(style="dim")
    grid.add_column(overflow="fold")
    model, meaning = equation(result)
    grid.add_row("model", Text(model))
    grid.add_row("", Text(printable(meaning)))
    grid.add_row("method", Text(printable(f"{result.method}; {instruments(result)}")))
    grid.add_row("used", Text(used(result)))
    return grid


def _plain_table(*columns: str) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    for column in columns:
        table.add_column(Text(column), overflow="fold")  # a string would be markup: "[ms]" is a tag
    return table


def quantity_table(result: FlightEstimate) -> Table:
    """Every quantity with its symbol, value, interval, unit and verdict."""
    table = _plain_table("quantity", "", "value", "95 % interval", "unit", "verdict")
    table.columns[2].justify = "right"
    for name, wording in QUANTITIES.items():
        quantity = result.quantities[name]
        value, interval = numbers(quantity, wording)
        table.add_row(
            Text(wording.words),
            Text(wording.symbol),
            Text(value, style="bold"),
            Text(interval),
            Text(wording.unit),
            status_text(quantity.verdict),
        )
    return table


def row_table(rows: tuple[FlightRow, ...], label: str) -> Table:
    """One row for each flight or method; the interval stands below the value."""
    words = [QUANTITIES[name] for name in ROW_QUANTITIES]
    titles = [f"{w.symbol} [{w.unit}]" if w.unit else w.symbol for w in words]
    table = _plain_table(label, *titles)
    table.columns[0].no_wrap = all(len(row.label) <= LONGEST_WHOLE for row in rows)
    for row in rows:
        cells = [Text.assemble(printable(row.label), "\n", status_text(row.verdict))]
        for name in ROW_QUANTITIES:
            quantity = row.quantities.get(name)
            value, interval = (NO_NUMBER, "") if quantity is None else numbers(quantity, QUANTITIES[name])
            cells.append(Text.assemble((value, "bold"), "\n", interval))
        table.add_row(*cells)
    return table


def _row_reasons(rows: tuple[FlightRow, ...]) -> Iterator[RenderableType]:
    """First reason of each flight that is not identified."""
    found = [f"{row.label}: {row.reasons[0].removesuffix(FLY).strip()}" for row in rows if row.reasons]
    if found:
        yield Text()
        yield bullets(found)


def reasons(result: FlightEstimate) -> Iterator[RenderableType]:
    """Why the verdict is not better, and what would change it, each remedy once."""
    if not result.verdict.reasons:
        return
    yield heading("Why")
    yield bullets(reason.sentence for reason in result.verdict.reasons)
    remedies = dict.fromkeys(reason.remedy for reason in result.verdict.reasons if reason.remedy)
    if remedies:
        yield heading("What to do")
        yield bullets(remedies)


def findings(found: tuple[Finding, ...], *, several: bool = False) -> Iterator[RenderableType]:
    """What stands out in one or several logs."""
    if found:
        yield heading(f"Noticed in the {'logs' if several else 'log'}")
        yield bullets(finding.message for finding in found)


def _worth_telling(result: FlightEstimate) -> tuple[Finding, ...]:
    """Findings without the quiet ones; what is said of several logs of a pool is said once."""
    logs = [flight.recording.name for flight in result.prepared]
    said: dict[tuple[str, str], list[str]] = {}
    for finding in result.findings:
        if finding.name in QUIET_FINDINGS:
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


def _checks(found: tuple[Check, ...]) -> Iterator[RenderableType]:
    if not found:
        return
    yield heading("Checks")
    grid = Table.grid(padding=(0, 2))
    grid.add_column(style="dim", no_wrap=True)
    grid.add_column(overflow="fold")
    for title, sentence in found:
        grid.add_row(Text(title), Text(sentence))
    yield grid


def _card(sections: tuple[CardSection, ...]) -> Iterator[RenderableType]:
    if not sections:
        return
    yield heading("Flight card")
    grid = Table.grid(padding=(0, 2))
    grid.add_column(style="dim", no_wrap=True)
    grid.add_column(overflow="fold")
    for section in sections:
        grid.add_row(Text(section.title), bullets(section.sentences))
    yield grid
