"""Document of a flight's result, and the card that comes first."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from math import isfinite
from typing import Any

import numpy as np

from eivor.exports.autopilots import ParameterChange, parameter_changes
from eivor.exports.fitted import Fitted
from eivor.flights.estimate import not_estimated
from eivor.flights.motion import Motion, MultiStepPrediction
from eivor.flights.quantity import NO_INTERVAL, CardSection, Implications, KeyFigure, QuantitySpec
from eivor.flights.result import Fit, FlightEstimate, FlightRow, LogEstimate
from eivor.inference.diagnostics.instruments import STRONG_FIRST_STAGE
from eivor.inference.diagnostics.record import outcome_word
from eivor.inference.diagnostics.residuals import LARGE_LEVERAGE
from eivor.inference.verdict import Cause, Reason, Status
from eivor.logs.read import log_format
from eivor.motions.vertical.model import curve_in_force, in_common
from eivor.report import document as doc
from eivor.report.document import Card, CardGroup, CardLine, Look
from eivor.signals.channels import common_side
from eivor.signals.recording import Recording
from eivor.signals.signals import stretches
from eivor.tools import Bool, Float, capitalised

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
    row: doc.QuantityRow
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
        look: tuple(map(_line, chosen) if look in WITH_NUMBER else _missing_lines(chosen))
        for look, chosen in by_look.items()
    }
    logs = (flight.recording for flight in results[0].prepared)
    damaged = [
        CardLine(log.name, item.message) for log in logs for item in log.findings if item.name in DAMAGE
    ]
    damaged[-1:] = [replace(line, remark=LEFT_OUT) for line in damaged[-1:]]
    headed = [(look, HEADINGS[look], item) for look, item in lines.items()]
    headed.append((Look.CONTRADICTED, "Damaged", tuple(damaged)))
    groups = tuple(CardGroup(*group) for group in headed if group[-1])
    return Card(*_title(by_look, damaged=bool(damaged)), groups)


def card_entries(results: Sequence[FlightEstimate]) -> list[CardEntry]:
    """Quantities of every motion that the card has; those of one name have the motion's beside it."""
    entries = [entry for result in results for entry in _entries(result)]
    counts = Counter(entry.row.wording.words for entry in entries)
    for index, entry in enumerate(entries):
        if counts[entry.row.wording.words] > 1 and entry.change is None:
            entries[index] = replace(entry, words=f"{entry.words} ({entry.result.motion.name})")
    return entries


def answered_reasons(result: FlightEstimate) -> frozenset[Reason]:
    """Reasons that the card gives with a remedy."""
    return frozenset(entry.reason for entry in _entries(result) if entry.look not in WITH_NUMBER)


def _entries(result: FlightEstimate) -> Iterator[CardEntry]:
    changes = {change.quantity: change for change in _changes(result)}
    quantities = result.motion.quantities
    reported = {*quantities.rows, *quantities.headline, *changes}
    for row in doc.quantity_rows(result.quantities, quantities):
        if row.name in reported:
            change = changes.get(row.name)
            words = change.parameter.words if change and change.estimate else row.wording.words
            yield CardEntry(result, row, words, _look(row, result), change)


def _look(row: doc.QuantityRow, result: FlightEstimate) -> Look:
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
    """Old value compared to the interval of the estimate, or the reason for no new value."""
    if change.missing:
        return capitalised(f"{_first_sentence(change.missing)}.")
    if change.estimate is None or not all(map(math.isfinite, change.estimate.interval)):
        return ""
    (low, high), old = change.estimate.interval, change.old
    new, value = change.new, change.estimate.value
    new_curve = new is not None and new.value != value
    end = ", by the curve in force. The new value belongs to the new curve: set both." if new_curve else "."
    if low <= old <= high:
        return f"{old:.4g} is inside the interval{end}"
    noun, side = change.parameter.words.split()[0], "higher" if value > old else "lower"
    how_far = f": {noun} is {abs(value / old - 1.0):.0%} {side}" if old > 0.0 else ""
    return f"{old:.4g} is outside the interval{how_far}{end}"


def _line(entry: CardEntry) -> CardLine:
    row, change, wording = entry.row, entry.change, entry.row.wording
    line = CardLine(entry.words, *row.texts, wording.shown_unit, quantity=row.name, symbol=wording.own_symbol)
    if change is None:
        return line
    name, old = change.parameter.name, f"{change.old:.4g}"
    if change.new is None:
        return replace(line, setting=f"{name} is {old}", remark=_remark(change))
    new, _ = doc.plain_numbers(change.new.value, change.new.interval)
    set_to = {"setting": f"{name} {old} -> {new}", "command": f"param set {name} {new}"}
    return replace(line, remark=_remark(change), **set_to)


def _missing_lines(entries: Iterable[CardEntry]) -> Iterator[CardLine]:
    """A line for each reason, with its quantities; the last of those with one remedy has the remedy."""
    names: dict[tuple[str, str], list[CardEntry]] = {}
    for entry in entries:
        kind = entry.reason.cause
        cause = kind.value if kind is not Cause.CONTRADICTION else ""
        names.setdefault((_remedy(entry), cause or _first_sentence(entry.reason.sentence)), []).append(entry)
    ordered = sorted(names, key=lambda item: [remedy for remedy, _ in names].index(item[0]))
    for index, (remedy, cause) in enumerate(ordered):
        words = ", ".join(_names(names[remedy, cause]))
        repeated = index + 1 < len(ordered) and ordered[index + 1][0] == remedy
        yield CardLine(capitalised(words), f"{cause}.", remark="" if repeated else remedy)


def _names(entries: Sequence[CardEntry]) -> Iterator[str]:
    """Names of quantities; in place of all that a motion has, its title."""
    for _, group in groupby(entries, lambda entry: id(entry.result)):
        first, *others = group
        if others and 1 + len(others) == len(list(_entries(first.result))):
            title = first.result.motion.words.title
            yield f"{title[0].lower()}{title[1:]}"
        else:
            yield from (entry.words for entry in (first, *others))


def _first_sentence(sentence: str) -> str:
    return sentence.split(". ", 1)[0].removesuffix(".")


def _remedy(entry: CardEntry) -> str:
    reason, words = entry.reason, entry.result.motion.words
    spec = log_format(entry.result.prepared[0].recording.format)
    sweeps, faster = ("", "") if spec is None else (spec.sweeps, spec.faster)
    if reason.cause in MOVE and entry.row.name in words.planned:
        sweep = f", or {sweeps}" if sweeps else ""
        return f"Fly what eivor plan proposes for this result (--json FIT.json){sweep}."
    if reason.cause is Cause.EXCITATION and sweeps:
        return f"Fly {sweeps}."
    how = f" ({faster})" if faster and LOGGING.search(reason.remedy) else ""
    return f"{_first_sentence(reason.remedy)}{how}." if reason.remedy else ""


def _title(by_look: Mapping[Look, Sequence[CardEntry]], *, damaged: bool) -> tuple[str, Look]:
    for look, prefix in ((Look.IDENTIFIED, ""), (Look.ROUGH, "roughly, ")):
        for entry in by_look[look][:1]:
            change = entry.change if entry.change and entry.change.estimate else None
            setting = f", {change.parameter.name} is {change.old:.4g}" if change else ""
            return capitalised(f"{prefix}{entry.words} {_line(entry).number}{setting}"), look
    if by_look[Look.CONTRADICTED]:
        return "The data contradict themselves: nothing is identified", Look.CONTRADICTED
    if damaged:
        return "The log is damaged: nothing is identified", Look.CONTRADICTED
    return "Nothing is identified", Look.MISSING


def flight_steps(result: FlightEstimate) -> tuple[CardSection, ...]:
    """What to fly and log instead; empty when the flight is identified."""
    if result.verdict.status is Status.IDENTIFIED:
        return ()
    return result.motion.words.advice(result.prepared[0].recording.format)


def missing_channels(recording: Recording, motion: Motion[Any]) -> tuple[str, ...]:
    """Channels without which the motion cannot be identified, and that the log lacks."""
    alternatives = [name.split("|") for name in motion.channels.needed]
    missing = [names[0] for names in alternatives if not {*names} & {*recording.channels}]
    inputs = [family.name for family in motion.channels.inputs]
    if "input" in inputs and not any(map(recording.family, inputs)):
        missing.append("input")
    return tuple(missing)


def logging_advice_for(recording: Recording, channel: str) -> tuple[str, ...]:
    """What to log so that `channel` is there; empty for logs whose format has no advice."""
    spec = log_format(recording.format)
    return spec.advice(channel) if spec is not None else ()


def spans_of(
    mask: Bool[np.ndarray, " n"], time_s: Float[np.ndarray, " n"]
) -> tuple[tuple[float, float], ...]:
    """First and last time of each stretch of a mask."""
    return tuple((float(time_s[part.start]), float(time_s[part.stop - 1])) for part in stretches(mask))


def used(result: FlightEstimate) -> str:
    """How much of the flights was used, in one line."""
    flights = [flight for flight in result.prepared if flight.runs]
    if not flights:
        return "no usable sample"
    runs = sum(len(flight.runs) for flight in flights)
    seconds = sum(flight.used_s for flight in flights)
    rates = sorted({round(flight.signals.rate_hz) for flight in flights})
    span = ""
    if result.window_s is not None:
        span = f" between {result.window_s[0]:.1f} and {result.window_s[1]:.1f} s"
    run = "one run" if runs == 1 else f"{runs} runs"
    return f"{seconds:.1f} s in {run}{span}, on a grid of {' and '.join(map(str, rates))} Hz"


#: Units that people read angles in, with what numbers are multiplied by.
SHOWN_IN = {"rad": ("deg", math.degrees(1.0)), "rad/s": ("deg/s", math.degrees(1.0))}


def display_unit(unit: str) -> tuple[str, float]:
    """Unit to show, and what numbers in the given one are multiplied by."""
    return SHOWN_IN.get(unit, (unit, 1.0))


def prediction_rows(prediction: MultiStepPrediction) -> list[tuple[str, ...]]:
    """Quantity, model, shown unit, and root mean square errors by horizon, of every prediction."""
    rows = []
    for item in prediction.errors:
        unit, times = display_unit(item.unit)
        rows.append((item.quantity, item.words, unit, *(f"{times * error:.3g}" for error in item.rms)))
    return rows


def prediction_parts(prediction: MultiStepPrediction, *, sentence: bool = True) -> tuple[doc.Part, ...]:
    """Root mean square errors of every quantity and model by horizon, and what is left out."""
    if not prediction.errors:
        return doc.bullets(prediction.omitted)
    sentences = ((prediction.sentence,) if sentence else ()) + (prediction.inequality,)
    horizons = (doc.TableColumn(f"{item:g} s", right=True, whole=True) for item in prediction.horizons_s)
    rows, previous = [], ""
    for quantity, words, unit, *errors in prediction_rows(prediction):
        rows.append(("" if quantity == previous else f"{quantity} [{unit}]", words, *errors))
        previous = quantity
    errors_by_horizon = doc.table((doc.TableColumn("RMS error of", whole=True), "by", *horizons), rows)
    return (errors_by_horizon, *doc.bullets((*sentences, *prediction.omitted)))


#: Outcomes of the tests of a pool.
AGREEMENT = ("agree", "may differ", "differ")
#: A check's title and its sentence.
Check = tuple[str, str]


def checks(result: FlightEstimate) -> Iterator[Check]:
    """Checks of an estimate, those left out that its method cannot make; none without an estimate."""
    if result.fit is not None:
        for make in (_prior_checks, _instruments, _constancy, _periodicity, _residual, _least_squares):
            yield from make(result, result.fit)
        yield from result.fit.motion_checks.report


def _prior_checks(result: FlightEstimate, fit: Fit) -> Iterator[Check]:
    if fit.lag_prior is not None:
        yield "lag", f"{fit.lag_prior.sentence} {_p_of(fit.lag_prior.p_value)}"
    pool = fit.pooled
    if pool is not None:
        text, differing = (
            ", ".join(result.motion.quantities[name].symbol for name in names)
            for names in (pool.tested, pool.differing)
        )
        yield (
            "pool",
            f"the flights {outcome_word(pool.agreement_p_value, AGREEMENT)} in {text} "
            f"{_p_of(pool.agreement_p_value)} and "
            f"{outcome_word(pool.shared_p_value, AGREEMENT)} in "
            f"{differing or 'what they share'} {_p_of(pool.shared_p_value)}",
        )
    if fit.sensors is not None:
        yield "sensors", result.motion.abilities.sensors.sentence(fit.sensors)


def _instruments(result: FlightEstimate, fit: Fit) -> Iterator[Check]:
    strongest = {name: F for name, F in fit.checks.first_stage.items() if isfinite(F)}
    strengths = [f"{F:.0f} for {result.motion.quantities[name].symbol}" for name, F in strongest.items()]
    if strengths:
        yield "instruments", f"first-stage F {', '.join(strengths)} ({STRONG_FIRST_STAGE:.0f} is needed)"
    agreement = fit.checks.agreement
    if agreement is not None and fit.checks.rank and isfinite(agreement.p_value):
        yield "agreement", f"the instruments {agreement.outcome} {_p_of(agreement.p_value)}"


def _constancy(result: FlightEstimate, fit: Fit) -> Iterator[Check]:
    constant = fit.checks.constancy
    if constant is None:
        return
    sentence = f"the parameters {constant.outcome} {_p_of(constant.p_value)}"
    if constant.speaks:
        changes = [
            f"{wording.symbol} by {constant.change[result.names.index(name)] * wording.scale:+.2g} "
            f"{wording.shown_unit}".rstrip()
            for name, wording in _headline(result)
        ]
        sentence += f", most likely {constant.break_at:.0%} into the time used: {', '.join(changes)}"
    yield "constancy", sentence


def _periodicity(result: FlightEstimate, fit: Fit) -> Iterator[Check]:
    swinging = fit.checks.periodicity
    if swinging is None:
        return
    tail = _p_of(swinging.p_value)
    if not swinging.speaks:
        yield "periods", f"no periodic component in the residual {tail}"
        return
    strongest = swinging.strongest
    period = f"with a period of {strongest.period:.2g} s {tail}"
    if strongest in swinging.left_over:
        sentence = (
            f"what the model leaves over of the {strongest.of} swings by {strongest.extent} {period}, "
            "as by a wind or a supply that swings"
        )
    else:
        wording = result.motion.quantities[strongest.of]
        extent = f"±{strongest.amplitude * wording.scale:.2g} {wording.shown_unit}".rstrip()
        sentence = f"{wording.symbol} varies by {extent} {period}"
    yield "periods", sentence


def _residual(result: FlightEstimate, fit: Fit) -> Iterator[Check]:
    memory, leverage = fit.checks.memory, fit.checks.leverage
    if memory is not None:
        drifting = " (it drifts)" if memory.drifts else ""
        width = 2.0 * memory.order_error
        yield "residual", f"memory {memory.memory:.2f} ± {width:.2f} (0 = none){drifting}"
    if fit.checks.memory_by_axis:
        memories = (f"{axis} {item.memory:.2f}" for axis, item in fit.checks.memory_by_axis.items())
        yield "by axis", f"memory of the residual: {', '.join(memories)}"
    if leverage is None:
        return
    for name, wording in _headline(result)[:1]:
        index = result.names.index(name)
        size = float(leverage.largest[index])
        if isfinite(size):
            hint = ": inspect that part" if abs(size) > LARGE_LEVERAGE else ""
            which = f"part {leverage.most[index] + 1} of {leverage.shift.shape[0]}"
            yield "leverage", f"dropping {which} shifts {wording.symbol} by {size:+.1f} standard errors{hint}"


def _least_squares(result: FlightEstimate, fit: Fit) -> Iterator[Check]:
    test, sentence = fit.checks.endogeneity, []
    if test is None:
        return
    for name, wording in _headline(result):
        quantity = result.quantities[name]
        value = quantity.value - float(test.difference[result.names.index(name)])
        if not isfinite(value):
            continue
        shift = (value - quantity.value) / quantity.std_error
        remark = f", {shift:+.1f} standard errors off" if test.notable(shift) else ""
        text = f"{wording.symbol} {value * wording.scale:.3g} {wording.shown_unit}".rstrip()
        sentence.append(f"{text}{remark}")
    if sentence:
        yield "least squares", f"would give {'; '.join(sentence)}"


def _headline(result: FlightEstimate) -> list[tuple[str, QuantitySpec]]:
    quantities = result.motion.quantities
    return [(name, quantities[name]) for name in quantities.headline if name in result.names]


def _p_of(p_value: float) -> str:
    return f"(p {'<= 0.001' if p_value <= 0.001 else f'{p_value:.2g}'})"


#: Ends of sentences.
_SENTENCES = re.compile(r"(?<=\.) (?=[A-Z])")


def row_quantities(row: FlightRow, motion: Motion[Any]) -> tuple[doc.QuantityRow, ...]:
    """The motion's `rows` of one flight or method, without numbers where nothing was estimated."""
    wording = {name: motion.quantities[name] for name in motion.quantities.rows}
    return doc.quantity_rows(not_estimated(motion) | dict(row.quantities), wording)


def reported_rows(result: FlightEstimate) -> tuple[doc.QuantityRow, ...]:
    """Quantities of a result in the order of reports."""
    return doc.quantity_rows(result.quantities, result.motion.quantities)


def further_reasons(result: FlightEstimate) -> dict[Reason, list[str]]:
    """Reasons against single quantities that are not reasons of the verdict, with the symbols of these."""
    stated = {reason.sentence for reason in result.verdict.reasons}
    symbols: dict[Reason, list[str]] = {}
    for row in reported_rows(result):
        for reason in row.quantity.reasons:
            if reason.sentence not in stated:
                symbols.setdefault(reason, []).append(row.wording.symbol)
    return symbols


def reasons(result: FlightEstimate) -> tuple[str, ...]:
    """Reasons of the verdict and of quantities; sentences that they share are printed once."""
    answered, printed, texts = answered_reasons(result), set[str](), []
    of_verdict = ((reason, "") for reason in result.verdict.reasons)
    single = ((reason, f"{', '.join(names)}: ") for reason, names in further_reasons(result).items())
    for reason, names in (*of_verdict, *single):
        if reason in answered and reason.cause is Cause.OTHER and ". " not in reason.sentence:
            continue
        first, *others = _SENTENCES.split(reason.sentence)
        if others and others[-1] in printed:
            others.pop()
        printed.update(others)
        texts.append(names + " ".join((first, *others)))
    return tuple(texts)


def systematic_sentences(result: FlightEstimate) -> tuple[str, ...]:
    """Systematic parts of intervals, each with the symbols of the quantities that have it."""
    symbols: dict[str, list[str]] = {}
    for row in reported_rows(result):
        if row.quantity.verdict is not Status.REFUSED:
            for part in row.quantity.systematic_uncertainties:
                symbols.setdefault(part.sentence, []).append(row.wording.symbol)
    return tuple(f"{', '.join(names)}: {sentence}" for sentence, names in symbols.items())


def remedies(result: FlightEstimate) -> tuple[str, ...]:
    """Remedies of the reasons, each once, without those on the card."""
    answered = answered_reasons(result)
    every = (*result.verdict.reasons, *further_reasons(result))
    texts = dict.fromkeys(reason.remedy for reason in every if reason.remedy and reason not in answered)
    return tuple(item for item in texts if not any(item != more and more.startswith(item) for more in texts))


def reported_findings(result: FlightEstimate) -> tuple[str, ...]:
    """Findings but the quiet ones and the reasons; what is said of several logs is said once."""
    reasons = {reason.sentence for reason in result.verdict.reasons}
    logs = [flight.recording.name for flight in result.prepared]
    logs_of_message: dict[tuple[str, str], list[str]] = {}
    for finding in result.findings:
        if finding.name == "epoch_time" or finding.message in reasons:
            continue  # what bears on no number, only an inspection shows
        log = next((name for name in logs if finding.message.startswith(f"{name}: ")), "")
        message = finding.message.removeprefix(f"{log}: ") if log else finding.message
        logs_of_message.setdefault((finding.name, message), []).extend([log] if log else [])
    texts = []
    for (_, message), about in logs_of_message.items():
        everywhere = len(about) == len(logs) > 1
        prefix = "Every log: " if everywhere else f"{', '.join(about)}: " if about else ""
        texts.append(prefix + message)
    return tuple(texts)


#: Where the card is, when it is not shown.
WHERE_THE_CARD_IS = "What to fly and what to log, step by step: the same command with --card."
NUMBER_COLUMNS = (
    doc.TableColumn("value", right=True, strong=True, whole=True),
    doc.TableColumn("95 % interval", whole=True),
    doc.TableColumn("unit"),
)


def log_documents(result: LogEstimate, *, card: bool = False) -> tuple[doc.Document, ...]:
    """Card of all motions of a log, then a document of each; the last has the motions left out."""
    results = tuple(result.motions.values())
    title, head = ", ".join(flight.recording.name for flight in result.first.prepared), result_card(results)
    lines = [line for group in head.groups for line in group.lines]
    printed = {text for line in lines for text in (line.text, f"{line.words}: {line.text}")}
    bodies = [tuple(_sections(item, printed, flight_card=card)) for item in results]
    bodies[-1] = (*bodies[-1], *doc.section("Left out", doc.Facts, tuple(result.left_out.items())))
    if len(results) == 1:
        return (doc.Document(title, "", bodies[0], head),)
    titled = (
        doc.Document(item.motion.words.title, "", body) for item, body in zip(results, bodies, strict=True)
    )
    return (doc.Document(title, "", (), head), *titled)


def _sections(result: FlightEstimate, printed: set[str], *, flight_card: bool) -> Iterator[doc.Section]:
    """Sections of a motion; findings of the log are printed once for all motions."""
    motion = result.motion
    numbers = {entry.row.name for entry in _entries(result) if entry.look in WITH_NUMBER}  # the card has them
    others = tuple(
        row for row in reported_rows(result) if row.name not in numbers and math.isfinite(row.quantity.value)
    )
    yield doc.Section("", (_facts(result), *((_quantity_table(others),) if others else ())))
    if result.implications.numbers:
        yield doc.Section("What follows for the vehicle", tuple(_implied_parts(result.implications)))
    yield from doc.section("Key figures", doc.Facts, _figures(result.figures))
    yield from doc.section("Why", doc.Bullets, reasons(result))
    steps = flight_steps(result)
    where = () if flight_card or not steps or WHERE_THE_CARD_IS in printed else (WHERE_THE_CARD_IS,)
    printed.update(where)
    yield from doc.section("What to do", doc.Bullets, (*remedies(result), *where))
    yield from doc.section("Checks", doc.Facts, checks(result))
    if result.multi_step_prediction is not None:
        prediction_section = (*prediction_parts(result.multi_step_prediction), doc.Figure("ahead"))
        yield doc.Section("Predicted ahead, from many starts of this flight", prediction_section)
    yield from doc.section("Systematic parts", doc.Bullets, systematic_sentences(result))
    if result.by_flight:
        yield doc.Section("What belongs to each flight of the pool", (_flight_table(result),))
    if result.flights:
        fly = motion.words.fly  # all reasons end with this advice
        firsts = ((row.label, row.reasons[0]) for row in result.flights if row.reasons)
        texts = doc.bullets(f"{label}: {reason.removesuffix(fly).strip()}" for label, reason in firsts)
        table = _row_table([(row, row_quantities(row, motion)) for row in result.flights], "log")
        yield doc.Section("Flights one by one", (table, doc.Figure("flights"), *texts))
    if result.comparisons:
        table = _row_table([(row, row_quantities(row, motion)) for row in result.comparisons], "method")
        yield doc.Section("Methods side by side", (table, doc.Figure("methods")))
    noticed = f"Noticed in the {'logs' if len(result.prepared) > 1 else 'log'}"
    findings = [item for item in reported_findings(result) if item not in printed]
    printed.update(findings)
    yield from doc.section(noticed, doc.Bullets, findings)
    if flight_card:
        yield from card_section(steps)
    yield doc.Section("Figure", (doc.Figure("flight"),))


def card_section(card: tuple[CardSection, ...]) -> Iterator[doc.Section]:
    """The flight card, unless there is none."""
    facts = ((part.title, doc.Bullets(part.sentences)) for part in card)
    yield from doc.section("Flight card", doc.Facts, facts)


def _facts(result: FlightEstimate) -> doc.Facts:
    with_what = "no instruments" if result.instruments == "none" else f"instruments: {result.instruments}"
    facts = {
        "model": result.motion.equation[0].replace(" - ", " − "),
        "": result.motion.view(result.prepared[0]).symbols,
        "method": f"{result.method}; {with_what}",
        "used": used(result),
    }
    return doc.Facts(tuple(facts.items()))


def _quantity_table(quantities: tuple[doc.QuantityRow, ...]) -> doc.TableOf:
    rows = []
    for row in quantities:
        verdict, wording = doc.Cell(row.label, status=row.quantity.verdict), row.wording
        symbol = ", ".join(filter(None, (wording.own_symbol, wording.field_symbol.replace("-", "−"))))
        rows.append((wording.words, symbol, *row.texts, wording.shown_unit, verdict))
    return doc.table(("quantity", "", *NUMBER_COLUMNS, "verdict"), rows)


def _implied_parts(implications: Implications) -> Iterator[doc.Part]:
    """Table of the implied numbers, then sentences for those without a value, and contradictions."""
    rows = []
    for number in implications.numbers:
        if number.value is not None and number.interval is not None:
            verdict = doc.Cell(doc.verdict_label(number.verdict, number.interval), status=number.verdict)
            numbers = doc.bounded_numbers(number.value, number.interval)
            unit = number.unit.replace("^2", "²")
            rows.append((number.words, number.symbol, *numbers, unit, verdict))
    if rows:
        yield doc.table(("", "", *NUMBER_COLUMNS, "verdict"), rows)
    text = (f"{number.words}: {number.sentence}" for number in implications.numbers if number.value is None)
    yield from doc.bullets((*text, *implications.contradictions))


def _figures(figures: Sequence[KeyFigure]) -> Iterator[tuple[str, str]]:
    """A line for each key figure; those of single motors share one, without their intervals."""
    for words, group in groupby(figures, lambda figure: figure.words):
        alike = tuple(group)
        numbers = [doc.plain_numbers(figure.value, figure.interval or NO_INTERVAL) for figure in alike]
        text = ", ".join(value for value, _ in numbers)
        interval = numbers[0][1] if len(alike) == 1 and alike[0].interval else ""
        yield words, " ".join(filter(None, (text, interval, alike[0].unit.replace("^2", "²"))))


def _row_table(rows: Sequence[tuple[FlightRow, Sequence[doc.QuantityRow]]], label: str) -> doc.TableOf:
    titles = [doc.symbol_of(quantity.wording) for quantity in rows[0][1]]
    columns = (doc.TableColumn(label), *(doc.TableColumn(title, strong=True, whole=True) for title in titles))
    cells = []
    for row, quantities in rows:
        texts = [quantity.texts for quantity in quantities]
        numbers = (doc.Cell(value, "" if value == doc.NO_NUMBER else interval) for value, interval in texts)
        cells.append((doc.Cell(row.label, row.verdict.label, row.verdict), *numbers))
    return doc.table(columns, cells)


def _flight_table(result: FlightEstimate) -> doc.TableOf:
    tables = [row.quantities for row in result.by_flight]
    wording = {
        name: words
        for name, words in result.motion.quantities.items()
        if all(name in table for table in tables) and len({table[name].value for table in tables}) > 1
    }
    return _row_table([(row, doc.quantity_rows(row.quantities, wording)) for row in result.by_flight], "log")
