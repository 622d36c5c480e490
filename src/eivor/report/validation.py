"""Validation of a fit on another flight: numbers, document, JSON and figure."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eivor import checks
from eivor.errors import InputError, UsageError
from eivor.flights.motion import FIT, Ahead, Motion
from eivor.flights.options import FlightOptions
from eivor.flights.prepare import LARGEST_INPUT_RATIO, check_options, prepare
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import Horizon, Predicted, SimpleModel
from eivor.flights.result import FlightEstimate
from eivor.inference.verdict import Status
from eivor.models.separable import NoInstruments
from eivor.motions import motion_of_model
from eivor.report.document import (
    Cell,
    Document,
    Fact,
    Facts,
    Section,
    TableColumn,
    TableOf,
    printable,
    short_name,
)
from eivor.report.document import Figure as DocumentFigure
from eivor.report.figure_panels import (
    BLUE,
    DARK,
    FIT_SHOWN_S,
    GREY,
    RED,
    GivenAxes,
    Panels,
    figure_of,
    fitting,
    given_axes,
    labelled,
    legend,
    page,
    without_abscissa,
)
from eivor.report.figures import SIZE_INCHES, ahead_page, ahead_panels
from eivor.report.flight import ahead_parts, ahead_rows
from eivor.report.json_document import Json, ahead_json, json_text, number
from eivor.report.outputs import saved_fit
from eivor.report.saved_fit import SavedFit, load_fit
from eivor.report.wording import NO_NUMBER
from eivor.signals.recording import Recording
from eivor.tools import Float, html_table

if TYPE_CHECKING:
    from collections.abc import Iterable

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


# -- Validation --


@dataclass(frozen=True, slots=True)
class PredictionError:
    """What a prediction leaves."""

    rms: float
    explained: float


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
    error: PredictionError  # Over all runs
    by_run: tuple[PredictionError, ...]


@dataclass(frozen=True)
class Validation:
    """A flight as a result of other flights predicts it.

    Parameters
    ----------
    fit : SavedFit
        The result.
    motion : Motion
        What it is a result of.
    flight : PreparedFlight
        The flight that is predicted.
    predictions : tuple of ModelPrediction
        Of every quantity over whole runs: by the fit, then by each simpler model. Empty for a motion that
        predicts ahead from many starts.
    ahead : Ahead or None
        Predictions some tenths of a second ahead; None for a motion that predicts whole runs.
    """

    fit: SavedFit
    motion: Motion[Any]
    flight: PreparedFlight
    predictions: tuple[ModelPrediction, ...]
    ahead: Ahead | None = None

    @property
    def spans_s(self) -> tuple[tuple[float, float], ...]:
        """First and last second of each run."""
        time = self.flight.grid.time_s
        return tuple((float(time[run.start]), float(time[run.stop - 1])) for run in self.flight.runs)

    @property
    def by_quantity(self) -> tuple[tuple[ModelPrediction, ...], ...]:
        """Predictions of each quantity, the fit's first."""
        firsts = [one for one in self.predictions if one.model == FIT]
        return tuple(
            tuple(one for one in self.predictions if one.quantity == first.quantity) for first in firsts
        )

    @property
    def predicts(self) -> bool:
        """Whether the fit explains something at the farthest horizon, and no simpler model more.

        Of predictions ahead: whether its errors are the least, in the mean over all quantities.
        """
        if self.ahead is not None:
            return self.ahead.predicts
        own, *others = self.by_quantity[-1]
        return own.error.explained > 0.0 and all(own.error.rms <= other.error.rms for other in others)

    @property
    def sentence(self) -> str:
        """What was found, in a sentence."""
        if self.ahead is not None:
            return self.ahead.sentence
        own, *others = self.by_quantity[-1]
        far = f"{own.quantity}, {own.horizon.words}, over {_seconds(self.flight)}"
        share = f"{own.error.explained:.1%}" if own.error.explained > 0.0 else "nothing"
        told = f"The fit explains {share} of the {far}"
        better = [one.words for one in others if one.error.rms < own.error.rms]
        if better:
            return f"{told}; {' and '.join(better)} leave{'s' if len(better) == 1 else ''} less."
        return f"{told}{', and leaves less than the simpler models' if others else ''}."

    def summary(self) -> str:
        """Errors of every prediction as plain text."""
        lines = [f"{self.motion.words.title}, {self.flight.recording.name}", self.sentence]
        if self.ahead is not None:
            told = ahead_rows(self.ahead)
            return "\n".join(
                [
                    *lines,
                    *(
                        f"{what:<12}{by:<38}{unit:<6}{' '.join(f'{one:>8}' for one in rms)}"
                        for what, by, unit, *rms in told
                    ),
                ]
            )
        lines += [
            f"{what:<42}{by:<36}{rms:>10} {unit:<6}{share:>9}" for what, by, rms, unit, share in _rows(self)
        ]
        return "\n".join(lines)

    def __repr__(self) -> str:
        return f"<Validation of {self.flight.recording.name!r}: {self.sentence}>"

    def _repr_html_(self) -> str:
        columns = ("prediction", "model", "RMS error", "unit", "explained")
        title = f"{self.motion.words.title}, {self.flight.recording.name}"
        if self.ahead is not None:
            horizons = tuple(f"{one:g} s" for one in self.ahead.horizons_s)
            return html_table(
                title, ("error of", "model", "unit", *horizons), ahead_rows(self.ahead), self.sentence
            )
        return html_table(title, columns, _rows(self), self.sentence)

    def to_json(self) -> str:
        """Text of the JSON document that ``eivor validate --json`` writes, see docs/json.md."""
        return json_text(validation_json(self))

    def plot(self, axes: Axes | Mapping[str, Axes] | Iterable[Axes] | None = None) -> Figure:
        """Figure: for each prediction what was measured and predicted, and below it what is left.

        Parameters
        ----------
        axes : mapping of str to Axes, or sequence of Axes, optional
            Where to draw: panels by name, "one_step", "one_step residual", "open_loop", "open_loop
            residual" for the vertical motion, or all in this order. Default: a figure of its own.

        Raises
        ------
        UsageError
            When `axes` do not fit the panels.
        """
        return validation_figure(self, axes)


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
        Errors of each prediction, over all runs and in each.

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
    result = _saved(fit)
    checks.kind("recording", recording, Recording, "a Recording", 'Read it: ev.read_log("other.ulg").')
    if not result.prediction:
        raise UsageError(
            "a result with an estimate",
            f"one without: {' '.join(result.reasons).rstrip('.')}",
            "Validate a flight that tells something.",
        )
    motion = motion_of_model(str(result.document["model"]["name"]))
    motion = motion.of_told_vehicle(result.prediction.get("vehicle"))
    motion, flight = _prepared(result, motion, recording, window, max_tilt_deg)
    _check_scale(result, motion, flight)
    ahead = motion.ahead((flight.shortened,), _simpler_models(result), result.refused)
    if ahead is not None:
        return _ahead_of(result, motion, flight, ahead)
    problem = motion.problem((flight.shortened,), NoInstruments())
    found = tuple(
        _of_model(name, model.words, predicted, flight)
        for name, model in _simpler_models(result).items()
        for predicted in motion.predictions(problem, model.values)
    )
    if not found:
        raise UsageError(
            "a motion that predicts", f"'{motion.name}', which does not", "See docs/motions.md: predictions."
        )
    return Validation(result, motion, flight, tuple(sorted(found, key=_nearest_first)))


def _saved(fit: SavedFit | FlightEstimate | str | Path) -> SavedFit:
    if isinstance(fit, FlightEstimate):
        return saved_fit(fit)
    if isinstance(fit, SavedFit):
        return fit
    if isinstance(fit, str | Path):
        return load_fit(fit)
    raise UsageError(
        "a result, or the path of its JSON file", checks.described(fit), 'Such as ev.load_fit("fit.json").'
    )


def _prepared(
    fit: SavedFit,
    motion: Motion[Any],
    recording: Recording,
    window: tuple[float, float] | None,
    max_tilt_deg: float | None,
) -> tuple[Motion[Any], PreparedFlight]:
    """The motion with the terms of the fit, and the flight."""
    told = fit.prediction
    options = FlightOptions(
        window=window,
        max_tilt_deg=told["limits"]["max_tilt_deg"] if max_tilt_deg is None else max_tilt_deg,
        input=told["input"],
        input_map=told["input_map"],
        terms=tuple(fit.document["provenance"]["options"].get("terms", ())),
    )
    check_options(motion, options)
    flight = prepare(recording, motion, options)
    if not flight.runs:
        raise InputError(
            f"three seconds {motion.words.where} in runs of a second or more, {motion.words.limits}",
            f"none in {recording.name}",
            motion.words.loosen,
        )
    return motion.for_flights((flight,), options), flight


def _check_scale(fit: SavedFit, motion: Motion[Any], flight: PreparedFlight) -> None:
    """Refuse a flight whose input is of another size than those of the fit, as far as the fit tells."""
    level, own = fit.prediction.get("input_level"), motion.input_level(flight)
    if level is not None and max(level, own) > LARGEST_INPUT_RATIO * min(level, own):
        raise InputError(
            f"{flight.input.name} of about {level:.4g} on average, as in the flights of the fit",
            f"{own:.4g} in {flight.recording.name}",
            "Give a flight of the same vehicle, with its commands in the same unit.",
        )


def _ahead_of(fit: SavedFit, motion: Motion[Any], flight: PreparedFlight, ahead: Ahead) -> Validation:
    if not ahead.errors:
        raise UsageError(
            "a result and a log that tell enough of the vehicle to predict it",
            " ".join(ahead.left_out) or "no half second without a gap",
            "Validate a flight that tells more, on a log of the same vehicle.",
        )
    return Validation(fit, motion, flight, (), ahead)


def _simpler_models(fit: SavedFit) -> dict[str, SimpleModel]:
    """The fit and the simpler models that its document holds, by name."""
    best = next(candidate for candidate in fit.candidates if candidate.best)
    at = {str(name): float(value) for name, value in fit.prediction["at"].items()}
    own = at | dict(zip(fit.names, best.values.tolist(), strict=True))
    beside = fit.prediction.get("beside", {})
    simpler = {name: SimpleModel(str(one["words"]), dict(one["values"])) for name, one in beside.items()}
    return {FIT: SimpleModel("the fit", own), **simpler}


def _of_model(name: str, words: str, told: Predicted, flight: PreparedFlight) -> ModelPrediction:
    measured, predicted = told.measured, told.predicted
    lengths = [samples.size for samples in flight.samples_of_runs]
    runs = [slice(stop - n, stop) for n, stop in zip(lengths, np.cumsum(lengths).tolist(), strict=True)]
    if told.horizon is Horizon.ONE_STEP:
        both = np.column_stack([measured, predicted])
        spectral = flight.spectral_runs()
        passed = [one.band_passed(both[run]) for one, run in zip(spectral, runs, strict=True)]
        measured, predicted = np.concatenate(passed).T
    centred = np.concatenate([measured[run] - measured[run].mean() for run in runs])
    left = measured - predicted
    return ModelPrediction(
        name,
        words,
        told.horizon,
        told.quantity,
        told.unit,
        measured,
        predicted,
        _error(left, centred),
        tuple(_error(left[run], centred[run]) for run in runs),
    )


def _error(left: Float[np.ndarray, " n"], moved: Float[np.ndarray, " n"]) -> PredictionError:
    power = float(moved @ moved)
    explained = 1.0 - float(left @ left) / power if power > 0.0 else float("nan")
    return PredictionError(float(np.sqrt(np.mean(left**2))), explained)


def _nearest_first(one: ModelPrediction) -> int:
    return list(Horizon).index(one.horizon)


def _seconds(flight: PreparedFlight) -> str:
    runs = len(flight.runs)
    return f"{flight.used_s:.1f} s" + (f" in {runs} runs" if runs > 1 else "")


def _rows(found: Validation) -> list[tuple[str, ...]]:
    return [
        (
            f"{one.quantity}, {one.horizon.words}",
            one.words,
            f"{one.error.rms:.3g}",
            one.unit,
            f"{one.error.explained:.1%}",
        )
        for one in found.predictions
    ]


# -- JSON validation --

VALIDATE_SCHEMA = "eivor.validate/1"


def validation_json(found: Validation) -> dict[str, Json]:
    """Document of a validation, ready for `json_text`."""
    log = found.flight.recording
    fitted = found.fit.document
    return {
        "schema": VALIDATE_SCHEMA,
        "log": {"name": log.name, "sha256": log.sha256 or None},
        "fit": {
            "logs": fitted["provenance"]["logs"],
            "model": fitted["model"]["name"],
            "verdict": found.fit.verdict.value,
        },
        "predicts": found.predicts,
        "sentence": found.sentence,
        "runs": [[number(start), number(end)] for start, end in found.spans_s],
        "samples": int(found.flight.used.sum()),
        "rate_hz": number(found.flight.signals.rate_hz),
        "band": [number(end) for end in found.flight.band_hz],
        "predictions": [_prediction(one) for one in found.predictions],
        "ahead": ahead_json(found.ahead),
        "provenance": {"version": version("eivor")},
    }


def _prediction(one: ModelPrediction) -> Json:
    return {
        "model": one.model,
        "horizon": one.horizon.value,
        "quantity": one.quantity,
        "unit": one.unit,
        "rms": number(one.error.rms),
        "explained": number(one.error.explained),
        "by_run": [{"rms": number(run.rms), "explained": number(run.explained)} for run in one.by_run],
    }


# -- Validation document --


def validation_document(found: Validation) -> Document:
    """Document of a validation."""
    table = (_models_table(found),) if found.ahead is None else ahead_parts(found.ahead, sentence=False)
    sections = [Section("", (_validation_facts(found), *table))]
    if found.ahead is None and len(found.spans_s) > 1:
        sections.append(Section("Of the fit, run by run", (_by_run(found),)))
    sections.append(Section("Figure", (DocumentFigure("validation"),)))
    return Document(found.flight.recording.name, None, found.sentence, tuple(sections))


def _validation_facts(found: Validation) -> Facts:
    logs = ", ".join(str(log["name"]) for log in found.fit.document["provenance"]["logs"])
    verdict = found.fit.verdict
    trust = "" if verdict is Status.IDENTIFIED else f" ({verdict.value})"
    runs = len(found.spans_s)
    return Facts(
        (
            Fact("fit", f"of {logs}{trust}"),
            Fact("model", found.motion.equation[0].replace(" - ", " − ")),
            Fact("used", f"{found.flight.used_s:.1f} s in {runs} run{'' if runs == 1 else 's'}"),
            *_how(found),
        )
    )


def _how(found: Validation) -> tuple[Fact, ...]:
    if found.ahead is not None:
        return (
            Fact("fitted", "the trim of each run, for every model with parameters alike"),
            Fact("starts", f"{found.ahead.start_s.size}, each from what was measured there"),
        )
    low, high = found.flight.band_hz
    return (
        Fact("fitted", "the trim and the start of each run, for every model alike"),
        Fact("band", f"{low:g} to {high:g} Hz, one step ahead; all frequencies in open loop"),
    )


def _models_table(found: Validation) -> TableOf:
    columns = (
        TableColumn("predicted"),
        TableColumn("by"),
        TableColumn("RMS error", right=True, strong=True),
        TableColumn("unit"),
        TableColumn("explained", right=True),
    )
    rows = []
    for models in found.by_quantity:
        for index, one in enumerate(models):
            what = Cell("") if index else Cell(f"{one.quantity}, {one.horizon.words}")
            rms, explained = _cells(one.error)
            rows.append((what, Cell(one.words), rms, Cell(one.unit), explained))
    return TableOf(columns, tuple(rows))


def _by_run(found: Validation) -> TableOf:
    own = [quantity[0] for quantity in found.by_quantity]
    columns = [TableColumn("run [s]", whole=True)]
    for one in own:
        title = f"{one.quantity}: RMS error [{one.unit}]"
        columns += [TableColumn(title, right=True, strong=True), TableColumn("explained", right=True)]
    rows = []
    for index, (start, end) in enumerate(found.spans_s):
        cells = [Cell(f"{start:.1f} to {end:.1f}")]
        for one in own:
            cells += _cells(one.by_run[index])
        rows.append(tuple(cells))
    return TableOf(tuple(columns), tuple(rows))


def _cells(error: PredictionError) -> tuple[Cell, Cell]:
    explained = f"{error.explained:.1%}" if error.explained == error.explained else NO_NUMBER
    return Cell(f"{error.rms:.3g}"), Cell(explained)


# -- Validation figure --

VALIDATION_COLOURS = (RED, BLUE, GREY, "#8a6d3b")
#: Letters of a line of the title.
TITLE_LETTERS = 120


def validation_figure(found: Validation, axes: GivenAxes | None = None) -> Figure:
    """Figure of a validation."""
    panels: Panels = {} if found.ahead is None else ahead_panels(found.ahead)
    for models in found.by_quantity:
        name = models[0].horizon.value
        panels[name] = partial(_draw_predicted, found=found, models=models)
        panels[f"{name} residual"] = partial(_draw_left, found=found, models=models)
    new_page = _validation_page if found.ahead is None else ahead_page
    placed = new_page(tuple(panels)) if axes is None else given_axes(axes, tuple(panels))
    for name, ax in placed.items():
        panels[name](ax)
    figure = figure_of(*placed.values())
    if axes is None:
        sentence = textwrap.fill(found.sentence, TITLE_LETTERS)
        title = f"{short_name(printable(found.flight.recording.name))}\n{sentence}"
        figure.suptitle(title, fontsize=11, parse_math=False)
    return figure


def _validation_page(names: tuple[str, ...]) -> dict[str, Axes]:
    from matplotlib.gridspec import GridSpec

    figure = page(SIZE_INCHES[0], SIZE_INCHES[1] * len(names) / 4.0)
    grid = GridSpec(len(names), 1, figure=figure, height_ratios=(1.6, 1.0) * (len(names) // 2))
    placed: dict[str, Axes] = {}
    for row, (predicted, left) in enumerate(zip(names[::2], names[1::2], strict=True)):
        placed[predicted] = figure.add_subplot(grid[2 * row])
        placed[left] = figure.add_subplot(grid[2 * row + 1], sharex=placed[predicted])
        without_abscissa(placed[predicted])
    return placed


def _draw_predicted(ax: Axes, found: Validation, models: tuple[ModelPrediction, ...]) -> None:
    time, shown = _shown(found, models[0])
    ax.plot(time, models[0].measured[shown], color=DARK, lw=1.2, label="measured")
    limits = _measured_limits(models[0].measured[shown])
    for one, colour in zip(models, VALIDATION_COLOURS, strict=False):
        ax.plot(time, one.predicted[shown], color=colour, lw=1.0, label=_label(one))
    first = models[0]
    ax.set_ylim(*limits)
    labelled(ax, y=f"{first.quantity} [{first.unit}]", size=9.0)
    start, end = time[0], time[-1]
    ax.set_title(
        fitting(ax, f"{first.quantity.capitalize()}, {first.horizon.words}, from {start:.0f} to {end:.0f} s"),
        fontsize=9,
        parse_math=False,
    )
    legend(ax, place="upper right")


def _draw_left(ax: Axes, found: Validation, models: tuple[ModelPrediction, ...]) -> None:
    time, shown = _shown(found, models[0])
    left = [(one.measured - one.predicted)[shown] for one in models]
    for values, colour in zip(left, VALIDATION_COLOURS, strict=False):
        ax.plot(time, values, color=colour, lw=0.9)
    ax.axhline(0.0, color="black", lw=0.5)
    low, high = _measured_limits(models[0].measured[shown])
    half = min(1.1 * max(float(np.abs(values).max()) for values in left), 0.5 * (high - low))
    ax.set_ylim(-half, half)
    labelled(ax, x="time from the log's start [s]", y=f"left [{models[0].unit}]", size=9.0)


def _label(one: ModelPrediction) -> str:
    return f"{one.words}: RMS error {one.error.rms:.2g} {one.unit}, explains {one.error.explained:.0%}"


def _measured_limits(measured: Float[np.ndarray, " shown"]) -> tuple[float, float]:
    """Room for what was measured, and above it for the legend; what drifts further leaves the panel."""
    low, high = float(measured.min()), float(measured.max())
    height = max(high - low, 1e-9)
    return low - 0.25 * height, high + 0.75 * height


def _shown(found: Validation, first: ModelPrediction) -> tuple[Float[np.ndarray, " shown"], slice]:
    """Time and samples of the liveliest part of the longest run."""
    lengths = [samples.size for samples in found.flight.samples_of_runs]
    longest = int(np.argmax(lengths))
    begin = sum(lengths[:longest])
    count = min(lengths[longest], max(int(FIT_SHOWN_S * found.flight.signals.rate_hz), 1))
    values = first.measured[begin : begin + lengths[longest]]
    power = np.concatenate([[0.0], np.cumsum((values - values.mean()) ** 2)])
    start = int(np.argmax(power[count:] - power[: power.size - count]))
    time = found.flight.grid.time_s[found.flight.samples_of_runs[longest]]
    return time[start : start + count], slice(begin + start, begin + start + count)
