"""The document of an inspection: what a log holds, and what `identify` says of it."""

from __future__ import annotations

import math
from collections.abc import Iterator

from eivor.flights.words import Words
from eivor.inference.verdict import Status
from eivor.report.card import flight_card
from eivor.report.document import Bullets, Cell, Document, Section, Statement, TableColumn, TableOf, Tone
from eivor.report.flight_document import card_section, section
from eivor.report.inspection import ChannelSummary, Flown, Inspection, PooledInspection
from eivor.report.wording import NO_NUMBER
from eivor.signals.recording import Recording

#: So many gaps or stretches are listed one by one.
LISTED = 6


def inspection_document(found: Inspection) -> Document:
    """Document of one log, with the flight card unless it is identified."""
    card = () if found.result is None else card_section(flight_card(found.result))
    return _document(found, (*_sections(found), *card))


def pooled_documents(found: PooledInspection) -> tuple[Document, ...]:
    """A document of each log, and one of all together, which has the flight card."""
    verdict = _verdict(found, of=f" of the {len(found.logs)} logs together")
    card = () if found.result is None else card_section(flight_card(found.result))
    together = Document("", None, "", (verdict, *card))
    return (*(_document(log, tuple(_sections(log))) for log in found.logs), together)


def _document(found: Inspection, sections: tuple[Section, ...]) -> Document:
    return Document(found.recording.name, None, _about(found.recording), sections)


def _about(log: Recording) -> str:
    first, last = log.span_s
    about = f"{log.format}, {first:.2f} to {last:.2f} s, {log.frame.value}"
    return about + (f", sha256 {log.sha256[:12]}…" if log.sha256 else "")


def _sections(found: Inspection) -> Iterator[Section]:
    yield Section("Channels", (_channel_table(found),))
    if found.flown is not None:
        words = found.motion.words
        yield from section(_sentence(words.where), Bullets, _airborne(found.flown, words))
        yield from section("References", Bullets, _references(found.flown, words))
    yield from _absent(found)
    parameters = (f"{name} = {value:g}" for name, value in found.parameters.items())
    yield from section("Parameters of the vehicle", Bullets, parameters)
    yield from section("Noticed in the log", Bullets, (finding.message for finding in found.findings))
    yield _verdict(found, *_part(found))


def _part(found: Inspection) -> tuple[str, ...]:
    """Of which part of a long log the verdict is, and why."""
    if found.tried is None:
        return ()
    start, end = found.tried
    why = (
        f"The log does not fit into memory: identify was tried on {start:.1f} to {end:.1f} s. Name another "
        "part with --window START:END."
    )
    return f" of {start:.1f} to {end:.1f} s", why


def _channel_table(found: Inspection) -> TableOf:
    columns = (
        TableColumn("channel, and its source", strong=True, below=Tone.FAINT),
        TableColumn("rate [Hz]", right=True, whole=True),
        TableColumn("range, and remarks", below=Tone.WARNING),
    )
    return TableOf(columns, tuple(_channel(summary) for summary in found.channels))


def _channel(summary: ChannelSummary) -> tuple[Cell, ...]:
    return (
        Cell(summary.name, summary.source),
        Cell(_rate(summary.rate_hz)),
        Cell(_range(summary), "; ".join(_remarks(summary))),
    )


def _rate(rate_hz: float) -> str:
    """To a tenth; of what happens now and then to two digits, which a tenth would make nothing."""
    return f"{rate_hz:.1f}" if rate_hz >= 1.0 or not rate_hz else f"{rate_hz:.2g}"


def _range(summary: ChannelSummary) -> str:
    if not math.isfinite(summary.lowest):
        return NO_NUMBER
    unit = f" {summary.unit}" if summary.unit else ""
    return f"{summary.lowest:.4g} to {summary.highest:.4g}{unit}"


def _remarks(summary: ChannelSummary) -> Iterator[str]:
    quality = summary.quality
    count = len(summary.gaps)
    if count:
        longest = max(end - start for start, end in summary.gaps)
        yield f"1 gap of {longest:.2g} s" if count == 1 else f"{count} gaps up to {longest:.2g} s"
    if summary.delay_s:
        yield f"{1e3 * summary.delay_s:.2g} ms of its own delay taken off its stamps"
    for number, what in (
        (quality.duplicated_stamps, "repeated stamps"),
        (quality.backward_stamps, "backward stamps"),
        (quality.evened_stamps, "evened stamps"),
        (quality.missing_values, "without a value"),
        (quality.overflowed, "overflowed"),
        (quality.saturated, "saturated"),
    ):
        if number:
            yield f"{number} {what}"


def _airborne(flown: Flown, words: Words) -> Iterator[str]:
    yield f"Known by {flown.rule}."
    where = _sentence(words.where)
    yield f"{where}: {_listed(flown.active)}." if flown.active else f"Never {words.where}."
    if flown.active:
        kept = f"{flown.used_s:.1f} s in {_listed(flown.used)}" if flown.used else "nothing"
        yield f"Used, after the limits of {words.limited_by}: {kept}."


def _sentence(words: str) -> str:
    """The words with a capital letter."""
    return words[:1].upper() + words[1:]


def _listed(intervals: tuple[tuple[float, float], ...]) -> str:
    shown = ", ".join(f"{start:.1f} to {end:.1f} s" for start, end in intervals[:LISTED])
    return shown + (f" and {len(intervals) - LISTED} more" if len(intervals) > LISTED else "")


def _references(flown: Flown, words: Words) -> Iterator[str]:
    if not flown.references:
        yield words.no_reference
    for reference in flown.references:
        verdict = "usable" if reference.usable else "not usable"
        yield f"{reference.name}: {verdict} ({reference.remark})."


def _absent(found: Inspection) -> Iterator[Section]:
    """Channels that the reader looked for in vain, the indispensable ones first."""
    log = found.recording
    absent = {
        name: sources
        for name, sources in log.looked_for.items()
        if name not in log.channels and not log.family(name.rstrip("1").rstrip("_"))
    }
    told = {name: sources for name, sources in absent.items() if sources != (f"column {name}",)}
    first = [f"{name} (needed): looked for {_sources(absent.get(name, ()), name)}" for name in found.missing]
    others = [
        f"{name}: looked for {_sources(sources, name)}"
        for name, sources in told.items()
        if name not in found.missing
    ]
    plain = [name for name in absent if name not in told and name not in found.missing]
    columns = [f"Columns {', '.join(plain)}."] if plain else []
    yield from section("Not in the log", Bullets, (*first, *others, *columns))
    yield from section("How to log it", Bullets, found.advice)


def _sources(sources: tuple[str, ...], name: str) -> str:
    return ", ".join(sources) or f"a channel or column '{name}'"


def _verdict(found: Inspection | PooledInspection, of: str = "", *told: str) -> Section:
    heading = f"What identify says{of} (found by running it)"
    if found.result is None:
        said = Statement("nothing: it cannot begin", Status.REFUSED)
    else:
        status = found.result.verdict.status
        said = Statement(status.value, status, f" (method {found.result.method})")
    return Section(heading, (said, Bullets((*found.reasons, *told))))
