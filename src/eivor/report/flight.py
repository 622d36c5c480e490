"""Document of a flight's result."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from typing import Any

import numpy as np

from eivor.estimation.estimate import Candidate, Estimate
from eivor.estimation.variable_projection import NuisanceProfile
from eivor.flights.estimate import not_estimated
from eivor.flights.motion import MultiStepPrediction
from eivor.flights.quantity import CardSection, Implications, Kind, Quantity, Trace, Wording
from eivor.flights.result import FitDiagnostics, FlightEstimate, FlightRow
from eivor.inference.diagnostics.instruments import STRONG_FIRST_STAGE
from eivor.inference.diagnostics.record import outcome_word
from eivor.inference.diagnostics.residuals import LARGE_LEVERAGE
from eivor.inference.verdict import Reason, Status, Verdict
from eivor.models.spectral import BinRows, SpectralRun
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
    printable,
)
from eivor.report.wording import NO_NUMBER, flight_card, numbers, plain_numbers, used
from eivor.signals.recording import Finding
from eivor.tools import Complex, Float

# -- Multi-step prediction --

#: Units that people read angles in, with what numbers are multiplied by.
SHOWN_IN = {"rad": ("deg", math.degrees(1.0)), "rad/s": ("deg/s", math.degrees(1.0))}


def display_unit(unit: str) -> tuple[str, float]:
    """Unit to show what is in another one, and what its numbers are multiplied by."""
    return SHOWN_IN.get(unit, (unit, 1.0))


def prediction_rows(prediction: MultiStepPrediction) -> list[tuple[str, ...]]:
    """Quantity, model, shown unit, and root mean square errors by horizon, of every prediction."""
    rows = []
    for item in prediction.errors:
        unit, times = display_unit(item.unit)
        rows.append((item.quantity, item.words, unit, *(f"{times * error:.3g}" for error in item.rms)))
    return rows


def prediction_parts(prediction: MultiStepPrediction, *, sentence: bool = True) -> tuple[Part, ...]:
    """Root mean square errors of every quantity and model by horizon, and what is left out."""
    message = (prediction.sentence,) if sentence and prediction.errors else ()
    table = (_table(prediction),) if prediction.errors else ()
    bullets = (*message, *prediction.omitted)
    return (*table, Bullets(bullets)) if bullets else table


def _table(prediction: MultiStepPrediction) -> TableOf:
    horizons = (TableColumn(f"{item:g} s", right=True, whole=True) for item in prediction.horizons_s)
    columns = (TableColumn("RMS error of", whole=True), TableColumn("by"), *horizons)
    rows, before = [], ""
    for quantity, words, unit, *errors in prediction_rows(prediction):
        first = "" if quantity == before else f"{quantity} [{unit}]"
        rows.append(tuple(map(Cell, (first, words, *errors))))
        before = quantity
    return TableOf(columns, tuple(rows))


# -- Fit checks --

#: Outcomes of the tests of a pool.
AGREEMENT = ("agree", "may differ", "differ")
#: A check's title and its sentence.
Check = tuple[str, str]


def checks(result: FlightEstimate) -> tuple[Check, ...]:
    """Checks of an estimate, those left out that its method cannot make; none without an estimate."""
    if result.fit is None:
        return ()
    makers = (
        _lag_prior,
        _pool,
        _sensors,
        _strength,
        _agreement,
        _constancy,
        _periodicity,
        _memory,
        _leverage,
        _least_squares,
    )
    shared = tuple(check for maker in makers for check in maker(result, result.fit.checks))
    return (*shared, *result.motion.checks(result.diagnostics))


def _lag_prior(result: FlightEstimate, _fit: FitDiagnostics, /) -> Iterator[Check]:
    given = None if result.fit is None else result.fit.lag_prior
    if given is not None:
        yield "lag", f"{given.sentence} {_tail(given.p_value)}"


def _sensors(result: FlightEstimate, _fit: FitDiagnostics, /) -> Iterator[Check]:
    sensors = None if result.fit is None else result.fit.sensors
    if sensors is not None:
        yield "sensors", result.motion.sensor_sentence(sensors)


def _pool(result: FlightEstimate, _fit: FitDiagnostics, /) -> Iterator[Check]:
    pool = None if result.fit is None else result.fit.pooled
    if pool is not None:
        text = ", ".join(result.motion.wording[name].symbol for name in pool.flight_specific)
        yield (
            "pool",
            f"the flights {outcome_word(pool.agreement_p_value, AGREEMENT)} in {text} "
            f"{_tail(pool.agreement_p_value)} and "
            f"{outcome_word(pool.shared_p_value, AGREEMENT)} in what they share {_tail(pool.shared_p_value)}",
        )


def _strength(result: FlightEstimate, diagnostics: FitDiagnostics) -> Iterator[Check]:
    known = [
        f"{F:.0f} for {result.motion.wording[name].symbol}"
        for name, F in diagnostics.first_stage.items()
        if isfinite(F)
    ]
    if known:
        yield "instruments", f"first-stage F {', '.join(known)} ({STRONG_FIRST_STAGE:.0f} is needed)"


def _agreement(_result: FlightEstimate, diagnostics: FitDiagnostics) -> Iterator[Check]:
    if diagnostics.agreement is not None and diagnostics.rank and isfinite(diagnostics.agreement.p_value):
        yield (
            "agreement",
            f"the instruments {diagnostics.agreement.outcome} {_tail(diagnostics.agreement.p_value)}",
        )


def _constancy(result: FlightEstimate, diagnostics: FitDiagnostics) -> Iterator[Check]:
    constant = diagnostics.constancy
    if constant is None:
        return
    sentence = f"the parameters {constant.outcome} {_tail(constant.p_value)}"
    if constant.speaks:
        changes = [
            f"{wording.symbol} by {constant.change[result.names.index(name)] * wording.scale:+.2g} "
            f"{wording.shown_unit}".rstrip()
            for name, wording in _closely(result)
        ]
        sentence += f", most likely {constant.break_at:.0%} into the time used: {', '.join(changes)}"
    yield "constancy", sentence


def _periodicity(result: FlightEstimate, diagnostics: FitDiagnostics) -> Iterator[Check]:
    swinging = diagnostics.periodicity
    if swinging is None:
        return
    tail = _tail(swinging.p_value)
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
        wording = result.motion.wording[strongest.of]
        extent = f"±{strongest.amplitude * wording.scale:.2g} {wording.shown_unit}".rstrip()
        sentence = f"{wording.symbol} varies by {extent} {period}"
    yield "periods", sentence


def _memory(_result: FlightEstimate, diagnostics: FitDiagnostics) -> Iterator[Check]:
    if diagnostics.memory is not None:
        drifting = " (it drifts)" if diagnostics.memory.drifts else ""
        yield (
            "residual",
            f"memory {diagnostics.memory.memory:.2f} ± {2.0 * diagnostics.memory.order_error:.2f} (0 "
            f"= none){drifting}",
        )


def _leverage(result: FlightEstimate, diagnostics: FitDiagnostics) -> Iterator[Check]:
    leverage = diagnostics.leverage
    if leverage is None:
        return
    for name, wording in _closely(result)[:1]:
        index = result.names.index(name)
        by = float(leverage.largest[index])
        if isfinite(by):
            look = ": inspect that part" if abs(by) > LARGE_LEVERAGE else ""
            which = f"part {leverage.most[index] + 1} of {leverage.shift.shape[0]}"
            yield "leverage", f"dropping {which} shifts {wording.symbol} by {by:+.1f} standard errors{look}"


def _least_squares(result: FlightEstimate, diagnostics: FitDiagnostics) -> Iterator[Check]:
    against, sentence = diagnostics.endogeneity, []
    if against is None:
        return
    for name, wording in _closely(result):
        quantity = result.quantities[name]
        value = quantity.value - float(against.difference[result.names.index(name)])
        if not isfinite(value):
            continue
        off = (value - quantity.value) / quantity.std_error
        remark = f", {off:+.1f} standard errors off" if against.notable(off) else ""
        text = f"{wording.symbol} {value * wording.scale:.3g} {wording.shown_unit}".rstrip()
        sentence.append(f"{text}{remark}")
    if sentence:
        yield "least squares", f"would give {'; '.join(sentence)}"


def _closely(result: FlightEstimate) -> list[tuple[str, Wording]]:
    """Parameters of the headline, which are looked at more closely."""
    return [(name, result.motion.wording[name]) for name in result.motion.headline if name in result.names]


def _tail(p_value: float) -> str:
    """P-value in brackets."""
    return f"(p {'<= 0.001' if p_value <= 0.001 else f'{p_value:.2g}'})"


# -- Fit numbers --

#: Lags of the autocorrelation: so many samples at twice the band's highest frequency.
AUTOCORRELATION_LAGS = 30
#: Length of the segments that spectra are averaged over [s].
SEGMENT_S = 10.0
#: Amplitudes below this share of the largest are not drawn: outside of the band there may be none at all.
LEAST_AMPLITUDE = 1e-6


@dataclass(frozen=True)
class FlightRun:
    """One run of the time rows.

    Parameters
    ----------
    flight : int
        Number of its flight among all that were prepared.
    name : str
        Its log.
    time_s : ndarray, shape (length,)
        On the log's clock.
    rows : slice
        Its rows among all.
    spectral : SpectralRun
        Its bins.
    """

    flight: int
    name: str
    time_s: Float[np.ndarray, " length"]
    rows: slice
    spectral: SpectralRun


@dataclass(frozen=True)
class Autocorrelation:
    """Autocorrelation of a residual."""

    what: str
    shift_s: Float[np.ndarray, " lags"]
    correlation: Float[np.ndarray, " lags"]  # [s]
    band: float


@dataclass(frozen=True)
class ProfileCurve:
    """How well each value of a continuous nuisance fits, with the discrete ones at one of their choices."""

    choice: str
    values: Float[np.ndarray, " values"]
    excess: Float[np.ndarray, " values"]


def flight_runs(result: FlightEstimate) -> list[FlightRun]:
    """Every run, in the order of the samples of a trace."""
    results: list[FlightRun] = []
    first = 0
    flying = [(index, flight) for index, flight in enumerate(result.prepared) if flight.runs]
    for number, (item, flight) in enumerate(flying):
        seconds, name = flight.grid.time_s, printable(flight.recording.name)
        for samples, spectral in zip(flight.samples_of_runs, flight.spectral_runs(number), strict=True):
            rows = slice(first, first + samples.size)
            results.append(FlightRun(item, name, seconds[samples], rows, spectral))
            first = rows.stop
    return results


def band_of(trace: Trace, run: FlightRun) -> tuple[float, float]:
    """Band that a trace is shown in [Hz]."""
    frequency, (low, high) = run.spectral.frequency_hz, run.spectral.band_hz
    return trace.band_hz or (float(frequency[0]) if frequency.size else low, high)


def within_band(trace: Trace, run: FlightRun) -> Float[np.ndarray, "length 2"]:
    """Measured and predicted over a run, both within the band."""
    return run.spectral.band_passed(np.column_stack([trace.measured, trace.predicted])[run.rows])


def residual_autocorrelation(best: Candidate, runs: list[FlightRun]) -> Autocorrelation:
    """Autocorrelation of the residual that inference works on, sampled at twice the band's top."""
    layout = best.rows.layout
    if isinstance(layout, BinRows):
        blocks = [block[:, 0] for block in layout.complex_blocks(best.residuals[:, None])]
        spectral, what = list(layout.runs), "whitened residual"
    else:
        spectral, what = [run.spectral for run in runs], "residual, band-passed"
        blocks = [
            run.spectral.spectrum(run.spectral.spread(best.residuals[run.rows][:, None]))[:, 0]
            for run in runs
            if run.rows.stop <= best.residuals.size
        ]
    correlation, shift_s = _autocorrelation(blocks, spectral)
    band = 1.96 / np.sqrt(max(2.0 * sum(block.size for block in blocks), 1.0))
    return Autocorrelation(what, shift_s, correlation, float(band))


def _autocorrelation(
    blocks: list[Complex[np.ndarray, " _"]], runs: list[SpectralRun]
) -> tuple[Float[np.ndarray, " lags"], Float[np.ndarray, " lags"]]:
    """Correlation at multiples of half a period of the band's top, from the power of the bins."""
    step = 1.0 / (2.0 * max(run.band_hz[1] for run in runs))
    lags = step * np.arange(AUTOCORRELATION_LAGS + 1)
    power = np.concatenate([np.abs(block) ** 2 for block in blocks])
    frequency = np.concatenate([run.frequency_hz for run, _ in zip(runs, blocks, strict=False)])
    total = float(power.sum())
    if total <= 0.0:
        return np.zeros(lags.size), lags
    correlation: Float[np.ndarray, " lags"] = np.cos(2.0 * np.pi * np.outer(lags, frequency)) @ power / total
    return correlation, lags


def spectrum(
    values: Float[np.ndarray, " rows"], runs: list[FlightRun]
) -> tuple[Float[np.ndarray, " bins"], Float[np.ndarray, " bins"]]:
    """Amplitude density, averaged over half-overlapping Hann segments of every run at one rate."""
    step = min(run.spectral.step_s for run in runs)
    runs_kept = [run for run in runs if run.spectral.step_s == step]
    longest = max(run.time_s.size for run in runs_kept)
    length = min(int(SEGMENT_S / step), longest)
    window = np.hanning(length + 1)[:length] if length > 1 else np.ones(length)
    total, count = np.zeros(length // 2 + 1), 0
    for run in runs_kept:
        series = values[run.rows]
        for first in range(0, series.size - length + 1, max(length // 2, 1)):
            segment = series[first : first + length]
            total += np.abs(np.fft.rfft((segment - segment.mean()) * window)) ** 2
            count += 1
    density = 2.0 * step * total / (max(count, 1) * float(window @ window))
    frequency = np.fft.rfftfreq(length, step)
    return frequency[1:], np.sqrt(np.maximum(density[1:], 1e-20))


def profile_curves(result: FlightEstimate, estimate: Estimate, number: int) -> list[ProfileCurve]:
    """Objective against one nuisance, a curve for each combination of discrete ones that fits."""
    lowest = min(candidate.criterion for candidate in estimate.candidates)
    curves = []
    for candidate in estimate.tenable():
        values, height = _curve(candidate, candidate.profiles[number])
        curves.append(ProfileCurve(_choice(candidate, result), values, height + candidate.criterion - lowest))
    return curves


def _curve(
    candidate: Candidate, profile: NuisanceProfile
) -> tuple[Float[np.ndarray, " values"], Float[np.ndarray, " values"]]:
    """Values of a nuisance, and the objective above its least there, as chi-square."""
    least = candidate.solution.objective
    # J of a method with instruments; for a direct one the logarithm's slope at its minimum
    height = candidate.criterion if candidate.rank else candidate.rows.response.size
    scale = height / least if least > 0.0 and height > 0.0 else 1.0
    # the refined minimum lies between points of the grid: without it a sharp valley has no bottom
    values = np.append(profile.grid, candidate.nuisances[profile.nuisance.name])
    excess = scale * (np.append(profile.objective, least) - least)
    order = np.argsort(values)
    return values[order], excess[order]


def _choice(candidate: Candidate, result: FlightEstimate) -> str:
    """Values of the discrete nuisances, in the motion's words: "delay 10 ms"."""
    refined = {profile.nuisance.name for profile in candidate.profiles}
    selected = [
        (result.motion.wording[name], value)
        for name, value in candidate.nuisances.items()
        if name not in refined
    ]
    return ", ".join(
        f"{item.words} {value * item.scale:.3g} {item.shown_unit}".rstrip() for item, value in selected
    )


# -- Reported result --

#: Findings that only an inspection shows: they bear on no number.
QUIET_FINDINGS = ("epoch_time",)


@dataclass(frozen=True, slots=True)
class QuantityReport:
    """A quantity with its words."""

    name: str
    wording: Wording
    quantity: Quantity

    @property
    def numbers_text(self) -> tuple[str, str]:
        """Value and interval in the shown unit; see `numbers`."""
        return numbers(self.quantity, self.wording)


@dataclass(frozen=True, slots=True)
class ReportRow:
    """One flight of a pool by itself, or one method beside the chosen one."""

    label: str  # Log or method
    status: Status
    reasons: tuple[str, ...]
    quantities: tuple[QuantityReport, ...]  # The motion's `rows`, without numbers where nothing was estimated

    def first_reason(self, fly: str) -> str:
        """The first reason, without the advice `fly` that all of them end with; empty for none."""
        return self.reasons[0].removesuffix(fly).strip() if self.reasons else ""


@dataclass(frozen=True, slots=True)
class FlightReport:
    """A result, ready to be reported."""

    logs: tuple[str, ...]
    verdict: Verdict
    meaning: str
    equation: tuple[str, str]
    symbols: str
    method: str
    instruments: str
    used: str
    quantities: tuple[QuantityReport, ...]
    order: tuple[str, ...]  # Their names in the order of reports
    checks: tuple[Check, ...]
    diagnostics: Mapping[str, float]
    findings: tuple[Finding, ...]  # All that was noticed
    flights: tuple[ReportRow, ...]
    comparisons: tuple[ReportRow, ...]
    by_flight: tuple[ReportRow, ...]
    flight_specific: tuple[str, ...]
    fly: str
    card: tuple[CardSection, ...]
    rows: tuple[str, ...]  # Names of the quantities that tables of flights show
    implications: Implications
    multi_step_prediction: (
        MultiStepPrediction | None
    )  # Predictions of the flights themselves some tenths of a second ahead

    @property
    def brief(self) -> tuple[QuantityReport, ...]:
        """Quantities that tables of flights show, where there is an estimate."""
        estimated = any(np.isfinite(quantity.quantity.std_error) for quantity in self.quantities)
        return tuple(item for item in self.reported if item.name in self.rows) if estimated else ()

    @property
    def reasons(self) -> tuple[Reason, ...]:
        """Reasons of the verdict, worst first."""
        return self.verdict.reasons

    @property
    def further(self) -> tuple[tuple[str, Reason], ...]:
        """Reasons against single quantities that are not reasons of the verdict, with their symbols."""
        against: dict[Reason, list[str]] = {}
        for reported in self.quantities:
            for reason in reported.quantity.reasons:
                against.setdefault(reason, []).append(reported.wording.symbol)
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
            (item.wording.words, systematic_uncertainty.sentence)
            for item in self.reported
            if item.quantity.verdict is not Status.REFUSED
            for systematic_uncertainty in item.quantity.systematic_uncertainties
        )

    @property
    def remedies(self) -> tuple[str, ...]:
        """What would change it, each remedy once."""
        reasons = (*self.reasons, *(reason for _, reason in self.further))
        result = dict.fromkeys(reason.remedy for reason in reasons if reason.remedy)
        return tuple(
            item for item in result if not any(item != more and more.startswith(item) for more in result)
        )

    @property
    def summary(self) -> str:
        """What is identified, what is identified weakly, and what is not and why; empty without numbers."""
        if not self.brief or all(
            item.quantity.verdict is self.brief[0].quantity.verdict for item in self.brief
        ):
            return ""
        parts = []
        for statuses, words in (
            ((Status.IDENTIFIED,), "identified"),
            ((Status.WEAK, Status.PROVISIONAL), "roughly identified"),
            ((Status.REFUSED,), "not identified"),
        ):
            names = [item.wording.words for item in self.brief if item.quantity.verdict in statuses]
            if names:
                parts.append(f"{in_words(names)} {'is' if len(names) == 1 else 'are'} {words}")
        refused = next(
            (item.quantity for item in self.brief if item.quantity.verdict is Status.REFUSED), None
        )
        why = refused.reasons[0].sentence if refused is not None and refused.reasons else ""
        why = f"{why.split('. ', 1)[0].removesuffix('.')}." if why else ""
        text = "; ".join(parts)
        return f"{text[0].upper()}{text[1:]}{f', because {_started(why)}' if why else '.'}"

    @property
    def reported(self) -> tuple[QuantityReport, ...]:
        """Quantities in the order of reports."""
        by_name = {quantity.name: quantity for quantity in self.quantities}
        return tuple(by_name[name] for name in self.order if name in by_name)

    @property
    def reported_findings(self) -> tuple[Finding, ...]:
        """Findings but the quiet ones and the reasons; what is said of several logs is said once."""
        reasons = {reason.sentence for reason in self.reasons}
        sentence: dict[tuple[str, str], list[str]] = {}
        for finding in self.findings:
            if finding.name in QUIET_FINDINGS or finding.message in reasons:
                continue
            log = next((name for name in self.logs if finding.message.startswith(f"{name}: ")), "")
            message = finding.message.removeprefix(f"{log}: ") if log else finding.message
            sentence.setdefault((finding.name, message), []).extend([log] if log else [])
        selected = []
        for (name, message), about in sentence.items():
            everywhere = len(about) == len(self.logs) > 1
            prefix = "Every log: " if everywhere else f"{', '.join(about)}: " if about else ""
            selected.append(Finding(name, prefix + message))
        return tuple(selected)


def flight_report(result: FlightEstimate) -> FlightReport:
    """What is reported about a result, with or without an estimate."""
    motion = result.motion
    return FlightReport(
        logs=tuple(flight.recording.name for flight in result.prepared),
        verdict=result.verdict,
        meaning=motion.words.meanings[result.verdict.status],
        equation=motion.written,
        symbols=motion.symbols(result.prepared[0]),
        method=result.method,
        instruments=result.instruments,
        used=used(result),
        quantities=_report(result.quantities, motion.wording),
        order=motion.plotted,
        checks=checks(result),
        diagnostics=result.diagnostics,
        findings=result.findings,
        flights=tuple(_flight_row(row, result) for row in result.flights),
        comparisons=tuple(_flight_row(row, result) for row in result.comparisons),
        by_flight=tuple(_report_row(row, result) for row in result.by_flight),
        flight_specific=_own(result),
        fly=motion.words.fly,
        card=flight_card(result),
        rows=motion.rows,
        implications=result.implications,
        multi_step_prediction=result.multi_step_prediction,
    )


def in_words(names: Sequence[str]) -> str:
    """Names with commas and an "and" between them."""
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last


def _started(sentence: str) -> str:
    """A sentence as the rest of another: "The lag is" becomes "the lag is"."""
    article = sentence.split(" ", 1)[0] in {"The", "A", "An", "No", "Every", "Its"}
    return f"{sentence[0].lower()}{sentence[1:]}" if article else sentence


def of_kind(quantities: tuple[QuantityReport, ...], kind: Kind) -> tuple[QuantityReport, ...]:
    """Parameters, or what is derived of them."""
    return tuple(quantity for quantity in quantities if quantity.wording.kind is kind)


def _flight_row(row: FlightRow, result: FlightEstimate) -> ReportRow:
    motion = result.motion
    quantities = not_estimated(motion, {}) | dict(row.quantities)
    wording = {name: motion.wording[name] for name in motion.rows}
    return ReportRow(row.label, row.verdict, row.reasons, _report(quantities, wording))


def _report_row(row: FlightRow, result: FlightEstimate) -> ReportRow:
    return ReportRow(row.label, row.verdict, row.reasons, _report(row.quantities, result.motion.wording))


def _own(result: FlightEstimate) -> tuple[str, ...]:
    """Quantities of a pool that are not alike in all flights."""
    tables = [row.quantities for row in result.by_flight]
    names = [name for name in result.motion.plotted if all(name in table for table in tables)]
    return tuple(name for name in names if len({table[name].value for table in tables}) > 1)


def _report(quantities: Mapping[str, Quantity], wording: Mapping[str, Wording]) -> tuple[QuantityReport, ...]:
    return tuple(
        QuantityReport(name, words, quantities[name]) for name, words in wording.items() if name in quantities
    )


# -- Flight document --

#: Where the card is, when it is not shown.
WHERE_THE_CARD_IS = "What to fly and what to log, step by step: the same command with --card."


def flight_document(result: FlightEstimate, *, card: bool = False) -> Document:
    """Document of a result."""
    return document_of(flight_report(result), card=card)


def document_of(record: FlightReport, *, card: bool = False) -> Document:
    """Document of what is reported about a result, see `flight_document`."""
    return Document(
        ", ".join(record.logs), record.verdict.status, record.meaning, tuple(_sections(record, card=card))
    )


def _sections(record: FlightReport, *, card: bool) -> Iterator[Section]:
    yield Section("", (_facts(record), _quantity_table(record)))
    if record.implications.numbers:
        yield Section("What follows for the vehicle", tuple(_implied(record.implications)))
    further = (f"{symbols}: {reason.sentence}" for symbols, reason in record.further)
    yield from section("Why", Bullets, (*(reason.sentence for reason in record.reasons), *further))
    where = () if card or not record.card else (WHERE_THE_CARD_IS,)
    yield from section("What to do", Bullets, (*record.remedies, *where))
    yield from section("Checks", Facts, (Fact(title, sentence) for title, sentence in record.checks))
    if record.multi_step_prediction is not None:
        prediction_section = (*prediction_parts(record.multi_step_prediction), Figure("ahead"))
        yield Section("Predicted ahead, from many starts of this flight", prediction_section)
    parts = (Fact(words, sentence) for words, sentence in record.systematic)
    yield from section("Systematic parts", Facts, parts)
    if record.by_flight:
        yield Section("What belongs to each flight of the pool", (_flight_table(record),))
    if record.flights:
        reasons = _row_reasons(record)
        table = _row_table(record.flights, "log")
        yield Section("Flights one by one", (table, Figure("flights"), *reasons))
    if record.comparisons:
        table = _row_table(record.comparisons, "method")
        yield Section("Methods side by side", (table, Figure("methods")))
    noticed = f"Noticed in the {'logs' if len(record.logs) > 1 else 'log'}"
    yield from section(noticed, Bullets, (finding.message for finding in record.reported_findings))
    if card:
        yield from card_section(record.card)
    yield Section("Figure", (Figure("flight"),))


def section(heading: str, part: type[Bullets] | type[Facts], record: Iterable[Any]) -> Iterator[Section]:
    """Section of one part, unless there is nothing to report."""
    result = tuple(record)
    if result:
        yield Section(heading, (part(result),))


def card_section(card: tuple[CardSection, ...]) -> Iterator[Section]:
    """The flight card, unless there is none."""
    facts = (Fact(part.title, Bullets(part.sentences)) for part in card)
    yield from section("Flight card", Facts, facts)


def _facts(record: FlightReport) -> Facts:
    with_what = "no instruments" if record.instruments == "none" else f"instruments: {record.instruments}"
    summary = (Fact("identified", record.summary),) if record.summary else ()
    return Facts(
        (
            *summary,
            Fact("model", record.equation[0].replace(" - ", " − ")),
            Fact("", record.symbols),
            Fact("method", f"{record.method}; {with_what}"),
            Fact("used", record.used),
        )
    )


def _quantity_table(record: FlightReport) -> TableOf:
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
    for item in record.reported:
        status, wording = item.quantity.verdict, item.wording
        texts = (wording.words, wording.symbol, *item.numbers_text, wording.shown_unit)
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
        tuple(
            map(
                Cell,
                (number.words, number.symbol, *plain_numbers(number.value, number.interval), number.unit),
            )
        )
        for number in implications.numbers
        if number.value is not None and number.interval is not None
    ]
    if rows:
        yield TableOf(columns, tuple(rows))
    text = (f"{number.words}: {number.sentence}" for number in implications.numbers if number.value is None)
    sentences = (*text, *implications.contradictions)
    if sentences:
        yield Bullets(sentences)


def _row_table(rows: tuple[ReportRow, ...], label: str) -> TableOf:
    """One row for each flight or method; the interval stands below the value."""
    words = [quantity.wording for quantity in rows[0].quantities]
    titles = [f"{w.symbol} [{w.shown_unit}]" if w.shown_unit else w.symbol for w in words]
    columns = (TableColumn(label), *(TableColumn(title, strong=True, whole=True) for title in titles))
    return TableOf(columns, tuple(_row_cells(row) for row in rows))


def _flight_table(record: FlightReport) -> TableOf:
    """One row for each flight of a pool, with the quantities that are its own."""
    rows = [
        replace(
            row,
            quantities=tuple(
                quantity for quantity in row.quantities if quantity.name in record.flight_specific
            ),
        )
        for row in record.by_flight
    ]
    return _row_table(tuple(rows), "log")


def _row_cells(row: ReportRow) -> tuple[Cell, ...]:
    cells = [Cell(row.label, row.status.value, row.status)]
    for quantity in row.quantities:
        value, interval = quantity.numbers_text
        cells.append(Cell(value, "" if value == NO_NUMBER else interval))
    return tuple(cells)


def _row_reasons(record: FlightReport) -> Iterator[Part]:
    """First reason of each flight that is not identified."""
    texts = [f"{row.label}: {row.first_reason(record.fly)}" for row in record.flights if row.reasons]
    if texts:
        yield Bullets(tuple(texts))
