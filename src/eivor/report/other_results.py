"""Documents of validations, tracks and plans, and tables of draws."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from eivor import checks
from eivor.errors import InputError, NotIdentifiedError, UsageError
from eivor.flights.motion import FIT, Ahead, Motion
from eivor.flights.options import FlightOptions
from eivor.flights.prepare import LARGEST_INPUT_RATIO, check_options, prepare
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import Horizon, Predicted, SimpleModel
from eivor.flights.result import FlightEstimate
from eivor.flights.track import HELD, TOLD, Moment, Track
from eivor.inference.verdict import Status
from eivor.models.separable import NoInstruments
from eivor.motions import motion_of_model
from eivor.motions.rigid_body.vehicle import KnownNumber
from eivor.planning.plan import FlightPlan, make_plan
from eivor.planning.vehicle import TARGETS, FlightLimits, VehicleGuess, vehicle_of_result
from eivor.report.document import Bullets, Cell, Document, Fact, Facts, Section, TableColumn, TableOf, Tone
from eivor.report.document import Figure as DocumentFigure
from eivor.report.flight import ahead_parts, ahead_rows, section
from eivor.report.json_document import Json, ahead_json, findings_list, json_text, number
from eivor.report.saved_fit import SavedFit, load_fit, saved_fit
from eivor.report.wording import NO_NUMBER, plain_numbers
from eivor.signals.recording import Recording
from eivor.tools import Float, html_table

if TYPE_CHECKING:
    from collections.abc import Iterable

    import polars as pl
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


# -- Draws table --

#: The mass is drawn from a stream of its own, so that it leaves the other draws alone.
MASS_STREAM = 1


def draws_table(
    fit: SavedFit,
    n: int,
    seed: int = 0,
    mass: KnownNumber | None = None,
    *,
    delays: Literal["best", "all"] = "best",
) -> pl.DataFrame:
    """Table of joint draws.

    Parameters
    ----------
    fit : SavedFit
        The result.
    n, seed : int
        See `SavedFit.sample`.
    mass : KnownNumber, optional
        Of the vehicle [kg]: drawn from a normal distribution beside the others, cut at zero.
    delays : {"best", "all"}
        See `SavedFit.sample`.

    Returns
    -------
    polars.DataFrame
        A row for each draw; a column for each parameter of the joint vector that is identified, one for
        each value of `prediction.at` beside it that is (such as the delay), and `mass` where it is given.

    Raises
    ------
    NotIdentifiedError
        When no parameter of the joint vector is identified.
    EstimationError, UsageError
        See `SavedFit.sample`.
    """
    import polars as pl

    draws = fit.sample(n, seed, delays=delays)
    told = [name for name, one in fit.quantities.items() if one.verdict is Status.IDENTIFIED]
    columns = {name: column for name, column in draws.items() if name in told}
    if not columns:
        raise NotIdentifiedError(
            "a parameter that is identified, to draw from",
            f"a result without: {' '.join(fit.reasons)}",
            "Fly again as the report says.",
        )
    for name, value in fit.prediction.get("at", {}).items():
        if name in told and name not in columns and value is not None:
            columns[name] = np.full(n, float(value))
    if mass is not None:
        own = np.random.default_rng([seed, MASS_STREAM])
        columns["mass"] = np.maximum(mass.value + mass.std * own.standard_normal(n), 0.0)
    return pl.DataFrame(columns)


# -- Track document --

#: Marks of a line, lowest first, and that of a time at which nothing is told.
MARKS, UNTOLD = "▁▂▃▄▅▆▇█", "·"
#: Marks of a line, and rows of a table, at most.
LINE, ROWS = 60, 16
#: Narrowest range that a line of marks spans, over the middle value: smaller ups and downs are no news.
FLAT = 0.1


def track_document(track: Track) -> Document:
    """Document of a track."""
    (flight,) = track.result.prepared
    told = (
        f"{len(track.told)} of {len(track.moments)} moments tell it"
        if track.moments
        else "no moment tells it"
    )
    return Document(
        flight.recording.name, None, f"{_called(track)} over the flight: {told}", tuple(_sections(track))
    )


def _called(track: Track) -> str:
    if not track.name:
        return "Nothing"
    wording = track.result.motion.wording[track.name]
    return f"{wording.words} {wording.symbol}"


def _sections(track: Track) -> Iterator[Section]:
    if track.moments:
        yield Section("", (_line(track), _table(track)))
    yield from section("Changes", Bullets, changes_told(track))
    yield from section("Not told", Bullets, untold(track))
    yield from section("Taken as known", Bullets, (*_at(track), *track.known))


def changes_told(track: Track) -> Iterator[str]:
    """Return a sentence about each change; one where there is none."""
    for one in track.changes:
        before, after = _beside(track, one)
        share = (
            f" by {abs(100.0 * (after / before - 1.0)):.0f} %"
            if before is not None and after is not None
            else ""
        )
        yield (
            f"Told at {one.time_s:.1f} s, and up to {track.memory_s:g} s older than that: "
            f"the {_called(track)} {'rose' if one.change > 0 else 'fell'}{share}."
        )
    if track.told and not track.changes:
        yield "None: what moved, moved slowly or within its band."


def _beside(track: Track, change: Moment) -> tuple[float | None, float | None]:
    """Values told a memory before a change, since it may be as old, and after it, within a memory."""
    before = [one.value for one in track.told if one.time_s < change.time_s - track.memory_s]
    after = [
        one.value
        for one in track.told
        if change.time_s + 0.25 * track.memory_s < one.time_s < change.time_s + track.memory_s
    ]
    return (before[-1] if before else None, after[-1] if after else None)


def untold(track: Track) -> Iterator[str]:
    """Why the parameter is not told, where it is not."""
    if not track.moments:
        yield from (f"{reason.sentence} {reason.remedy}" for reason in track.result.verdict.reasons)
        return
    for start, stop in _stretches(track):
        here = track.moments[start:stop]
        ends = f"{here[0].time_s:.1f} to {here[-1].time_s:.1f} s"
        empty = sum(one.share < HELD for one in here)
        if 2 * empty >= len(here):
            why = "hardly any sample of the memory before is of flight that can be used"
        else:
            why = f"the interval is wider than ±{100.0 * TOLD:.0f} %; a longer memory narrows it (--memory)"
        yield f"{ends}: {why}."


def _stretches(track: Track) -> Iterator[tuple[int, int]]:
    edges = np.flatnonzero(np.diff([0, *(not one.told for one in track.moments), 0]))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def _at(track: Track) -> Iterator[str]:
    if track.at:
        values = ", ".join(
            f"{name.replace('_', ' ')} {1e3 * value:.0f} ms" for name, value in track.at.items()
        )
        yield f"Followed at {values}, with a memory of {track.memory_s:g} s."


def marks(values: Sequence[float], told: Sequence[bool]) -> str:
    """Line of marks: the least value told is the lowest, the largest the highest."""
    seen = np.array([value for value, is_told in zip(values, told, strict=True) if is_told])
    if not seen.size:
        return UNTOLD * len(values)
    middle = 0.5 * float(seen.min() + seen.max())
    span = max(float(np.ptp(seen)), FLAT * abs(middle))
    low = middle - 0.5 * span
    return "".join(
        MARKS[min(int((value - low) / span * len(MARKS)), len(MARKS) - 1)] if is_told else UNTOLD
        for value, is_told in zip(values, told, strict=True)
    )


def _thinned(track: Track, most: int) -> list[Moment]:
    """Moments evenly spread, changes among them."""
    step = max(1, -(-len(track.moments) // most))
    return [one for number, one in enumerate(track.moments) if one.change or number % step == step - 1]


def _line(track: Track) -> Facts:
    shown = _thinned(track, LINE)
    line = marks([one.value for one in shown], [one.told for one in shown])
    ends = f"{track.moments[0].time_s:.1f} to {track.moments[-1].time_s:.1f} s"
    symbol = track.result.motion.wording[track.name].symbol
    return Facts((Fact(symbol, line), Fact("", f"{ends}; {UNTOLD} is not told")))


def _table(track: Track) -> TableOf:
    wording = track.result.motion.wording[track.name]
    columns = (
        TableColumn("time [s]", strong=True),
        TableColumn(f"{wording.symbol} [{wording.shown_unit or wording.unit}]", right=True, whole=True),
        TableColumn("95 % interval", whole=True),
        TableColumn("of the first told", right=True),
        TableColumn("", below=Tone.WARNING),
    )
    first = track.told[0].value if track.told else None
    rows = []
    for one in _thinned(track, ROWS):
        value, interval = NO_NUMBER, NO_NUMBER
        if one.told:
            scaled = wording.scale * one.value, wording.scale * one.half_width
            value, interval = plain_numbers(scaled[0], (scaled[0] - scaled[1], scaled[0] + scaled[1]))
        share = f"{100.0 * one.value / first:.0f} %" if one.told and first else ""
        note = {1: "rose", -1: "fell", 0: ""}[one.change]
        rows.append((Cell(f"{one.time_s:.1f}"), Cell(value), Cell(interval), Cell(share), Cell(note)))
    return TableOf(columns, tuple(rows))


# -- JSON track --


def track_json(track: Track) -> dict[str, Json]:
    """Document of a track; numbers are in SI units, and null where nothing is told."""
    (flight,) = track.result.prepared
    return {
        "schema": "eivor.track/1",
        "log": flight.recording.name,
        "parameter": track.name,
        "unit": track.unit,
        "memory_s": track.memory_s,
        "at": dict(track.at),
        "known": list(track.known),
        "moments": [
            {
                "time_s": one.time_s,
                "value": number(one.value),
                "low": number(one.value - one.half_width),
                "high": number(one.value + one.half_width),
                "told": one.told,
            }
            for one in track.moments
        ],
        "changes": [{"time_s": one.time_s, "upwards": one.change > 0} for one in track.changes],
        "not_told": list(untold(track)),
        "verdict_of_the_flight": track.result.verdict.status.value,
        "findings": findings_list(track.result.findings),
    }


# -- Validation --


@dataclass(frozen=True, slots=True)
class PredictionError:
    """What a prediction leaves.

    Parameters
    ----------
    rms : float
        Root mean square of what was measured less what was predicted.
    explained : float
        One less its sum of squares over that of what was measured without its mean; below zero for a
        prediction that is worse than the mean.
    """

    rms: float
    explained: float


@dataclass(frozen=True)
class ModelPrediction:
    """One measured quantity as one model predicts it.

    Parameters
    ----------
    model, words : str
        The model's name, and what it is.
    horizon : Horizon
        How far ahead it looks.
    quantity, unit : str
        What is predicted.
    measured, predicted : ndarray, shape (samples,)
        Run after run.
    error : PredictionError
        Over all runs.
    by_run : tuple of PredictionError
        In each run.
    """

    model: str
    words: str
    horizon: Horizon
    quantity: str
    unit: str
    measured: Float[np.ndarray, " samples"] = field(repr=False)
    predicted: Float[np.ndarray, " samples"] = field(repr=False)
    error: PredictionError
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
        from eivor.report.figures import validation_figure

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


# -- Plan --

PLAN_SCHEMA = "eivor.plan/1"


def plan(
    source: SavedFit | FlightEstimate | VehicleGuess | str | Path,
    *,
    target: str = "",
    limits: FlightLimits | None = None,
    shape: str = "",
    seed: int = 0,
) -> FlightPlan:
    """Plan the flight that would tell: after one that could not, or of rough numbers.

    Parameters
    ----------
    source : SavedFit, FlightEstimate, VehicleGuess, str or Path
        A result, refused ones included, the file of one, or rough numbers of a vehicle.
    target : str
        "friction", "gain" or "lag". Default: the first of friction, lag and gain that the result could not
        tell.
    limits : FlightLimits, optional
        Of height, speed, acceleration, tilt and time.
    shape : str
        "multisine" or "steps". Default: the one whose simulated flights tell more.
    seed : int
        Of phases, step heights, wind and noise.

    Returns
    -------
    FlightPlan
        Setpoints, and the half-widths that the recipe gave of simulated flights.

    Raises
    ------
    UsageError
        For words that do not exist, arguments of other types, and a result of another motion.
    InputError
        When the file cannot be read, or no flight keeps the limits.

    Notes
    -----
    Simulated with the result's numbers, what it left over by frequency, and its controller; this takes
    seven seconds or so.
    """
    return make_plan(_vehicle(source), target=target, limits=limits, shape=shape, seed=seed)


def _vehicle(source: SavedFit | FlightEstimate | VehicleGuess | str | Path) -> VehicleGuess:
    if isinstance(source, VehicleGuess):
        return source
    if isinstance(source, FlightEstimate):
        source = saved_fit(source)
    elif isinstance(source, str | Path):
        source = load_fit(source)
    if not isinstance(source, SavedFit):
        raise UsageError(
            "a result, the path of its JSON file, or a vehicle",
            checks.described(source),
            'Such as ev.plan("fit.json") or ev.plan(ev.VehicleGuess()).',
        )
    return vehicle_of_result(source.document)


def plan_document(made: FlightPlan) -> Document:
    """Document of a plan."""
    columns = (
        TableColumn("quantity"),
        TableColumn("taken as", right=True),
        TableColumn("half-width", right=True, strong=True),
        TableColumn("unit"),
        TableColumn("identified"),
    )
    rows = []
    for word, found in made.predicted.items():
        asked = TARGETS[word]
        taken = "" if asked.relative else f"{found.value:.3g}"
        told = f"in {found.identified} of {len(found.verdicts)}"
        rows.append(tuple(map(Cell, (asked.words, taken, f"± {found.half_width:.2g}", asked.unit, told))))
    return Document(
        f"Plan for the {TARGETS[made.target].words}",
        None,
        made.sentence,
        (Section("", (_plan_facts(made), TableOf(columns, tuple(rows)))),),
    )


def _plan_facts(made: FlightPlan) -> Facts:
    limits, (low, high, speed) = made.limits, made.reached
    gains = made.vehicle.follows
    return Facts(
        (
            Fact("setpoint", f"{made.shape.words}, about {limits.middle_m:g} m above take-off"),
            Fact(
                "limits",
                f"{limits.height_m[0]:g} to {limits.height_m[1]:g} m, {limits.speed:g} m/s, "
                f"{limits.acceleration:g} m/s², {limits.tilt_deg:g}° of tilt, {limits.duration_s:g} s",
            ),
            Fact("simulated", f"{low:.1f} to {high:.1f} m, up to {speed:.1f} m/s"),
            Fact(
                "controller",
                f"{gains.position_gain:.2g} 1/s on height, {gains.velocity_gain:.2g} 1/s on climb rate"
                + (
                    ", as the flight was flown"
                    if made.vehicle.controller is not None
                    else ", to suit the lag"
                ),
            ),
        )
    )


def plan_json(made: FlightPlan) -> dict[str, Json]:
    """Document of a plan of schema ``eivor.plan/1``, ready for `json_text`."""
    limits, (low, high, speed) = made.limits, made.reached
    return {
        "schema": PLAN_SCHEMA,
        "target": made.target,
        "sentence": made.sentence,
        "shape": {"kind": made.shape.kind, "words": made.shape.words},
        "limits": {
            "height_m": list(limits.height_m),
            "speed": limits.speed,
            "acceleration": limits.acceleration,
            "tilt_deg": limits.tilt_deg,
            "duration_s": limits.duration_s,
        },
        "predicted": {
            word: {
                "half_width": number(found.half_width),
                "value": number(found.value),
                "unit": TARGETS[word].unit,
                "verdicts": [status.value for status in found.verdicts],
            }
            for word, found in made.predicted.items()
        },
        "simulated": {"lowest_m": number(low), "highest_m": number(high), "speed": number(speed)},
        "provenance": {"version": version("eivor")},
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
