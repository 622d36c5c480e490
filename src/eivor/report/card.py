"""Card of results: what is identified and what to set, what is rough, and what is missing and why."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

from eivor.exports.autopilots import ParameterChange, parameter_changes
from eivor.exports.fitted import Fitted
from eivor.flights.result import FlightEstimate
from eivor.inference.verdict import Cause, Reason, Status
from eivor.logs.read import log_format
from eivor.motions.vertical.model import curve_in_force, in_common
from eivor.report.document import Card, CardGroup, CardLine, Look
from eivor.report.rows import QuantityRow, plain_numbers, quantity_rows
from eivor.signals.channels import common_side
from eivor.tools import capitalised

#: Causes that other movements mend.
MOVE = (Cause.ZERO, Cause.WIDE, Cause.EXCITATION)
#: Remedies that a logging profile is part of.
LOGGING = re.compile(r"^Log |, and log ")
#: Looks of quantities whose numbers the card has; of others it has a reason.
WITH_NUMBER = (Look.IDENTIFIED, Look.ROUGH)
HEADINGS = {
    Look.IDENTIFIED: "Identified",
    Look.ROUGH: "Rough",
    Look.MISSING: "Not identified",
    Look.CONTRADICTED: "Contradicted",
}
#: Findings of readers that values are lost, and what is said of them.
DAMAGE = ("corrupt_parts", "checksum", "overflow")
LEFT_OUT = "What is damaged is left out: copy the log again, or mend its logger."


@dataclass(frozen=True, slots=True)
class CardEntry:
    """A quantity of a result that the card has."""

    result: FlightEstimate
    row: QuantityRow
    words: str
    look: Look
    change: ParameterChange | None

    @property
    def reason(self) -> Reason:
        reasons = self.row.quantity.reasons or self.result.verdict.reasons
        red = (reason for reason in reasons if _contradicts(reason))
        return next(red, reasons[0] if reasons else Reason(Status.REFUSED, "It was not estimated."))


def result_card(results: Sequence[FlightEstimate]) -> Card:
    """Card of the results of a log, or of a pool of logs, one for each motion."""
    entries = sorted(card_entries(results), key=lambda entry: entry.change is None)
    by_look = {look: [entry for entry in entries if entry.look is look] for look in Look}
    lines = {
        look: tuple(map(_line, chosen) if look in WITH_NUMBER else _missing(chosen))
        for look, chosen in by_look.items()
    }
    damaged = tuple(_damaged(results[0]))
    headed = [(look, HEADINGS[look], item) for look, item in lines.items()]
    headed.append((Look.CONTRADICTED, "Damaged", damaged))
    groups = tuple(CardGroup(*group) for group in headed if group[-1])
    return Card(*_title(by_look, damaged=bool(damaged)), groups)


def _damaged(result: FlightEstimate) -> list[CardLine]:
    """A line for each damage of a log; the last says what to do."""
    logs = (flight.recording for flight in result.prepared)
    lines = [CardLine(log.name, item.message) for log in logs for item in log.findings if item.name in DAMAGE]
    return [*lines[:-1], *(replace(line, remark=LEFT_OUT) for line in lines[-1:])]


def card_entries(results: Sequence[FlightEstimate]) -> list[CardEntry]:
    """Quantities of every motion that the card has; those of one name have the motion's beside it."""
    entries = [entry for result in results for entry in _entries(result)]
    named = Counter(entry.row.wording.words for entry in entries)
    for index, entry in enumerate(entries):
        if named[entry.row.wording.words] > 1 and entry.change is None:
            entries[index] = replace(entry, words=f"{entry.words} ({entry.result.motion.name})")
    return entries


def quantities_with_number(result: FlightEstimate) -> frozenset[str]:
    """Quantities whose numbers the card has."""
    return frozenset(entry.row.name for entry in _entries(result) if entry.look in WITH_NUMBER)


def answered_reasons(result: FlightEstimate) -> frozenset[Reason]:
    """Reasons that the card gives, with what to do."""
    return frozenset(entry.reason for entry in _entries(result) if entry.look not in WITH_NUMBER)


def _entries(result: FlightEstimate) -> Iterator[CardEntry]:
    changes = {change.quantity: change for change in _changes(result)}
    quantities = result.motion.quantities
    listed = {*quantities.rows, *quantities.headline, *changes}
    for row in quantity_rows(result.quantities, quantities):
        if row.name in listed:
            change = changes.get(row.name)
            words = change.parameter.words if change and change.estimate else row.wording.words
            yield CardEntry(result, row, words, _look(row, result), change)


def _look(row: QuantityRow, result: FlightEstimate) -> Look:
    status = row.quantity.verdict
    if status in (Status.IDENTIFIED, Status.WEAK):
        return Look(status.value)
    reasons = row.quantity.reasons or result.verdict.reasons
    return Look.CONTRADICTED if any(map(_contradicts, reasons)) else Look.MISSING


def _contradicts(reason: Reason) -> bool:
    return reason.status is Status.REFUSED and reason.cause is Cause.CONTRADICTION


def _changes(result: FlightEstimate) -> tuple[ParameterChange, ...]:
    first, logged = result.prepared[0], [flight.recording.parameters for flight in result.prepared]
    fitted = Fitted(
        model=result.motion.words.model,
        quantities=result.quantities,
        input=first.input.name,
        map_name=first.input_map,
        curve_side=common_side(flight.curve_side for flight in result.prepared),
        curve_in_force=curve_in_force(logged),
        input_measured=first.input.measured,
        formats=tuple(flight.recording.format for flight in result.prepared),
        logs=(),
        version="",
    )
    return parameter_changes(fitted, in_common(logged))


def _remark(change: ParameterChange) -> str:
    """How the old value lies to what was flown, or why there is no new one."""
    if change.missing:
        return capitalised(f"{_first(change.missing)}.")
    if change.estimate is None or not all(map(math.isfinite, change.estimate.interval)):
        return ""
    (low, high), old = change.estimate.interval, change.old
    new, value = change.new, change.estimate.value
    moved = new is not None and new.value != value
    end = ", by the curve in force. The new value belongs to the new curve: set both." if moved else "."
    if low <= old <= high:
        return f"{old:.4g} is inside the interval{end}"
    what, side = change.parameter.words.split()[0], "higher" if value > old else "lower"
    how_far = f": {what} is {abs(value / old - 1.0):.0%} {side}" if old > 0.0 else ""
    return f"{old:.4g} is outside the interval{how_far}{end}"


def _line(entry: CardEntry) -> CardLine:
    row, change, wording = entry.row, entry.change, entry.row.wording
    line = CardLine(entry.words, *row.texts, wording.shown_unit, quantity=row.name, symbol=wording.own_symbol)
    if change is None:
        return line
    name, old = change.parameter.name, f"{change.old:.4g}"
    if change.new is None:
        return replace(line, setting=f"{name} is {old}", remark=_remark(change))
    new, _ = plain_numbers(change.new.value, change.new.interval)
    set_to = {"setting": f"{name} {old} -> {new}", "command": f"param set {name} {new}"}
    return replace(line, remark=_remark(change), **set_to)


def _missing(entries: Iterable[CardEntry]) -> Iterator[CardLine]:
    """A line for each reason, with its quantities; of those with one remedy the last has it."""
    names: dict[tuple[str, str], list[CardEntry]] = {}
    for entry in entries:
        cause = entry.reason.cause
        why = cause.value if cause is not Cause.CONTRADICTION else ""
        names.setdefault((_remedy(entry), why or _first(entry.reason.sentence)), []).append(entry)
    ordered = sorted(names, key=lambda item: [remedy for remedy, _ in names].index(item[0]))
    for index, (remedy, why) in enumerate(ordered):
        words = ", ".join(_names(names[remedy, why]))
        shared = index + 1 < len(ordered) and ordered[index + 1][0] == remedy
        yield CardLine(capitalised(words), f"{why}.", remark="" if shared else remedy)


def _names(entries: Sequence[CardEntry]) -> Iterator[str]:
    """Names of quantities; in place of all that a motion has, its title."""
    for _, group in groupby(entries, lambda entry: id(entry.result)):
        first, *others = group
        if others and 1 + len(others) == len(list(_entries(first.result))):
            title = first.result.motion.words.title
            yield f"{title[0].lower()}{title[1:]}"
        else:
            yield from (entry.words for entry in (first, *others))


def _first(sentence: str) -> str:
    return sentence.split(". ", 1)[0].removesuffix(".")


def _remedy(entry: CardEntry) -> str:
    reason, words = entry.reason, entry.result.motion.words
    known = log_format(entry.result.prepared[0].recording.format)
    sweeps, faster = ("", "") if known is None else (known.sweeps, known.faster)
    if reason.cause in MOVE and entry.row.name in words.planned:
        other = f", or {sweeps}" if sweeps else ""
        return f"Fly what eivor plan proposes for this result (--json FIT.json){other}."
    if reason.cause is Cause.EXCITATION and sweeps:
        return f"Fly {sweeps}."
    how = f" ({faster})" if faster and LOGGING.search(reason.remedy) else ""
    return f"{_first(reason.remedy)}{how}." if reason.remedy else ""


def _title(by_look: Mapping[Look, Sequence[CardEntry]], *, damaged: bool) -> tuple[str, Look]:
    for look, before in ((Look.IDENTIFIED, ""), (Look.ROUGH, "roughly, ")):
        for entry in by_look[look][:1]:
            change = entry.change if entry.change and entry.change.estimate else None
            known = f", {change.parameter.name} is {change.old:.4g}" if change else ""
            return capitalised(f"{before}{entry.words} {_line(entry).number}{known}"), look
    if by_look[Look.CONTRADICTED]:
        return "The data contradict themselves: nothing is identified", Look.CONTRADICTED
    if damaged:
        return "The log is damaged: nothing is identified", Look.CONTRADICTED
    return "Nothing is identified", Look.MISSING
