"""Interface of a motion, the inputs of its verdict and multi-step prediction."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import ceil
from typing import ClassVar, Generic, TypeVar

import numpy as np

from eivor.errors import UsageError
from eivor.estimation.estimate import Estimate
from eivor.estimation.method import Method
from eivor.flights.grid import MEMORY_S, RECOVERY_S, Active, Grid, airborne_by_log
from eivor.flights.lag_prior import LagPrior
from eivor.flights.options import FlightOptions
from eivor.flights.prepared import InputFamily, PreparedFlight, Selection, SensorAgreement
from eivor.flights.quantity import (
    AcrossFlights,
    CardSection,
    CoupledAxis,
    Drawn,
    Implications,
    PlotData,
    PredictedQuantity,
    Quantity,
    QuantityEstimate,
    SimpleModel,
    SystematicUncertainty,
    Trace,
    TrackedParameter,
    Wording,
    Words,
)
from eivor.flights.references import ReferenceSource
from eivor.inference.confidence_set import ConfidenceSet
from eivor.inference.verdict import Reason
from eivor.models.separable import InstrumentRule, SeparableProblem, Values
from eivor.signals.channels import CanonicalChannel
from eivor.signals.recording import Finding, Recording
from eivor.signals.signals import Signals
from eivor.tools import Float, Int

# -- Multi-step prediction --

#: How far ahead predictions look [s].
HORIZONS_S = (0.1, 0.2, 0.3, 0.4, 0.5)
#: Starts are so far apart [s]; in longer flights further, so that there are no more than so many.
BETWEEN_STARTS_S, MOST_STARTS = 0.05, 2000
#: Steps of the integration are no longer than this, or one of the grid [s].
LONGEST_STEP_S = 0.010
#: A state that runs away, by numbers that are far off, stays at this.
AWAY = 1e9
#: Names among the models: the fit itself, and that everything stays as it is at the start.
FIT, UNCHANGED = "fit", "unchanged"
#: Right-hand side of x' = f(x, sample) for starts side by side, over the step that begins at a sample.
Derivative = Callable[[Float[np.ndarray, "parts starts"], Int[np.ndarray, " starts"]], np.ndarray]


@dataclass(frozen=True)
class HorizonErrors:
    """What one model leaves of one quantity after each horizon."""

    model: str  # The model's name, and what it is
    words: str  # The model's name, and what it is
    quantity: str  # What is predicted, and the unit of what is left
    unit: str  # What is predicted, and the unit of what is left
    #: Size of predicted less measured; NaN where nothing was measured
    left: Float[np.ndarray, "starts horizons"] = field(repr=False)
    #: Measured and predicted after the last horizon, of a quantity that is a single number
    series: Float[np.ndarray, "starts 2"] | None = field(default=None, repr=False)

    @property
    def rms(self) -> tuple[float, ...]:
        """Root mean square of what is left after each horizon."""
        return tuple(float(np.sqrt(np.mean(item[np.isfinite(item)] ** 2))) for item in self.left.T)


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
        for item, *others in self.by_quantity:
            for other in others:
                results.setdefault(other.words, []).append(item.rms[-1] / max(other.rms[-1], 1e-300))
        return {words: float(np.exp(np.mean(np.log(ratios)))) for words, ratios in results.items()}

    @property
    def predicts(self) -> bool:
        """Whether the fit leaves less than every simpler model, see `ratios`."""
        return bool(self.errors) and all(ratio <= 1.0 for ratio in self.ratios.values())

    @property
    def sentence(self) -> str:
        """What was found, in sentences."""
        after = f"After {self.horizons_s[-1]:g} s"
        than = [f"{ratio:.2g} of those of '{words}'" for words, ratio in self.ratios.items()]
        if not than:
            return f"{after} there is nothing to hold the fit's errors against."
        return f"{after} the fit's errors are {' and '.join(than)}, in the mean.{self._beaten}"

    @property
    def _beaten(self) -> str:
        """Sentences that say where a simpler model leaves less."""
        less: dict[str, list[str]] = {}
        for item, *others in self.by_quantity:
            for other in others:
                if other.rms[-1] < item.rms[-1]:
                    less.setdefault(other.words, []).append(item.quantity)
        return "".join(f" '{words}' leaves less of {', '.join(names)}." for words, names in less.items())


def multi_step_predictions(
    by_flight: Sequence[tuple[HorizonErrors, ...]],
    starts: Sequence[Float[np.ndarray, " _"]],
    names: tuple[str, ...],
) -> MultiStepPrediction:
    """Predictions of several flights, one after the other; what nothing was measured of is left out."""
    errors = []
    for parts in zip(*(item for item in by_flight if item), strict=True):
        left = np.concatenate([part.left for part in parts])
        series = [part.series for part in parts if part.series is not None]
        if np.isfinite(left).any(axis=0).all():
            errors.append(replace(parts[0], left=left, series=np.concatenate(series) if series else None))
    return MultiStepPrediction(tuple(errors), np.concatenate([*starts, np.empty(0)]), names)


@dataclass(frozen=True)
class Starts:
    """Where predictions of a flight start."""

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
            now = self.samples + step
            first = derivative(state, now)
            second = derivative(np.clip(state + step_s * first, -AWAY, AWAY), now)
            state = np.clip(state + 0.5 * step_s * (first + second), -AWAY, AWAY)
            if step + stride in self.steps:
                results.append(state)
        return np.stack(results)

    def over_step(self, series: Float[np.ndarray, "... n"]) -> Float[np.ndarray, "... n"]:
        """Mean of a series, taken as a line between samples, over the step that begins at each sample."""
        stride = self._stride
        between = 0.5 * (series[..., :-1] + series[..., 1:])
        area = np.concatenate([np.zeros_like(series[..., :1]), np.cumsum(between, axis=-1)], axis=-1)
        result = series.copy()
        result[..., :-stride] = (area[..., stride:] - area[..., :-stride]) / stride
        return result

    @property
    def _stride(self) -> int:
        """Samples of a step, of which every horizon has a whole number."""
        most = max(int(LONGEST_STEP_S / self.step_s + 1e-9), 1)
        return max(index for index in range(1, most + 1) if all(step % index == 0 for step in self.steps))


def starts_of(flight: PreparedFlight) -> Starts:
    """Starts at even distances in every run of a flight, as soon as its actuators' states are known."""
    step_s = flight.signals.step_s
    steps = tuple(max(round(horizon / step_s), 1) for horizon in HORIZONS_S)
    broken = np.concatenate([[0], np.cumsum(~flight.usable)])
    every = max(round(BETWEEN_STARTS_S / step_s), -(-int(flight.used.sum()) // MOST_STARTS))
    known = ceil(RECOVERY_S / step_s)
    results = [np.arange(max(run.start, known), run.stop - steps[-1], every) for run in flight.runs]
    samples = np.concatenate([*results, np.empty(0, dtype=np.int64)]).astype(np.int64)
    whole = broken[samples + steps[-1] + 1] == broken[samples]
    return Starts(samples[whole], steps, step_s)


def trim(flight: PreparedFlight, left: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Mean of what an equation leaves over each run, on the samples of that run; zero elsewhere."""
    result = np.zeros(left.size)
    for run, samples in zip(flight.runs, flight.samples_of_runs, strict=True):
        result[run] = left[samples].mean()
    return result


# -- Inputs of a verdict --


@dataclass(frozen=True, slots=True)
class Searched:
    """A nuisance parameter that was searched for on a grid."""

    value: float
    highest: float  # Top of the grid


@dataclass(frozen=True, slots=True)
class InstrumentStrength:
    """What the instruments identify, in numbers."""

    #: Conditional first-stage F of each joint parameter; NaN without instruments
    first_stage: Mapping[str, float]
    p_value: float  # Of the over-identification test
    #: Nuisance parameters that were searched for
    searched: Mapping[str, Searched] = field(default_factory=dict)
    #: Sets that hold however weak the instruments are, of parameters whose interval is theirs: where
    #: instruments are weak, or where the sets have no bounds
    robust: Mapping[str, ConfidenceSet] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class VerdictInputs:
    """What a verdict needs to know beside the numbers."""

    flights: int  # Number of flights used
    #: Slowest command, and the fastest of what was measured over the slowest flight [Hz]
    command_rate_hz: float
    #: Slowest command, and the fastest of what was measured over the slowest flight [Hz]
    response_rate_hz: float
    exogenous: bool  # The instruments do not answer the vehicle
    direct: bool  # The method uses no instruments
    missing_reference: str = ""  # Why there is no instrument; empty when there is one
    constant_reference: bool = False  # A reference is logged, and constant
    excitation: str = ""  # How much the flights moved, as a sentence; empty when it is not known
    single_frequency_hz: float = 0.0  # The frequency of a reference that has only one; zero for others [Hz]
    #: What the motion adds, see `Motion.diagnostics`
    numbers: Mapping[str, float] = field(default_factory=dict)
    lag_prior: LagPrior | None = None  # What was known of the lag from elsewhere
    sensors: SensorAgreement | None = None  # Whether two measurements of one response agree
    aligned: bool = False  # The differences between them that can be taken out are
    used_s: float = np.inf  # Time used of all flights [s]
    past_inputs: bool = False  # The instruments are past inputs, which a controller computes


# -- Motion --

P = TypeVar("P", bound=SeparableProblem)


class Motion(ABC, Generic[P]):
    """One kind of motion: its equation, its quantities, their verdicts and their words."""

    name: ClassVar[str]
    """The command line's word."""
    model_name: ClassVar[str]
    """The name in JSON documents."""
    equation: ClassVar[tuple[str, str]]
    """The equation in one line, and what its symbols are."""
    wording: ClassVar[Mapping[str, Wording]]
    """Every quantity, in the order of results; each joint parameter of the estimate is among them."""
    plotted: ClassVar[tuple[str, ...]]
    """The same names in the order of reports."""
    headline: ClassVar[tuple[str, ...]]
    """Quantities whose grounds make the overall verdict."""
    rows: ClassVar[tuple[str, ...]]
    """Quantities that a table of flights or of methods shows."""
    words: ClassVar[Words]
    """How reports speak of it."""
    inputs: ClassVar[tuple[InputFamily, ...]]
    """What may drive the vehicle, in order of preference."""
    telemetry: ClassVar[tuple[str, ...]] = ()
    """Channels that are measured states of what drives it."""
    lag_from: ClassVar[tuple[str, ...]] = ()
    """Names of other motions that the same actuators make: where they identify the lag."""
    coupled_axes: ClassVar[tuple[CoupledAxis, ...]] = ()
    """Quantities that other motions identify, with the lag that this one identifies."""
    across: ClassVar[tuple[AcrossFlights, ...]] = ()
    """Quantities that reports of fleets pool; the headline as it is where nothing is said."""
    needed: ClassVar[tuple[str, ...]]
    """Channels without which nothing can be identified, beside an input."""
    references: ClassVar[tuple[ReferenceSource, ...]]
    """Channels that may be instruments."""
    channels: ClassVar[tuple[CanonicalChannel, ...]] = ()
    """Channels that it adds to the canonical ones."""
    of_flight: ClassVar[tuple[str, ...]] = ()
    """Linear parameters that belong to the flight (wind, load) and not to the vehicle: flights of a pool have
    each their own. Names out of the problem's parameters; what belongs to a run is none of them."""
    terms: ClassVar[Mapping[str, str]] = {}
    """Terms that its equation may have beside the others: the word of each, and what it is."""
    direct: ClassVar[str] = "least_squares"
    """Method that serves when no instrument is at hand."""
    memory_s: ClassVar[float] = MEMORY_S
    """Time before a sample that decides the state of what drives the vehicle [s]: 25 of the longest lags."""
    logged_parameters: ClassVar[tuple[str, ...]] = ()
    """Parameters of an autopilot that are worth showing."""
    vehicle_parameters: ClassVar[tuple[str, ...]] = ()
    """Parameters of an autopilot that stand for the vehicle: flights in which they differ make no pool."""

    # -- from a log to a problem --------------------------------------------------------------------------

    def check(self, options: FlightOptions) -> None:
        """Refuse options that this motion does not have, before any log is looked at."""

    def weighted(self, method: Method, /) -> Method:
        """Return a method with the weights of rows that it needs for this motion; by default its own."""
        return method

    def for_flights(self, _flights: tuple[PreparedFlight, ...], _options: FlightOptions, /) -> Motion[P]:
        """Return the same motion with the terms that were asked for, and what all flights say together."""
        return self

    @property
    def written(self) -> tuple[str, str]:
        """The equation with the terms that were asked for, and what its symbols are."""
        return self.equation

    def of_vehicle(self, vehicle: str) -> Motion[P]:
        """Return the same motion of a vehicle that a user describes, by a name or a file."""
        raise UsageError(
            "a motion that asks what flies", f"'{self.name}', which does not", f"Leave out {vehicle!r}."
        )

    @abstractmethod
    def select(self, log: Recording, options: FlightOptions) -> Selection:
        """Return the channels by role, and which samples count."""

    def active(self, log: Recording, grid: Grid, input_level: Float[np.ndarray, " n"]) -> Active:
        """Samples during which the motion holds; for what flies: while it is in the air."""
        return airborne_by_log(log, grid, input_level)

    @abstractmethod
    def problem(self, flights: tuple[PreparedFlight, ...], rule: InstrumentRule) -> P:
        """Return the problem of flights that all have runs."""

    def signals(self, flight: PreparedFlight, _lag_s: float, _delay_s: float, /) -> Signals:
        """Return a flight's signals for work in Python, what drives the vehicle as its equation has it."""
        return flight.signals

    def refined(
        self, problem: P, estimated: Callable[[P], Estimate], _options: FlightOptions, /
    ) -> tuple[P, Estimate]:
        """Problem and its estimate, when all that the motion finds out by estimates is found out."""
        return problem, estimated(problem)

    def with_refinement(
        self, flights: tuple[PreparedFlight, ...], _problem: P, /
    ) -> tuple[PreparedFlight, ...]:
        """Flights as a result holds them, with what was found out of them."""
        return flights

    def input_level(self, flight: PreparedFlight) -> float:
        """Size of a flight's input over the samples used, by which inputs of other scales are identified."""
        return float(np.abs(flight.used_input).mean())

    # -- from an estimate to a result ---------------------------------------------------------------------

    @abstractmethod
    def quantities(self, problem: P, estimate: Estimate) -> Mapping[str, QuantityEstimate]:
        """Return every quantity of `wording`."""

    @abstractmethod
    def reasons(
        self, quantities: Mapping[str, QuantityEstimate], strength: InstrumentStrength, inputs: VerdictInputs
    ) -> Mapping[str, tuple[Reason, ...]]:
        """Reasons against each quantity of `wording`."""

    def known(self, _flights: tuple[PreparedFlight, ...], /) -> Mapping[str, float]:
        """Values of quantities that flights with runs determine without an estimate."""
        return {}

    def excitation(self, _flights: tuple[PreparedFlight, ...], /) -> str:
        """Say how much the flights moved, in a sentence; empty for nothing."""
        return ""

    def systematic_uncertainties(
        self,
        _flights: tuple[PreparedFlight, ...],
        _quantities: Mapping[str, QuantityEstimate],
        _inputs: VerdictInputs,
        /,
    ) -> Mapping[str, tuple[SystematicUncertainty, ...]]:
        """Systematic parts by quantity: what the scatter within these flights, all with runs, cannot show."""
        return {}

    # -- sensors that identify the same
    # -----------------------------------------------------------------------

    def sensors(self, _problem: P, _flights: tuple[PreparedFlight, ...], /) -> SensorAgreement | None:
        """Whether two measurements of one response agree; None where the flights have but one."""
        return None

    def sensor_sentence(self, _sensors: SensorAgreement, /) -> str:
        """What is reported about them, in a line."""
        return ""

    def aligned(
        self, flights: tuple[PreparedFlight, ...], _sensors: SensorAgreement, /
    ) -> tuple[PreparedFlight, ...]:
        """Flights with those differences taken out that can be."""
        return flights

    def following(self, _quantities: Mapping[str, QuantityEstimate], /) -> Mapping[str, QuantityEstimate]:
        """Quantities that follow from a headline whose interval is another than that of `quantities`."""
        return {}

    def diagnostics(
        self, _problem: P, _estimate: Estimate, _flights: tuple[PreparedFlight, ...], /
    ) -> Mapping[str, float]:
        """Numbers behind the verdict that this motion alone has."""
        return {}

    def checks(self, _numbers: Mapping[str, float], /) -> tuple[tuple[str, str], ...]:
        """What they say: a title and a sentence each, for those that reports show."""
        return ()

    def tracked_parameter(
        self, _problem: P, _quantities: Mapping[str, Quantity], _options: FlightOptions, /
    ) -> TrackedParameter | None:
        """What can be followed over a flight, and what is known beside it; by default nothing can."""
        return None

    def implications(self, _estimate: Estimate, /) -> Implications:
        """What follows from an estimate and from what a user supplied; by default nothing."""
        return Implications()

    def findings(
        self, _flights: tuple[PreparedFlight, ...], _quantities: Mapping[str, Quantity], /
    ) -> tuple[Finding, ...]:
        """What this motion alone notices in the logs, beside the result."""
        return ()

    # -- for replicates of a pool, see `bootstrap_flights` -------------------------------------------------

    def flight_sums(self, _problem: P, _at: Values, /) -> Mapping[str, Float[np.ndarray, " flights"]]:
        """Sums over the samples of each flight, at values of the nuisances, that `resampled` needs."""
        return {}

    def resampled(self, problem: P, drawn: Drawn) -> Mapping[str, float]:
        """Quantities of a draw of flights, in the order of results; each is a parameter or in `wording`."""
        searched = [nuisance.name for nuisance in problem.nuisances if nuisance.searched]
        return {**drawn.parameters, **{name: drawn.nuisances[name] for name in searched}}

    # -- predictions of another flight, see `eivor.report.other_results` ------------------------

    def simple_models(self, _problem: P, _estimate: Estimate, /) -> Mapping[str, SimpleModel]:
        """Models that an estimate is held against in another flight, by name; none without predictions."""
        return {}

    def predictions(self, _problem: P, _values: Values, /) -> tuple[PredictedQuantity, ...]:
        """What parameters and nuisances, by name, say of flights; the farthest horizon comes last."""
        return ()

    def multi_step_prediction(
        self,
        _flights: tuple[PreparedFlight, ...],
        _models: Mapping[str, SimpleModel],
        _refused: frozenset[str],
        /,
    ) -> MultiStepPrediction | None:
        """Predictions some tenths of a second ahead, from many starts of flights that all have runs."""
        return None

    def vehicle_record(self) -> Mapping[str, object] | None:
        """What a result says of the vehicle it was made for, for JSON; nothing for a motion that asks not."""
        return None

    def with_vehicle_record(self, _report: object, /) -> Motion[P]:
        """Return the same motion of the vehicle that a result holds, see `vehicle_record`."""
        return self

    # -- for planning ---------------------------------------------------------------------------------------

    def closed_loop_record(
        self, _problem: P, _estimate: Estimate, _flights: tuple[PreparedFlight, ...], /
    ) -> Mapping[str, object]:
        """How the flights were flown: what simulating another one needs, for JSON; by default nothing."""
        return {}

    # -- for reports --------------------------------------------------------------------------------------

    @abstractmethod
    def symbols(self, flight: PreparedFlight) -> str:
        """What the symbols of the equation are in this flight, one line."""

    @abstractmethod
    def traces(self, problem: P, estimate: Estimate) -> tuple[Trace, ...]:
        """Measured and predicted, for each axis."""

    @abstractmethod
    def overview(self, flight: PreparedFlight) -> tuple[PlotData, ...]:
        """Series to look at beside the input when nothing could be estimated."""

    @abstractmethod
    def advice(self, log_format: str) -> tuple[CardSection, ...]:
        """What to fly and to log."""
