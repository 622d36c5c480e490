"""Validation of a fit on another flight: numbers, document, JSON and figure."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from eivor import checks
from eivor.errors import InputError, MissingChannelError, UsageError
from eivor.flights.estimate import FlightState, estimated
from eivor.flights.lag_prior import EFFECTIVE_LAG, LAG_SUMS
from eivor.flights.motion import FIT, Motion, MultiStepPrediction, for_flights
from eivor.flights.options import FlightOptions
from eivor.flights.prepare import check_options, prepare
from eivor.flights.prepared import LARGEST_INPUT_RATIO, LEVEL, RATE, CommandLimit, PreparedFlight
from eivor.flights.quantity import Horizon, PredictedQuantity, Quantity, QuantityTable, SimpleModel
from eivor.flights.result import FlightEstimate
from eivor.inference.distributions import chi_square_tail, normal_quantile
from eivor.inference.verdict import Status
from eivor.models.separable import NoInstruments
from eivor.report import document as doc
from eivor.report import figure_panels as plots
from eivor.report.figures import prediction_page, prediction_panels
from eivor.report.flight import prediction_parts, prediction_rows
from eivor.report.json_document import JsonPrediction, document, json_text, prediction_json
from eivor.report.outputs import saved_of
from eivor.report.saved_fit import SavedFit
from eivor.signals.recording import Recording
from eivor.tools import Float, html_table, printable

#: Level at which a flight contradicts a fit, over all quantities.
CONTRADICTION_LEVEL = 0.05
#: What documents have of a prediction.
PREDICTED = ("model", "horizon", "quantity", "unit", "rms", "explained")
COMPARED = {Status.IDENTIFIED, Status.WEAK}  # A number without instruments or excitation is none to compare


@dataclass(frozen=True, slots=True)
class QuantityComparison:
    """A quantity of a fit, and of the flight that is predicted alone."""

    fit: doc.QuantityRow
    flight: doc.QuantityRow
    p_value: float  # Of no difference, over all that are compared; NaN when either does not identify it

    @property
    def contradicts(self) -> bool:
        return self.p_value < CONTRADICTION_LEVEL


def quantity_comparisons(
    table: QuantityTable, fit: Mapping[str, Quantity], flight: Mapping[str, Quantity]
) -> tuple[QuantityComparison, ...]:
    """Wald tests by half-widths of both intervals, by Bonferroni; of what both identify, however roughly."""
    rows = []
    for name, spec in table.items():
        parameter = not spec.derived and name not in LAG_SUMS[EFFECTIVE_LAG]
        compared = parameter or spec.across or name == EFFECTIVE_LAG  # not what is of a flight's speeds
        if spec.by_run or not compared or name not in fit or name not in flight:
            continue
        pair = doc.QuantityRow(name, spec, _summed(fit, name)), doc.QuantityRow(name, spec, flight[name])
        first, second = (row.quantity for row in pair)
        spread = max(math.hypot(first.half_width, second.half_width), np.finfo(np.float64).tiny)
        distance = normal_quantile(0.95) * (second.value - first.value) / spread
        tested = math.isfinite(distance) and {first.verdict, second.verdict} <= COMPARED
        rows.append((*pair, chi_square_tail(distance**2, 1) if tested else math.nan))
    count = sum(math.isfinite(p_value) for *_, p_value in rows)
    return tuple(QuantityComparison(a, b, float(np.minimum(count * p_value, 1.0))) for a, b, p_value in rows)


def _summed(quantities: Mapping[str, Quantity], name: str) -> Quantity:
    """A quantity; the value of an effective lag is the sum of its parts, by which a fit predicts."""
    quantity = quantities[name]
    if name != EFFECTIVE_LAG or not quantities.keys() >= set(LAG_SUMS[name]):
        return quantity
    value = sum(quantities[part].value for part in LAG_SUMS[name])
    (low, high), shift = quantity.interval, value - quantity.value
    return replace(quantity, value=value, interval=(low + shift, high + shift))


@dataclass(frozen=True)
class ModelPrediction:
    """One measured quantity as one model predicts it."""

    model: str
    words: str
    horizon: Horizon
    quantity: str
    unit: str
    measured: Float[np.ndarray, " samples"] = field(repr=False)
    predicted: Float[np.ndarray, " samples"] = field(repr=False)
    rms: float  # of the residual, over all runs
    explained: float  # share of the measured power


@dataclass(frozen=True)
class Validation:
    """A flight as a result of other flights predicts it."""

    fit: SavedFit
    motion: Motion[Any]  # What the fit is a result of
    flight: PreparedFlight  # The flight that is predicted
    #: Of every quantity over whole runs: by the fit, then by each simpler model; empty for a motion that
    #: predicts ahead from many starts.
    predictions: tuple[ModelPrediction, ...]
    multi_step_prediction: MultiStepPrediction | None = None  # None for a motion that predicts whole runs
    comparisons: tuple[QuantityComparison, ...] = ()  # With what the flight identifies by itself

    @property
    def spans_s(self) -> tuple[tuple[float, float], ...]:
        """First and last second of each run."""
        time = self.flight.grid.time_s
        return tuple((float(time[run.start]), float(time[run.stop - 1])) for run in self.flight.runs)

    @property
    def by_quantity(self) -> tuple[tuple[ModelPrediction, ...], ...]:
        """Predictions of each quantity, the fit's first."""
        names = (item.quantity for item in self.predictions if item.model == FIT)
        return tuple(tuple(item for item in self.predictions if item.quantity == name) for name in names)

    @property
    def predicts(self) -> bool:
        """Whether the fit explains something at the farthest horizon, and no simpler model more.

        Of predictions ahead: whether its errors are the least, in the mean over all quantities.
        """
        if self.multi_step_prediction is not None:
            return self.multi_step_prediction.predicts
        farthest, rivals = self._farthest_models
        is_least = all(farthest.rms <= rival.rms for rival in rivals)
        return farthest.explained > 0.0 and is_least

    @property
    def _farthest_models(self) -> tuple[ModelPrediction, list[ModelPrediction]]:
        """Prediction of the fit at the farthest horizon, and those of its rivals."""
        farthest, *others = self.by_quantity[-1]
        # one step ahead, least squares have the smallest residual by construction
        return farthest, others if farthest.horizon is Horizon.OPEN_LOOP else []

    @property
    def contradictions(self) -> tuple[QuantityComparison, ...]:
        """Quantities in which the flight contradicts the fit."""
        return tuple(item for item in self.comparisons if item.contradicts)

    @property
    def agrees(self) -> bool:
        """Whether the fit predicts the flight, and the flight contradicts none of its quantities."""
        return self.predicts and not self.contradictions

    @property
    def sentence(self) -> str:
        """Prediction and contradictions in words."""
        contradicted = " and ".join(row.fit.wording.words for row in self.contradictions)
        parts = [f"The flight contradicts the {contradicted}."] if contradicted else []
        untested = ", ".join(row.fit.wording.words for row in self.comparisons if math.isnan(row.p_value))
        notes = [f"Not compared, since fit or flight does not identify it: {untested}."] if untested else []
        return " ".join([*parts, self._prediction_sentence, *notes])

    @property
    def _prediction_sentence(self) -> str:
        if self.multi_step_prediction is not None:
            return self.multi_step_prediction.sentence
        farthest, others = self._farthest_models
        runs = f" in {len(self.flight.runs)} runs" if len(self.flight.runs) > 1 else ""
        quantity = f"{farthest.quantity}, {farthest.horizon.words}, over {self.flight.used_s:.1f} s{runs}"
        share = f"{farthest.explained:.1%}" if farthest.explained > 0.0 else "nothing"
        text = f"The fit explains {share} of the {quantity}"
        better = [item.words for item in others if item.rms < farthest.rms]
        if better:
            return f"{text}; {' and '.join(better)} leave{'s' if len(better) == 1 else ''} less."
        return f"{text}{', and leaves less than the simpler models' if others else ''}."

    def summary(self) -> str:
        """Errors of every prediction as plain text."""
        lines = [self._title, self.sentence]
        for label, by, rms, unit, share in _rows(self):
            lines.append(f"{label:<42}{by:<36}{rms:>10} {unit:<6}{share:>9}")
        steps = self.multi_step_prediction
        for label, by, unit, *errors in prediction_rows(steps) if steps else ():
            lines.append(f"{label:<12}{by:<38}{unit:<6}{' '.join(f'{item:>8}' for item in errors)}")
        return "\n".join(lines)

    @property
    def _title(self) -> str:
        return f"{self.motion.words.title}, {self.flight.recording.name}"

    def __repr__(self) -> str:
        return f"<Validation of {self.flight.recording.name!r}: {self.sentence}>"

    def _repr_html_(self) -> str:
        steps = self.multi_step_prediction
        titles: tuple[str, ...] = ("prediction", "model", "RMS error", "unit", "explained")
        if steps is not None:
            titles = ("error of", "model", "unit", *(f"{item:g} s" for item in steps.horizons_s))
        rows = _rows(self) if steps is None else prediction_rows(steps)
        return html_table(self._title, titles, rows, self.sentence)

    def to_json(self) -> str:
        """Text of the JSON document that ``eivor validate --json`` writes, see docs/json.md."""
        log, fitted = self.flight.recording, self.fit.document
        return json_text(
            document(
                "eivor.validate/1",
                log={"name": log.name, "sha256": log.sha256 or None},
                fit={"logs": fitted.provenance.logs, "model": fitted.model.name, "verdict": self.fit.verdict},
                predicts=self.predicts,
                contradicted=[item.fit.name for item in self.contradictions],
                sentence=self.sentence,
                runs=self.spans_s,
                samples=int(self.flight.used.sum()),
                rate_hz=self.flight.signals.rate_hz,
                band=self.flight.band_hz,
                predictions=[{name: getattr(item, name) for name in PREDICTED} for item in self.predictions],
                ahead=prediction_json(self.multi_step_prediction),
                comparisons=[
                    {"quantity": item.fit.name, "unit": item.fit.quantity.unit, "p_value": item.p_value}
                    | {
                        name: {"value": row.quantity.value, "interval": row.quantity.interval}
                        for name, row in (("fit", item.fit), ("flight", item.flight))
                    }
                    for item in self.comparisons
                ],
            )
        )

    def plot(self) -> plots.Figure:
        """Figure: for each prediction what was measured and predicted, and below it what is left."""
        multi_step = self.multi_step_prediction
        panels: plots.Panels = {} if multi_step is None else prediction_panels(multi_step)
        for models in self.by_quantity:
            name = models[0].horizon.value
            panels[name] = partial(_draw_predicted, validation=self, models=models)
            panels[f"{name} residual"] = partial(_draw_residual, validation=self, models=models)
        size, heights = (plots.SIZE_INCHES[0], plots.SIZE_INCHES[1] * len(panels) / 4.0), (1.6, 1.0)
        if multi_step is None:
            placed = plots.column_page(tuple(panels), size, heights=heights * (len(panels) // 2), shared=2)
        else:
            placed = prediction_page(tuple(panels))
        figure = plots.drawn(panels, placed)
        sentence = textwrap.fill(self.sentence, 120)
        title = f"{doc.shortened(printable(self.flight.recording.name))}\n{sentence}"
        figure.suptitle(title, fontsize=11, parse_math=False)
        return figure


def validate(
    fit: SavedFit | FlightEstimate | str | Path,
    recording: Recording,
    *,
    window: tuple[float, float] | None = None,
    max_tilt_deg: float | None = None,
) -> Validation:
    """Predict another flight by a result, beside simpler models of the flights that the result came from.

    Parameters
    ----------
    fit : SavedFit, FlightEstimate, str or Path
        The result, or the file that ``eivor identify --json`` wrote of it.
    recording : Recording
        Another flight of the same vehicle, from `read_log`.
    window : tuple of float, optional
        Start and end [s] on that log's clock.
    max_tilt_deg : float, optional
        Samples tilted further are left out [deg]. Default: the limit of the fit.

    Returns
    -------
    Validation
        Errors of each prediction, over all runs.

    Raises
    ------
    UsageError
        For arguments of other types, a fit without an estimate, and one of a motion that predicts nothing.
    InputError
        When the fit cannot be read, the log lacks a channel, or has no run.

    Notes
    -----
    Nothing is fitted to the flight but what belongs to each run: its trim, and where it starts.
    """
    result = saved_of(fit, "a result, or the path of its JSON file", 'Such as ev.load_fit("fit.json").')
    checks.kind("recording", recording, Recording, "a Recording", 'Read it: ev.read_log("other.ulg").')
    prediction = result.document.prediction
    if prediction is None:
        expected = "a result with an estimate"
        remedy = "Validate a flight that carries some information."
        raise UsageError(expected, f"one without: {' '.join(result.reasons).rstrip('.')}", remedy)
    motion = result.motion
    state = _prepared(result, prediction, motion, recording, window, max_tilt_deg)
    motion, (flight,) = state.motion, state.prepared
    level, input_level = prediction.input_level, flight.input_level
    if level is not None and max(level, input_level) > LARGEST_INPUT_RATIO * min(level, input_level):
        expected = f"{flight.input.name} of about {level:.4g} on average, as in the flights of the fit"
        remedy = "Give a flight of the same vehicle, with its commands in the same unit."
        raise InputError(expected, f"{input_level:.4g} in {flight.recording.name}", remedy)
    models, predicts, ahead = _simpler_models(result, prediction), motion.abilities.prediction, None
    results: tuple[ModelPrediction, ...] = ()
    if predicts.multi_step is not None:
        ahead = predicts.multi_step((flight.shortened,), models, result.refused)
        if not ahead.errors:
            expected = "a result and a log that carry enough information of the vehicle to predict it"
            remedy = "Validate a flight that carries more information, on a log of the same vehicle."
            raise UsageError(expected, " ".join(ahead.omitted) or "no half second without a gap", remedy)
    elif predicts.another_flight is None:
        received = f"'{motion.name}', which does not"
        raise UsageError("a motion that predicts", received, "See docs/motions.md: predictions.")
    else:
        problem = motion.problem((flight.shortened,), NoInstruments())
        results = tuple(
            _prediction(name, model.words, predicted, flight)
            for name, model in models.items()
            for predicted in predicts.another_flight(problem, model.values)
        )
    in_order = sorted(results, key=lambda item: list(Horizon).index(item.horizon))
    comparisons = quantity_comparisons(motion.quantities, result.quantities, estimated(state).quantities)
    return Validation(result, motion, flight, tuple(in_order), ahead, comparisons)


def _prepared(
    fit: SavedFit,
    prediction: JsonPrediction,
    motion: Motion[Any],
    recording: Recording,
    window: tuple[float, float] | None,
    max_tilt_deg: float | None,
) -> FlightState:
    terms = fit.document.provenance.options.get("terms")
    options = FlightOptions(
        window=window,
        max_tilt_deg=prediction.max_tilt_deg if max_tilt_deg is None else max_tilt_deg,
        input=prediction.input,
        input_map=prediction.input_map,
        terms=tuple(map(str, terms)) if isinstance(terms, list) else (),
    )
    check_options(motion, options)
    if prediction.input and not recording.family(prediction.input.rstrip("*").rstrip("_")):
        expected = f"the input of the fit, '{prediction.input}', in {recording.name}"
        remedy = "Give a log with the same command; in a table or a bag, a channel map may name it (--map)."
        raise MissingChannelError(expected, "a log without it", remedy)
    flight = prepare(recording, motion, options)
    for kind in (RATE, LEVEL):
        limit = fit.document.diagnostics.get(kind)
        flight = flight.within(CommandLimit(kind, limit)) if limit and flight.issued else flight
    if not flight.runs:
        expected = f"three seconds {motion.words.where} in runs of a second or more"
        raise InputError(expected, f"none in {recording.name}: {flight.shortfall[0]}", flight.shortfall[1])
    return FlightState(for_flights(motion, (flight,), options), (flight,), options)


def _simpler_models(fit: SavedFit, prediction: JsonPrediction) -> dict[str, SimpleModel]:
    values = {name: math.nan if x is None else x for name, x in prediction.at.items()}
    if fit.estimated is not None:
        values = {**values, **dict(zip(fit.names, fit.estimated.values.tolist(), strict=True))}
    models = prediction.simple_models.values()
    if fit.estimated is None or any(not set(values) <= set(model.values) for model in models):
        expected = "a result with a value for each parameter of its models"
        raise InputError(expected, "one that lacks some", "Identify the flight again.")
    return {FIT: SimpleModel("the fit", values), **prediction.simple_models}


def _prediction(name: str, words: str, record: PredictedQuantity, flight: PreparedFlight) -> ModelPrediction:
    measured, predicted = record.measured, record.predicted
    runs = _runs(flight)
    if record.horizon is Horizon.ONE_STEP:
        columns = np.column_stack([measured, predicted])
        spectral = zip(flight.spectral_runs(), runs, strict=True)
        measured, predicted = np.concatenate([item.band_passed(columns[run]) for item, run in spectral]).T
    centred = np.concatenate([measured[run] - measured[run].mean() for run in runs])
    residual, power = measured - predicted, float(centred @ centred)
    explained = 1.0 - float(residual @ residual) / power if power > 0.0 else math.nan
    labels = name, words, record.horizon, record.quantity, record.unit
    return ModelPrediction(*labels, measured, predicted, float(np.sqrt(np.mean(residual**2))), explained)


def _runs(flight: PreparedFlight) -> list[slice]:
    """Samples of each run, among those that are predicted."""
    lengths = [samples.size for samples in flight.samples_of_runs]
    return [slice(stop - n, stop) for n, stop in zip(lengths, np.cumsum(lengths).tolist(), strict=True)]


def _rows(validation: Validation) -> list[tuple[str, ...]]:
    return [
        (
            f"{item.quantity}, {item.horizon.words}",
            item.words,
            f"{item.rms:.3g}",
            item.unit,
            f"{item.explained:.1%}" if math.isfinite(item.explained) else doc.NO_NUMBER,
        )
        for item in validation.predictions
    ]


def validation_document(validation: Validation) -> doc.Document:
    """Document of a validation."""
    steps = validation.multi_step_prediction
    columns = ("predicted", "by", doc.TableColumn("RMS error", right=True, strong=True), "unit")
    rows, previous = [], ""
    for label, *others in _rows(validation):
        rows.append(("" if label == previous else label, *others))
        previous = label
    models = doc.table((*columns, doc.TableColumn("explained", right=True)), rows)
    parts = (models,) if steps is None else prediction_parts(steps, sentence=False)
    sections = [doc.Section("", (_validation_facts(validation), *parts))]
    if validation.comparisons:
        sections.append(doc.Section("This flight by itself", (_comparison_table(validation.comparisons),)))
    sections.append(doc.Section("Figure", (doc.Figure("validation"),)))
    return doc.Document(validation.flight.recording.name, validation.sentence, tuple(sections))


def _validation_facts(validation: Validation) -> doc.Facts:
    logs = ", ".join(str(log.get("name")) for log in validation.fit.document.provenance.logs)
    verdict, flight = validation.fit.verdict, validation.flight
    runs, multi_step = len(flight.runs), validation.multi_step_prediction
    facts = {
        "fit": f"of {logs}{'' if verdict is Status.IDENTIFIED else f' ({verdict.value})'}",
        "model": validation.motion.equation[0].replace(" - ", " − "),
        "used": f"{flight.used_s:.1f} s in {runs} run{'' if runs == 1 else 's'}",
    }
    if multi_step is not None:
        facts["fitted"] = "the trim of each run, for every model with parameters alike"
        facts["starts"] = f"{multi_step.start_s.size}, each from what was measured there"
    else:
        low, high = flight.band_hz
        facts["fitted"] = "the trim and the start of each run, for every model alike"
        facts["band"] = f"{low:g} to {high:g} Hz, one step ahead; all frequencies in open loop"
    return doc.Facts(tuple(facts.items()))


def _comparison_table(comparisons: tuple[QuantityComparison, ...]) -> doc.TableOf:
    number = partial(doc.TableColumn, right=True, strong=True)
    interval, rows = "95 % interval", []
    columns = ("quantity", number("fit"), interval, number("flight"), interval, "unit", "p-value")
    for item in comparisons:
        wording = item.fit.wording
        p_value = f"{item.p_value:.2g}{': contradicts' if item.contradicts else ''}"
        p_value = "not compared" if math.isnan(item.p_value) else p_value
        unit = wording.shown_unit or wording.unit
        rows.append((wording.words, *item.fit.texts, *item.flight.texts, unit, p_value))
    return doc.table(columns, rows)


VALIDATION_COLOURS = (plots.RED, plots.BLUE, plots.GREY, "#8a6d3b")


def _draw_predicted(ax: plots.Axes, validation: Validation, models: tuple[ModelPrediction, ...]) -> None:
    time, series = _shown_part(validation, models[0])
    first = models[0]
    ax.plot(time, first.measured[series], color=plots.DARK, lw=1.2, label="measured")
    for model, colour in zip(models, VALIDATION_COLOURS, strict=False):
        rms, explained = model.rms, model.explained
        label = f"{model.words}: RMS error {rms:.2g} {model.unit}, explains {explained:.0%}"
        ax.plot(time, model.predicted[series], color=colour, lw=1.0, label=label)
    ax.set_ylim(*_measured_limits(first.measured[series]))
    plots.labelled(ax, y=f"{first.quantity} [{first.unit}]", size=9.0)
    title = f"{first.quantity.capitalize()}, {first.horizon.words}"
    plots.headed(ax, f"{title}, from {time[0]:.0f} to {time[-1]:.0f} s")
    plots.legend(ax, location="upper right")


def _draw_residual(ax: plots.Axes, validation: Validation, models: tuple[ModelPrediction, ...]) -> None:
    time, series = _shown_part(validation, models[0])
    residuals = [(model.measured - model.predicted)[series] for model in models]
    for values, colour in zip(residuals, VALIDATION_COLOURS, strict=False):
        ax.plot(time, values, color=colour, lw=0.9)
    ax.axhline(0.0, color="black", lw=0.5)
    low, high = _measured_limits(models[0].measured[series])
    half = min(1.1 * max(float(np.abs(values).max()) for values in residuals), 0.5 * (high - low))
    ax.set_ylim(-half, half)
    plots.labelled(ax, x="time from the log's start [s]", y=f"left [{models[0].unit}]", size=9.0)


def _measured_limits(measured: Float[np.ndarray, " shown"]) -> tuple[float, float]:
    """Limits of a panel: the measured range, and room above it for the legend."""
    low, high = float(measured.min()), float(measured.max())
    height = max(high - low, 1e-9)
    return low - 0.25 * height, high + 0.75 * height


def _shown_part(validation: Validation, first: ModelPrediction) -> tuple[Float[np.ndarray, " shown"], slice]:
    flight = validation.flight
    samples, run = max(zip(flight.samples_of_runs, _runs(flight), strict=True), key=lambda pair: pair[0].size)
    longest = max(int(plots.FIT_SHOWN_S * flight.signals.rate_hz), 1)
    window = plots.liveliest(first.measured[run], longest)
    return flight.grid.time_s[samples][window], slice(run.start + window.start, run.start + window.stop)
