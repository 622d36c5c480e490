"""Document of a flight's result."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from typing import Any

import numpy as np

from eivor.estimation.estimate import Estimate
from eivor.estimation.variable_projection import NuisanceProfile
from eivor.flights.estimate import not_estimated
from eivor.flights.motion import Motion, MultiStepPrediction
from eivor.flights.quantity import CardSection, Choice, Implications, Quantity, QuantitySpec, Trace
from eivor.flights.result import Fit, FlightEstimate, FlightRow
from eivor.inference.diagnostics.instruments import STRONG_FIRST_STAGE
from eivor.inference.diagnostics.record import outcome_word
from eivor.inference.diagnostics.residuals import LARGE_LEVERAGE
from eivor.inference.verdict import Reason, Status, Verdict
from eivor.logs.read import log_format
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
    capitalised,
    printable,
)
from eivor.signals.recording import Finding, Recording
from eivor.signals.signals import stretches
from eivor.tools import Bool, Complex, Float

# -- Card --


def flight_card(result: FlightEstimate) -> tuple[CardSection, ...]:
    """What to fly and log instead; empty when the flight is identified."""
    if result.verdict.status is Status.IDENTIFIED:
        return ()
    return result.motion.words.advice(result.prepared[0].recording.format)


def missing_channels(recording: Recording, motion: Motion[Any]) -> tuple[str, ...]:
    """Channels without which the motion cannot be identified, and that the log lacks."""
    missing = [name for name in motion.channels.needed if name not in recording.channels]
    if not any(recording.family(family.name) for family in motion.channels.inputs):
        missing.append("input")
    return tuple(missing)


def logging_advice_for(recording: Recording, channel: str) -> tuple[str, ...]:
    """What to log so that `channel` is there; empty for logs whose format has no advice."""
    known = log_format(recording.format)
    return known.advice(channel) if known is not None else ()


# -- QuantitySpec --

#: What to print where there is no number.
NO_NUMBER = "–"
#: Values outside this range are written with an exponent.
PLAIN_RANGE = (1e-3, 1e6)


def numbers(quantity: Quantity, wording: QuantitySpec) -> tuple[str, str]:
    """Value and interval in the shown unit: "0.186", "[0.162, 0.210]"; of a choice "0 or 10 (5 tried)"."""
    if quantity.choice is not None:
        return f"{quantity.value * wording.scale:g}", _fitting(quantity.choice, wording.scale)
    low, high = quantity.interval
    return plain_numbers(quantity.value * wording.scale, (low * wording.scale, high * wording.scale))


def plain_numbers(value: float, interval: tuple[float, float]) -> tuple[str, str]:
    """Value and interval as `numbers` shows them, of numbers in the unit that is shown."""
    low, high = interval
    bounded = math.isfinite(low) and math.isfinite(high)
    position = _decimals(0.5 * (high - low)) if bounded and high > low else _decimals(value, digits=4)
    exponent = _exponent(max(abs(x) for x in (value, low, high) if math.isfinite(x)) if bounded else value)
    number = _number(value, position, exponent)
    if not bounded:
        return number, NO_NUMBER
    return number, f"[{_number(low, position, exponent)}, {_number(high, position, exponent)}]"


def _fitting(choice: Choice, scale: float) -> str:
    if len(choice.tried) < 2:
        return NO_NUMBER
    *others, last = [f"{value * scale:g}" for value in choice.fitting]
    fitting = f"{', '.join(others)} or {last}" if others else last
    return f"{fitting} ({len(choice.tried)} tried)"


def _decimals(spread: float, digits: int = 2) -> int:
    """Number of decimals that shows `spread` to so many significant digits; negative left of the point."""
    if not math.isfinite(spread) or spread == 0.0:
        return 0
    return digits - 1 - math.floor(math.log10(abs(spread)))


def _exponent(size: float) -> int:
    """Power of ten to take out; zero for sizes that are read without one."""
    if not math.isfinite(size) or size == 0.0 or PLAIN_RANGE[0] <= abs(size) < PLAIN_RANGE[1]:
        return 0
    return math.floor(math.log10(abs(size)))


def _number(value: float, position: int, exponent: int) -> str:
    if not math.isfinite(value):
        return NO_NUMBER
    decimals = position + exponent
    rounded = round(value / 10.0**exponent, decimals) + 0.0  # plus zero: no "-0"
    return f"{rounded:.{max(decimals, 0)}f}" + (f"e{exponent}" if exponent else "")


def axis_of(wording: QuantitySpec) -> str:
    """Words of an axis for a quantity in its shown unit."""
    return f"{wording.words} {wording.symbol} [{wording.shown_unit or '-'}]"


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
    makers = (_known_beforehand, _instruments, _constancy, _periodicity, _residual, _least_squares)
    shared = tuple(check for maker in makers for check in maker(result, result.fit))
    checks = result.motion.abilities.checks
    return (*shared, *([] if checks is None else checks(result.diagnostics)))


def _known_beforehand(result: FlightEstimate, fit: Fit) -> Iterator[Check]:
    if fit.lag_prior is not None:
        yield "lag", f"{fit.lag_prior.sentence} {_tail(fit.lag_prior.p_value)}"
    pool = fit.pooled
    if pool is not None:
        text = ", ".join(result.motion.quantities[name].symbol for name in pool.flight_specific)
        yield (
            "pool",
            f"the flights {outcome_word(pool.agreement_p_value, AGREEMENT)} in {text} "
            f"{_tail(pool.agreement_p_value)} and "
            f"{outcome_word(pool.shared_p_value, AGREEMENT)} in what they share {_tail(pool.shared_p_value)}",
        )
    comparison = result.motion.abilities.sensors
    if fit.sensors is not None and comparison is not None:
        yield "sensors", comparison.sentence(fit.sensors)


def _instruments(result: FlightEstimate, fit: Fit) -> Iterator[Check]:
    strengths = [
        f"{F:.0f} for {result.motion.quantities[name].symbol}"
        for name, F in fit.checks.first_stage.items()
        if isfinite(F)
    ]
    if strengths:
        yield "instruments", f"first-stage F {', '.join(strengths)} ({STRONG_FIRST_STAGE:.0f} is needed)"
    agreement = fit.checks.agreement
    if agreement is not None and fit.checks.rank and isfinite(agreement.p_value):
        yield "agreement", f"the instruments {agreement.outcome} {_tail(agreement.p_value)}"


def _constancy(result: FlightEstimate, fit: Fit) -> Iterator[Check]:
    constant = fit.checks.constancy
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


def _periodicity(result: FlightEstimate, fit: Fit) -> Iterator[Check]:
    swinging = fit.checks.periodicity
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
        wording = result.motion.quantities[strongest.of]
        extent = f"±{strongest.amplitude * wording.scale:.2g} {wording.shown_unit}".rstrip()
        sentence = f"{wording.symbol} varies by {extent} {period}"
    yield "periods", sentence


def _residual(result: FlightEstimate, fit: Fit) -> Iterator[Check]:
    memory, leverage = fit.checks.memory, fit.checks.leverage
    if memory is not None:
        drifting = " (it drifts)" if memory.drifts else ""
        yield (
            "residual",
            f"memory {memory.memory:.2f} ± {2.0 * memory.order_error:.2f} (0 = none){drifting}",
        )
    if leverage is None:
        return
    for name, wording in _closely(result)[:1]:
        index = result.names.index(name)
        by = float(leverage.largest[index])
        if isfinite(by):
            look = ": inspect that part" if abs(by) > LARGE_LEVERAGE else ""
            which = f"part {leverage.most[index] + 1} of {leverage.shift.shape[0]}"
            yield "leverage", f"dropping {which} shifts {wording.symbol} by {by:+.1f} standard errors{look}"


def _least_squares(result: FlightEstimate, fit: Fit) -> Iterator[Check]:
    against, sentence = fit.checks.endogeneity, []
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


def _closely(result: FlightEstimate) -> list[tuple[str, QuantitySpec]]:
    return [
        (name, result.motion.quantities[name])
        for name in result.motion.quantities.headline
        if name in result.names
    ]


def _tail(p_value: float) -> str:
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
    """One run of the time rows."""

    flight: int  # Number of its flight among all that were prepared
    name: str  # Its log
    time_s: Float[np.ndarray, " length"]  # On the log's clock
    rows: slice  # Its rows among all
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


def residual_autocorrelation(best: Estimate, runs: list[FlightRun]) -> Autocorrelation:
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


def banded(
    frequency: Float[np.ndarray, " bins"], amplitude: Float[np.ndarray, " bins"], per_decade: int
) -> tuple[Float[np.ndarray, " bands"], Float[np.ndarray, " bands"]]:
    """Geometric mean frequency and root mean square amplitude of bands of equal ratio."""
    band = np.floor(per_decade * np.log10(frequency / frequency[0])).astype(np.int64)
    _, position = np.unique(band, return_inverse=True)
    count = np.bincount(position)
    centre = np.exp(np.bincount(position, np.log(frequency)) / count)
    return centre, np.sqrt(np.bincount(position, amplitude**2) / count)


def spans_of(
    mask: Bool[np.ndarray, " n"], time_s: Float[np.ndarray, " n"]
) -> tuple[tuple[float, float], ...]:
    """First and last time of each stretch of a mask."""
    return tuple((float(time_s[part.start]), float(time_s[part.stop - 1])) for part in stretches(mask))


def profile_curves(result: FlightEstimate, estimate: Estimate, number: int) -> list[ProfileCurve]:
    """Objective against one nuisance, a curve for each combination of discrete ones that fits."""
    lowest = min(candidate.criterion for candidate in estimate.candidates)
    curves = []
    for candidate in estimate.tenable():
        values, height = _curve(candidate, candidate.profiles[number])
        curves.append(ProfileCurve(_choice(candidate, result), values, height + candidate.criterion - lowest))
    return curves


def _curve(
    candidate: Estimate, profile: NuisanceProfile
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


def _choice(candidate: Estimate, result: FlightEstimate) -> str:
    refined = {profile.nuisance.name for profile in candidate.profiles}
    selected = [
        (result.motion.quantities[name], value)
        for name, value in candidate.nuisances.items()
        if name not in refined
    ]
    texts = (f"{item.words} {value * item.scale:.3g} {item.shown_unit}" for item, value in selected)
    return ", ".join(map(str.rstrip, texts))


# -- Reported result --

#: Findings that only an inspection shows: they bear on no number.
QUIET_FINDINGS = ("epoch_time",)


@dataclass(frozen=True, slots=True)
class QuantityReport:
    """A quantity with its words."""

    name: str
    wording: QuantitySpec
    quantity: Quantity

    @property
    def numbers_text(self) -> tuple[str, str]:
        """Value and interval in the shown unit; see `numbers`."""
        return numbers(self.quantity, self.wording)

    @property
    def scaled_interval(self) -> tuple[float, float]:
        """Interval in the shown unit."""
        low, high = self.quantity.interval
        return low * self.wording.scale, high * self.wording.scale


@dataclass(frozen=True, slots=True)
class ReportRow:
    """One flight of a pool by itself, or one method beside the chosen one."""

    label: str  # Log or method
    status: Status
    reasons: tuple[str, ...]
    quantities: tuple[QuantityReport, ...]  # The motion's `rows`, without numbers where nothing was estimated


@dataclass(frozen=True, slots=True)
class FlightReport:
    """A result, ready to be reported."""

    result: FlightEstimate
    logs: tuple[str, ...]
    verdict: Verdict
    meaning: str
    quantities: tuple[QuantityReport, ...]
    flights: tuple[ReportRow, ...]
    comparisons: tuple[ReportRow, ...]
    by_flight: tuple[ReportRow, ...]

    @property
    def brief(self) -> tuple[QuantityReport, ...]:
        """Quantities that tables of flights show, where there is an estimate."""
        if not any(np.isfinite(item.quantity.std_error) for item in self.quantities):
            return ()
        return tuple(item for item in self.reported if item.name in self.result.motion.quantities.rows)

    @property
    def reasons(self) -> tuple[Reason, ...]:
        """Reasons of the verdict, worst first."""
        return self.verdict.reasons

    @property
    def further(self) -> tuple[tuple[str, Reason], ...]:
        """Reasons against single quantities that are not reasons of the verdict, with their symbols."""
        against: dict[Reason, list[str]] = {}
        for quantity_row in self.quantities:
            for reason in quantity_row.quantity.reasons:
                against.setdefault(reason, []).append(quantity_row.wording.symbol)
        known = {reason.sentence for reason in self.reasons}
        further = ((symbols, reason) for reason, symbols in against.items() if reason.sentence not in known)
        return tuple((", ".join(symbols), reason) for symbols, reason in further)

    @property
    def systematic(self) -> tuple[tuple[str, str], ...]:
        """Systematic parts of intervals: the quantity in words, and what for."""
        written = (item for item in self.reported if item.quantity.verdict is not Status.REFUSED)
        return tuple(
            (item.wording.words, part.sentence)
            for item in written
            for part in item.quantity.systematic_uncertainties
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
        if len({item.quantity.verdict for item in self.brief}) < 2:
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
        refused = [item.quantity for item in self.brief if item.quantity.verdict is Status.REFUSED]
        why = refused[0].reasons[0].sentence if refused and refused[0].reasons else ""
        why = f"{why.split('. ', 1)[0].removesuffix('.')}." if why else ""
        text = "; ".join(parts)
        return f"{capitalised(text)}{f', because {_as_continuation(why)}' if why else '.'}"

    @property
    def reported(self) -> tuple[QuantityReport, ...]:
        """Quantities in the order of reports."""
        by_name = {quantity.name: quantity for quantity in self.quantities}
        return tuple(by_name[name] for name in self.result.motion.quantities if name in by_name)

    @property
    def reported_findings(self) -> tuple[Finding, ...]:
        """Findings but the quiet ones and the reasons; what is said of several logs is said once."""
        reasons = {reason.sentence for reason in self.reasons}
        logs_of_message: dict[tuple[str, str], list[str]] = {}
        for finding in self.result.findings:
            if finding.name in QUIET_FINDINGS or finding.message in reasons:
                continue
            log = next((name for name in self.logs if finding.message.startswith(f"{name}: ")), "")
            message = finding.message.removeprefix(f"{log}: ") if log else finding.message
            logs_of_message.setdefault((finding.name, message), []).extend([log] if log else [])
        selected = []
        for (name, message), about in logs_of_message.items():
            everywhere = len(about) == len(self.logs) > 1
            prefix = "Every log: " if everywhere else f"{', '.join(about)}: " if about else ""
            selected.append(Finding(name, prefix + message))
        return tuple(selected)


def flight_report(result: FlightEstimate) -> FlightReport:
    """What is reported about a result, with or without an estimate."""
    motion = result.motion
    return FlightReport(
        result=result,
        logs=tuple(flight.recording.name for flight in result.prepared),
        verdict=result.verdict,
        meaning=motion.words.meanings[result.verdict.status],
        quantities=_report(result.quantities, motion.quantities),
        flights=tuple(_flight_row(row, result) for row in result.flights),
        comparisons=tuple(_flight_row(row, result) for row in result.comparisons),
        by_flight=tuple(
            ReportRow(row.label, row.verdict, row.reasons, _report(row.quantities, motion.quantities))
            for row in result.by_flight
        ),
    )


def in_words(names: Sequence[str]) -> str:
    """Names with commas and an "and" between them."""
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last


def _as_continuation(sentence: str) -> str:
    """A sentence as the rest of another: "The lag is" becomes "the lag is"."""
    article = sentence.split(" ", 1)[0] in {"The", "A", "An", "No", "Every", "Its"}
    return f"{sentence[0].lower()}{sentence[1:]}" if article else sentence


def _flight_row(row: FlightRow, result: FlightEstimate) -> ReportRow:
    motion = result.motion
    quantities = not_estimated(motion, {}) | dict(row.quantities)
    wording = {name: motion.quantities[name] for name in motion.quantities.rows}
    return ReportRow(row.label, row.verdict, row.reasons, _report(quantities, wording))


def _report(
    quantities: Mapping[str, Quantity], wording: Mapping[str, QuantitySpec]
) -> tuple[QuantityReport, ...]:
    known = ((name, words) for name, words in wording.items() if name in quantities)
    return tuple(QuantityReport(name, words, quantities[name]) for name, words in known)


# -- Flight document --

#: Where the card is, when it is not shown.
WHERE_THE_CARD_IS = "What to fly and what to log, step by step: the same command with --card."
NUMBER_COLUMNS = (
    TableColumn("value", right=True, strong=True, whole=True),
    TableColumn("95 % interval", whole=True),
    TableColumn("unit"),
)


def flight_document(result: FlightEstimate, *, card: bool = False) -> Document:
    """Document of a result."""
    return document_of(flight_report(result), card=card)


def document_of(record: FlightReport, *, card: bool = False) -> Document:
    """Document of what is reported about a result, see `flight_document`."""
    sections = tuple(_sections(record, card=card))
    return Document(", ".join(record.logs), record.verdict.status, record.meaning, sections)


def _sections(record: FlightReport, *, card: bool) -> Iterator[Section]:
    result = record.result
    yield Section("", (_facts(record), _quantity_table(record)))
    if result.implications.numbers:
        yield Section("What follows for the vehicle", tuple(_implied(result.implications)))
    further = (f"{symbols}: {reason.sentence}" for symbols, reason in record.further)
    yield from section("Why", Bullets, (*(reason.sentence for reason in record.reasons), *further))
    steps = flight_card(result)
    where = () if card or not steps else (WHERE_THE_CARD_IS,)
    yield from section("What to do", Bullets, (*record.remedies, *where))
    yield from section("Checks", Facts, (Fact(title, sentence) for title, sentence in checks(result)))
    if result.multi_step_prediction is not None:
        prediction_section = (*prediction_parts(result.multi_step_prediction), Figure("ahead"))
        yield Section("Predicted ahead, from many starts of this flight", prediction_section)
    parts = (Fact(words, sentence) for words, sentence in record.systematic)
    yield from section("Systematic parts", Facts, parts)
    if record.by_flight:
        yield Section("What belongs to each flight of the pool", (_flight_table(record.by_flight, result),))
    if record.flights:
        fly = result.motion.words.fly  # all reasons end with this advice
        firsts = ((row.label, row.reasons[0]) for row in record.flights if row.reasons)
        reasons = tuple(f"{label}: {reason.removesuffix(fly).strip()}" for label, reason in firsts)
        parts_below = (Bullets(reasons),) if reasons else ()
        table = _row_table(record.flights, "log")
        yield Section("Flights one by one", (table, Figure("flights"), *parts_below))
    if record.comparisons:
        table = _row_table(record.comparisons, "method")
        yield Section("Methods side by side", (table, Figure("methods")))
    noticed = f"Noticed in the {'logs' if len(record.logs) > 1 else 'log'}"
    yield from section(noticed, Bullets, (finding.message for finding in record.reported_findings))
    if card:
        yield from card_section(steps)
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
    result = record.result
    with_what = "no instruments" if result.instruments == "none" else f"instruments: {result.instruments}"
    summary = (Fact("summary", record.summary),) if record.summary else ()
    return Facts(
        (
            *summary,
            Fact("model", result.motion.equation[0].replace(" - ", " − ")),
            Fact("", result.motion.view(result.prepared[0]).symbols),
            Fact("method", f"{result.method}; {with_what}"),
            Fact("used", used(result)),
        )
    )


def _quantity_table(record: FlightReport) -> TableOf:
    columns = (TableColumn("quantity"), TableColumn(""), *NUMBER_COLUMNS, TableColumn("verdict"))
    rows = []
    for item in record.reported:
        status, wording = item.quantity.verdict, item.wording
        texts = (wording.words, wording.symbol, *item.numbers_text, wording.shown_unit)
        rows.append((*map(Cell, texts), Cell(status.value, status=status)))
    return TableOf(columns, tuple(rows))


def _implied(implications: Implications) -> Iterator[Part]:
    """Numbers that follow, then in sentences those that do not, and what cannot be."""
    columns = (TableColumn(""), TableColumn(""), *NUMBER_COLUMNS)
    texts = (
        (number.words, number.symbol, *plain_numbers(number.value, number.interval), number.unit)
        for number in implications.numbers
        if number.value is not None and number.interval is not None
    )
    rows = [tuple(map(Cell, row)) for row in texts]
    if rows:
        yield TableOf(columns, tuple(rows))
    text = (f"{number.words}: {number.sentence}" for number in implications.numbers if number.value is None)
    sentences = (*text, *implications.contradictions)
    if sentences:
        yield Bullets(sentences)


def _row_table(rows: tuple[ReportRow, ...], label: str) -> TableOf:
    words = [quantity.wording for quantity in rows[0].quantities]
    titles = [f"{w.symbol} [{w.shown_unit}]" if w.shown_unit else w.symbol for w in words]
    columns = (TableColumn(label), *(TableColumn(title, strong=True, whole=True) for title in titles))
    return TableOf(columns, tuple(_row_cells(row) for row in rows))


def _flight_table(by_flight: tuple[ReportRow, ...], result: FlightEstimate) -> TableOf:
    tables = [row.quantities for row in result.by_flight]
    alike = {
        name
        for name in result.motion.quantities
        if not all(name in table for table in tables) or len({table[name].value for table in tables}) == 1
    }
    rows = (
        replace(row, quantities=tuple(quantity for quantity in row.quantities if quantity.name not in alike))
        for row in by_flight
    )
    return _row_table(tuple(rows), "log")


def _row_cells(row: ReportRow) -> tuple[Cell, ...]:
    cells = [Cell(row.label, row.status.value, row.status)]
    for quantity in row.quantities:
        value, interval = quantity.numbers_text
        cells.append(Cell(value, "" if value == NO_NUMBER else interval))
    return tuple(cells)
