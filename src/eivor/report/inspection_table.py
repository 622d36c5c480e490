"""The inspection of a log for a terminal; the conventions are those of `eivor.report.table`."""

from __future__ import annotations

import math
from collections.abc import Iterator

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from eivor.flights.prepare import PreparedFlight
from eivor.flights.result import FlightEstimate
from eivor.report.inspection import ChannelSummary, Inspection, stretches
from eivor.report.table import COLOURS, bullets, findings, heading
from eivor.report.wording import NO_NUMBER, printable
from eivor.signals.recording import Finding

#: So many gaps or stretches are listed one by one.
LISTED = 6


def inspection_report(found: Inspection) -> Group:
    """Everything that `eivor inspect` prints about a log."""
    return Group(*_parts(found))


def _parts(found: Inspection) -> Iterator[RenderableType]:
    yield _head(found)
    yield heading("Channels")
    yield _channel_table(found)
    if found.result is not None:
        yield heading("In the air")
        yield bullets(_airborne(found.result.prepared[0]))
        yield heading("References")
        yield bullets(_references(found.result.prepared[0]))
    yield from _absent(found)
    if found.parameters:
        yield heading("Parameters of the vehicle")
        yield bullets([f"{name} = {value:g}" for name, value in found.parameters.items()])
    yield from findings(_findings(found))
    yield from _verdict(found)


def _head(found: Inspection) -> Text:
    log = found.recording
    first, last = log.span_s
    head = Text(printable(log.name), style="bold", overflow="fold")
    about = f"\n{log.format}, {first:.2f} to {last:.2f} s, {log.frame.value}"
    if log.sha256:
        about += f", sha256 {log.sha256[:12]}…"
    head.append(about, style="not bold")
    return head


def _channel_table(found: Inspection) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    table.add_column(Text("channel, and its source"), overflow="fold")
    table.add_column(Text("rate [Hz]"), justify="right", no_wrap=True)
    table.add_column(Text("range, and remarks"), overflow="fold")
    for summary in found.channels:
        channel = summary.channel
        name = Text.assemble((printable(channel.name), "bold"), "\n", (printable(channel.source), "dim"))
        about = Text.assemble(_range(summary), "\n", ("; ".join(_remarks(summary)), "yellow"))
        table.add_row(name, Text(f"{channel.rate_hz:.1f}"), about)
    return table


def _range(summary: ChannelSummary) -> str:
    if not math.isfinite(summary.lowest):
        return NO_NUMBER
    unit = f" {summary.channel.unit}" if summary.channel.unit else ""
    return f"{summary.lowest:.4g} to {summary.highest:.4g}{unit}"


def _remarks(summary: ChannelSummary) -> Iterator[str]:
    quality = summary.channel.quality
    count = len(summary.gaps)
    if count:
        longest = max(end - start for start, end in summary.gaps)
        yield f"{count} {'gap' if count == 1 else 'gaps'} up to {longest:.2g} s"
    for number, what in (
        (quality.duplicated_stamps, "repeated stamps"),
        (quality.backward_stamps, "backward stamps"),
        (quality.missing_values, "without a value"),
        (quality.overflowed, "overflowed"),
        (quality.saturated, "saturated"),
    ):
        if number:
            yield f"{number} {what}"


def _airborne(flight: PreparedFlight) -> Iterator[str]:
    signals = flight.flight.signals
    flown = stretches(flight.airborne.mask, signals.start_s, signals.step_s)
    yield f"Known by {flight.airborne.rule}."
    yield f"In the air: {_listed(flown)}." if flown else "Never in the air."
    if flown:
        runs = stretches(flight.used, signals.start_s, signals.step_s)
        kept = f"{float(flight.used.sum()) * signals.step_s:.1f} s in {_listed(runs)}" if runs else "nothing"
        yield f"Used, after the limits of tilt, window and gaps: {kept}."


def _listed(intervals: list[tuple[float, float]]) -> str:
    shown = ", ".join(f"{start:.1f} to {end:.1f} s" for start, end in intervals[:LISTED])
    return shown + (f" and {len(intervals) - LISTED} more" if len(intervals) > LISTED else "")


def _references(flight: PreparedFlight) -> Iterator[str]:
    if not flight.references:
        yield "None is logged: no position, velocity or acceleration setpoint, and no stick."
    for reference in flight.references:
        verdict = "usable" if reference.usable else "not usable"
        yield f"{reference.name}: {verdict} ({reference.remark})."


def _absent(found: Inspection) -> Iterator[RenderableType]:
    """Channels that the reader looked for in vain, the indispensable ones first."""
    log = found.recording
    absent = {
        name: sources
        for name, sources in log.looked_for.items()
        if name not in log.channels and not log.family(name.rstrip("1").rstrip("_"))
    }
    told = {name: sources for name, sources in absent.items() if sources != (f"column {name}",)}
    if absent or found.missing:
        yield heading("Not in the log")
        first = [
            f"{name} (needed): looked for {_sources(absent.get(name, ()), name)}" for name in found.missing
        ]
        others = [
            f"{name}: looked for {_sources(sources, name)}"
            for name, sources in told.items()
            if name not in found.missing
        ]
        plain = [name for name in absent if name not in told and name not in found.missing]
        yield bullets([*first, *others, *([f"Columns {', '.join(plain)}."] if plain else [])])
    if found.advice:
        yield heading("How to log it")
        yield bullets(found.advice)


def _sources(sources: tuple[str, ...], name: str) -> str:
    return ", ".join(sources) or f"a channel or column '{name}'"


def _findings(found: Inspection) -> tuple[Finding, ...]:
    return found.result.findings if found.result is not None else found.recording.findings


def _verdict(found: Inspection) -> Iterator[RenderableType]:
    yield heading("What identify says (found by running it)")
    if found.result is None:
        yield Text("nothing: it cannot begin", style="bold red")
    else:
        yield _status(found.result)
    yield bullets(found.reasons)


def _status(result: FlightEstimate) -> Text:
    status = result.verdict.status
    return Text.assemble((status.value, COLOURS[status]), f" (method {result.method})")
