"""Inspection of logs: what they hold and what identification would say."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from eivor.errors import EivorError
from eivor.flights.motion import Motion
from eivor.flights.options import FlightOptions
from eivor.flights.prepare import overview
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import NAN
from eivor.flights.result import FlightEstimate
from eivor.motions.identify import identify_flight
from eivor.motions.rigid_body.compatibility import Calibration, comparisons, wind_table
from eivor.report import document as doc
from eivor.report import flight as report
from eivor.report.json_document import Json, document
from eivor.signals.recording import Channel, Finding, MadeChannels, Recording
from eivor.tools import capitalised

#: Of a log that does not fit into memory, in which more was flown, `identify` is tried on so much [s].
TRIED_WHOLE_S, TRIED_S = 600.0, 180.0
#: Stretches of time, first and last second of each.
Stretches = tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class ChannelSummary:
    """One channel in numbers."""

    channel: Channel
    lowest: float
    highest: float
    gaps: tuple[tuple[float, float], ...]  # Intervals without a sample [s]


@dataclass(frozen=True)
class Inspection:
    """A log, and what `identify` makes of it, or why it cannot begin."""

    result: FlightEstimate | None
    obstacle: EivorError | None
    motion: Motion[Any]
    recording: Recording
    channels: tuple[ChannelSummary, ...]
    missing: tuple[str, ...]  # Channels without which nothing can be identified, and that the log lacks
    advice: tuple[str, ...]
    whole: tuple[str, Stretches] | None = None
    tried: tuple[float, float] | None = None  # [s]

    @property
    def reasons(self) -> tuple[str, ...]:
        if self.result is not None:
            return self.result.verdict.sentences
        return (str(self.obstacle),) if self.obstacle is not None else ()

    @property
    def findings(self) -> tuple[Finding, ...]:
        return self.recording.findings if self.result is None else self.result.findings

    @property
    def flight(self) -> PreparedFlight | None:
        """The log as `identify` takes it; None when it cannot begin."""
        return None if self.result is None else self.result.prepared[0]

    def active(self, flight: PreparedFlight) -> tuple[str, Stretches]:
        """Rule by which the vehicle was in motion, and the stretches in which it was."""
        return self.whole or (flight.active.rule, report.spans_of(flight.active.mask, flight.grid.time_s))

    @property
    def calibration(self) -> tuple[str, ...]:
        """Offset, scale and tilt between two measurements of one response, in words."""
        fit = None if self.result is None else self.result.fit
        sensors = None if fit is None else fit.sensors
        return () if sensors is None else (self.motion.abilities.sensors.sentence(sensors),)

    @cached_property
    def compatibility(self) -> tuple[Calibration, ...]:
        """Clocks, scales, biases and axes of sensors in the air, by kinematics alone."""
        spans = (self.recording.span_s,) if self.flight is None else self.active(self.flight)[1]
        sensors = (row for item in comparisons(self.recording, spans) for row in item.table())
        return (*sensors, *wind_table(self.recording, spans))

    @property
    def parameters(self) -> dict[str, float]:
        logged = self.recording.parameters
        return {name: logged[name] for name in self.motion.channels.parameters if name in logged}


def inspection(recording: Recording, options: FlightOptions, motion: Motion[Any]) -> Inspection:
    """Inspect a log; never raises for what the log lacks."""
    result, obstacle, whole, tried = None, None, None, None
    try:
        if isinstance(recording.channels, MadeChannels) and options.window is None:
            whole = overview(recording, motion, options)
            tried = _part_to_try(whole[1])
        part = options if tried is None else replace(options, window=tried)
        result = identify_flight(recording, part, model=motion)
    except EivorError as error:
        obstacle = error
    missing = report.missing_channels(recording, motion)
    texts = (sentence for name in missing for sentence in report.logging_advice_for(recording, name))
    channels = tuple(_summary(recording.channels[name]) for name in sorted(recording.channels))
    advice = tuple(dict.fromkeys(texts))
    return Inspection(result, obstacle, motion, recording, channels, missing, advice, whole, tried)


def _part_to_try(active: Stretches) -> tuple[float, float] | None:
    """The middle of the longest stretch in the air; None where so little was flown that all can be tried."""
    if sum(end - start for start, end in active) <= TRIED_WHOLE_S:
        return None
    start, end = max(active, key=lambda stretch: stretch[1] - stretch[0])
    middle, half = 0.5 * (start + end), 0.5 * min(TRIED_S, end - start)
    return middle - half, middle + half


def _summary(channel: Channel) -> ChannelSummary:
    finite, ends = np.isfinite(channel.values), (NAN, NAN)
    if finite.any():
        low = np.min(channel.values, where=finite, initial=np.inf)
        ends = float(low), float(np.max(channel.values, where=finite, initial=-np.inf))
    # a held channel may rest: silence is no gap in it
    gaps = () if channel.held and channel.rate_hz < 1.0 else tuple(channel.gaps())
    return ChannelSummary(channel, *ends, gaps)


def inspection_json(inspection: Inspection) -> dict[str, Json]:
    """Document of a log, ready for `json_text`."""
    log, flight, airborne = inspection.recording, inspection.flight, None
    if flight is not None:
        rule, active = inspection.active(flight)
        airborne = {
            "rule": rule,
            "segments": active,
            "used": report.spans_of(flight.used, flight.grid.time_s),
        }
    return document(
        "eivor.inspect/1",
        log={
            "name": log.name,
            "format": log.format,
            "frame": log.frame.name.lower(),
            "sha256": log.sha256 or None,
            "span": log.span_s,
        },
        channels=[
            {
                **{name: getattr(item.channel, name) for name in ("name", "source", "unit")},
                "samples": item.channel.time_s.size,
                **{name: getattr(item.channel, name) for name in ("rate_hz", "held", "estimated", "delay_s")},
                "range": (item.lowest, item.highest),
                "gaps": item.gaps,
                **asdict(item.channel.quality),
            }
            for item in inspection.channels
        ],
        missing=inspection.missing,
        looked_for=log.looked_for,
        advice=inspection.advice,
        airborne=airborne,
        tried=inspection.tried,
        references=[
            {"name": reference.name, "usable": reference.usable, "remark": reference.remark}
            for reference in (flight.references if flight else ())
        ],
        parameters=inspection.parameters,
        calibration=inspection.compatibility,
        findings=inspection.findings,
        verdict="unusable" if inspection.result is None else inspection.result.verdict.status.value,
        reasons=inspection.reasons,
    )


#: So many gaps or stretches are listed one by one.
LISTED = 6


def inspection_document(result: Inspection) -> doc.Document:
    """Document of a log: channels, findings and verdict, with the flight card if there is one."""
    card = () if result.result is None else report.card_section(report.flight_steps(result.result))
    return _document(result, (*_sections(result), *card))


def _document(inspected: Inspection, sections: tuple[doc.Section, ...]) -> doc.Document:
    log, (first, last) = inspected.recording, inspected.recording.span_s
    sha256 = f", sha256 {log.sha256[:12]}…" if log.sha256 else ""
    about = f"{log.format}, {first:.2f} to {last:.2f} s, {log.frame.value}{sha256}"
    return doc.Document(log.name, about, sections)


def calibration_document(result: Inspection) -> doc.Document:
    """Document of the calibration of a log's sensors by kinematics."""
    sentence = "Sensors cannot be compared: attitude and body rates, at 20 Hz or more, are not logged."
    heads = ("by kinematics alone", doc.TableColumn("value", right=True), "95 % interval", "unit")
    rows = [(row.what, *_numbers(row), row.unit) for row in result.compatibility]
    part = doc.table(heads, rows) if rows else doc.Bullets((sentence,))
    return _document(result, (doc.Section("Calibration", (part,)),))


def _numbers(row: Calibration) -> tuple[str, str]:
    is_known = math.isfinite(row.value)
    return doc.plain_numbers(row.value, row.interval) if is_known else ("not known", doc.NO_NUMBER)


def _sections(result: Inspection) -> Iterator[doc.Section]:
    yield doc.Section("Channels", (_channel_table(result),))
    if result.flight is not None:
        words, references = result.motion.words, result.flight.references
        yield from doc.section(capitalised(words.where), doc.Bullets, _airborne(result, result.flight))
        usable = (
            f"{item.name}: {'usable' if item.usable else 'not usable'} ({item.remark})."
            for item in references
        )
        yield doc.Section("References", (doc.Bullets(tuple(usable) or (words.no_reference,)),))
        yield from doc.section("Calibration", doc.Bullets, result.calibration)
    yield from _absent(result)
    parameters = (f"{name} = {value:g}" for name, value in result.parameters.items())
    yield from doc.section("Parameters of the vehicle", doc.Bullets, parameters)
    yield from doc.section(
        "Noticed in the log", doc.Bullets, (finding.message for finding in result.findings)
    )
    if result.tried is None:
        yield _verdict_section(result)
        return
    part = "{:.1f} to {:.1f} s".format(*result.tried)
    why = f"The log does not fit into memory: identify was tried on {part}."
    yield _verdict_section(result, f" of {part}", f"{why} Name another part with --window START:END.")


def _channel_table(result: Inspection) -> doc.TableOf:
    columns = (
        doc.TableColumn("channel, and its source", strong=True, below=doc.Tone.FAINT),
        doc.TableColumn("rate [Hz]", right=True, whole=True),
        doc.TableColumn("range, and remarks", below=doc.Tone.WARNING),
    )
    rows = []
    for item in result.channels:
        channel, rate = item.channel, item.channel.rate_hz
        # of what happens now and then two digits, which a tenth would make nothing
        text = f"{rate:.1f}" if rate >= 1.0 or not rate else f"{rate:.2g}"
        span = doc.NO_NUMBER
        if math.isfinite(item.lowest):
            span = f"{item.lowest:.4g} to {item.highest:.4g} {channel.unit}".rstrip()
        remarks = "; ".join(_remarks(item))
        rows.append((doc.Cell(channel.name, channel.source), text, doc.Cell(span, remarks)))
    return doc.table(columns, rows)


def _remarks(summary: ChannelSummary) -> Iterator[str]:
    quality = summary.channel.quality
    count = len(summary.gaps)
    if count:
        longest = max(end - start for start, end in summary.gaps)
        yield f"1 gap of {longest:.2g} s" if count == 1 else f"{count} gaps up to {longest:.2g} s"
    if summary.channel.delay_s:
        yield f"{1e3 * summary.channel.delay_s:.2g} ms of its own delay taken off its stamps"
    for number, words in (
        (quality.duplicated_stamps, "repeated stamps"),
        (quality.backward_stamps, "backward stamps"),
        (quality.evened_stamps, "evened stamps"),
        (quality.missing_values, "without a value"),
        (quality.overflowed, "overflowed"),
        (quality.saturated, "saturated"),
    ):
        if number:
            yield f"{number} {words}"


def _airborne(result: Inspection, flight: PreparedFlight) -> Iterator[str]:
    (rule, active), words = result.active(flight), result.motion.words
    yield f"Known by {rule}."
    yield f"{capitalised(words.where)}: {_interval_list(active)}." if active else f"Never {words.where}."
    if active:
        used = report.spans_of(flight.used, flight.grid.time_s)
        duration = f"{flight.used_s:.1f} s in {_interval_list(used)}" if used else "nothing"
        yield f"Used, after the limits of {words.limited_by}: {duration}."


def _interval_list(intervals: Stretches) -> str:
    text = ", ".join(f"{start:.1f} to {end:.1f} s" for start, end in intervals[:LISTED])
    return text + (f" and {len(intervals) - LISTED} more" if len(intervals) > LISTED else "")


def _absent(result: Inspection) -> Iterator[doc.Section]:
    log = result.recording
    absent = {
        name: sources
        for name, sources in log.looked_for.items()
        if name not in log.channels and not log.family(name.rstrip("1").rstrip("_"))
    }

    def where(name: str) -> str:
        return ", ".join(absent.get(name, ())) or f"a channel or column '{name}'"

    unmapped = [name for name, sources in absent.items() if sources == (f"column {name}",)]
    first = [f"{name} (needed): looked for {where(name)}" for name in result.missing]
    others = [
        f"{name}: looked for {where(name)}" for name in absent if name not in (*unmapped, *result.missing)
    ]
    unmapped = [name for name in unmapped if name not in result.missing]
    columns = [f"Columns {', '.join(unmapped)}."] if unmapped else []
    yield from doc.section("Not in the log", doc.Bullets, (*first, *others, *columns))
    yield from doc.section("How to log it", doc.Bullets, result.advice)


def _verdict_section(result: Inspection, part: str = "", *record: str) -> doc.Section:
    heading = f"What identify says{part} (found by running it)"
    if result.result is None:
        statement = doc.Statement("nothing: it cannot begin", doc.Look.MISSING)
    else:
        card = report.result_card((result.result,))
        statement = doc.Statement(card.title, card.look, f" (method {result.result.method})")
    return doc.Section(heading, (statement, doc.Bullets((*result.reasons, *record))))
