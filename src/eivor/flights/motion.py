"""Interface of a motion, the inputs of its verdict and multi-step prediction."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import ceil
from typing import Any, Generic, TypeVar

import msgspec
import numpy as np

from eivor.errors import UsageError
from eivor.estimation.estimate import Estimate
from eivor.flights import quantity
from eivor.flights.grid import RECOVERY_S
from eivor.flights.lag_prior import LAG_TABLES
from eivor.flights.options import FlightOptions
from eivor.flights.prepared import InputFamily, PreparedFlight, Selection, SensorAgreement
from eivor.flights.quantity import CoupledAxis, Quantity, QuantityEstimate, SimpleModel, TrackedParameter
from eivor.flights.references import ReferenceSource
from eivor.flights.verdict import MotionChecks, Rule, SystematicPart
from eivor.models.separable import InstrumentRule, SeparableProblem, Values
from eivor.signals.channels import CanonicalChannel
from eivor.signals.recording import Finding, Recording
from eivor.strict_toml import package_tables
from eivor.tools import Float, Int

#: How far ahead predictions look [s].
HORIZONS_S = (0.1, 0.2, 0.3, 0.4, 0.5)
#: Spacing of starts [s], larger in flights that would have more than the largest number of them.
START_SPACING_S, MOST_STARTS = 0.05, 2000
#: Steps of the integration are no longer than this, or one of the grid [s].
LONGEST_STEP_S = 0.010
#: Limit of the size of a state that diverges.
DIVERGED = 1e9
#: Names among the models: the fit itself, and that everything stays as it is at the start.
FIT, UNCHANGED = "fit", "unchanged"
#: Right-hand side of x' = f(x, sample) for starts side by side, over the step that begins at a sample.
Derivative = Callable[[Float[np.ndarray, "parts starts"], Int[np.ndarray, " starts"]], np.ndarray]


@dataclass(frozen=True)
class HorizonErrors:
    """Prediction errors of one model in one quantity after each horizon."""

    model: str  # The model's name
    words: str  # What the model is
    quantity: str  # What is predicted
    unit: str  # Of the errors
    #: Size of predicted less measured; NaN where nothing was measured
    sizes: Float[np.ndarray, "starts horizons"] = field(repr=False)
    #: Sizes of the changes from the start to the last horizon, measured and predicted
    changes: Float[np.ndarray, "starts 2"] = field(repr=False)
    #: Measured and predicted after the last horizon, of a quantity that is a single number
    series: Float[np.ndarray, "starts 2"] | None = field(default=None, repr=False)

    @property
    def rms(self) -> tuple[float, ...]:
        """Root-mean-square error after each horizon."""
        return tuple(map(_rms, self.sizes.T))

    @property
    def theil(self) -> float:
        """Theil's inequality coefficient of the changes from the start: 0 all of it predicted, 1 nothing."""
        measured, predicted = map(_rms, self.changes.T)
        return self.rms[-1] / (measured + predicted) if measured + predicted > 0.0 else float("nan")


def _rms(values: Float[np.ndarray, " n"]) -> float:
    return float(np.sqrt(np.mean(values[np.isfinite(values)] ** 2)))


@dataclass(frozen=True)
class MultiStepPrediction:
    """Predictions of flights by several models."""

    errors: tuple[HorizonErrors, ...]  # Of every quantity: by the fit, then by each simpler model
    #: Times of the starts on their log's clock [s], flight after flight
    start_s: Float[np.ndarray, " starts"] = field(repr=False)
    omitted: tuple[str, ...] = ()  # Sentences that say what is not predicted, and why
    horizons_s: tuple[float, ...] = HORIZONS_S  # How far ahead [s]

    @property
    def by_quantity(self) -> tuple[tuple[HorizonErrors, ...], ...]:
        """Errors of each quantity, the fit's first."""
        names = dict.fromkeys(error.quantity for error in self.errors)
        return tuple(tuple(error for error in self.errors if error.quantity == name) for name in names)

    @property
    def ratios(self) -> dict[str, float]:
        """Errors of the fit over those of each simpler model, by its words."""
        results: dict[str, list[float]] = {}
        for item, *simpler in self.by_quantity:
            for model in simpler:
                results.setdefault(model.words, []).append(item.rms[-1] / max(model.rms[-1], 1e-300))
        return {words: float(np.exp(np.mean(np.log(ratios)))) for words, ratios in results.items()}

    @property
    def predicts(self) -> bool:
        """Whether the fit's errors are smaller than every simpler model's, see `ratios`."""
        return bool(self.errors) and all(ratio <= 1.0 for ratio in self.ratios.values())

    @property
    def sentence(self) -> str:
        """The result in sentences."""
        after = f"After {self.horizons_s[-1]:g} s"
        than = [f"{ratio:.2g} of those of '{words}'" for words, ratio in self.ratios.items()]
        if not than:
            return f"{after} there is nothing to hold the fit's errors against."
        better: dict[str, list[str]] = {}
        for item, *simpler in self.by_quantity:
            for model in simpler:
                if model.rms[-1] < item.rms[-1]:
                    better.setdefault(model.words, []).append(item.quantity)
        beaten = (f" '{words}' leaves less of {', '.join(names)}." for words, names in better.items())
        return f"{after} the fit's errors are {' and '.join(than)}, in the mean.{''.join(beaten)}"

    @property
    def inequality(self) -> str:
        """Theil's coefficients of the fit, in a sentence."""
        parts = [f"{item.quantity} {item.theil:.2f}" for item, *_ in self.by_quantity]
        after = f"after {self.horizons_s[-1]:g} s (0 all of the change is predicted, 1 nothing)"
        return f"Theil's inequality coefficients {after}: {', '.join(parts)}." if parts else ""


@dataclass(frozen=True)
class Starts:
    """Starts of the predictions of a flight."""

    samples: Int[np.ndarray, " starts"]
    steps: tuple[int, ...]  # Samples from a start to each horizon
    step_s: float

    @property
    def ends(self) -> Int[np.ndarray, "horizons starts"]:
        """Samples that are predicted."""
        return self.samples + np.array(self.steps)[:, None]

    def propagate(
        self, state: Float[np.ndarray, "parts starts"], derivative: Derivative
    ) -> Float[np.ndarray, "horizons parts starts"]:
        """States at the horizons by Heun's method, all starts side by side."""
        results, stride = [], self._stride
        step_s = stride * self.step_s
        for step in range(0, self.steps[-1], stride):
            samples = self.samples + step
            first = derivative(state, samples)
            second = derivative(np.clip(state + step_s * first, -DIVERGED, DIVERGED), samples)
            state = np.clip(state + 0.5 * step_s * (first + second), -DIVERGED, DIVERGED)
            if step + stride in self.steps:
                results.append(state)
        return np.stack(results)

    def over_step(self, series: Float[np.ndarray, "... n"]) -> Float[np.ndarray, "... n"]:
        """Mean of a series, taken as a line between samples, over the step that begins at each sample."""
        means = 0.5 * (series[..., :-1] + series[..., 1:])
        return self.over_steps(np.concatenate([series[..., :1], means], axis=-1))

    def over_steps(self, means: Float[np.ndarray, "... n"]) -> Float[np.ndarray, "... n"]:
        """Mean over the step that begins at each sample, of means over the steps that end at samples."""
        stride, area, result = self._stride, np.cumsum(means, axis=-1), means.copy()
        result[..., :-stride] = (area[..., stride:] - area[..., :-stride]) / stride
        return result

    @property
    def _stride(self) -> int:
        longest = max(int(LONGEST_STEP_S / self.step_s + 1e-9), 1)
        return max(index for index in range(1, longest + 1) if all(step % index == 0 for step in self.steps))


def starts_of(
    flight: PreparedFlight, horizons_s: tuple[float, ...] = HORIZONS_S, spacing_s: float = START_SPACING_S
) -> Starts:
    """Starts at even distances in every run of a flight, as soon as its actuators' states are known."""
    step_s = flight.signals.step_s
    steps = tuple(dict.fromkeys(max(round(horizon / step_s), 1) for horizon in horizons_s))
    broken = np.concatenate([[0], np.cumsum(~flight.usable)])
    spacing = max(round(spacing_s / step_s), -(-int(flight.used.sum()) // MOST_STARTS))
    recovery = ceil(RECOVERY_S / step_s)
    results = [np.arange(max(run.start, recovery), run.stop - steps[-1], spacing) for run in flight.runs]
    samples = np.concatenate([*results, np.empty(0, dtype=np.int64)]).astype(np.int64)
    complete = broken[samples + steps[-1] + 1] == broken[samples]
    return Starts(samples[complete], steps, step_s)


def multi_step_predictions(
    flights: Sequence[PreparedFlight],
    errors: Callable[[int, Starts], Iterable[HorizonErrors]],
    omitted: tuple[str, ...],
) -> MultiStepPrediction:
    """Predictions of flights, joined over flights; quantities that were not measured are omitted."""
    starts, joined = [starts_of(flight) for flight in flights], []
    by_flight = [tuple(errors(number, of_flight)) for number, of_flight in enumerate(starts)]
    for parts in zip(*filter(None, by_flight), strict=True):
        sizes = np.concatenate([part.sizes for part in parts])
        series = [part.series for part in parts if part.series is not None]
        if np.isfinite(sizes).any(axis=0).all():
            changes = np.concatenate([part.changes for part in parts])
            joined_series = np.concatenate(series) if series else None
            joined.append(replace(parts[0], sizes=sizes, changes=changes, series=joined_series))
    times = [flight.grid.time_s[of_flight.samples] for flight, of_flight in zip(flights, starts, strict=True)]
    return MultiStepPrediction(tuple(joined), np.concatenate([*times, np.empty(0)]), omitted)


def trim(flight: PreparedFlight, residual: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Mean residual of an equation over each run, on its samples; zero elsewhere."""
    result = np.zeros(residual.size)
    for run, samples in zip(flight.runs, flight.samples_of_runs, strict=True):
        result[run] = residual[samples].mean()
    return result


P = TypeVar("P", bound=SeparableProblem)
Solver = Callable[[P], Estimate]
Flights = tuple[PreparedFlight, ...]


@dataclass(frozen=True)
class LogChannels:
    """What a motion reads of a log."""

    inputs: tuple[InputFamily, ...]  # What may drive the vehicle, in order of preference
    #: Channels without which nothing can be identified, beside an input; "a|b" is one of two
    needed: tuple[str, ...] = ()
    references: tuple[ReferenceSource, ...] = ()  # Channels that may be instruments
    added: tuple[CanonicalChannel, ...] = ()  # Channels that the motion adds to the canonical ones
    telemetry: tuple[str, ...] = ()  # Channels that are measured states of what drives the vehicle
    parameters: tuple[str, ...] = ()  # Parameters of an autopilot that are worth showing
    #: Parameters that stand for the vehicle: flights in which they differ make no pool
    vehicle_parameters: tuple[str, ...] = ()


class VehicleSupport(msgspec.Struct, frozen=True):
    """A motion that depends on a description of the vehicle."""

    #: The motion of a vehicle, by the name of a shipped one or a file; None where all vehicles are alike
    load: Callable[[str], Motion[Any]] | None
    record: Mapping[str, object] | None  # What a result says of the vehicle it was made for, for JSON
    restore: Callable[[object], Motion[Any]]  # The motion of the vehicle that a result holds


@dataclass(frozen=True)
class SensorComparison(Generic[P]):
    """A motion with two measurements of one response."""

    #: None where flights have but one
    agreement: Callable[[P, Flights], SensorAgreement | None] = lambda *_: None
    sentence: Callable[[SensorAgreement], str] = lambda _agreement: ""
    #: Flights without differences of which it is known which measurement is wrong; to align, without others
    corrected: Callable[[Flights, SensorAgreement, FlightOptions], Flights] = lambda flights, *_: flights


@dataclass(frozen=True)
class Resampling(Generic[P]):
    """A motion whose replicates of a pool are more than its parameters."""

    #: Over the samples of each flight
    sums: Callable[[P, Values], Mapping[str, Float[np.ndarray, " flights"]]]
    #: Of a draw of flights by parameters, nuisances and those sums, in the order of results
    quantities: Callable[[P, Values, Values, Values], Mapping[str, float]]


@dataclass(frozen=True)
class Prediction(Generic[P]):
    """A motion that predicts flights."""

    #: To hold an estimate against
    simple_models: Callable[[P, Estimate], Mapping[str, SimpleModel]] = lambda *_: {}
    #: Predictions by parameters and nuisances; the farthest horizon comes last
    another_flight: Callable[[P, Values], tuple[quantity.PredictedQuantity, ...]] | None = None
    #: Some tenths of a second from many starts, by models and without refused quantities
    multi_step: Callable[[Flights, Mapping[str, SimpleModel], frozenset[str]], MultiStepPrediction] | None = (
        None
    )
    #: Output-error estimate of multi-step predictions, from another estimate
    output_error: Callable[[Any, Estimate, Flights], tuple[Estimate, tuple[Finding, ...]]] | None = None


@dataclass(frozen=True)
class Abilities:
    """What only some motions can do."""

    vehicle: VehicleSupport | None = None
    check: Callable[[FlightOptions], object] = lambda _options: None  # Refuses options before a log is read
    #: The motion with requested terms and properties of all flights; None where these change nothing
    for_flights: Callable[[Flights, FlightOptions], Motion[Any]] | None = None
    terms: Mapping[str, str] = field(default_factory=dict)  # Optional terms: the word of each, and what it is
    #: The last of several problems, and its estimate; and flights as that problem refines them
    refined: Callable[[Any, Solver[Any], FlightOptions, Flights], tuple[Any, Estimate]] = (
        lambda problem, solve, _options, _flights: (problem, solve(problem))
    )
    refined_flights: Callable[[Flights, Any], Flights] = lambda flights, _problem: flights
    sensors: SensorComparison[Any] = SensorComparison()
    resampling: Resampling[Any] | None = None
    prediction: Prediction[Any] = Prediction()
    #: A parameter that is followed over a flight
    tracking: Callable[[Any, Mapping[str, Quantity], FlightOptions, str], TrackedParameter] | None = None
    #: How the flights were flown, for JSON: what simulating another one needs
    closed_loop_record: Callable[[Any, Estimate, Flights], Mapping[str, object]] | None = None
    #: What follows from a vehicle's description
    implications: Callable[[Estimate, Mapping[str, Quantity]], quantity.Implications] = (
        lambda _fit, _quantities: quantity.Implications()
    )
    #: Quantities that flights determine without an estimate, and the inputs of their rules
    known: Callable[[Flights], tuple[Mapping[str, QuantityEstimate], MotionChecks]] | None = None
    excitation: Callable[[Flights], str] = lambda _flights: ""  # How much flights moved, a sentence
    findings: Callable[[Flights, Mapping[str, Quantity]], tuple[Finding, ...]] = lambda *_: ()
    #: Key figures of flights, of their quantities and diagnostics
    figures: Callable[
        [Flights, Mapping[str, Quantity], Mapping[str, float]], Iterable[quantity.KeyFigure]
    ] = lambda *_: ()
    whitened: bool = False  # Direct methods need whitened rows
    profiled: bool = False  # Intervals of parameters are their profile sets, whatever the instruments
    lag_from: tuple[str, ...] = ()  # Motions that the same actuators make: they may identify the lag
    coupled_axes: tuple[CoupledAxis, ...] = ()  # Quantities that other motions identify, with this lag


class FlightView(msgspec.Struct, frozen=True):
    """A flight in reports."""

    symbols: str  # What the symbols of the equation are in this flight
    panels: tuple[quantity.PlotData, ...]  # Series to look at where nothing could be estimated


class Motion(ABC, Generic[P]):
    """One kind of motion: its equation, its quantities, their verdicts and their words."""

    name: str
    """The command line's word."""
    words: quantity.Words
    """How reports speak of it."""
    equation: tuple[str, str]
    """The equation in one line, and what its symbols are."""
    quantities: quantity.QuantityTable
    """Every quantity; each joint parameter of the estimate is among them."""
    rules: tuple[Rule, ...]
    """When a sentence speaks against quantities: the table of its verdicts."""
    parts: tuple[SystematicPart, ...] = ()
    """What the scatter within flights cannot show: the table of the systematic parts of intervals."""
    channels: LogChannels
    """What it reads of a log."""
    abilities: Abilities = Abilities()
    """What only some motions can do."""

    @abstractmethod
    def select(self, log: Recording, options: FlightOptions) -> Selection:
        """Return the channels by role, and which samples count."""

    @abstractmethod
    def problem(self, flights: Flights, rule: InstrumentRule) -> P:
        """Return the problem of flights that all have runs."""

    @abstractmethod
    def derive(self, problem: P, estimate: Estimate) -> Mapping[str, QuantityEstimate]:
        """Return every quantity that the estimate gives."""

    def checks(self, _problem: P, _estimate: Estimate, _flights: Flights, /) -> MotionChecks:
        """What this motion alone finds out about an estimate, for its rules and reports."""
        return MotionChecks()

    @abstractmethod
    def traces(self, problem: P, estimate: Estimate) -> tuple[quantity.Trace, ...]:
        """Measured and predicted, for each axis."""

    @abstractmethod
    def view(self, flight: PreparedFlight) -> FlightView:
        """Return what a report shows of a flight."""


class MotionTables(msgspec.Struct, frozen=True):
    """What users read of a motion, and what it reads of logs: the file beside its code."""

    equation: tuple[str, str]
    words: quantity.Words
    channels: LogChannels
    quantities: dict[str, quantity.QuantitySpec]
    coupled_axes: tuple[CoupledAxis, ...] = ()


def motion_tables(package: str) -> MotionTables:
    """Return the tables of a package; of quantities, what is not given is as of all motions or as usual."""
    tables = package_tables(package, "motion.toml")
    for name, declared in tables["quantities"].items():
        unit = declared.get("unit", "").replace("^2", "²").replace("^3", "³")
        defaults = {"words": name.replace("_", " "), "shown_unit": unit} | LAG_TABLES.get(name, {})
        tables["quantities"][name] = defaults | declared
    return msgspec.convert(tables, MotionTables)


def of_vehicle(motion: Motion[Any], vehicle: str) -> Motion[Any]:
    """Return the motion of a vehicle that a user describes, by a name or a file."""
    support = motion.abilities.vehicle
    if support is None or support.load is None:
        raise UsageError(
            "a motion that asks what flies", f"'{motion.name}', which does not", f"Leave out {vehicle!r}."
        )
    return support.load(vehicle)


def for_flights(motion: Motion[Any], flights: Flights, options: FlightOptions) -> Motion[Any]:
    """Return the motion with the requested terms and properties of all flights."""
    specialised = motion.abilities.for_flights
    return motion if specialised is None else specialised(flights, options)
