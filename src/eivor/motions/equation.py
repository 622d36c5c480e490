"""Declared equations: problem, quantities, traces and predictions of a motion, and answers of its loop."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any, TypeVar

import msgspec
import numpy as np

from eivor.estimation.estimate import Estimate
from eivor.flights import motion, quantity
from eivor.flights.lag_prior import EFFECTIVE_LAG, joint_quantities, lag_quantities
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import QuantityEstimate, SimpleModel, Trace
from eivor.flights.references import ReferenceSource
from eivor.logs.channel_map import Expression, parse_expression
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY, AxisColumns, LaggedRuns, actuators, lag_and_delay
from eivor.models.regression import Parameter
from eivor.models.separable import InstrumentRule, LaggedReferences, Prior, Values
from eivor.models.spectral import SpectralRun, densities
from eivor.signals.channels import family_members
from eivor.signals.filters import actuator_state, shifted_by, time_derivative
from eivor.signals.signals import Signals
from eivor.tools import Bool, Float

#: Inputs behind the actuators by name, each of every sample or a number.
States = Mapping[str, Any]


@dataclass(frozen=True)
class Term:
    """A parameter times an expression over channels, such as ``-speed`` or ``sign(speed)``."""

    name: str
    of: str  # A number makes the parameter an intercept
    symbol: str
    unit: str
    behind: bool = False  # The inputs in the expression are states of the actuators: they lag

    @property
    def parameter(self) -> Parameter:
        return Parameter(self.name, self.unit)

    @cached_property
    def expression(self) -> Expression:
        return parsed(self.of)

    @property
    def is_intercept(self) -> bool:
        """Whether it is the same at all times."""
        return not self.expression.columns

    @property
    def is_linear(self) -> bool:
        """Whether it is a channel, or a derivative of one."""
        return len(self.expression.columns) == 1 and not any(
            isinstance(step, float | np.ufunc) for step in self.expression.steps
        )

    @property
    def is_steady(self) -> bool:
        """Whether it moves, and by no actuator."""
        return not (self.behind or self.is_intercept)


@dataclass(frozen=True)
class Mirror:
    """A curve of a term, with derivatives of a reference in place of the states."""

    reference: str
    of: str
    orders: Mapping[str, int]  # How often the reference is derived in time, for each state

    def columns(
        self, signals: Signals, chain: Float[np.ndarray, "lags n"], lag_s: float
    ) -> Iterator[Float[np.ndarray, " n"]]:
        """One column for each lag of the reference; derivatives are differences of lags."""
        for last in range(max(self.orders.values()), len(chain)):
            given = {
                name: np.diff(chain[last - order : last + 1], n=order, axis=0)[0] / (-lag_s) ** order
                for name, order in self.orders.items()
            }
            yield evaluated(parsed(self.of), signals, given)


@dataclass(frozen=True)
class AxisEquation:
    """Equation of one axis: response = sum of terms + an intercept for each run."""

    name: str  # In words
    inputs: tuple[str, ...]  # Channels, or families of channels, that drive it
    response: tuple[str, ...]  # Expressions for what is explained; the last is always logged
    terms: tuple[Term, ...]
    trace: tuple[str, str, str, str]  # Words, unit, model and driven part, as figures show them
    references: tuple[ReferenceSource, ...] = ()
    reference_lags: tuple[int, float] | None = None  # How many lags of each reference, and how long [s]
    #: Channel, words and unit of what is predicted; None for nothing
    state: tuple[str, str, str] | None = None
    mirrors: tuple[Mirror, ...] = ()
    instruments_of: tuple[str, ...] = ()  # Expressions over references, in place of these
    averaged: tuple[str, ...] = ()  # Inputs that hold: what acts around a sample is the mean of two
    linear: bool = True  # Whether `states` are linear in what is logged

    def columns(
        self,
        signals: Signals,
        texts: Sequence[str],
        states: States | None = None,
        delay_s: float = 0.0,
    ) -> Float[np.ndarray, "n k"]:
        """Columns of expressions, in which inputs are states, or do not lag, but may be late."""
        if states is None:
            states = {}
            for name in self.averaged:
                late = shifted_by(signals.channel(name)[:, None], step_s=signals.step_s, delay_s=delay_s)
                states[name] = _around_samples(late[:, 0])
        columns = [evaluated(parsed(text), signals, states) for text in texts]
        return np.array(columns).reshape(-1, signals.sample_count).T

    def family(self, signals: Signals, name: str) -> Float[np.ndarray, "n m"]:
        """What is logged of an input."""
        return signals.family(name)

    def states(
        self, logged: Mapping[str, Float[np.ndarray, "n m"]], signals: Signals, path: Mapping[str, float]
    ) -> States:
        """What that makes behind the actuators: means of the families."""
        pairs = logged.items()
        return {name: mean_of(actuator_state(of, step_s=signals.step_s, **path)) for name, of in pairs}

    @property
    def is_forced(self) -> bool:
        """Whether what is explained is itself an input that holds, such as the force of a motor."""
        return any(name in self.averaged for text in self.response for name in parsed(text).columns)

    def is_late(self, term: Term) -> bool:
        """Whether a delay of the inputs that hold moves a term."""
        held = not {*term.expression.columns}.isdisjoint(self.averaged)
        return term.is_steady and (held or self.is_forced)

    def late(self, signals: Signals) -> Callable[[Values], Float[np.ndarray, "n m"]]:
        """Columns of the steady terms where held inputs come later than they are logged, by a delay."""
        texts, step_s = [term.of for term in self.terms if self.is_late(term)], signals.step_s
        if not self.is_forced:
            return lambda at: self.columns(signals, texts, delay_s=at[DELAY.name])
        early = self.columns(signals, texts)
        return lambda at: shifted_by(early, step_s=step_s, delay_s=-at[DELAY.name])

    def instruments(self, signals: Signals, rule: InstrumentRule, others: set[str]) -> np.ndarray:
        """Its own references with their lags, and the curves of terms of them; or past inputs."""
        # an equation may hold what another one drives alone
        inputs = [mean_of(signals.family(name)) for name in self.inputs]
        commands = inputs or [np.zeros(signals.sample_count)]
        if not isinstance(rule, LaggedReferences):
            return np.column_stack([rule.columns(signals, command) for command in commands])
        names = tuple(name for name in rule.channels if name not in others) or rule.channels
        lags = rule.lags if self.reference_lags is None else self.reference_lags
        if self.instruments_of:
            made = {text: evaluated(parsed(text), signals) for text in self.instruments_of}
            more = replace(signals, channels={**signals.channels, **made})
            return replace(rule, channels=self.instruments_of, lags=lags).columns(more, commands[0])
        chains = replace(rule, channels=names, lags=lags).columns(signals, commands[0]).T
        columns = [*chains]
        for mirror in self.mirrors:
            if mirror.reference in names and lags is not None:
                first = names.index(mirror.reference) * (lags[0] + 1)
                columns += mirror.columns(signals, chains[first : first + lags[0] + 1], lags[1])
        return np.array(columns).T


@dataclass(frozen=True)
class Driven:
    """Columns of the terms of an equation behind the actuators, at a lag and a delay."""

    axis: AxisEquation
    signals: Signals

    def __call__(self, nuisance_values: Values) -> Float[np.ndarray, "n m"]:
        states = self.axis.states(self._logged, self.signals, actuators(nuisance_values))
        return self.axis.columns(self.signals, [t.of for t in self.axis.terms if t.behind], states)

    @cached_property
    def _logged(self) -> dict[str, Float[np.ndarray, "n m"]]:
        used = {name for term in self.axis.terms if term.behind for name in term.expression.columns}
        return {name: self.axis.family(self.signals, name) for name in self.axis.inputs if name in used}


def mean_of(family: Float[np.ndarray, "n m"]) -> Float[np.ndarray, " n"]:
    """Mean of the members of a family."""
    mean: Float[np.ndarray, " n"] = family[:, 0] if family.shape[1] == 1 else family.mean(axis=1)
    return mean


def _around_samples(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """What values that hold over the step after each sample do at the samples, below the rate."""
    # a hold has the gain sinc(f h) and is half a step late: so have these weights, up to f^3
    padded = np.pad(values, (2, 1), mode="edge")
    return (13.0 * (padded[1:-2] + padded[2:-1]) - padded[:-3] - padded[3:]) / 24.0


def _as_smooth(flight: PreparedFlight, names: Sequence[str]) -> Signals:
    """Signals of a flight; held inputs that are means over steps are no smoother than states that are."""
    # means lose a share of (pi f h)^2 / 6, and an input as much again by its hold; of n samples 4 / n^2 less
    lost = max(1.0 - 4.0 / (flight.rates_hz["command"] * flight.signals.step_s) ** 2, 0.0)
    channels = dict(flight.signals.channels)
    for name in names:
        channels[name] = channels[name] - lost / 24.0 * np.diff(np.pad(channels[name], 1, mode="edge"), 2)
    return replace(flight.signals, channels=channels) if names else flight.signals


@cache
def parsed(text: str) -> Expression:
    """An expression over channels and their derivatives."""
    return parse_expression(text, "an equation", constant=True)


def evaluated(
    expression: Expression, signals: Signals, given: States | None = None
) -> Float[np.ndarray, " n"]:
    """Value of an expression for each sample; `given` stands for channels of its names."""
    channels, known = signals.channels, given or {}
    of = {name: known[name] if name in known else channels[name] for name in expression.columns}
    if expression.steps == (*of,):
        return of.popitem()[1]
    values = expression.evaluate(of, signals.step_s)
    return values if values.ndim else np.full(signals.sample_count, values)


def logged_axes(axes: Sequence[AxisEquation], flights: motion.Flights) -> tuple[AxisEquation, ...]:
    """Axes whose input all flights have."""
    return tuple(
        axis
        for axis in axes
        if all(family_members(name, flight.signals.channels) for name in axis.inputs for flight in flights)
    )


#: Values of the delay of inputs that the log does not date, to begin a search at.
LATE_VALUES = 5


R = TypeVar("R", bound=LaggedRuns)


class DeclaredMotion(motion.Motion[R]):
    """A motion whose axes are declared equations."""

    axes: tuple[AxisEquation, ...]
    """The equations."""
    grids: tuple[Sequence[float] | Float[np.ndarray, " _"], ...] = ()
    """Lags and delays to search [s]; those of `lag_and_delay` where there are none."""

    def axes_of(self, flights: motion.Flights) -> Sequence[Mapping[int, AxisEquation]]:
        """Equations of each flight, by number: those that all flights are logged for."""
        return [{self.axes.index(axis): axis for axis in logged_axes(self.axes, flights)}] * len(flights)

    def signals(self, flight: PreparedFlight, axis: AxisEquation) -> Signals:
        """What an equation of a flight is evaluated over."""
        return _as_smooth(flight, axis.averaged)

    def problem(self, flights: motion.Flights, rule: InstrumentRule) -> R:
        return self.lagged_runs(flights, rule)  # type: ignore[return-value]

    def lagged_runs(self, flights: motion.Flights, rule: InstrumentRule) -> LaggedRuns:
        """Regressions of the equations for each lag and delay."""
        by_flight = self.axes_of(flights)
        logged = tuple(by_flight[0].values())
        steady = tuple(term.parameter for axis in logged for term in axis.terms if term.is_steady)
        behind = tuple(term.parameter for axis in logged for term in axis.terms if term.behind)
        slack_s = max(flight.command_slack_s for flight in flights)
        late = not behind and slack_s > 0.0 and any(axis.averaged for axis in logged)
        delayed = tuple(t.parameter for axis in logged for t in axis.terms if late and axis.is_late(t))
        fixed, moving = tuple(p for p in steady if p not in delayed), delayed or behind
        columns = []
        for number, (flight, axes) in enumerate(zip(flights, by_flight, strict=True)):
            for index, axis in axes.items():
                signals = self.signals(flight, axis)
                known = [text for text in axis.response if {*parsed(text).columns} <= {*signals.channels}]
                moves = [term for term in axis.terms if (axis.is_late(term) if late else term.behind)]
                stays = [term for term in axis.terms if term.is_steady and term not in moves]
                whole = np.zeros((signals.sample_count, len(fixed)))
                whole[:, [fixed.index(term.parameter) for term in stays]] = axis.columns(
                    signals, [term.of for term in stays]
                )
                columns.append(
                    AxisColumns(
                        signals.step_s,
                        flight.runs,
                        axis.columns(signals, known),
                        whole,
                        axis.late(signals) if late else Driven(axis, signals),
                        self.instruments(axis, signals, rule),
                        number,
                        index,
                        flight.band_hz,
                        flight.usable,
                        tuple(moving.index(term.parameter) for term in moves),
                        (axis.linear and all(term.is_linear for term in moves)) or (late and axis.is_forced),
                    )
                )
        step_s = max((column.step_s for column in columns), default=0.0)
        lag, delay = lag_and_delay(*self.grids, step_s=step_s)
        if late:
            # a command of every sample, the likeliest, is late by all of the slack
            grid = np.linspace(-1.5 * slack_s, 1.5 * slack_s, LATE_VALUES)
            lag, prior = lag.known_at(0.0), Prior(0.0, slack_s)
            delay = replace(delay, grid=grid, prior=prior, tolerance=1e-3 * slack_s)
        return LaggedRuns(tuple(columns), (*fixed, *moving), (lag, delay))

    def instruments(self, axis: AxisEquation, signals: Signals, rule: InstrumentRule) -> np.ndarray:
        others = {source.channel for item in self.axes if item != axis for source in item.references}
        return axis.instruments(signals, rule, others)

    def derive(self, problem: R, estimate: Estimate) -> Mapping[str, QuantityEstimate]:
        results = {**joint_quantities(estimate), **lag_quantities(problem, estimate)}
        return {name: results[name] for name in self.quantities if name in results}

    def traces(self, problem: R, estimate: Estimate) -> tuple[Trace, ...]:
        traces = []
        for number in problem.axes:
            driving = {term.parameter for term in self.axes[number].terms if term.behind}
            part = [index for index, parameter in enumerate(problem.parameters) if parameter in driving]
            series = problem.series_in_band(estimate.nuisances, number, estimate.theta, part)
            traces.append(Trace(*self.axes[number].trace, *series.T))
        return tuple(traces)


def simple_models(problem: LaggedRuns, estimate: Estimate) -> dict[str, SimpleModel]:
    """Least squares of all rows in frequency with neither lag nor delay."""
    without = {**estimate.nuisances, ACTUATOR_LAG.name: 0.0, DELAY.name: 0.0}
    bins = problem.bins(without)
    rows, response = (np.concatenate([p.real, p.imag]) for p in (bins.regressors, bins.responses[:, 0]))
    sizes = np.sqrt((rows * rows).sum(axis=0))
    sizes[sizes == 0.0] = 1.0
    fitted = np.linalg.lstsq(rows / sizes, response)[0] / sizes
    names = (parameter.name for parameter in problem.parameters)
    values = {**without, **dict(zip(names, fitted.tolist(), strict=True))}
    return {"least_squares": SimpleModel("no-lag least squares", values)}


def response_predictions(
    axes: Sequence[AxisEquation], problem: LaggedRuns, values: Values
) -> tuple[quantity.PredictedQuantity, ...]:
    """Response of each axis within the band, of what is measured beside it."""
    index = {item.name: values[item.name] for item in problem.nuisances}
    theta = np.array([values[item.name] for item in problem.parameters])
    results = []
    for number in problem.axes:
        words, unit, *_ = axes[number].trace
        measured, predicted, _ = problem.series_in_band(index, number, theta, ()).T
        made = (quantity.Horizon.ONE_STEP, words, unit, measured, predicted)
        results.append(quantity.PredictedQuantity(*made))
    return tuple(results)


STAYS = "stays as it is"


def equation_prediction(
    axes: Sequence[AxisEquation],
    flights: motion.Flights,
    models: Mapping[str, SimpleModel],
    refused_names: frozenset[str],
) -> motion.MultiStepPrediction:
    """State of each axis after each horizon by its input alone, by each model, and as it was at the start."""
    fit = next(iter(models.values())).values
    logged, predicted, omitted = logged_axes(axes, flights), [], []
    for axis in axes:
        if axis.state is None:
            continue
        term = max(axis.terms, key=lambda term: (term.behind, not term.is_intercept))
        name, words, why = term.name, term.name.replace("_", " "), ""
        if axis not in logged:
            why = "its input or state is not logged"
        elif term.behind and EFFECTIVE_LAG in refused_names:
            why = "the lag is refused"
        elif name in refused_names or name not in fit:
            why = f"the {words} is refused" if name in refused_names else f"the fit has no {words}"
        if why:
            omitted.append(f"The {axis.state[1]} is not predicted: {why}.")
        else:
            predicted.append(axis)

    def errors(number: int, starts: motion.Starts) -> Iterator[motion.HorizonErrors]:
        for axis in predicted:
            yield from _errors(axis, flights[number], starts, models)

    return motion.multi_step_predictions(flights, errors, tuple(omitted))


def _errors(
    axis: AxisEquation, flight: PreparedFlight, starts: motion.Starts, models: Mapping[str, SimpleModel]
) -> Iterator[motion.HorizonErrors]:
    channel, words, unit = axis.state or ("", "", "")
    state = flight.signals.channel(channel)
    measured, started = state[starts.ends], state[starts.samples]
    by_model = {name: (m.words, _propagated(axis, flight, starts, m.values)) for name, m in models.items()}
    by_model[motion.UNCHANGED] = (STAYS, np.broadcast_to(started, measured.shape))
    for name, (model_words, predicted) in by_model.items():
        left, series = np.abs(predicted - measured).T, np.column_stack([measured[-1], predicted[-1]])
        changes = np.abs(series - started[:, None])
        yield motion.HorizonErrors(name, model_words, words, unit, left, changes, series)


def _propagated(
    axis: AxisEquation, flight: PreparedFlight, starts: motion.Starts, values: Values
) -> Float[np.ndarray, "horizons starts"]:
    signals, (channel, *_) = flight.signals, axis.state or ("",)
    state = signals.channel(channel)
    of_axis = [term for term in axis.terms if term.is_steady]
    steady = [t for t in of_axis if t.expression.of_moments and t.expression.columns == (channel,)]
    others = [term for term in of_axis if term not in steady]
    moving = [term for term in axis.terms if term.behind]
    driven = Driven(axis, signals)(values) @ np.array([values[term.name] for term in moving])
    driven += axis.columns(signals, [term.of for term in others]) @ [values[term.name] for term in others]

    def of_state(of: np.ndarray) -> np.ndarray:
        parts = [values[term.name] * term.expression.evaluate({channel: of}) for term in steady]
        return np.sum(parts, axis=0) if parts else np.zeros_like(of)

    driven = driven + motion.trim(flight, time_derivative(state, signals.step_s) - of_state(state) - driven)
    force = starts.over_step(driven)
    started = state[None, starts.samples]
    return starts.propagate(started, lambda now, sample: force[sample] + of_state(now))[:, 0]


# -- Answers of a machine in its loop --

#: An answer to a pulse is straight between knots: a sample apart, later in this ratio, up to the last.
RATIO, LAST_S = 1.25, 8.0
#: A plan is in use for this share of its time at least.
LEAST_IN_USE = 0.5
#: Share of the power of an acceleration that is left out above its highest frequency.
SLOW = 0.02
#: Ridges that weights are chosen from, as shares of the largest singular value squared.
RIDGES = np.geomspace(1e-14, 1e-2, 25)
#: Frequencies at which densities are kept, over the band.
NODES = 12
#: Of a uniform law over a range.
UNIFORM = 1.0 / math.sqrt(12.0)

#: From values of expressions to the samples that count, None for all, and the rule.
Counted = Callable[[Callable[[str], Float[np.ndarray, " n"]]], "tuple[Bool[np.ndarray, ' n'] | None, str]"]


class Answers(msgspec.Struct):
    """A machine in its loop: how channels answer references, and what no term explains."""

    step_s: float
    band_hz: tuple[float, float]
    references: list[str]
    levels: dict[str, float]
    #: Largest distance from the level; of references the largest rate and acceleration as well
    sizes: dict[str, tuple[float, ...]]
    #: Of references: all but a little of the power of their acceleration is below
    highest_hz: dict[str, float]
    weights: dict[str, list[float]]  # Of each channel: answers to every reference at the knots
    densities: list[list[float]]  # One-sided, of each axis
    std_errors: dict[str, float] = {}  # By the formula, of what was logged

    def channels(self, moves: Mapping[str, Float[np.ndarray, " n"]]) -> dict[str, np.ndarray]:
        """Every channel where references move so about their levels."""
        columns = _answering([moves[name] for name in self.references], self.step_s)
        answers = {name: self.levels[name] + columns @ weights for name, weights in self.weights.items()}
        return answers | {name: self.levels[name] + moves[name] for name in self.references}

    def expected(
        self,
        axes: Sequence[AxisEquation],
        counted: Counted,
        channels: Mapping[str, Float[np.ndarray, " n"]],
        values: Values,
        delays_s: Sequence[float],
    ) -> tuple[dict[str, float], float]:
        """Standard error of each parameter and nuisance by the formula, and a log determinant of them."""
        signals = Signals(1.0 / self.step_s, channels)
        count = signals.sample_count
        mask, _ = counted(lambda text: axes[0].columns(signals, [text])[:, 0])
        if mask is not None and mask.mean() < LEAST_IN_USE:
            return {}, math.inf
        run = SpectralRun(0, count, self.step_s, self.band_hz, counted=mask)
        terms = [term for axis in axes for term in axis.terms if not term.is_intercept]
        lags = [ACTUATOR_LAG.name, DELAY.name] if any(term.behind for term in terms) else []
        names = [term.name for term in terms] + lags
        # a lag costs more than a delay, and data hardly tell them apart
        at = dict(zip(lags, (sum(values[name] for name in lags), 0.0), strict=False))
        triangle = np.zeros((0, len(names)))
        if lags:
            triangle = np.eye(1, len(names), len(names) - 1)
            triangle /= max(UNIFORM * (delays_s[-1] - delays_s[0]), 1e-4)
        for axis, density in zip(axes, self.densities, strict=True):
            columns = self._columns(axis, signals, values, at, names)
            power = np.exp(np.interp(np.log(run.frequency_hz), np.log(_nodes(self.band_hz)), np.log(density)))
            power *= float(np.mean(run.taper**2)) / (4.0 * self.step_s)
            white = run.spectrum(columns) / np.sqrt(power)[:, None]
            triangle = np.asarray(np.linalg.qr(np.concatenate([triangle, white.real, white.imag]), mode="r"))
        scale = np.maximum(np.linalg.norm(triangle, axis=0), 1e-300)
        inverse = np.linalg.pinv(triangle / scale, rcond=1e-10) / scale[:, None]
        if lags:
            names, inverse = [*names, EFFECTIVE_LAG], np.vstack([inverse, inverse[-2] + inverse[-1]])
        results = dict(zip(names, np.linalg.norm(inverse, axis=1).tolist(), strict=True))
        # of the parameters, and of lag and delay together
        kept = [k for k, name in enumerate(names) if name not in lags]
        return results, 2.0 * float(np.linalg.slogdet(inverse[kept] @ inverse[kept].T)[1])

    def _columns(
        self, axis: AxisEquation, signals: Signals, values: Values, at: Values, names: list[str]
    ) -> Float[np.ndarray, "n names"]:
        """What each parameter and nuisance moves in the response of an axis."""
        steady = [term for term in axis.terms if term.is_steady]
        behind = [term for term in axis.terms if term.behind]
        columns = np.zeros((signals.sample_count, len(names)))
        of_steady, of_behind = ([names.index(term.name) for term in terms] for terms in (steady, behind))
        columns[:, of_steady] = axis.columns(signals, [term.of for term in steady])
        if behind:
            gains = [values[term.name] for term in behind]
            driven = Driven(axis, signals)
            columns[:, of_behind] = driven(at)
            for name in at:
                ends = [max(at[name] + part * self.step_s, 0.0) for part in (-0.5, 0.5)]
                below, above = (driven({**at, name: end}) @ gains for end in ends)
                columns[:, names.index(name)] = (above - below) / (ends[1] - ends[0])
        return columns


def answers_of(
    axes: Sequence[AxisEquation],
    counted: Counted,
    delays_s: Sequence[float],
    problem: LaggedRuns,
    estimate: Estimate,
    flights: motion.Flights,
) -> dict[str, object]:
    """The answers of flights, ready for JSON; nothing where references do not move, or do in some only."""
    first = flights[0]
    references, step_s = list(first.usable_references), first.signals.step_s
    alike = all([*f.usable_references] == references and f.signals.step_s == step_s for f in flights)
    if not (references and alike and len(problem.axes) == len(axes)):
        return {}
    channels = dict.fromkeys((*references, *first.signals.channels))
    parts = {
        name: [flight.signals.channel(name) for flight in flights]
        for name in channels
        if all(name in flight.signals.channels for flight in flights)
    }
    used = [flight.usable for flight in flights]
    levels = {name: float(np.mean(_joined(series, used))) for name, series in parts.items()}
    about = {name: [np.nan_to_num(item - levels[name]) for item in series] for name, series in parts.items()}

    def largest(name: str, order: int) -> float:
        pairs = zip(about[name], used, strict=True)
        moves = (np.abs(np.diff(item, order)[keep[order:]]).max() for item, keep in pairs)
        return float(max(moves)) / step_s**order

    sizes = {name: tuple(largest(name, n) for n in range(3 if name in references else 1)) for name in about}
    highest = {name: max(_highest_hz(item, step_s) for item in about[name]) for name in references}
    answering = [name for name in about if name not in references]
    columns = np.concatenate(
        [_answering([about[name][k] for name in references], step_s)[keep] for k, keep in enumerate(used)]
    )
    targets = np.column_stack([_joined(about[name], used) for name in answering])
    solution = _ridge(columns, targets, 2.0 * first.band_hz[1] * step_s * columns.shape[0])
    weights = dict(zip(answering, solution.T.tolist(), strict=True))
    noises = _densities(problem, estimate, _nodes(first.band_hz))
    made = Answers(step_s, first.band_hz, references, levels, sizes, highest, weights, noises)
    values = {**estimate.nuisances, **estimate.parameters}
    every: dict[str, float] = {}
    for k in range(len(flights)):
        logged = made.channels({name: about[name][k] for name in references})
        errors, _ = made.expected(axes, counted, logged, values, delays_s)
        every = {
            name: 1.0 / math.hypot(1.0 / every.get(name, math.inf), 1.0 / error)
            for name, error in errors.items()
        }
    return msgspec.to_builtins(msgspec.structs.replace(made, std_errors=every))


def _densities(
    problem: LaggedRuns, estimate: Estimate, nodes_hz: Float[np.ndarray, " nodes"]
) -> list[list[float]]:
    """Of what no term explains of each axis, by the response that leaves the least."""
    bins, results = problem.bins(estimate.nuisances), []
    power = (np.abs(bins.residuals(estimate.theta)) ** 2).T
    of_bin = np.concatenate([np.full(run.count, run.axis) for run in bins.layout.runs])
    for number in problem.axes:
        runs = [run for run in bins.layout.runs if run.axis == number]
        each = [densities(runs, item[of_bin == number], nodes_hz) for item in power]
        results.append(np.maximum(np.min(each, axis=0), 1e-300).tolist())
    return results


def faster(series: Float[np.ndarray, " n"], step_s: float, frequency_hz: float) -> float:
    """Share of the power of the acceleration above a frequency."""
    power = np.abs(np.fft.rfft(np.diff(series, 2))) ** 2
    above = np.fft.rfftfreq(series.size - 2, step_s) > frequency_hz
    return float(power[above].sum() / max(power.sum(), 1e-300))


def _highest_hz(series: Float[np.ndarray, " n"], step_s: float) -> float:
    power = np.cumsum(np.abs(np.fft.rfft(np.diff(series, 2))) ** 2)
    return float(np.fft.rfftfreq(series.size - 2, step_s)[np.searchsorted(power, (1.0 - SLOW) * power[-1])])


def _ridge(
    columns: Float[np.ndarray, "n k"], targets: Float[np.ndarray, "n m"], independent: float
) -> Float[np.ndarray, "k m"]:
    """Weights with the ridge of least generalized cross-validation, of so many independent samples."""
    U, s, Vt = np.linalg.svd(columns, full_matrices=False)
    parts, results = U.T @ targets, []
    for part, power in zip(parts.T, (targets**2).sum(axis=0), strict=True):
        kept = s**2 / (s**2 + s[0] ** 2 * RIDGES[:, None])
        left = power - part @ part + (((1.0 - kept) * part) ** 2).sum(axis=1)
        best = kept[np.argmin(left / (1.0 - np.minimum(kept.sum(axis=1) / independent, 0.9)) ** 2)]
        results.append(Vt.T @ (best * part / np.maximum(s, 1e-300)))
    return np.column_stack(results)


def _joined(series: Sequence[np.ndarray], used: Sequence[np.ndarray]) -> Float[np.ndarray, " n"]:
    return np.concatenate([item[keep] for item, keep in zip(series, used, strict=True)])


def _nodes(band_hz: tuple[float, float]) -> Float[np.ndarray, " nodes"]:
    return np.geomspace(max(band_hz[0], 1e-3), band_hz[1], NODES)


def _answering(series: Sequence[np.ndarray], step_s: float) -> Float[np.ndarray, "n columns"]:
    """Each reference through the pulse at every knot."""
    knots = [-1, 0]
    while knots[-1] * step_s < LAST_S:
        knots.append(max(knots[-1] + 1, round(RATIO * knots[-1])))
    taps = np.arange(-1, knots[-1] + 1)
    pulses = np.stack([np.interp(taps, knots, row) for row in np.eye(len(knots))])
    count = series[0].size
    length = 1 << (count + taps.size).bit_length()
    of_pulses = np.fft.rfft(pulses, length)
    columns = []
    for item in series:
        # before the first sample a reference was where it is then
        answers = np.fft.irfft(np.fft.rfft(item - item[0], length) * of_pulses, length)[:, 1 : count + 1]
        columns.append(answers.T + item[0] * pulses.sum(axis=1))
    return np.concatenate(columns, axis=1)
