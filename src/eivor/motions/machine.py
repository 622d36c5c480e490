"""Declared machines as motions: selection, instruments, activity, quantities, verdicts and words."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from eivor.errors import InputError, UsageError
from eivor.estimation.derived import derived_from
from eivor.estimation.estimate import Estimate
from eivor.flights.grid import Active, Grid, on_grid
from eivor.flights.lag_prior import EFFECTIVE_LAG, LAG_QUANTITIES, LEVEL, ratio_quantity
from eivor.flights.motion import Abilities, Flights, FlightView, LogChannels, Prediction, VehicleSupport
from eivor.flights.options import FlightOptions
from eivor.flights.prepared import InputFamily, PreparedFlight, Selection
from eivor.flights.quantity import (
    NAN,
    NO_INTERVAL,
    CardSection,
    Kind,
    PlotData,
    Quantity,
    QuantityEstimate,
    QuantitySpec,
    QuantityTable,
    Words,
)
from eivor.flights.references import ReferenceSource, white_noise_std
from eivor.flights.result import FlightEstimate
from eivor.flights.verdict import (
    FlightWords,
    Limit,
    Rule,
    SystematicPart,
    VerdictInputs,
    clock_part,
    flight_rules,
    longest_lag_rule,
)
from eivor.inference.covariance import JointEstimate
from eivor.inference.distributions import t_quantile
from eivor.inference.verdict import Status
from eivor.logs.channel_map import Expression, InTime
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY, LaggedRuns
from eivor.models.separable import InstrumentRule, LaggedReferences
from eivor.motions.equation import (
    AxisEquation,
    DeclaredMotion,
    Term,
    equation_prediction,
    parsed,
    simple_models,
)
from eivor.signals.channels import CanonicalChannel
from eivor.signals.recording import Channel, DataSheet, Finding, Recording
from eivor.tools import Bool, Float

# -- Parts of a declaration --

LAGS = (ACTUATOR_LAG.name, DELAY.name)
#: The interval of the lag [s].
LAG_LIMIT = Limit(identified_within=0.02, identified=0.1, narrower="Move it in quicker steps.")
#: Cosine averages of the standard error of an intercept, and degrees of freedom of its t.
AVERAGES = 8
#: Time constants of the lags of references, of which the strongest is taken [s].
TIME_CONSTANTS_S = (0.03, 0.06, 0.12, 0.25, 0.5, 1.0, 2.0)
#: Instruments beyond the unknowns.
TO_SPARE = 2
#: A machine stands still below this share of its usual speed, or so many times the noise of that.
STANDSTILL_SHARE, STANDSTILL_NOISES = 0.02, 3.0
#: Less than this share of a log in use is refused.
LEAST_ACTIVE = 0.2
#: Steps of grids are within these [s]: those of the fastest channel.
STEPS_S = (0.005, 0.1)
#: The band of rows ends at this share of the rate of the slowest channel, and begins and ends here [Hz].
BAND_SHARE, BAND_HZ = 0.2, (0.04, 5.0)
#: Above this share of the rate there is nothing to see.
NYQUIST_SHARE = 0.5


@dataclass(frozen=True, slots=True)
class MachineChannel:
    """A channel of a machine."""

    name: str
    unit: str
    #: "state", which must be logged; "response", which may be; "input"; "reference"
    role: str
    held: bool = False
    feedback: bool = False  # A reference that a controller computes from what the machine does
    noise: float | DataSheet | None = None

    @property
    def canonical(self) -> CanonicalChannel:
        """The channel as logs know it."""
        set_beforehand = self.role == "reference" and not self.feedback
        free = self.role == "input" and not self.unit
        return CanonicalChannel(
            self.name, self.unit, held=self.held, free_unit=free, exogenous=set_beforehand
        )


@dataclass(frozen=True, slots=True)
class Derived:
    """A quantity that follows from parameters."""

    name: str
    of: str  # An expression over parameters
    symbol: str
    unit: str

    @property
    def parameters(self) -> tuple[str, ...]:
        """Parameters in it."""
        return parsed(self.of).columns

    def quantity(self, estimate: Estimate) -> QuantityEstimate:
        """Value and interval: by Fieller's method for a ratio, else by a profile."""
        expression = parsed(self.of)
        steps = [step for step in expression.steps if step is not np.negative]
        if len(steps) == 3 and steps[2] is np.divide and isinstance(steps[1], str):
            above, sign = steps[0], (-1.0) ** (len(expression.steps) - len(steps))
            if isinstance(above, float):
                return ratio_quantity(estimate, sign * above, steps[1], self.unit)
            result = ratio_quantity(estimate, str(above), steps[1], self.unit)
            if sign > 0.0:
                return result
            low, high = result.interval
            return replace(result, value=-result.value, interval=(-high, -low))

        def of_vector(values: Float[np.ndarray, " n"]) -> float:
            return float(expression.evaluate(dict(zip(estimate.names, values, strict=True))))

        made = derived_from(of_vector, JointEstimate(estimate.values, estimate.joint_covariance), LEVEL)
        if not np.isfinite((made.value, made.std_error, *made.interval)).all():
            return QuantityEstimate(NAN, self.unit, NAN, NO_INTERVAL)
        return QuantityEstimate(made.value, self.unit, made.std_error, made.interval)


@dataclass(frozen=True)
class Activity:
    """Which samples count."""

    when: str = ""  # A condition over channels; empty for none
    moving: tuple[str, ...] = ()  # Expressions whose sign stands in a term: below a threshold it is not known

    def __call__(self, log: Recording, grid: Grid, _level: Float[np.ndarray, " n"], /) -> Active:
        """Samples of a log."""
        whole = np.ones(grid.count, dtype=np.bool_)
        if self.when:
            counted = self._values(self.when, log, grid) > 0.5
            return Active(whole, f"the condition {self.when}", counted)
        if not self.moving:
            return Active(whole, "the whole record")
        counted = whole
        rules: list[str] = []
        for text in self.moving:
            speed = np.abs(self._values(text, log, grid))
            usual = float(np.nanquantile(speed, 0.95))
            least = max(
                STANDSTILL_SHARE * usual, STANDSTILL_NOISES * white_noise_std(speed[np.isfinite(speed)])
            )
            counted = counted & (speed > least)
            rules.append(f"|{text}| above {least:.2g}")
        return Active(whole, f"movement: {' and '.join(rules)}", counted)

    @staticmethod
    def _values(text: str, log: Recording, grid: Grid) -> Float[np.ndarray, " n"]:
        expression = parsed(text)
        channels = {name: on_grid(log.channel(name), grid)[0] for name in expression.columns}
        return np.broadcast_to(expression.evaluate(channels, grid.step_s), (grid.count,))


# -- Simulation --

#: Steps of the integration are no longer than this [s].
LONGEST_STEP_S = 0.005
Derivatives = dict[str, int]


def _by_order(expression: Expression) -> tuple[Expression, Derivatives]:
    """The expression with derivatives of channels as columns (``q''``), and the highest order of each."""
    steps: list[Any] = []
    orders: Derivatives = {}
    for step in expression.steps:
        if isinstance(step, InTime):
            if step.lag_s is not None or not isinstance(steps[-1], str):
                expected = "derivatives of channels alone in an equation that is simulated"
                raise UsageError(expected, f"'{expression.text}'", "Declare a channel for what is derived.")
            steps[-1] += "'"
        else:
            steps.append(step)
    columns = tuple(dict.fromkeys(step for step in steps if isinstance(step, str)))
    for column in columns:
        name = column.rstrip("'")
        orders[name] = max(orders.get(name, 0), len(column) - len(name))
    return replace(expression, steps=tuple(steps), columns=columns), orders


@dataclass(frozen=True)
class Simulation:
    """Equations of a machine, with numbers and signals."""

    machine: Machine
    values: Mapping[str, float]
    signals: Mapping[str, np.ndarray | Callable[..., Any]]
    noise: Mapping[str, float]
    disturbance: tuple[float, float]

    @cached_property
    def equations(self) -> list[tuple[Expression, list[tuple[float, Expression, bool]], str]]:
        """Response, terms with their parameters, and the derivative that each axis determines."""
        results = []
        needed = [term.name for term in self.machine.terms]
        needed += list(LAGS) if self.machine.has_lag else []
        missing = [name for name in needed if name not in self.values]
        if missing:
            raise UsageError(
                f"values of {', '.join(needed)}", f"none of {', '.join(missing)}", "Give them too."
            )
        for axis in self.machine.axes:
            response, orders = _by_order(parsed(axis.response[-1]))
            terms = []
            for term in axis.terms:
                made, more = _by_order(term.expression)
                terms.append((self.values[term.name], made, term.behind))
                orders = {name: max(orders.get(name, 0), more.get(name, 0)) for name in {*orders, *more}}
            solved = [name for name, order in orders.items() if order]
            if len(solved) != 1:
                expected = f"one state with a derivative in the equation of {axis.name}"
                raise UsageError(expected, ", ".join(solved) or "none", "Simulate it by other means.")
            results.append((response, terms, solved[0] + orders[solved[0]] * "'"))
        return results

    def columns(
        self, count: int, step_s: float, records: int, rng: np.random.Generator
    ) -> dict[str, np.ndarray]:
        """Columns of a log, see `Machine.simulate`."""
        machine, parts = self.machine, max(math.ceil(step_s / LONGEST_STEP_S - 1e-9), 1)
        h, size = step_s / parts, (records,)
        state = {solved[:end]: np.zeros(size) for *_, solved in self.equations for end in _ends(solved)}
        given = [c.name for c in machine.logged if c.role != "response" and c.name not in state]
        absent = [name for name in given if name not in self.signals]
        if absent:
            raise UsageError(
                f"signals of {', '.join(given)}", f"none of {', '.join(absent)}", "Give them too."
            )
        lag_s, delay_s = (self.values[name] if machine.has_lag else 0.0 for name in LAGS)
        late, decay = round(delay_s / h), math.exp(-h / lag_s) if lag_s > 0.0 else 0.0
        inputs = [c.name for c in machine.logged if c.role == "input"]
        pushed, lasting = self.disturbance
        kept, push = math.exp(-h / lasting), np.zeros((len(self.equations), records))
        logged = {c.name: np.zeros((count, records)) for c in machine.logged}
        queue: list[dict[str, np.ndarray]] = []
        acting: dict[str, np.ndarray] = {}
        for k in range(count):
            measured = {
                name: value + self.noise.get(name, 0.0) * rng.standard_normal(records)
                for name, value in state.items()
            }
            now = {}
            for name in given:
                signal = self.signals[name]
                value = signal(k * step_s, measured) if callable(signal) else np.asarray(signal)[k]
                now[name] = np.broadcast_to(np.asarray(value, dtype=np.float64), size)
            command = {name: now[name] for name in inputs}
            acting = acting or command
            for part in range(parts):
                queue.append(command)
                driving = queue.pop(0) if len(queue) > late else queue[0]
                acting = {name: driving[name] + decay * (acting[name] - driving[name]) for name in inputs}
                push = kept * push + pushed * math.sqrt(1.0 - kept**2) * rng.standard_normal(push.shape)
                first, responses = self._derivative(state, now, acting, push)
                if not part:
                    self._log(logged, k, now, measured, responses, rng)
                moved = {name: value + h * first[name] for name, value in state.items()}
                second, _ = self._derivative(moved, now, acting, push)
                state = {
                    name: value + 0.5 * h * (first[name] + second[name]) for name, value in state.items()
                }
        columns = {"time": step_s * np.arange(count), **logged}
        return {
            name: item[:, 0] if item.ndim > 1 and records == 1 else item for name, item in columns.items()
        }

    def _log(
        self,
        logged: dict[str, np.ndarray],
        k: int,
        now: Mapping[str, np.ndarray],
        measured: Mapping[str, np.ndarray],
        responses: Mapping[str, np.ndarray],
        rng: np.random.Generator,
    ) -> None:
        """Put a sample into the columns."""
        for name, series in logged.items():
            known = measured if name in measured else now if name in now else responses
            std = 0.0 if name in measured else self.noise.get(name, 0.0)
            series[k] = known[name] + std * rng.standard_normal(series.shape[1])

    def _derivative(
        self,
        state: Mapping[str, np.ndarray],
        now: Mapping[str, np.ndarray],
        acting: Mapping[str, np.ndarray],
        push: Float[np.ndarray, "axes records"],
    ) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        """Derivative of each state, and responses by the names of their channels."""
        known: dict[str, np.ndarray] = {**now, **state}
        highest, responses = {}, {}
        for number, (response, terms, solved) in enumerate(self.equations):

            def left(value: float, at: int = number) -> np.ndarray:
                """Response less terms, with a value of the derivative that is sought."""
                response, terms, solved = self.equations[at]
                columns = {**known, solved: np.full(push.shape[1], value)}
                lagging = {**columns, **acting}
                right = sum(p * item.evaluate(lagging if behind else columns) for p, item, behind in terms)
                return np.asarray(response.evaluate(columns) - right - push[at])

            at_zero = left(0.0)
            highest[solved] = known[solved] = -at_zero / (left(1.0) - at_zero)
            for text in self.machine.axes[number].response[:-1]:
                responses[text] = response.evaluate(known)
        derivative = {name: highest.get(f"{name}'", state.get(f"{name}'", np.zeros(1))) for name in state}
        return derivative, responses


def _ends(solved: str) -> Iterator[int]:
    """Lengths of the names of a state and of its derivatives but the highest."""
    return iter(range(len(solved.rstrip("'")), len(solved)))


# -- Machine --


@dataclass(frozen=True)
class Machine(DeclaredMotion):
    """A motion that is declared, see `eivor.machine`."""

    name: str
    title: str
    equation: tuple[str, str]
    logged: tuple[MachineChannel, ...]
    axes: tuple[AxisEquation, ...]
    headline: tuple[str, ...]
    move: str
    log: str
    derived: tuple[Derived, ...]
    half_widths: tuple[float, float]  # Of identified and of weak, as shares
    activity: Activity
    band_hz: tuple[float, float] | None
    record: Mapping[str, Any]  # The declaration as it was read
    grids: tuple[Any, ...] = ()  # Lags and delays [s]

    @property
    def has_lag(self) -> bool:
        """Whether an actuator is declared."""
        return any(term.behind for axis in self.axes for term in axis.terms)

    @cached_property
    def terms(self) -> tuple[Term, ...]:
        """Terms of all axes."""
        return tuple(term for axis in self.axes for term in axis.terms)

    @cached_property
    def quantities(self) -> QuantityTable:  # type: ignore[override]
        """Parameters, what follows from them, and the lag."""
        rows = [
            (term.name, term.symbol, term.unit, Kind.DERIVED if term.is_intercept else Kind.PARAMETER)
            for term in self.terms
        ]
        rows += [(item.name, item.symbol, item.unit, Kind.DERIVED) for item in self.derived]
        specs = {
            name: QuantitySpec(
                name.replace("_", " "),
                symbol,
                unit,
                kind,
                shown_unit=unit.replace("^2", "²"),
                in_rows=kind is Kind.PARAMETER,
                headline=name in self.headline,
            )
            for name, symbol, unit, kind in rows
        }
        if self.has_lag:
            lag = LAG_QUANTITIES[EFFECTIVE_LAG]
            specs |= {**LAG_QUANTITIES, EFFECTIVE_LAG: replace(lag, in_rows=True)}
        return QuantityTable(specs)

    @property
    def words(self) -> Words:  # type: ignore[override]
        """How reports speak of it."""
        named = " and ".join(self.quantities[name].words for name in self.headline)
        verb = "are" if len(self.headline) > 1 else "is"
        intervals = "their intervals" if len(self.headline) > 1 else "its interval"
        return Words(
            title=self.title,
            model=self.name,
            identified=f"{named} {verb} identified within {intervals}.",
            refused=f"the log does not identify {named}.",
            provisional="no instrument: disturbances may bias the numbers.",
            fly=self.move,
            no_lag="No actuator is declared:\nthere is no lag to find.",
            where="in use",
            begins="moves",
            another_log="Give another log.",
            advice=lambda _format: (CardSection("Move", (self.move,)), CardSection("Log", (self.log,))),
        )

    @cached_property
    def channels(self) -> LogChannels:  # type: ignore[override]
        """What it reads of a log."""
        return LogChannels(
            tuple(InputFamily(item.name, measured=not item.held) for item in self._of_role("input")),
            tuple(item.name for item in self._of_role("state")),
            tuple(ReferenceSource(item.name) for item in self._of_role("reference")),
            added=tuple(channel.canonical for channel in self.logged),
        )

    @property
    def abilities(self) -> Abilities:  # type: ignore[override]
        """Predictions, how much the machine moved, and the declaration in results."""
        ahead = partial(equation_prediction, self.axes)
        return Abilities(
            vehicle=VehicleSupport(self._refuse_vehicle, {"machine": dict(self.record)}, lambda _: self),
            prediction=Prediction(simple_models, multi_step=ahead),
            excitation=self._excitation,
            findings=self._findings,
        )

    def _refuse_vehicle(self, name: str) -> Machine:
        raise UsageError(
            "a motion that asks what flies", f"'{self.name}', which does not", f"Leave out {name!r}."
        )

    def simulate(
        self,
        parameters: Mapping[str, float] | FlightEstimate,
        signals: Mapping[str, np.ndarray | Callable[..., Any]],
        *,
        seconds: float = 60.0,
        step_s: float = 0.01,
        noise: Mapping[str, float] | None = None,
        disturbance: tuple[float, float] = (0.0, 1.0),
        records: int = 1,
        seed: int = 0,
    ) -> dict[str, np.ndarray]:
        """Simulate the machine from rest, in open loop or under control.

        Parameters
        ----------
        parameters : mapping of str to float, or FlightEstimate
            Every parameter, and `actuator_lag` and `delay` [s] where an actuator is declared.
        signals : mapping
            An array of shape (n,) or (n, records) for every channel that is no state of the equations; of
            inputs also a function of time [s] and of the measured states by name.
        seconds, step_s : float
            Length of the record, and time between samples, at which commands change [s].
        noise : mapping of str to float, optional
            Standard deviation of the measurement noise of channels.
        disturbance : tuple of float
            Standard deviation of what pushes the response, and how long a push lasts [s].
        records : int
            So many records with noises of their own, side by side.
        seed : int
            Of the random numbers.

        Returns
        -------
        dict of str to ndarray, shape (n,) or (n, records)
            `time` and every channel, as `eivor.recording_from_columns` takes them.

        Raises
        ------
        UsageError
            When a number or a signal is missing, or an equation has no state whose derivative it determines.
        """
        values = parameters.parameters if isinstance(parameters, FlightEstimate) else dict(parameters)
        count = round(seconds / step_s)
        return Simulation(self, values, dict(signals), dict(noise or {}), disturbance).columns(
            count, step_s, records, np.random.default_rng(seed)
        )

    def select(self, log: Recording, options: FlightOptions) -> Selection:
        """States, responses and commands, with the noise that is declared."""
        if options.input:
            inputs = ", ".join(item.name for item in self._of_role("input"))
            raise UsageError(
                f"the inputs that the machine declares ({inputs})",
                f"--input {options.input}",
                "Leave it out, or name another channel in the declaration.",
            )
        commands = tuple(self._channel(log, item) for item in self._of_role("input"))
        states = {item.name: self._channel(log, item) for item in self._of_role("state")}
        known = [item for item in self._of_role("response") if item.name in log.channels]
        responses = {item.name: self._channel(log, item) for item in known}
        measured = [*states.values(), *responses.values()]
        rates = [channel.rate_hz for channel in (measured or commands)]
        step_s = float(f"{1.0 / max(channel.rate_hz for channel in (*measured, *commands)):.2g}")
        band = self.band_hz
        if band is None:
            band = (BAND_HZ[0], min(BAND_HZ[1], BAND_SHARE * min(rates)))
        elif band[1] > NYQUIST_SHARE * min(rates):
            raise InputError(
                f"a band below half the rate of the slowest channel, {NYQUIST_SHARE * min(rates):.3g} Hz",
                f"one up to {band[1]:g} Hz, of which {log.name} holds nothing",
                "Log faster, or declare a lower band.",
            )
        return Selection(
            self.channels.inputs[0],
            commands,
            states=states,
            responses=responses,
            band_hz=band,
            step_s=float(np.clip(step_s, *STEPS_S)),
            active=self.activity,
        )

    def problem(self, flights: Flights, rule: InstrumentRule) -> LaggedRuns:
        """Regressions of the flights; of the time constants of lagged references the strongest is taken."""
        if not isinstance(rule, LaggedReferences):
            return super().problem(flights, rule)
        searched = sum(len(grid) > 1 for grid in self.grids) if self.has_lag else 0
        unknowns = max(sum(not term.is_intercept for term in axis.terms) for axis in self.axes) + searched
        series = max(len(axis.instruments_of) or len(rule.channels) for axis in self.axes)
        count = math.ceil((unknowns + TO_SPARE) / series) - 1
        step_s = max(flight.signals.step_s for flight in flights)
        longest_s = max((run.stop - run.start) * f.signals.step_s for f in flights for run in f.runs)
        lags = [lag for lag in TIME_CONSTANTS_S if 2.0 * step_s <= lag <= 0.1 * longest_s] or [2.0 * step_s]
        problems = [super(Machine, self).problem(flights, replace(rule, lags=(count, lag))) for lag in lags]
        return max(problems, key=_strength) if count else problems[0]

    def derive(self, problem: LaggedRuns, estimate: Estimate) -> Mapping[str, QuantityEstimate]:
        """Parameters, the lag, intercepts, and what follows from parameters."""
        results = dict(super().derive(problem, estimate))
        for number, axis in enumerate(self.axes):
            for term in axis.terms:
                if term.is_intercept and number in problem.axes:
                    results[term.name] = _intercept(problem, estimate, number, term)
        known = {*results} & {*estimate.names}
        results |= {
            item.name: item.quantity(estimate) for item in self.derived if {*item.parameters} <= known
        }
        return {name: results[name] for name in self.quantities if name in results}

    @property
    def rules(self) -> tuple[Rule, ...]:  # type: ignore[override]
        """Rows of the instruments, of the samples, and of the width of each interval."""
        words = FlightWords(self.move, self.log, self.log, "moves", "Keep disturbances away.")
        stages = (
            *(term.name for term in self.terms if not term.is_intercept),
            *(LAGS if self.has_lag else ()),
        )
        rows = [_active_rule(self.activity), *([] if not self.has_lag else self._lag_rules(words, stages))]
        limit = Limit(
            *self.half_widths,
            zero=Status.REFUSED,
            narrower="Log for longer, or give several logs.",
            away_from_zero=self.move,
        )
        for term in self.terms:
            following = [item.name for item in self.derived if term.name in item.parameters]
            set_of = "" if term.is_intercept else term.name
            rows += flight_rules(words, (term.name,), stages, set_of)
            if not term.is_intercept:
                rows += limit.rules(term.name, self.quantities[term.name], *following)
        for item in self.derived:
            rows += flight_rules(words, (item.name,), stages, item.name)
        return tuple(rows)

    def _lag_rules(self, words: FlightWords, stages: tuple[str, ...]) -> list[Rule]:
        lag = LAG_LIMIT.rules(EFFECTIVE_LAG, self.quantities[EFFECTIVE_LAG], *LAGS)
        check = "Check that the command is that of this machine, or declare a longer one."
        return [
            *flight_rules(words, (*LAGS, EFFECTIVE_LAG), stages, EFFECTIVE_LAG),
            *lag,
            longest_lag_rule((), check),
            _end_of_delays_rule(check),
            _slow_samples_rule(),
        ]

    @property
    def parts(self) -> tuple[SystematicPart, ...]:  # type: ignore[override]
        """Commands that may have been issued between those that are logged."""
        return (clock_part((*LAGS, EFFECTIVE_LAG)),) if self.has_lag else ()

    def view(self, flight: PreparedFlight) -> FlightView:
        """What the input is, and the states."""
        panels = [
            PlotData(f"{item.name.replace('_', ' ')}\n[{item.unit}]", flight.signals.channel(item.name))
            for item in self._of_role("state")
        ]
        behind = " behind a lag τ and a delay d" if self.has_lag else ""
        inputs = ", ".join(item.name for item in self._of_role("input"))
        return FlightView(f"{inputs}{behind}", tuple(panels))

    def _of_role(self, role: str) -> tuple[MachineChannel, ...]:
        return tuple(channel for channel in self.logged if channel.role == role)

    def _channel(self, log: Recording, declared: MachineChannel) -> Channel:
        """A channel of a log, held and with noise as it is declared."""
        channel = log.channel(declared.name)
        noise = channel.noise if declared.noise is None else declared.noise
        return replace(channel, held=declared.held, noise=noise)

    def _excitation(self, flights: Flights) -> str:
        """Standard deviations of the inputs and of the states."""
        words = []
        for channel in (*self._of_role("input"), *self._of_role("state")):
            parts = [flight.signals.channel(channel.name)[flight.used] for flight in flights]
            words.append(f"{channel.name.replace('_', ' ')} {np.concatenate(parts).std():.2g} {channel.unit}")
        return f"Standard deviations: {', '.join(item.strip() for item in words)}."

    def _findings(self, flights: Flights, _quantities: Mapping[str, Quantity]) -> tuple[Finding, ...]:
        """How much of the logs counts, where that is not all."""
        if not self.activity.moving or self.activity.when:
            return ()
        share = 1.0 - _active_share(flights)
        if not share:
            return ()
        rules = "; ".join(dict.fromkeys(flight.active.rule for flight in flights))
        sentence = (
            f"Standstill is left out, {share:.0%} of the log ({rules}): the sign of a speed is not known "
            "there. Declare [active] for another rule."
        )
        return (Finding("standstill", sentence),)


def _active_share(flights: Flights) -> float:
    """Share of samples that count by the activity."""
    masks = [flight.active.counted for flight in flights if flight.active.counted is not None]
    return float(np.mean(np.concatenate(masks))) if masks else 1.0


def _active_rule(activity: Activity) -> Rule:
    """Row of logs in which the machine is hardly in use."""
    rule = activity.when or "movement"
    return Rule(
        (),
        lambda inputs: _active_share(inputs.flights) < LEAST_ACTIVE,
        Status.REFUSED,
        lambda inputs: (
            f"The machine is in use for {_active_share(inputs.flights):.0%} of the log only (by {rule}); "
            f"{LEAST_ACTIVE:.0%} are needed."
        ),
        "Move it for longer, cut the log with --window, or declare another [active].",
    )


def _end_of_delays_rule(remedy: str) -> Rule:
    """Row of a delay that ended at the longest that is searched."""

    def at_the_end(inputs: VerdictInputs) -> bool:
        delay = inputs.strength.searched.get(DELAY.name)
        return delay is not None and delay.value >= 0.999 * delay.highest > 0.0

    return Rule(
        (),
        at_the_end,
        Status.WEAK,
        lambda inputs: (
            "The delay ran into the longest that is declared "
            f"({inputs.strength.searched[DELAY.name].highest:.3g} s)."
        ),
        remedy,
    )


def _slow_samples_rule() -> Rule:
    """Row of samples that are too slow for the lag."""

    def step_s(inputs: VerdictInputs) -> float:
        return 1.0 / max(min(inputs.command_rate_hz, inputs.response_rate_hz), 1e-9)

    return Rule(
        (*LAGS, EFFECTIVE_LAG),
        lambda inputs: inputs.quantities[EFFECTIVE_LAG].value < 2.0 * step_s(inputs),
        Status.WEAK,
        lambda inputs: (
            f"Samples are {1e3 * step_s(inputs):.3g} ms apart, more than half the lag: how the command held "
            "between them moves it."
        ),
        "Log commands and states faster.",
    )


def _strength(problem: LaggedRuns) -> float:
    """Least canonical correlation of the instruments with the columns, that of the lag among them."""
    middle = {item.name: float(item.grid[(item.grid.size - 1) // 2]) for item in problem.nuisances}
    bins = problem.bins(middle)
    columns, response = bins.regressors, bins.responses[:, -1]
    if problem.nuisances[0].searched:
        theta = np.linalg.lstsq(columns, response)[0]
        slope = problem.nuisances[0].derivative(lambda at: problem.bins(at).regressors @ theta, middle)
        columns = np.column_stack([columns, slope])

    def basis(matrix: np.ndarray) -> np.ndarray:
        """Orthonormal basis of the columns, as real rows."""
        rows = np.concatenate([matrix.real, matrix.imag])
        sizes = np.linalg.norm(rows, axis=0)
        return np.asarray(np.linalg.qr(rows / np.where(sizes > 0.0, sizes, 1.0))[0])

    return float(np.linalg.svd(basis(bins.instruments).T @ basis(columns), compute_uv=False)[-1])


def _intercept(problem: LaggedRuns, estimate: Estimate, axis: int, term: Term) -> QuantityEstimate:
    """Mean of what the other terms leave, over what the term is; its error has that of the parameters."""
    left, regressors = [], []
    theta = estimate.theta
    for item in problem.columns:
        if item.axis != axis:
            continue
        moving = np.zeros((len(item.fixed), theta.size - item.fixed.shape[1]))
        columns = item.moving(estimate.nuisances)
        moving[:, list(range(columns.shape[1]) if item.moved is None else item.moved)] = columns
        whole = np.column_stack([item.fixed, moving])
        for run in item.runs:
            counted: Bool[np.ndarray, " n"] | slice | None = item.counted(run)
            counted = slice(None) if counted is None else counted
            left.append((item.responses[run, -1] - whole[run] @ theta)[counted])
            regressors.append(whole[run][counted])
    series, per = np.concatenate(left), float(term.expression.evaluate({}))
    # power of the residual at the lowest frequencies, where the error of a mean is from
    position = np.pi * (np.arange(series.size) + 0.5) / series.size
    waves = [np.sqrt(2.0 / series.size) * np.cos(k * position) for k in range(1, AVERAGES + 1)]
    power = np.mean([float(wave @ (series - series.mean())) ** 2 for wave in waves])
    own = math.sqrt(power / series.size)
    direction = np.zeros(len(estimate.names))
    direction[: theta.size] = np.concatenate(regressors).mean(axis=0)
    covariance = estimate.joint_covariance
    error = math.hypot(own, covariance.std_error(direction)) / abs(per)
    half = math.hypot(t_quantile(LEVEL, AVERAGES) * own, covariance.half_width(direction, LEVEL)) / abs(per)
    value = float(series.mean()) / per
    return QuantityEstimate(value, term.unit, error, (value - half, value + half))
