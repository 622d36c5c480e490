"""Declared equations: problem, quantities, traces and predictions of a motion, and answers of its loop."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, reduce
from typing import Any, TypeVar

import msgspec
import numpy as np

from eivor import checks
from eivor.estimation.estimate import Estimate
from eivor.flights import motion, quantity
from eivor.flights.lag_prior import EFFECTIVE_LAG, joint_quantities, lag_quantities
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import QuantityEstimate, SimpleModel, Trace
from eivor.flights.references import ReferenceSource
from eivor.linalg.system import COPIED_ROWS, merged_roots, row_blocks
from eivor.logs.channel_map import Expression, InTime, parse_expression
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY, AxisColumns, LaggedRuns, actuators, lag_and_delay
from eivor.models.regression import Parameter
from eivor.models.separable import GivenBins, InstrumentRule, LaggedReferences, Prior, Values
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
        """Whether it varies, and no actuator lags it."""
        return not (self.behind or self.is_intercept)


@dataclass(frozen=True)
class Mirror:
    """A nonlinear term with derivatives of a reference in place of its states."""

    reference: str
    of: str
    orders: Mapping[str, int]  # Order of the reference's derivative for each state

    def columns(
        self, signals: Signals, chain: Float[np.ndarray, "lags n"], lag_s: float
    ) -> Iterator[Float[np.ndarray, " n"]]:
        """One column for each lag of the reference; derivatives are differences of lags."""
        for last in range(max(self.orders.values()), len(chain)):
            derivatives = {
                name: np.diff(chain[last - order : last + 1], n=order, axis=0)[0] / (-lag_s) ** order
                for name, order in self.orders.items()
            }
            yield evaluated(parsed(self.of), signals, derivatives)


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
        self, signals: Signals, texts: Sequence[str], states: States | None = None, delay_s: float = 0.0
    ) -> Float[np.ndarray, "n k"]:
        """Columns of expressions, whose inputs are actuator states, or logged inputs with a delay."""
        if states is None:
            states = {}
            for name in self.averaged:
                delayed = shifted_by(signals.channel(name)[:, None], step_s=signals.step_s, delay_s=delay_s)
                states[name] = _means_around_samples(delayed[:, 0])
        columns = [evaluated(parsed(text), signals, states) for text in texts]
        return np.array(columns).reshape(-1, signals.sample_count).T

    def family(self, signals: Signals, name: str) -> Float[np.ndarray, "n m"]:
        """Logged channels of an input."""
        return signals.family(name)

    def states(
        self, logged: Mapping[str, Float[np.ndarray, "n m"]], signals: Signals, path: Mapping[str, float]
    ) -> States:
        """States of the actuators, as means of the families."""
        items = logged.items()
        return {name: mean_of(actuator_state(of, step_s=signals.step_s, **path)) for name, of in items}

    @property
    def is_forced(self) -> bool:
        """Whether the response is itself a held input, such as the force of a motor."""
        return any(name in self.averaged for text in self.response for name in parsed(text).columns)

    def is_delayed(self, term: Term) -> bool:
        """Whether a delay of the held inputs changes a term."""
        held = not {*term.expression.columns}.isdisjoint(self.averaged)
        return term.is_steady and (held or self.is_forced)

    def delayed_columns(self, signals: Signals) -> Callable[[Values], Float[np.ndarray, "n m"]]:
        """Columns of the terms without an actuator, by the delay of held inputs."""
        texts, step_s = [term.of for term in self.terms if self.is_delayed(term)], signals.step_s
        if not self.is_forced:
            return lambda nuisances: self.columns(signals, texts, delay_s=nuisances[DELAY.name])
        undelayed = self.columns(signals, texts)
        return lambda nuisances: shifted_by(undelayed, step_s=step_s, delay_s=-nuisances[DELAY.name])

    def instruments(self, signals: Signals, rule: InstrumentRule, names: tuple[str, ...]) -> np.ndarray:
        """Lags of references, by their names, and nonlinear terms of them, or past inputs."""
        # an equation may have no input of its own, but states of another
        inputs = [mean_of(signals.family(name)) for name in self.inputs]
        commands = inputs or [np.zeros(signals.sample_count)]
        if not isinstance(rule, LaggedReferences):
            return np.column_stack([rule.columns(signals, command) for command in commands])
        lags = rule.lags if self.reference_lags is None else self.reference_lags
        if self.instruments_of:
            series = {text: evaluated(parsed(text), signals) for text in self.instruments_of}
            extended = replace(signals, channels={**signals.channels, **series})
            return replace(rule, channels=self.instruments_of, lags=lags).columns(extended, commands[0])
        chains = replace(rule, channels=names, lags=lags).columns(signals, commands[0]).T
        columns = [*chains]
        for mirror in self.mirrors:
            if mirror.reference in names and lags is not None:
                start = names.index(mirror.reference) * (lags[0] + 1)
                columns += mirror.columns(signals, chains[start : start + lags[0] + 1], lags[1])
        return np.array(columns).T


@dataclass(frozen=True)
class DrivenColumns:
    """Columns of the terms that actuators lag, for a lag and a delay."""

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


def _means_around_samples(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Values held over the step after each sample, averaged around the samples."""
    # a hold has the gain sinc(f h) and is half a step late: so have these weights, up to f^3
    padded = np.pad(values, (2, 1), mode="edge")
    return (13.0 * (padded[1:-2] + padded[2:-1]) - padded[:-3] - padded[3:]) / 24.0


def _equally_smooth(flight: PreparedFlight, names: Sequence[str]) -> Signals:
    """Signals of a flight, with held inputs made as smooth as states that are means over steps."""
    # means lose a share of (pi f h)^2 / 6, and an input as much again by its hold; of n samples 4 / n^2 less
    loss = max(1.0 - 4.0 / (flight.rates_hz["command"] * flight.signals.step_s) ** 2, 0.0)
    channels = dict(flight.signals.channels)
    for name in names:
        channels[name] = channels[name] - loss / 24.0 * np.diff(np.pad(channels[name], 1, mode="edge"), 2)
    return replace(flight.signals, channels=channels) if names else flight.signals


@cache
def parsed(text: str) -> Expression:
    """An expression over channels and their derivatives."""
    return parse_expression(text, "an equation", constant=True)


def evaluated(
    expression: Expression, signals: Signals, substitutes: States | None = None
) -> Float[np.ndarray, " n"]:
    """Value of an expression for each sample; `substitutes` replace channels of the same name."""
    channels, known = signals.channels, substitutes or {}
    columns = {name: known[name] if name in known else channels[name] for name in expression.columns}
    if expression.steps == (*columns,):
        return columns.popitem()[1]
    values = expression.evaluate(columns, signals.step_s)
    return values if values.ndim else np.full(signals.sample_count, values)


def logged_axes(axes: Sequence[AxisEquation], flights: motion.Flights) -> tuple[AxisEquation, ...]:
    """Axes whose input all flights have."""
    return tuple(
        axis
        for axis in axes
        if all(family_members(name, flight.signals.channels) for name in axis.inputs for flight in flights)
    )


#: Values of the delay of inputs that the log does not date, to begin a search at.
DELAY_VALUES = 5


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
        """Signals of an equation of a flight."""
        return _equally_smooth(flight, axis.averaged)

    def problem(self, flights: motion.Flights, rule: InstrumentRule) -> R:
        return self.lagged_runs(flights, rule)  # type: ignore[return-value]

    def lagged_runs(self, flights: motion.Flights, rule: InstrumentRule) -> LaggedRuns:
        """Regressions of the equations for each lag and delay."""
        by_flight = self.axes_of(flights)
        common = tuple(by_flight[0].values())
        unlagged = tuple(term.parameter for axis in common for term in axis.terms if term.is_steady)
        lagged = tuple(term.parameter for axis in common for term in axis.terms if term.behind)
        slack_s = max(flight.command_slack_s for flight in flights)
        by_delay = not lagged and slack_s > 0.0 and any(axis.averaged for axis in common)
        delayed = tuple(t.parameter for axis in common for t in axis.terms if by_delay and axis.is_delayed(t))
        fixed, varying = tuple(p for p in unlagged if p not in delayed), delayed or lagged
        columns = []
        for number, (flight, axes) in enumerate(zip(flights, by_flight, strict=True)):
            for index, axis in axes.items():
                signals = self.signals(flight, axis)
                responses = [text for text in axis.response if {*parsed(text).columns} <= {*signals.channels}]
                varied = [term for term in axis.terms if (axis.is_delayed(term) if by_delay else term.behind)]
                constant = [term for term in axis.terms if term.is_steady and term not in varied]
                block = np.zeros((signals.sample_count, len(fixed)))
                block[:, [fixed.index(term.parameter) for term in constant]] = axis.columns(
                    signals, [term.of for term in constant]
                )
                columns.append(
                    AxisColumns(
                        signals.step_s,
                        flight.runs,
                        axis.columns(signals, responses),
                        block,
                        axis.delayed_columns(signals) if by_delay else DrivenColumns(axis, signals),
                        self.instruments(axis, signals, rule),
                        number,
                        index,
                        flight.band_hz,
                        flight.usable,
                        tuple(varying.index(term.parameter) for term in varied),
                        (axis.linear and all(t.is_linear for t in varied)) or (by_delay and axis.is_forced),
                    )
                )
        step_s = max((column.step_s for column in columns), default=0.0)
        lag, delay = lag_and_delay(*self.grids, step_s=step_s)
        if by_delay:
            # a command of every sample, the likeliest, is late by all of the slack
            grid = np.linspace(-1.5 * slack_s, 1.5 * slack_s, DELAY_VALUES)
            lag, prior = lag.known_at(0.0), Prior(0.0, slack_s)
            delay = replace(delay, grid=grid, prior=prior, tolerance=1e-3 * slack_s)
        return LaggedRuns(tuple(columns), (*fixed, *varying), (lag, delay))

    def references_of(self, axis: AxisEquation, rule: InstrumentRule) -> tuple[str, ...]:
        """References of a rule but for those of other equations; all where no other is left."""
        names = rule.channels if isinstance(rule, LaggedReferences) else ()
        others = {source.channel for item in self.axes if item != axis for source in item.references}
        return tuple(name for name in names if name not in others) or names

    def instruments(self, axis: AxisEquation, signals: Signals, rule: InstrumentRule) -> np.ndarray:
        return axis.instruments(signals, rule, self.references_of(axis, rule))

    def derive(self, problem: R, estimate: Estimate) -> Mapping[str, QuantityEstimate]:
        results = {**joint_quantities(estimate), **lag_quantities(problem, estimate)}
        return {name: results[name] for name in self.quantities if name in results}

    def traces(self, problem: R, estimate: Estimate) -> tuple[Trace, ...]:
        traces = []
        for number in problem.axes:
            driving = {term.parameter for term in self.axes[number].terms if term.behind}
            driven = [index for index, parameter in enumerate(problem.parameters) if parameter in driving]
            series = problem.series_in_band(estimate.nuisances, number, estimate.theta, driven)
            traces.append(Trace(*self.axes[number].trace, *series.T))
        return tuple(traces)


#: How the first of two responses differs from the second: it is late, or reads less.
OFFSET, SCALE = Parameter("offset", "s"), Parameter("scale", "")
#: Smaller differences matter to nothing.
LEAST_DIFFERENCE = {OFFSET.name: 0.001, SCALE.name: 0.005}


def has_two_responses(problem: LaggedRuns) -> bool:
    """Whether an equation has two responses, and instruments to compare them by."""
    pairs = all(item.responses.shape[1] == 2 and item.instruments.shape[1] for item in problem.columns)
    return pairs and len(problem.axes) == 1


def response_difference(
    problem: LaggedRuns,
    columns: Sequence[Float[np.ndarray, "n k"]] = (),
    instruments: Sequence[Float[np.ndarray, "n p"]] = (),
    parameters: tuple[Parameter, ...] = (),
) -> GivenBins:
    """Regression of the difference of two responses on offset, scale and other columns."""
    causes, bins = list[np.ndarray](), problem.bins(problem.first_values)
    for item in problem.columns:
        valid, a = item.valid, item.responses.mean(axis=1)
        if valid is not None and valid.any():  # a slope reads its neighbours, which may be beyond a limit
            a = np.interp(np.arange(a.size), np.flatnonzero(valid), a[valid])
        causes.append(np.array([np.gradient(a, item.step_s), a]).T)
    regressors, psi = [problem.spectra(causes)], [bins.instruments]
    if parameters:
        regressors, psi = [*regressors, problem.spectra(columns)], [*psi, problem.spectra(instruments)]
    return GivenBins(
        replace(
            bins,
            responses=bins.responses @ [[-1.0], [1.0]],
            regressors=np.hstack(regressors),
            instruments=np.hstack(psi),
            parameters=(OFFSET, SCALE, *parameters),
        )
    )


def explained(
    basis: Float[np.ndarray, "n p"], runs: Sequence[slice], columns: Float[np.ndarray, "n k"]
) -> Float[np.ndarray, "n k"]:
    """Least-squares predictions of columns by others and a constant, over the runs."""
    parts = (slice(*ends) for run in runs for ends in row_blocks(run.start, run.stop, COPIED_ROWS))
    rows = (np.column_stack([basis[k], np.ones(k.stop - k.start), columns[k]]) for k in parts)
    root, rcond = reduce(merged_roots, rows), len(basis) * np.finfo(np.float64).eps
    weights = np.linalg.lstsq(root[:, : basis.shape[1] + 1], root[:, basis.shape[1] + 1 :], rcond=rcond)[0]
    return np.asarray(basis @ weights[:-1] + weights[-1])


def simple_models(problem: LaggedRuns, estimate: Estimate) -> dict[str, SimpleModel]:
    """Least squares of all rows in frequency with neither lag nor delay."""
    no_lag = {**estimate.nuisances, ACTUATOR_LAG.name: 0.0, DELAY.name: 0.0}
    bins = problem.bins(no_lag)
    rows, response = (np.concatenate([p.real, p.imag]) for p in (bins.regressors, bins.responses[:, 0]))
    sizes = np.sqrt((rows * rows).sum(axis=0))
    sizes[sizes == 0.0] = 1.0
    fitted = np.linalg.lstsq(rows / sizes, response)[0] / sizes
    names = (parameter.name for parameter in problem.parameters)
    values = {**no_lag, **dict(zip(names, fitted.tolist(), strict=True))}
    return {"least_squares": SimpleModel("no-lag least squares", values)}


def response_predictions(
    axes: Sequence[AxisEquation], problem: LaggedRuns, values: Values
) -> tuple[quantity.PredictedQuantity, ...]:
    """Response of each axis within the band, measured and predicted."""
    nuisances = {item.name: values[item.name] for item in problem.nuisances}
    theta = np.array([values[item.name] for item in problem.parameters])
    results = []
    for number in problem.axes:
        words, unit, *_ = axes[number].trace
        measured, predicted, _ = problem.series_in_band(nuisances, number, theta, ()).T
        fields = (quantity.Horizon.ONE_STEP, words, unit, measured, predicted)
        results.append(quantity.PredictedQuantity(*fields))
    return tuple(results)


UNCHANGED_WORDS = "stays as it is"


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
        name, words, reason = term.name, term.name.replace("_", " "), ""
        if axis not in logged:
            reason = "its input or state is not logged"
        elif term.behind and EFFECTIVE_LAG in refused_names:
            reason = "the lag is refused"
        elif name in refused_names or name not in fit:
            reason = f"the {words} is refused" if name in refused_names else f"the fit has no {words}"
        if reason:
            omitted.append(f"The {axis.state[1]} is not predicted: {reason}.")
        else:
            predicted.append(axis)

    def errors(number: int, starts: motion.Starts) -> Iterator[motion.HorizonErrors]:
        for axis in predicted:
            yield from _horizon_errors(axis, flights[number], starts, models)

    return motion.multi_step_predictions(flights, errors, tuple(omitted))


def _horizon_errors(
    axis: AxisEquation, flight: PreparedFlight, starts: motion.Starts, models: Mapping[str, SimpleModel]
) -> Iterator[motion.HorizonErrors]:
    channel, words, unit = axis.state or ("", "", "")
    state = flight.signals.channel(channel)
    measured, initial = state[starts.ends], state[starts.samples]
    by_model = {name: (m.words, _predicted(axis, flight, starts, m.values)) for name, m in models.items()}
    by_model[motion.UNCHANGED] = (UNCHANGED_WORDS, np.broadcast_to(initial, measured.shape))
    for name, (model_words, predicted) in by_model.items():
        errors, series = np.abs(predicted - measured).T, np.column_stack([measured[-1], predicted[-1]])
        changes = np.abs(series - initial[:, None])
        yield motion.HorizonErrors(name, model_words, words, unit, errors, changes, series)


def _predicted(
    axis: AxisEquation, flight: PreparedFlight, starts: motion.Starts, values: Values
) -> Float[np.ndarray, "horizons starts"]:
    signals, (channel, *_) = flight.signals, axis.state or ("",)
    state = signals.channel(channel)
    unlagged = [term for term in axis.terms if term.is_steady]
    undriven = [t for t in unlagged if t.expression.of_moments and t.expression.columns == (channel,)]
    driving = [term for term in unlagged if term not in undriven]
    lagged = [term for term in axis.terms if term.behind]
    driven = DrivenColumns(axis, signals)(values) @ np.array([values[term.name] for term in lagged])
    driven += axis.columns(signals, [term.of for term in driving]) @ [values[term.name] for term in driving]

    def effect(of: np.ndarray) -> np.ndarray:
        parts = [values[term.name] * term.expression.evaluate({channel: of}) for term in undriven]
        return np.sum(parts, axis=0) if parts else np.zeros_like(of)

    driven = driven + motion.trim(flight, time_derivative(state, signals.step_s) - effect(state) - driven)
    force = starts.over_step(driven)
    initial = state[None, starts.samples]
    return starts.propagate(initial, lambda now, sample: force[sample] + effect(now))[:, 0]


# -- Responses of a machine in its loop --

#: A pulse response is linear between knots: at first a sample apart, later in this ratio, up to the last.
KNOT_RATIO, LAST_KNOT_S = 1.25, 8.0
#: A plan is in use for this share of its time at least.
LEAST_USED = 0.5
#: Share of the power of an acceleration above its highest frequency.
TAIL = 0.02
#: Ridges that weights are chosen from, as shares of the largest singular value squared.
RIDGES = np.geomspace(1e-14, 1e-2, 25)
#: Frequencies at which densities are kept, over the band.
NODE_COUNT = 12
#: Standard deviation of a uniform distribution over a range of one.
UNIFORM_STD = 1.0 / math.sqrt(12.0)

#: From values of expressions to the samples that count, None for all, and the rule.
Counted = Callable[[Callable[[str], Float[np.ndarray, " n"]]], "tuple[Bool[np.ndarray, ' n'] | None, str]"]


class LoopResponses(msgspec.Struct):
    """A machine in closed loop: responses of channels to references, and residual densities."""

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
        """Every channel, for movements of references about their levels."""
        columns = _responses([moves[name] for name in self.references], self.step_s)
        responses = {name: self.levels[name] + columns @ weights for name, weights in self.weights.items()}
        return responses | {name: self.levels[name] + moves[name] for name in self.references}

    def expected(
        self,
        axes: Sequence[AxisEquation],
        counted: Counted,
        channels: Mapping[str, Float[np.ndarray, " n"]],
        values: Values,
        delays_s: Sequence[float],
    ) -> tuple[dict[str, float], float]:
        """Standard error of each parameter and nuisance by the formula, and their log determinant."""
        signals = Signals(1.0 / self.step_s, channels)
        count = signals.sample_count
        mask, _ = counted(lambda text: axes[0].columns(signals, [text])[:, 0])
        if mask is not None and mask.mean() < LEAST_USED:
            return {}, math.inf
        run = SpectralRun(0, count, self.step_s, self.band_hz, counted=mask)
        terms = [term for axis in axes for term in axis.terms if not term.is_intercept]
        lags = [ACTUATOR_LAG.name, DELAY.name] if any(term.behind for term in terms) else []
        names = [term.name for term in terms] + lags
        # a lag costs more than a delay, and data hardly tell them apart
        nuisances = dict(zip(lags, (sum(values[name] for name in lags), 0.0), strict=False))
        triangle = np.zeros((0, len(names)))
        if lags:
            triangle = np.eye(1, len(names), len(names) - 1)
            triangle /= max(UNIFORM_STD * (delays_s[-1] - delays_s[0]), 1e-4)
        for axis, density in zip(axes, self.densities, strict=True):
            columns = self._columns(axis, signals, values, nuisances, names)
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
        rows = [k for k, name in enumerate(names) if name not in lags]
        return results, 2.0 * float(np.linalg.slogdet(inverse[rows] @ inverse[rows].T)[1])

    def _columns(
        self, axis: AxisEquation, signals: Signals, values: Values, nuisances: Values, names: list[str]
    ) -> Float[np.ndarray, "n names"]:
        """Sensitivity of the response of an axis to each parameter and nuisance."""
        steady = [term for term in axis.terms if term.is_steady]
        lagged = [term for term in axis.terms if term.behind]
        columns = np.zeros((signals.sample_count, len(names)))
        at_steady, at_lagged = ([names.index(term.name) for term in terms] for terms in (steady, lagged))
        columns[:, at_steady] = axis.columns(signals, [term.of for term in steady])
        if lagged:
            gains = [values[term.name] for term in lagged]
            driven = DrivenColumns(axis, signals)
            columns[:, at_lagged] = driven(nuisances)
            for name in nuisances:
                ends = [max(nuisances[name] + part * self.step_s, 0.0) for part in (-0.5, 0.5)]
                below, above = (driven({**nuisances, name: end}) @ gains for end in ends)
                columns[:, names.index(name)] = (above - below) / (ends[1] - ends[0])
        return columns


def loop_record(
    axes: Sequence[AxisEquation],
    counted: Counted,
    delays_s: Sequence[float],
    problem: LaggedRuns,
    estimate: Estimate,
    flights: motion.Flights,
) -> dict[str, object]:
    """Loop responses of flights, ready for JSON; empty unless the same references move in all flights."""
    first = flights[0]
    references, step_s = list(first.usable_references), first.signals.step_s
    same_layout = all([*f.usable_references] == references and f.signals.step_s == step_s for f in flights)
    if not (references and same_layout and len(problem.axes) == len(axes)):
        return {}
    channels = dict.fromkeys((*references, *first.signals.channels))
    parts = {
        name: [flight.signals.channel(name) for flight in flights]
        for name in channels
        if all(name in flight.signals.channels for flight in flights)
    }
    used = [flight.usable for flight in flights]
    levels = {name: float(np.mean(_joined(series, used))) for name, series in parts.items()}
    delta = {name: [np.nan_to_num(item - levels[name]) for item in series] for name, series in parts.items()}

    def largest(name: str, order: int) -> float:
        pairs = zip(delta[name], used, strict=True)
        peaks = (np.abs(np.diff(item, order)[mask[order:]]).max() for item, mask in pairs)
        return float(max(peaks)) / step_s**order

    sizes = {name: tuple(largest(name, n) for n in range(3 if name in references else 1)) for name in delta}
    highest = {name: max(_highest_hz(item, step_s) for item in delta[name]) for name in references}
    responding = [name for name in delta if name not in references]
    columns = np.concatenate(
        [_responses([delta[name][k] for name in references], step_s)[mask] for k, mask in enumerate(used)]
    )
    targets = np.column_stack([_joined(delta[name], used) for name in responding])
    solution = _ridge_weights(columns, targets, 2.0 * first.band_hz[1] * step_s * columns.shape[0])
    weights = dict(zip(responding, solution.T.tolist(), strict=True))
    noises = _densities(problem, estimate, _nodes(first.band_hz))
    responses = LoopResponses(step_s, first.band_hz, references, levels, sizes, highest, weights, noises)
    values = {**estimate.nuisances, **estimate.parameters}
    combined: dict[str, float] = {}
    for k in range(len(flights)):
        logged = responses.channels({name: delta[name][k] for name in references})
        errors, _ = responses.expected(axes, counted, logged, values, delays_s)
        combined = {
            name: 1.0 / math.hypot(1.0 / combined.get(name, math.inf), 1.0 / error)
            for name, error in errors.items()
        }
    return msgspec.to_builtins(msgspec.structs.replace(responses, std_errors=combined))


def _densities(
    problem: LaggedRuns, estimate: Estimate, nodes_hz: Float[np.ndarray, " nodes"]
) -> list[list[float]]:
    """Residual density of each axis, of the response with the smallest."""
    bins, results = problem.bins(estimate.nuisances), []
    power = (np.abs(bins.residuals(estimate.theta)) ** 2).T
    of_bin = np.concatenate([np.full(run.count, run.axis) for run in bins.layout.runs])
    for number in problem.axes:
        runs = [run for run in bins.layout.runs if run.axis == number]
        of_runs = [densities(runs, item[of_bin == number], nodes_hz) for item in power]
        results.append(np.maximum(np.min(of_runs, axis=0), 1e-300).tolist())
    return results


def faster(series: Float[np.ndarray, " n"], step_s: float, frequency_hz: float) -> float:
    """Share of the power of the acceleration above a frequency."""
    power = np.abs(np.fft.rfft(np.diff(series, 2))) ** 2
    is_above = np.fft.rfftfreq(series.size - 2, step_s) > frequency_hz
    return float(power[is_above].sum() / max(power.sum(), 1e-300))


def _highest_hz(series: Float[np.ndarray, " n"], step_s: float) -> float:
    power = np.cumsum(np.abs(np.fft.rfft(np.diff(series, 2))) ** 2)
    return float(np.fft.rfftfreq(series.size - 2, step_s)[np.searchsorted(power, (1.0 - TAIL) * power[-1])])


def _ridge_weights(
    columns: Float[np.ndarray, "n k"], targets: Float[np.ndarray, "n m"], independent: float
) -> Float[np.ndarray, "k m"]:
    """Ridge weights by generalized cross-validation, for a number of independent samples."""
    U, s, Vt = np.linalg.svd(columns, full_matrices=False)
    parts, results = U.T @ targets, []
    for part, power in zip(parts.T, (targets**2).sum(axis=0), strict=True):
        filters = s**2 / (s**2 + s[0] ** 2 * RIDGES[:, None])
        residual = power - part @ part + (((1.0 - filters) * part) ** 2).sum(axis=1)
        best = filters[np.argmin(residual / (1.0 - np.minimum(filters.sum(axis=1) / independent, 0.9)) ** 2)]
        results.append(Vt.T @ (best * part / np.maximum(s, 1e-300)))
    return np.column_stack(results)


def _joined(series: Sequence[np.ndarray], used: Sequence[np.ndarray]) -> Float[np.ndarray, " n"]:
    return np.concatenate([item[mask] for item, mask in zip(series, used, strict=True)])


def _nodes(band_hz: tuple[float, float]) -> Float[np.ndarray, " nodes"]:
    return np.geomspace(max(band_hz[0], 1e-3), band_hz[1], NODE_COUNT)


def _responses(series: Sequence[np.ndarray], step_s: float) -> Float[np.ndarray, "n columns"]:
    """Response of each reference to the pulse at every knot."""
    knots = [-1, 0]
    while knots[-1] * step_s < LAST_KNOT_S:
        knots.append(max(knots[-1] + 1, round(KNOT_RATIO * knots[-1])))
    taps = np.arange(-1, knots[-1] + 1)
    pulses = np.stack([np.interp(taps, knots, row) for row in np.eye(len(knots))])
    count = series[0].size
    length = 1 << (count + taps.size).bit_length()
    pulse_spectra = np.fft.rfft(pulses, length)
    columns = []
    for item in series:
        # before the first sample a reference was where it is then
        filtered = np.fft.irfft(np.fft.rfft(item - item[0], length) * pulse_spectra, length)[:, 1 : count + 1]
        columns.append(filtered.T + item[0] * pulses.sum(axis=1))
    return np.concatenate(columns, axis=1)


# -- Simulation --


def by_order(expression: Expression) -> Expression:
    """The expression with derivatives of channels as columns, such as ``q''``."""
    steps: list[Any] = []
    for step in expression.steps:
        if isinstance(step, InTime):
            checks.require(
                step.lag_s is None and isinstance(steps[-1], str),
                "derivatives of channels alone in an equation that is simulated",
                f"'{expression.text}'",
                "Declare a channel for what is derived.",
            )
            steps[-1] += "'"
        else:
            steps.append(step)
    return replace(expression, steps=tuple(steps))


@dataclass(frozen=True)
class SolvedEquation:
    """Equation of one axis with numbers, solved for its highest derivative."""

    response: Expression
    terms: tuple[tuple[float, Expression, bool], ...]  # Parameter, expression, behind the actuator
    others: tuple[str, ...]  # Response channels that may be logged as well

    @cached_property
    def solved(self) -> str:
        """Highest derivative of the state of the response, or else of the terms."""
        of_response = [name for name in self.response.columns if name.endswith("'")]
        states = {name.rstrip("'") for name in of_response or self._derived}
        expected, remedy = "one state with a derivative in each equation", "Simulate it by other means."
        checks.require(len(states) == 1, expected, ", ".join(sorted(states)) or "none", remedy)
        return max((name for name in self._derived if {name.rstrip("'")} == states), key=len)

    @property
    def _derived(self) -> set[str]:
        columns = [*self.response.columns, *(name for _, item, _ in self.terms for name in item.columns)]
        return {name for name in columns if name.endswith("'")}

    @property
    def needed(self) -> set[str]:
        """Derivatives that this equation takes as known."""
        return self._derived - {self.solved}

    @property
    def lower(self) -> list[str]:
        """The state and its derivatives below the solved one."""
        return [self.solved[: -1 - n] for n in range(self.solved.count("'"))]

    def derivative(self, known: Mapping[str, Any], actuated: Mapping[str, Any], push: Any) -> np.ndarray:
        """Value of the highest derivative, in which the equation is affine."""

        def residual(value: float) -> Any:
            columns = {**known, self.solved: value}
            lagged = {**columns, **actuated}
            right = sum(p * item.evaluate(lagged if behind else columns) for p, item, behind in self.terms)
            return self.response.evaluate(columns) - right - push

        at_zero = residual(0.0)
        return np.asarray(-at_zero / (residual(1.0) - at_zero))
