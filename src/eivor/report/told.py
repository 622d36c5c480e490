"""What is told of a result, whatever the medium: the one source of its document and of its JSON.

Sentences, rows and numbers are chosen and put in order here. A medium shows them, and what else it needs it
takes from the result.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from eivor.flights.ahead import Ahead
from eivor.flights.implied import Implications
from eivor.flights.quantity import Kind, Quantity, Wording
from eivor.flights.recipe import not_estimated
from eivor.flights.result import FlightEstimate, FlightRow
from eivor.flights.words import CardSection
from eivor.inference.verdict import Reason, Status, Verdict
from eivor.report.card import flight_card
from eivor.report.fit_checks import Check, checks
from eivor.report.wording import numbers, used
from eivor.signals.recording import Finding

#: Findings that only an inspection shows: they bear on no number.
QUIET_FINDINGS = ("epoch_time",)


@dataclass(frozen=True, slots=True)
class ToldQuantity:
    """A quantity with its words.

    Parameters
    ----------
    name : str
        Its name.
    wording : Wording
        How it is called, measured and shown.
    quantity : Quantity
        Its numbers and its verdict.
    """

    name: str
    wording: Wording
    quantity: Quantity

    @property
    def shown(self) -> tuple[str, str]:
        """Value and interval in the shown unit; see `numbers`."""
        return numbers(self.quantity, self.wording)


@dataclass(frozen=True, slots=True)
class ToldRow:
    """One flight of a pool by itself, or one method beside the chosen one.

    Parameters
    ----------
    label : str
        Log or method.
    status : Status
        Its verdict.
    reasons : tuple of str
        Sentences, each with its remedy.
    quantities : tuple of ToldQuantity
        The motion's `rows`, without numbers where nothing was estimated.
    """

    label: str
    status: Status
    reasons: tuple[str, ...]
    quantities: tuple[ToldQuantity, ...]

    def first_reason(self, fly: str) -> str:
        """The first reason, without the advice `fly` that all of them end with; empty for none."""
        return self.reasons[0].removesuffix(fly).strip() if self.reasons else ""


@dataclass(frozen=True, slots=True)
class ToldFlight:
    """A result, ready to be told.

    Parameters
    ----------
    logs : tuple of str
        Names of the logs.
    verdict : Verdict
        The overall one, with reasons and remedies.
    meaning : str
        What its status means.
    equation : tuple of str
        The motion's equation, and what its symbols are.
    symbols : str
        What the symbols are in this flight.
    method, instruments : str
        What it was estimated with.
    used : str
        How much of the flights was used.
    quantities : tuple of ToldQuantity
        Every one, in the order of results.
    order : tuple of str
        Their names in the order of reports.
    checks : tuple of (str, str)
        What was checked, a title and a sentence each.
    diagnostics : mapping of str to float
        The numbers behind it.
    findings : tuple of Finding
        All that was noticed.
    flights, comparisons : tuple of ToldRow
        Flights by themselves, and methods.
    by_flight : tuple of ToldRow
        What a pool says of each flight, every quantity.
    own : tuple of str
        Quantities of which each flight of a pool has its own.
    fly : str
        What to fly when nothing else helps.
    card : tuple of CardSection
        What to fly and to log, step by step; empty when the flight is identified.
    rows : tuple of str
        Names of the quantities that tables of flights show.
    implications : Implications
        What follows for the vehicle from the estimate and from what was supplied.
    ahead : Ahead or None
        Predictions of the flights themselves some tenths of a second ahead.
    """

    logs: tuple[str, ...]
    verdict: Verdict
    meaning: str
    equation: tuple[str, str]
    symbols: str
    method: str
    instruments: str
    used: str
    quantities: tuple[ToldQuantity, ...]
    order: tuple[str, ...]
    checks: tuple[Check, ...]
    diagnostics: Mapping[str, float]
    findings: tuple[Finding, ...]
    flights: tuple[ToldRow, ...]
    comparisons: tuple[ToldRow, ...]
    by_flight: tuple[ToldRow, ...]
    own: tuple[str, ...]
    fly: str
    card: tuple[CardSection, ...]
    rows: tuple[str, ...]
    implications: Implications
    ahead: Ahead | None

    @property
    def brief(self) -> tuple[ToldQuantity, ...]:
        """Quantities that tables of flights show, where there is an estimate."""
        estimated = any(np.isfinite(told.quantity.std_error) for told in self.quantities)
        return tuple(told for told in self.reported if told.name in self.rows) if estimated else ()

    @property
    def reasons(self) -> tuple[Reason, ...]:
        """Grounds of the verdict, worst first."""
        return self.verdict.reasons

    @property
    def further(self) -> tuple[tuple[str, Reason], ...]:
        """Grounds against single quantities that are not grounds of the verdict, with their symbols."""
        against: dict[Reason, list[str]] = {}
        for told in self.quantities:
            for reason in told.quantity.reasons:
                against.setdefault(reason, []).append(told.wording.symbol)
        known = {reason.sentence for reason in self.reasons}
        return tuple(
            (", ".join(symbols), reason)
            for reason, symbols in against.items()
            if reason.sentence not in known
        )

    @property
    def systematic(self) -> tuple[tuple[str, str], ...]:
        """Systematic parts of intervals: the quantity in words, and what for."""
        return tuple(
            (told.wording.words, one.sentence)
            for told in self.reported
            if told.quantity.verdict is not Status.REFUSED
            for one in told.quantity.allowances
        )

    @property
    def remedies(self) -> tuple[str, ...]:
        """What would change it, each remedy once."""
        reasons = (*self.reasons, *(reason for _, reason in self.further))
        found = dict.fromkeys(reason.remedy for reason in reasons if reason.remedy)
        return tuple(one for one in found if not any(one != more and more.startswith(one) for more in found))

    @property
    def summary(self) -> str:
        """What is told, what is told weakly, and what is not and why; empty without numbers.

        It speaks of the quantities that tables of flights show.
        """
        if not self.brief or all(
            told.quantity.verdict is self.brief[0].quantity.verdict for told in self.brief
        ):
            return ""
        parts = []
        for statuses, words in (
            ((Status.IDENTIFIED,), "told"),
            ((Status.WEAK, Status.PROVISIONAL), "told roughly"),
            ((Status.REFUSED,), "not told"),
        ):
            names = [told.wording.words for told in self.brief if told.quantity.verdict in statuses]
            if names:
                parts.append(f"{in_words(names)} {'is' if len(names) == 1 else 'are'} {words}")
        refused = next(
            (told.quantity for told in self.brief if told.quantity.verdict is Status.REFUSED), None
        )
        why = refused.reasons[0].sentence if refused is not None and refused.reasons else ""
        why = f"{why.split('. ', 1)[0].removesuffix('.')}." if why else ""
        told = "; ".join(parts)
        return f"{told[0].upper()}{told[1:]}{f', because {_begun(why)}' if why else '.'}"

    @property
    def reported(self) -> tuple[ToldQuantity, ...]:
        """Quantities in the order of reports."""
        by_name = {told.name: told for told in self.quantities}
        return tuple(by_name[name] for name in self.order if name in by_name)

    @property
    def worth_telling(self) -> tuple[Finding, ...]:
        """Findings but the quiet ones and the reasons; what is said of several logs is said once."""
        reasons = {reason.sentence for reason in self.reasons}
        said: dict[tuple[str, str], list[str]] = {}
        for finding in self.findings:
            if finding.name in QUIET_FINDINGS or finding.message in reasons:
                continue
            log = next((name for name in self.logs if finding.message.startswith(f"{name}: ")), "")
            message = finding.message.removeprefix(f"{log}: ") if log else finding.message
            said.setdefault((finding.name, message), []).extend([log] if log else [])
        told = []
        for (name, message), about in said.items():
            everywhere = len(about) == len(self.logs) > 1
            prefix = "Every log: " if everywhere else f"{', '.join(about)}: " if about else ""
            told.append(Finding(name, prefix + message))
        return tuple(told)


def told_flight(result: FlightEstimate) -> ToldFlight:
    """What is told of a result, with or without an estimate."""
    motion = result.motion
    return ToldFlight(
        logs=tuple(flight.recording.name for flight in result.prepared),
        verdict=result.verdict,
        meaning=motion.words.meanings[result.verdict.status],
        equation=motion.written,
        symbols=motion.symbols(result.prepared[0]),
        method=result.method,
        instruments=result.instruments,
        used=used(result),
        quantities=_told(result.quantities, motion.wording),
        order=motion.shown,
        checks=checks(result),
        diagnostics=result.diagnostics,
        findings=result.findings,
        flights=tuple(_row(row, result) for row in result.flights),
        comparisons=tuple(_row(row, result) for row in result.comparisons),
        by_flight=tuple(_whole_row(row, result) for row in result.by_flight),
        own=_own(result),
        fly=motion.words.fly,
        card=flight_card(result),
        rows=motion.rows,
        implications=result.implications,
        ahead=result.ahead,
    )


def in_words(names: Sequence[str]) -> str:
    """Names with commas and an "and" between them."""
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last


def _begun(sentence: str) -> str:
    """A sentence as the rest of another: "The lag is" becomes "the lag is"."""
    article = sentence.split(" ", 1)[0] in {"The", "A", "An", "No", "Every", "Its"}
    return f"{sentence[0].lower()}{sentence[1:]}" if article else sentence


def of_kind(quantities: tuple[ToldQuantity, ...], kind: Kind) -> tuple[ToldQuantity, ...]:
    """Parameters, or what is derived of them."""
    return tuple(told for told in quantities if told.wording.kind is kind)


def _row(row: FlightRow, result: FlightEstimate) -> ToldRow:
    motion = result.motion
    quantities = not_estimated(motion, {}) | dict(row.quantities)
    wording = {name: motion.wording[name] for name in motion.rows}
    return ToldRow(row.label, row.verdict, row.reasons, _told(quantities, wording))


def _whole_row(row: FlightRow, result: FlightEstimate) -> ToldRow:
    return ToldRow(row.label, row.verdict, row.reasons, _told(row.quantities, result.motion.wording))


def _own(result: FlightEstimate) -> tuple[str, ...]:
    """Quantities of a pool that are not alike in all flights."""
    tables = [row.quantities for row in result.by_flight]
    names = [name for name in result.motion.shown if all(name in table for table in tables)]
    return tuple(name for name in names if len({table[name].value for table in tables}) > 1)


def _told(quantities: Mapping[str, Quantity], wording: Mapping[str, Wording]) -> tuple[ToldQuantity, ...]:
    return tuple(
        ToldQuantity(name, words, quantities[name]) for name, words in wording.items() if name in quantities
    )
