"""Declared machines as motions: selection, instruments, activity, quantities and words."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from eivor import checks
from eivor.errors import InputError, UsageError, did_you_mean
from eivor.estimation.estimate import Estimate, derived_from
from eivor.flights import quantity, verdict
from eivor.flights.grid import Active, Grid, on_grid
from eivor.flights.lag_prior import EFFECTIVE_LAG, LAG_QUANTITIES, LEVEL, ratio_quantity
from eivor.flights.motion import (
    Abilities,
    Flights,
    FlightView,
    LogChannels,
    Prediction,
    SensorComparison,
    VehicleSupport,
)
from eivor.flights.options import FlightOptions
from eivor.flights.prepared import InputFamily, PreparedFlight, Selection, deviations
from eivor.flights.quantity import NAN, CardSection, Quantity, QuantityEstimate
from eivor.flights.references import ReferenceSource, white_noise_std
from eivor.flights.result import FlightEstimate
from eivor.inference.covariance import JointEstimate
from eivor.inference.distributions import t_quantile
from eivor.inference.verdict import Status
from eivor.models.lagged_runs import DELAY, LaggedRuns
from eivor.models.separable import InstrumentRule, LaggedReferences, Prior
from eivor.motions import equation, machine_verdict
from eivor.motions.equation import AxisEquation, DeclaredMotion, SolvedEquation, Term, parsed
from eivor.motions.machine_verdict import LAGS, MachineChecks
from eivor.signals.channels import CanonicalChannel
from eivor.signals.recording import Channel, DataSheet, Finding, Recording
from eivor.signals.signals import stretches
from eivor.tools import Bool, Float, capitalised

# -- Parts of a declaration --

#: Cosine averages of the standard error of an intercept, and degrees of freedom of its t.
AVERAGES = 8
#: Time constants of the lags of references, of which the strongest is taken [s].
TIME_CONSTANTS_S = (0.03, 0.06, 0.12, 0.25, 0.5, 1.0, 2.0)
#: Instruments in excess of the unknowns, for each reference.
SPARE_INSTRUMENTS = 2
#: A machine stands still below this share of its usual speed, or this multiple of its noise.
STANDSTILL_SHARE, STANDSTILL_NOISES = 0.02, 3.0
#: A reversal in fewer samples is no standstill: where noise decides, leaving it out would favour some noises.
STANDSTILL_SAMPLES = 6
#: Steps of grids are within these [s]: those of the fastest channel.
STEPS_S = (0.005, 0.1)
#: The band of rows ends at this share of the rate of the slowest channel, and begins and ends here [Hz].
BAND_SHARE, BAND_HZ = 0.2, (0.04, 5.0)
#: Highest observable frequency, as a share of the rate.
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
        exogenous = self.role == "reference" and not self.feedback
        free = self.role == "input" and not self.unit
        return CanonicalChannel(self.name, self.unit, held=self.held, free_unit=free, exogenous=exogenous)


@dataclass(frozen=True, slots=True)
class Derived:
    """A quantity that follows from parameters."""

    name: str
    of: str  # An expression over parameters
    symbol: str
    unit: str

    @property
    def parameters(self) -> tuple[str, ...]:
        return parsed(self.of).columns

    @property
    def reciprocal_of(self) -> str:
        """The parameter that it is one over; empty for others."""
        steps = parsed(self.of).steps
        return str(steps[1]) if (*steps[:1], *steps[2:]) == (1.0, np.divide) else ""

    def quantity(self, estimate: Estimate) -> QuantityEstimate:
        """Value and interval: by Fieller's method for a ratio, else by a profile."""
        expression = parsed(self.of)
        match [step for step in expression.steps if step is not np.negative]:
            case [str() | float() as above, str() as below, np.divide]:
                sign = (-1.0) ** (len(expression.steps) - 3)
                return ratio_quantity(estimate, above, below, self.unit).times(sign)

        def value(values: Float[np.ndarray, " n"]) -> float:
            return float(expression.evaluate(dict(zip(estimate.names, values, strict=True))))

        result = derived_from(value, JointEstimate(estimate.values, estimate.joint_covariance), LEVEL)
        if not np.isfinite((result.value, result.std_error, *result.interval)).all():
            return QuantityEstimate(NAN, self.unit, NAN, quantity.NO_INTERVAL)
        return QuantityEstimate(result.value, self.unit, result.std_error, result.interval)


@dataclass(frozen=True)
class Activity:
    """Rule for the samples that count."""

    when: str = ""  # A condition over channels; empty for none
    moving: tuple[str, ...] = ()  # Expressions whose sign stands in a term: below a threshold it is not known

    def __call__(self, log: Recording, grid: Grid, _level: Float[np.ndarray, " n"], /) -> Active:
        def values(text: str) -> Float[np.ndarray, " n"]:
            expression = parsed(text)
            channels = {name: on_grid(log.channel(name), grid)[0] for name in expression.columns}
            return np.broadcast_to(expression.evaluate(channels, grid.step_s), (grid.count,))

        counted, rule = self.counted(values)
        return Active(np.ones(grid.count, dtype=np.bool_), rule, counted)

    def counted(
        self, values: Callable[[str], Float[np.ndarray, " n"]]
    ) -> tuple[Bool[np.ndarray, " n"] | None, str]:
        """Mask of the samples that count, None for all, and the rule in words."""
        if not (self.when or self.moving):
            return None, "the whole record"
        counted = values(self.when) > 0.5 if self.when else np.array(True)
        rules = list[str]()
        for text in self.moving:
            velocity = values(text)
            speed = np.abs(velocity)
            noise = STANDSTILL_NOISES * white_noise_std(speed[np.isfinite(speed)])
            usual = STANDSTILL_SHARE * float(np.nanquantile(speed, 0.95))
            threshold = max(usual, noise)
            moves = speed > threshold
            for slow in stretches(~moves) if noise > usual else ():
                if slow.stop - slow.start < STANDSTILL_SAMPLES and slow.start > 0 and slow.stop < speed.size:
                    moves[slow] = velocity[slow.start - 1] * velocity[slow.stop] < 0.0
            counted = counted & moves
            rules.append(f"|{text}| above {threshold:.2g}")
        condition = [f"the condition {self.when}"] if self.when else []
        movement = [f"movement: {' and '.join(rules)}"] if rules else []
        return np.asarray(counted), "; ".join((*condition, *movement))


# -- Simulation --

#: Steps of the integration are no longer than this, or for slow actuators four times as long [s].
LONGEST_STEP_S = 0.005


def _require_all(kind: str, names: list[str], provided: Mapping[str, Any], also: Iterable[str]) -> None:
    missing = [name for name in names if name not in provided]
    unknown = [name for name in provided if name not in (*names, *also)]
    received = [f"none of {', '.join(missing)}"] * bool(missing) + list(map(repr, unknown))
    remedy = did_you_mean("".join(unknown[:1]), missing or names, f"Give these {kind}, by these names.")
    checks.require(not received, f"{kind} of {', '.join(names)}", ", and ".join(received), remedy)


@dataclass(frozen=True)
class Machine(DeclaredMotion[LaggedRuns]):
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
        return tuple(term for axis in self.axes for term in axis.terms)

    @cached_property
    def quantities(self) -> quantity.QuantityTable:  # type: ignore[override]
        parameters = {term.name for term in self.terms if not term.is_intercept}
        listed: list[Term | Derived] = [*self.terms, *self.derived]
        specs = {
            item.name: quantity.QuantitySpec(
                item.name if item.name.find("_") == 1 else item.name.replace("_", " "),
                item.symbol,
                item.unit,
                item.name not in parameters,
                shown_unit=item.unit.replace("^2", "²"),
                in_rows=item.name in parameters,
                headline=item.name in self.headline,
                needs=item.parameters if isinstance(item, Derived) else (),
                reciprocal_of=item.reciprocal_of if isinstance(item, Derived) else "",
            )
            for item in listed
        }
        if self.has_lag:
            lag = LAG_QUANTITIES[EFFECTIVE_LAG]
            specs |= {**LAG_QUANTITIES, EFFECTIVE_LAG: replace(lag, in_rows=True)}
        elif any(axis.averaged for axis in self.axes):  # of inputs whose stamps do not date them
            specs |= {DELAY.name: LAG_QUANTITIES[DELAY.name]}
        return quantity.QuantityTable(specs)

    @property
    def words(self) -> quantity.Words:  # type: ignore[override]
        has_rule = bool(self.activity.when or self.activity.moving)
        return quantity.Words(
            title=self.title,
            model=self.name,
            fly=self.move,
            no_lag="No actuator is declared:\nthere is no lag to find.",
            where="in use",
            loosen=f"{self.move} Or declare another [active]." if has_rule else "Widen the window.",
            begins="moves",
            another_log="Give another log.",
            card=(CardSection("Move", (self.move,)), CardSection("Log", (self.log,))),
            log_reference=self.log,
            log_planned=self.log,
            undisturbed="Keep disturbances away.",
            of_answers=Status.PROVISIONAL,
        )

    @cached_property
    def channels(self) -> LogChannels:  # type: ignore[override]
        return LogChannels(
            tuple(InputFamily(item.name, measured=not item.held) for item in self._of_role("input")),
            tuple(item.name for item in self._of_role("state")),
            tuple(ReferenceSource(item.name) for item in self._of_role("reference")),
            added=tuple(channel.canonical for channel in self.logged),
        )

    @property
    def abilities(self) -> Abilities:  # type: ignore[override]
        states = any(axis.state for axis in self.axes)
        ahead = partial(equation.equation_prediction, self.axes) if states else None
        return Abilities(
            vehicle=VehicleSupport(None, {"machine": dict(self.record)}, lambda _: self),
            prediction=Prediction(
                equation.simple_models, partial(equation.response_predictions, self.axes), ahead
            ),
            excitation=self._excitation,
            findings=self._findings,
            tracking=self._tracked_parameter,
            closed_loop_record=partial(equation.loop_record, self.axes, self.activity.counted, self.delays_s),
            profiled=True,
            sensors=SensorComparison(
                machine_verdict.response_agreement,
                partial(machine_verdict.difference_sentence, self.axes[0].response),
            ),
        )

    @property
    def delays_s(self) -> Sequence[float]:
        return self.grids[1] if self.grids else (0.0,)

    def _tracked_parameter(
        self, problem: LaggedRuns, quantities: Mapping[str, Quantity], _options: FlightOptions, name: str
    ) -> quantity.TrackedParameter:
        """Rows of a parameter, by default the first driven headline; the others as priors of the record."""
        order = sorted(self.terms, key=lambda term: (term.name not in self.headline, not term.behind))
        names = tuple(term.name for term in order if not term.is_intercept)
        name = name or names[0]
        checks.index_of("a parameter", name, names)
        number = next(k for k, axis in enumerate(self.axes) if name in (term.name for term in axis.terms))
        order = [term for term in order if term in self.axes[number].terms]
        known, sentences = dict[str, Prior](), list[str]()
        for term in order:
            item = quantities.get(term.name)
            if item is not None and term.name != name and item.half_width < math.inf:
                known[term.name] = Prior(item.value, 0.5 * item.half_width)
                value = f"{item.value:.3g} ± {item.half_width:.2g} {term.unit}".strip()
                words = capitalised(f"{self.quantities[term.name].words} {value}")
                sentences.append(f"{words}, as the whole record identifies it.")
        # an intercept term is the parameter times a number
        intercepts = [(known.get(t.name), float(t.expression.evaluate({}))) for t in order if t.is_intercept]
        intercept = next((Prior(x * item.mean, abs(x) * item.std) for item, x in intercepts if item), None)
        # of several equations the one with this parameter
        columns = next(item for item in problem.columns if item.axis == number)
        parameters, fixed_count = {term.parameter for term in order}, problem.still
        fixed = [k for k in range(fixed_count) if problem.parameters[k] in parameters]
        used = [problem.parameters[k] for k in fixed]
        used += [item for item in problem.parameters[fixed_count:] if item in parameters]
        columns = replace(columns, fixed=columns.fixed[:, fixed], moved=None)
        runs = replace(problem, columns=(columns,), parameters=tuple(used))
        return quantity.TrackedParameter(name, runs, known, intercept, tuple(sentences))

    def solved(self, values: Mapping[str, float]) -> list[SolvedEquation]:
        """Equations with numbers, in an order in which each can be solved."""
        names = [*(term.name for term in self.terms), *(LAGS if self.has_lag else ())]
        _require_all("values", names, values, self.quantities)
        remaining = [
            SolvedEquation(
                equation.by_order(parsed(axis.response[-1])),
                tuple(
                    (values[term.name], equation.by_order(term.expression), term.behind)
                    for term in axis.terms
                ),
                axis.response[:-1],
            )
            for axis in self.axes
        ]
        known, results = {name for item in remaining for name in item.lower}, list[SolvedEquation]()
        while remaining:
            ready = [item for item in remaining if item.needed <= known]
            expected = "equations of which each holds highest derivatives of earlier ones only"
            checks.require(bool(ready), expected, "a circle of them", "Simulate it by other means.")
            results += ready
            known |= {item.solved for item in ready}
            remaining = [item for item in remaining if item not in ready]
        return results

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
            An array of shape (n,) or (n, records) for every channel that is no state of the equations. Inputs
            may be functions of time [s] and of the measured states by name.
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
        shape, rng, noises = (round(seconds / step_s), records), np.random.default_rng(seed), noise or {}
        equations = self.solved(values)
        lag_s, delay_s = (values[name] if self.has_lag else 0.0 for name in LAGS)
        longest_s = min(max(LONGEST_STEP_S, 0.1 * lag_s), 4.0 * LONGEST_STEP_S)
        substeps, (std, memory_s) = math.ceil(step_s / longest_s - 1e-9), disturbance
        h, memory = step_s / substeps, math.exp(-step_s / substeps / memory_s)
        state = {name: np.zeros(shape[1]) for e in equations for name in e.lower}
        names = [item.name for item in self.logged if item.role != "response" and item.name not in state]
        channels = [item.name for item in self.logged]
        _require_all("signals", names, signals, channels)
        for name in noises:
            checks.index_of("noise of a channel", name, channels)
        for name in names:
            series = signals[name]
            count = math.inf if callable(series) else len(np.atleast_1d(series))
            expected = f"{shape[0]} samples of {name}, for {seconds:g} s in steps of {step_s:g} s"
            checks.require(count >= shape[0], expected, f"{count}", "Give a longer series, or fewer seconds.")
        delay_steps, decay = round(delay_s / h), math.exp(-h / lag_s) if lag_s > 0.0 else 0.0
        logged = {item.name: np.zeros(shape) for item in self.logged}
        push = np.zeros((len(equations), shape[1]))
        sources, zero = [(name, signals[name]) for name in names], np.zeros(shape[1])
        queue: list[dict[str, np.ndarray]] = []
        actuated: dict[str, np.ndarray] = {}

        def derivatives(stage: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
            known: dict[str, Any] = {**now, **stage}
            for number, item in enumerate(equations):
                known[item.solved] = item.derivative(known, actuated, push[number])
            return known

        for k in range(shape[0]):
            errors = {name: noises.get(name, 0.0) * rng.standard_normal(shape[1]) for name in logged}
            measured = {name: state[name] + errors[name] for name in state if name in logged}
            now = {n: zero + (u(k * step_s, measured) if callable(u) else u[k]) for n, u in sources}
            for substep in range(substeps):
                queue.append({item.name: now[item.name] for item in self.logged if item.role == "input"})
                delayed = queue.pop(0) if len(queue) > delay_steps else queue[0]
                actuated = {n: u + decay * (actuated.get(n, u) - u) for n, u in delayed.items()}
                push = memory * push + std * math.sqrt(1.0 - memory**2) * rng.standard_normal(push.shape)
                first = derivatives(state)
                if not substep:
                    responses = {n: e.response.evaluate(first) for e in equations for n in e.others}
                    for name, series in logged.items():
                        series[k] = {**now, **state, **responses}[name] + errors[name]
                second = derivatives({name: value + h * first[f"{name}'"] for name, value in state.items()})
                state = {n: v + 0.5 * h * (first[f"{n}'"] + second[f"{n}'"]) for n, v in state.items()}
        columns = {name: series[:, 0] if shape[1] == 1 else series for name, series in logged.items()}
        return {"time": step_s * np.arange(shape[0]), **columns}

    def select(self, log: Recording, options: FlightOptions) -> Selection:
        """States, responses and commands, with the noise that is declared."""
        names = [item.name for item in self._of_role("input")]
        if options.input not in ("", *names):
            expected = f"the inputs that the machine declares ({', '.join(names)})"
            raise UsageError(
                expected, f"--input {options.input}", "Leave it out, or declare another channel."
            )
        commands = tuple(self._channel(log, item) for item in self._of_role("input"))
        states = {item.name: self._channel(log, item) for item in self._of_role("state")}
        known = [item for item in self._of_role("response") if item.name in log.channels]
        responses = {item.name: self._channel(log, item) for item in known}
        measured = [*states.values(), *responses.values()]
        slowest = min(channel.rate_hz for channel in (measured or commands))
        step_s = float(f"{1.0 / max(channel.rate_hz for channel in (*measured, *commands)):.2g}")
        band = self.band_hz or (BAND_HZ[0], min(BAND_HZ[1], BAND_SHARE * slowest))
        if self.band_hz and band[1] > NYQUIST_SHARE * slowest:
            expected = f"a band below half the rate of the slowest channel, {NYQUIST_SHARE * slowest:.3g} Hz"
            received = f"one up to {band[1]:g} Hz, of which {log.name} holds nothing"
            raise InputError(expected, received, "Log faster, or declare a lower band.")
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
        given = len(self.axes[0].instruments_of)  # all equations have the same
        references = min(len(self.references_of(axis, rule)) for axis in self.axes)
        spare = SPARE_INSTRUMENTS * (1 if given else references)
        count = math.ceil((unknowns + spare) / (given or references)) - 1
        step_s = max(flight.signals.step_s for flight in flights)
        longest_s = max((run.stop - run.start) * f.signals.step_s for f in flights for run in f.runs)
        lags = [lag for lag in TIME_CONSTANTS_S if 2.0 * step_s <= lag <= 0.1 * longest_s] or [2.0 * step_s]
        first = super().problem(flights, replace(rule, lags=(count, lags[0])))
        if not count:
            return first

        def with_lag(lag_s: float) -> LaggedRuns:
            lagged = replace(rule, lags=(count, lag_s))
            signals = ((self.axes[item.axis], flights[item.flight].signals) for item in first.columns)
            return first.with_instruments([self.instruments(*of, lagged) for of in signals])

        return max([first, *map(with_lag, lags[1:])], key=partial(_strength, _target_basis(first)))

    def checks(self, problem: LaggedRuns, estimate: Estimate, flights: Flights, /) -> MachineChecks:
        if not estimate.assembler.needs_instruments:
            return MachineChecks({})
        test = machine_verdict.ResidualTest.of(problem, estimate)
        return MachineChecks(
            machine_verdict.answers(test, problem, flights),
            machine_verdict.estimates_by_response(problem, self.axes, self.derive),
            machine_verdict.missed_term(test, problem, estimate, self.axes),
        )

    def derive(self, problem: LaggedRuns, estimate: Estimate) -> Mapping[str, QuantityEstimate]:
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
    def rules(self) -> tuple[verdict.Rule, ...]:  # type: ignore[override]
        words, moving = self.words, [term.name for term in self.terms if not term.is_intercept]
        stages = (*moving, *(LAGS if self.has_lag else ()))
        rows = [machine_verdict.active_rule(self.activity.when), machine_verdict.ANSWERING]
        if not self.activity.when:
            rows.append(machine_verdict.STANDSTILL)
        if self.has_lag:
            check = "Check that the command is that of this machine, or declare a longer one."
            rows += verdict.flight_rules(words, (*LAGS, EFFECTIVE_LAG), stages, EFFECTIVE_LAG)
            rows += verdict.lag_rules(machine_verdict.LAG_LIMIT, self.quantities[EFFECTIVE_LAG])
            delay = "The delay ran into the longest that is declared ({:.3g} s)."
            too_long = verdict.end_of_grid_rule(
                DELAY.name, (), lambda longest, _: delay.format(longest), check
            )
            rows += [verdict.longest_lag_rule((), check), too_long, machine_verdict.SLOW_SAMPLES]
        longer = partial(machine_verdict.narrower, "Log for longer, or give several logs.")
        limit = verdict.Limit(
            *self.half_widths, zero=Status.REFUSED, narrower=longer, away_from_zero=self.move
        )
        for term in self.terms:
            rows += verdict.flight_rules(
                self.words, (term.name,), stages, "" if term.is_intercept else term.name
            )
            if not term.is_intercept:
                rows += limit.rules(term.name, self.quantities[term.name])
        for item in self.derived:
            known = item.reciprocal_of or item.name
            rows += verdict.flight_rules(words, (item.name,), item.parameters, known)
            rows += limit.rules(item.name, self.quantities[item.name])
        return tuple(rows)

    @property
    def parts(self) -> tuple[verdict.SystematicPart, ...]:  # type: ignore[override]
        """Commands between those logged, responses that disagree, a missed term, parameters that change."""
        clock = (verdict.clock_part((*LAGS, EFFECTIVE_LAG)),) if self.has_lag else ()
        names, derived = (*self.quantities,), {item.name: item.of for item in self.derived}
        return (*clock, *machine_verdict.parts(names, derived))

    def view(self, flight: PreparedFlight) -> FlightView:
        behind = " behind a lag τ and a delay d" if self.has_lag else ""
        inputs = ", ".join(item.name for item in self._of_role("input"))
        labels = {
            item.name: f"{item.name.replace('_', ' ')}\n[{item.unit}]" for item in self._of_role("state")
        }
        panels = (flight.plot_data(label, of=name) for name, label in labels.items())
        return FlightView(f"{inputs}{behind}", tuple(panels))

    def _of_role(self, role: str) -> tuple[MachineChannel, ...]:
        return tuple(channel for channel in self.logged if channel.role == role)

    def _channel(self, log: Recording, declared: MachineChannel) -> Channel:
        """A channel of a log, held and with noise as it is declared."""
        channel = log.channel(declared.name)
        noise = channel.noise if declared.noise is None else declared.noise
        return replace(channel, held=declared.held, noise=noise)

    def _excitation(self, flights: Flights) -> str:
        moving = (*self._of_role("input"), *self._of_role("state"))
        return deviations(flights, ((c.name.replace("_", " "), c.name, c.unit, 1.0) for c in moving))

    def _findings(self, flights: Flights, _quantities: Mapping[str, Quantity]) -> tuple[Finding, ...]:
        """Share of the logs that counts, unless it is all."""
        share = 1.0 - machine_verdict.active_share(flights)
        if self.activity.when or not (self.activity.moving and share):
            return ()
        rules = "; ".join(dict.fromkeys(flight.active.rule for flight in flights))
        sentence = (
            f"Standstill is left out, {share:.0%} of the log ({rules}): the sign of a speed is not known "
            "there. Declare [active] for another rule."
        )
        return (Finding("standstill", sentence),)


def _target_basis(problem: LaggedRuns) -> Float[np.ndarray, "rows n"]:
    """Basis of the regressors and of the derivative with respect to the lag."""
    nuisances = {item.name: float(item.grid[(item.grid.size - 1) // 2]) for item in problem.nuisances}
    bins = problem.bins(nuisances)
    columns, response = bins.regressors, bins.responses[:, -1]
    if problem.nuisances[0].searched:
        theta = np.linalg.lstsq(columns, response)[0]
        slope = problem.nuisances[0].derivative(lambda x: problem.bins(x).regressors @ theta, nuisances)
        columns = np.column_stack([columns, slope])
    return _basis(columns)


def _strength(target: Float[np.ndarray, "rows n"], problem: LaggedRuns) -> float:
    """Least canonical correlation of the instruments with the target basis."""
    return float(np.linalg.svd(_basis(problem.instrument_bins).T @ target, compute_uv=False)[-1])


def _basis(matrix: np.ndarray) -> Float[np.ndarray, "rows n"]:
    rows = np.concatenate([matrix.real, matrix.imag])
    sizes = np.linalg.norm(rows, axis=0)
    return np.asarray(np.linalg.qr(rows / np.where(sizes > 0.0, sizes, 1.0))[0])


def _intercept(problem: LaggedRuns, estimate: Estimate, axis: int, term: Term) -> QuantityEstimate:
    """Mean residual of the other terms over the term's number; its error includes the parameters'."""
    residuals, regressors, theta = [], [], estimate.theta
    for item in problem.columns:
        if item.axis == axis:
            rows = item.all_columns(estimate.nuisances, theta.size)
            residuals += item.cut(item.responses[:, -1] - rows @ theta)
            regressors += item.cut(rows)
    series, per = np.concatenate(residuals), float(term.expression.evaluate({}))
    # power of the residual at the lowest frequencies, where the error of a mean is from
    position = np.pi * (np.arange(series.size) + 0.5) / series.size
    waves = [np.sqrt(2.0 / series.size) * np.cos(k * position) for k in range(1, AVERAGES + 1)]
    power = np.mean([float(wave @ (series - series.mean())) ** 2 for wave in waves])
    sigma = math.sqrt(power / series.size)
    direction = np.zeros(len(estimate.names))
    direction[: theta.size] = np.concatenate(regressors).mean(axis=0)
    covariance = estimate.joint_covariance
    error = math.hypot(sigma, covariance.std_error(direction)) / abs(per)
    half = math.hypot(t_quantile(LEVEL, AVERAGES) * sigma, covariance.half_width(direction, LEVEL)) / abs(per)
    value = float(series.mean()) / per
    return QuantityEstimate(value, term.unit, error, (value - half, value + half))
