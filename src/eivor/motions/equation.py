"""Declared equations: problem, quantities, traces, predictions, words and verdict of a motion."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial

import numpy as np

from eivor.errors import UsageError, did_you_mean
from eivor.estimation.estimate import Estimate
from eivor.flights import quantity
from eivor.flights.grid import Active, Grid
from eivor.flights.lag_prior import (
    EFFECTIVE_LAG,
    LAG_QUANTITIES,
    joint_quantities,
    lag_quantities,
    ratio_quantity,
)
from eivor.flights.motion import (
    UNCHANGED,
    Abilities,
    Flights,
    FlightView,
    HorizonErrors,
    LogChannels,
    Motion,
    MultiStepPrediction,
    Prediction,
    Starts,
    multi_step_predictions,
    starts_of,
    trim,
)
from eivor.flights.options import FlightOptions
from eivor.flights.prepared import InputFamily, PreparedFlight, Selection, chosen_input
from eivor.flights.quantity import (
    CardSection,
    Kind,
    PlotData,
    QuantityEstimate,
    QuantitySpec,
    QuantityTable,
    SimpleModel,
    Trace,
    Words,
)
from eivor.flights.references import ReferenceSource
from eivor.flights.verdict import (
    FlightWords,
    Limit,
    Rule,
    SystematicPart,
    clock_part,
    flight_rules,
    longest_lag_rule,
)
from eivor.inference.verdict import Status
from eivor.logs.channel_map import Expression, parse_expression
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY, AxisColumns, LaggedRuns, lag_and_delay
from eivor.models.regression import Parameter
from eivor.models.separable import DrivenSignals, InstrumentRule, LaggedReferences, NoInstruments, Values
from eivor.signals.channels import CanonicalChannel, family_members
from eivor.signals.filters import actuator_state, time_derivative
from eivor.signals.recording import Recording
from eivor.signals.signals import Signals
from eivor.tools import Float

# -- Declaration --

_DERIVATIVE = re.compile(r"ddt\((\w+)\)")
#: Functions of a term that instruments need as well: what moves a speed moves its sign by a curve.
_CURVES = (np.sign, np.absolute)


@dataclass(frozen=True)
class Term:
    """A parameter times an expression over channels, such as ``-speed`` or ``sign(speed)``."""

    name: str
    of: str  # With ``ddt(channel)`` for a derivative in time
    symbol: str
    unit: str
    behind: bool = False  # The input in the expression is the state of the actuators: it lags

    @property
    def parameter(self) -> Parameter:
        """The parameter."""
        return Parameter(self.name, self.unit)

    @cached_property
    def expression(self) -> Expression:
        """The expression, checked."""
        return parsed(self.of)


@dataclass(frozen=True)
class AxisEquation:
    """Equation of one axis: response = sum of terms + an intercept for each run."""

    name: str  # In words
    input: str  # Channel, or family of channels, that drives it
    response: tuple[str, ...]  # Expressions for what is explained; the last is always logged
    terms: tuple[Term, ...]
    trace: tuple[str, str, str, str]  # Words, unit, model and driven part, as figures show them
    references: tuple[ReferenceSource, ...] = ()
    reference_lags: tuple[int, float] | None = None  # How many lags of each reference, and how long [s]
    state: tuple[str, str, str] | None = (
        None  # Channel, words and unit of what is predicted; None for nothing
    )

    def columns(self, signals: Signals, texts: Sequence[str]) -> Float[np.ndarray, "n k"]:
        """Columns of expressions."""
        columns = [_evaluated(parsed(text), signals) for text in texts]
        return np.column_stack(columns) if columns else np.empty((signals.sample_count, 0))

    def driven(self, signals: Signals, nuisance_values: Values) -> Float[np.ndarray, "n m"]:
        """Columns of the terms behind the actuators, at a lag and a delay."""
        state = actuator_state(
            signals.family(self.input),
            step_s=signals.step_s,
            lag_s=nuisance_values[ACTUATOR_LAG.name],
            delay_s=nuisance_values[DELAY.name],
        ).mean(axis=1)
        terms = [term for term in self.terms if term.behind]
        return np.column_stack([_evaluated(term.expression, signals, {self.input: state}) for term in terms])

    def instruments(self, signals: Signals, rule: InstrumentRule, others: set[str]) -> np.ndarray:
        """Its own references with their lags, and curves of them where terms have such curves."""
        if isinstance(rule, LaggedReferences):
            own = tuple(name for name in rule.channels if name not in others)
            lags = rule.lags if self.reference_lags is None else self.reference_lags
            rule = replace(rule, channels=own or rule.channels, lags=lags)
        columns = rule.columns(DrivenSignals(signals, signals.family(self.input).mean(axis=1)))
        if isinstance(rule, NoInstruments):
            return columns
        used = {step for term in self.terms for step in term.expression.steps if not term.behind}
        return np.column_stack([columns, *(curve(columns) for curve in _CURVES if curve in used)])


@cache
def parsed(text: str) -> Expression:
    """An expression over channels and their derivatives."""
    return parse_expression(_DERIVATIVE.sub(r'"ddt(\1)"', text), "an equation")


def _evaluated(
    expression: Expression, signals: Signals, given: Mapping[str, np.ndarray] | None = None
) -> Float[np.ndarray, " n"]:
    """Value of an expression for each sample; `given` stands for channels of its names."""
    channels = {**signals.channels, **(given or {})}
    values = {}
    for name in expression.columns:
        of = _DERIVATIVE.fullmatch(name)
        values[name] = channels[name] if of is None else time_derivative(channels[of[1]], signals.step_s)
    return np.broadcast_to(expression.evaluate(values), (signals.sample_count,))


# -- Problem, quantities and traces --


def logged_axes(axes: Sequence[AxisEquation], flights: Flights) -> tuple[AxisEquation, ...]:
    """Axes whose input all flights have."""
    return tuple(
        axis for axis in axes if all(family_members(axis.input, f.signals.channels) for f in flights)
    )


def _known(text: str, signals: Signals) -> bool:
    return all(_DERIVATIVE.sub(r"\1", name) in signals.channels for name in parsed(text).columns)


class DeclaredMotion(Motion[LaggedRuns]):
    """A motion whose axes are declared equations."""

    axes: tuple[AxisEquation, ...]
    """The equations."""
    grids: tuple[Sequence[float] | Float[np.ndarray, " _"], ...] = ()
    """Lags and delays to search [s]; those of `lag_and_delay` where there are none."""

    def problem(self, flights: Flights, rule: InstrumentRule) -> LaggedRuns:
        """Regressions of the flights for each lag and delay."""
        logged = logged_axes(self.axes, flights)
        fixed = tuple(term.parameter for axis in logged for term in axis.terms if not term.behind)
        moving = tuple(term.parameter for axis in logged for term in axis.terms if term.behind)
        columns = []
        for number, flight in enumerate(flights):
            signals = flight.signals
            for axis in logged:
                others = {source.channel for item in self.axes if item != axis for source in item.references}
                known = [text for text in axis.response if _known(text, signals)]
                steady = [term for term in axis.terms if not term.behind]
                whole = np.zeros((signals.sample_count, len(fixed)))
                whole[:, [fixed.index(term.parameter) for term in steady]] = axis.columns(
                    signals, [term.of for term in steady]
                )
                columns.append(
                    AxisColumns(
                        signals.step_s,
                        flight.runs,
                        axis.columns(signals, known),
                        whole,
                        partial(axis.driven, signals),
                        axis.instruments(signals, rule, others),
                        number,
                        self.axes.index(axis),
                        flight.band_hz,
                        flight.usable,
                        tuple(moving.index(term.parameter) for term in axis.terms if term.behind),
                    )
                )
        step_s = max((column.step_s for column in columns), default=0.0)
        return LaggedRuns(tuple(columns), (*fixed, *moving), lag_and_delay(*self.grids, step_s=step_s))

    def derive(self, problem: LaggedRuns, estimate: Estimate) -> Mapping[str, QuantityEstimate]:
        """Parameters of the axes that are logged, and the lag."""
        results = {**joint_quantities(estimate), **lag_quantities(problem, estimate)}
        return {name: results[name] for name in self.quantities if name in results}

    def traces(self, problem: LaggedRuns, estimate: Estimate) -> tuple[Trace, ...]:
        """Response of each axis within the band, measured and predicted."""
        traces = []
        for number in problem.axes:
            driving = {term.parameter for term in self.axes[number].terms if term.behind}
            part = [place for place, parameter in enumerate(problem.parameters) if parameter in driving]
            series = problem.series_in_band(estimate.nuisances, number, estimate.theta, part)
            traces.append(Trace(*self.axes[number].trace, *series.T))
        return tuple(traces)


def simple_models(problem: LaggedRuns, estimate: Estimate) -> dict[str, SimpleModel]:
    """Least squares without a lag."""
    return {quantity.NAME: quantity.least_squares_without_lag(problem, estimate.nuisances)}


# -- Multi-step prediction --

#: What it is that everything stays as it is.
STAYS = "stays as it is"


def equation_prediction(
    axes: Sequence[AxisEquation],
    flights: Flights,
    models: Mapping[str, SimpleModel],
    refused_names: frozenset[str],
) -> MultiStepPrediction:
    """State of each axis after each horizon by its input alone, by each model, and as it was at the start."""
    fit = next(iter(models.values())).values
    logged, predicted, omitted = logged_axes(axes, flights), [], []
    for axis in axes:
        if axis.state is None:
            continue
        name = next(term.name for term in axis.terms if term.behind)
        words, why = name.replace("_", " "), ""
        if axis not in logged:
            why = "its input or state is not logged"
        elif EFFECTIVE_LAG in refused_names:
            why = "the lag is refused"
        elif name in refused_names or name not in fit:
            why = f"the {words} is refused" if name in refused_names else f"the fit has no {words}"
        if why:
            omitted.append(f"The {axis.state[1]} is not predicted: {why}.")
        else:
            predicted.append(axis)
    starts = [starts_of(flight) for flight in flights]
    pairs = list(zip(flights, starts, strict=True))
    errors = [
        tuple(error for axis in predicted for error in _errors(axis, flight, begun, models))
        for flight, begun in pairs
    ]
    times = [flight.grid.time_s[begun.samples] for flight, begun in pairs]
    return multi_step_predictions(errors, times, tuple(omitted))


def _errors(
    axis: AxisEquation, flight: PreparedFlight, starts: Starts, models: Mapping[str, SimpleModel]
) -> Iterator[HorizonErrors]:
    """Errors of one axis by each model."""
    channel, words, unit = axis.state or ("", "", "")
    state = flight.signals.channel(channel)
    measured, started = state[starts.ends], state[starts.samples]
    by_model = {name: (m.words, _propagated(axis, flight, starts, m.values)) for name, m in models.items()}
    by_model[UNCHANGED] = (STAYS, np.broadcast_to(started, measured.shape))
    for name, (model_words, predicted) in by_model.items():
        left, series = np.abs(predicted - measured).T, np.column_stack([measured[-1], predicted[-1]])
        yield HorizonErrors(name, model_words, words, unit, left, series)


def _propagated(
    axis: AxisEquation, flight: PreparedFlight, starts: Starts, values: Values
) -> Float[np.ndarray, "horizons starts"]:
    """Answer of the state to the input, from every start."""
    signals, (channel, *_) = flight.signals, axis.state or ("",)
    state = signals.channel(channel)
    steady = [term for term in axis.terms if not term.behind and term.expression.columns == (channel,)]
    others = [term for term in axis.terms if not term.behind and term not in steady]
    moving = [term for term in axis.terms if term.behind]
    columns = np.column_stack(
        [axis.driven(signals, values), axis.columns(signals, [term.of for term in others])]
    )
    driven = columns @ np.array([values[term.name] for term in (*moving, *others)])

    def of_state(of: np.ndarray) -> np.ndarray:
        parts = [values[term.name] * term.expression.evaluate({channel: of}) for term in steady]
        return np.sum(parts, axis=0) if parts else np.zeros_like(of)

    driven = driven + trim(flight, time_derivative(state, signals.step_s) - of_state(state) - driven)
    force = starts.over_step(driven)
    started = state[starts.samples][None, :]
    return starts.propagate(started, lambda now, sample: force[sample] + of_state(now))[:, 0]


# -- Machine --

#: The interval of a quantity that is identified is no wider than this share of it to either side.
HALF_WIDTH = 0.2
#: The same of the lag [s].
LAG_LIMIT = Limit(identified_within=0.02, narrower="Move it in quicker steps.")


@dataclass(frozen=True, slots=True)
class Channel:
    """A channel of a machine."""

    name: str
    unit: str
    #: "state", which must be logged; "response", which may be; "input"; "reference"
    role: str

    @property
    def canonical(self) -> CanonicalChannel:
        """The channel as logs know it: inputs and references hold their values, and references are set."""
        held = self.role in {"input", "reference"}
        free = self.role == "input" and not self.unit
        return CanonicalChannel(
            self.name, self.unit, held=held, free_unit=free, exogenous=self.role == "reference"
        )


@dataclass(frozen=True, slots=True)
class Ratio:
    """A quantity that is one parameter, or a number, over another one."""

    name: str
    above: str | float
    below: str
    symbol: str
    unit: str = ""


@dataclass(frozen=True)
class Machine(DeclaredMotion):
    """A motion that is declared: channels, an equation for each axis, and what is to be known.

    Parameters
    ----------
    name : str
        The command line's word.
    title : str
        A heading.
    equation : tuple of str
        The equation in one line, and its symbols.
    logged : tuple of Channel
        Channels and their roles.
    axes : tuple of AxisEquation
        The equations.
    headline : tuple of str
        Quantities whose verdicts make the overall one.
    move, log : str
        What to do with the machine, and what to log, where a log identifies too little.
    derived : tuple of Ratio
        Quantities that follow from parameters.
    half_width : float
        Largest half-width of an identified quantity, as a share of it.
    band_hz : tuple of float
        Band of the rows in frequency [Hz].

    Raises
    ------
    UsageError
        When an expression names no channel of the machine, or a reference.
    """

    name: str
    title: str
    equation: tuple[str, str]
    logged: tuple[Channel, ...]
    axes: tuple[AxisEquation, ...]
    headline: tuple[str, ...]
    move: str
    log: str
    derived: tuple[Ratio, ...] = ()
    half_width: float = HALF_WIDTH
    band_hz: tuple[float, float] = (0.05, 5.0)

    def __post_init__(self) -> None:
        known = [channel.name for channel in self.logged if channel.role != "reference"]
        for text in (text for axis in self.axes for text in (*axis.response, *(t.of for t in axis.terms))):
            for name in parsed(text).columns:
                channel = _DERIVATIVE.sub(r"\1", name)
                if channel not in known:
                    raise UsageError(
                        f"an expression over the channels {', '.join(known)}",
                        f"{text!r} with '{channel}'",
                        did_you_mean(channel, known, "Declare the channel: its name, unit and role."),
                    )

    @cached_property
    def quantities(self) -> QuantityTable:  # type: ignore[override]
        """Parameters, what follows from them, and the lag."""
        terms = [(term.name, term.symbol, term.unit, Kind.PARAMETER) for a in self.axes for term in a.terms]
        ratios = [(ratio.name, ratio.symbol, ratio.unit, Kind.DERIVED) for ratio in self.derived]
        specs = LAG_QUANTITIES | {
            name: QuantitySpec(
                name.replace("_", " "),
                symbol,
                unit,
                kind,
                shown_unit=unit.replace("^2", "²"),
                in_rows=kind is Kind.PARAMETER,
            )
            for name, symbol, unit, kind in (*terms, *ratios)
        }
        specs[EFFECTIVE_LAG] = replace(specs[EFFECTIVE_LAG], in_rows=True)
        order = (*(name for name, *_ in (*terms, *ratios)), *LAG_QUANTITIES)
        return QuantityTable({name: replace(specs[name], headline=name in self.headline) for name in order})

    @property
    def words(self) -> Words:  # type: ignore[override]
        """How reports speak of it."""
        named = " and ".join(self.quantities[name].words for name in self.headline)
        return Words(
            title=self.title,
            model=self.name,
            identified=f"{named} are identified within their intervals.",
            refused=f"the log does not identify {named}.",
            provisional="no instrument: disturbances may bias the numbers.",
            fly=self.move,
            no_lag="The state of the actuators was measured:\nthere is no lag to find.",
            where="in use",
            begins="moves",
            another_log="Give another log.",
            advice=lambda _format: (CardSection("Move", (self.move,)), CardSection("Log", (self.log,))),
        )

    @cached_property
    def channels(self) -> LogChannels:  # type: ignore[override]
        """What it reads of a log."""
        return LogChannels(
            tuple(InputFamily(name) for name in self._of_role("input")),
            self._of_role("state"),
            tuple(ReferenceSource(name) for name in self._of_role("reference")),
            added=tuple(channel.canonical for channel in self.logged),
        )

    @property
    def abilities(self) -> Abilities:  # type: ignore[override]
        """Predictions, and how much the machine moved."""
        ahead = partial(equation_prediction, self.axes)
        return Abilities(prediction=Prediction(simple_models, multi_step=ahead), excitation=self._excitation)

    def select(self, log: Recording, options: FlightOptions) -> Selection:
        """States, responses and commands."""
        family, commands = chosen_input(log, self.channels.inputs, options.input, remedy=self.log.rstrip("."))
        return Selection(
            family,
            commands,
            states={name: log.channel(name) for name in self._of_role("state")},
            responses={name: log.channels.get(name) for name in self._of_role("response")},
            band_hz=self.band_hz,
            active=_throughout,
        )

    def derive(self, problem: LaggedRuns, estimate: Estimate) -> Mapping[str, QuantityEstimate]:
        """Parameters, the lag, and what follows from parameters."""
        ratios = {r.name: ratio_quantity(estimate, r.above, r.below, r.unit) for r in self.derived}
        return {**super().derive(problem, estimate), **ratios}

    @property
    def rules(self) -> tuple[Rule, ...]:  # type: ignore[override]
        """Rows of the instruments, and of the width of each interval."""
        words = FlightWords(self.move, self.log, self.log, "moves", "Keep disturbances away.")
        lags, terms = (ACTUATOR_LAG.name, DELAY.name), [term for axis in self.axes for term in axis.terms]
        stages = (*(term.name for term in terms), *lags)
        lag = LAG_LIMIT.rules(EFFECTIVE_LAG, self.quantities[EFFECTIVE_LAG], *lags)
        rows = [*flight_rules(words, (*lags, EFFECTIVE_LAG), stages, EFFECTIVE_LAG), *lag]
        limit = Limit(
            self.half_width,
            zero=Status.REFUSED,
            narrower="Log for longer, or give several logs.",
            away_from_zero=self.move,
        )
        for term in terms:
            following = [ratio.name for ratio in self.derived if term.name in (ratio.above, ratio.below)]
            rows += flight_rules(words, (term.name, *following), stages, term.name)
            rows += limit.rules(term.name, self.quantities[term.name], *following)
        both = [ratio.name for ratio in self.derived if isinstance(ratio.above, str)]
        for name in both:
            rows += flight_rules(words, (name,), stages, name)
        return (*rows, longest_lag_rule((), "Check that the command is that of this machine."))

    @property
    def parts(self) -> tuple[SystematicPart, ...]:  # type: ignore[override]
        """Commands that may have been issued between those that are logged."""
        return (clock_part((ACTUATOR_LAG.name, DELAY.name, EFFECTIVE_LAG)),)

    def view(self, flight: PreparedFlight) -> FlightView:
        """What the input is, and the states."""
        states = [channel for channel in self.logged if channel.role == "state"]
        panels = [
            PlotData(f"{item.name.replace('_', ' ')}\n[{item.unit}]", flight.signals.channel(item.name))
            for item in states
        ]
        return FlightView(f"{flight.input.name} behind a lag τ and a delay d", tuple(panels))

    def _of_role(self, role: str) -> tuple[str, ...]:
        return tuple(channel.name for channel in self.logged if channel.role == role)

    def _excitation(self, flights: Flights) -> str:
        """Standard deviations of the input and of the states."""
        inputs = np.concatenate([flight.used_input.mean(axis=1) for flight in flights])
        words = [f"The input varied by {inputs.std():.2g}"]
        for channel in self.logged:
            if channel.role == "state":
                parts = [flight.signals.channel(channel.name)[flight.used] for flight in flights]
                spread = np.concatenate(parts).std()
                words.append(f"{channel.name.replace('_', ' ')} by {spread:.2g} {channel.unit}")
        return f"{', '.join(words)} (standard deviations)."


def _throughout(_log: Recording, grid: Grid, _input_level: Float[np.ndarray, " n"], /) -> Active:
    return Active(np.ones(grid.count, dtype=np.bool_), "the whole record")
