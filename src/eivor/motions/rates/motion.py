"""Turning rates: axes, equations, selection, systematic parts and verdict."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain

import numpy as np

from eivor.errors import DataError, EstimationError, InputError, MissingChannelError, UsageError
from eivor.estimation.estimate import Estimate
from eivor.estimation.methods import by_name, identify
from eivor.flights import quantity, verdict
from eivor.flights.grid import Active, Grid, airborne_by_log, on_grid
from eivor.flights.lag_prior import EFFECTIVE_LAG
from eivor.flights.motion import Abilities, Flights, FlightView, Prediction, Solver, motion_tables
from eivor.flights.options import FlightOptions
from eivor.flights.prepared import PreparedFlight, Selection, check_vehicle, chosen_input, deviations
from eivor.flights.references import HEADED, ReferenceSource, with_headed_references
from eivor.inference.diagnostics.instruments import STRONG_FIRST_STAGE
from eivor.inference.verdict import Cause, Status
from eivor.models import lagged_runs
from eivor.models.frequency_response import local_polynomials, spectra
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY, SECOND_STAGE, LaggedRuns
from eivor.models.regression import Parameter
from eivor.models.separable import AT_END, InstrumentRule, LaggedReferences, WarmStart
from eivor.motions.equation import AxisEquation, DeclaredMotion, Term, equation_prediction, simple_models
from eivor.signals.filters import actuator_state, integrated
from eivor.signals.recording import GRAVITY, HELICOPTER, Channel, Finding, Recording
from eivor.tools import Bool, Float

TABLES = motion_tables("eivor.motions.rates")
QUANTITIES = quantity.QuantityTable(TABLES.quantities)
TORQUE = "torque_setpoint"

#: Lags of each reference, how many and how long [s]: those that rates follow, and velocity across.
REFERENCE_LAGS, ACROSS_LAGS = (4, 0.06), (2, 1.0)
#: Lags and delays to search [s]. A lag of 1/D with a damping of 1/tau turns the vehicle as a lag of tau with
#: a damping of D does, but for the gain: lags as long as damping takes are not searched.
LAGS_S = np.geomspace(0.004, 0.15, 30)
DELAYS_S = (0.0, 0.005, 0.010, 0.015, 0.020, 0.030)

#: Setpoints across the ground that tilt the vehicle about an axis.
TILTED_BY = {"roll": HEADED["left"], "pitch": HEADED["forward"]}
#: What drag off the centre of mass does by the velocity across.
BY_DRAG = {"roll": "roll_by_drag_y", "pitch": "pitch_by_drag_x"}


class Axis(AxisEquation):
    """Turning about one of the body's axes: p' = G u - D p, about yaw with a reaction J u'."""

    @property
    def torque(self) -> str:
        """Channel of the setpoint."""
        return self.inputs[0]

    @property
    def rate(self) -> str:
        """Channel of the rate."""
        return self.torque.replace(TORQUE, "angular_rate")

    def answers(self, flights: Flights) -> bool:
        """Whether a reference of the axis that serves answers the vehicle."""
        names = [source.channel for source in self.references]
        serving = [item for flight in flights for item in flight.references if item.usable]
        return any(item.name in names and not item.exogenous for item in serving)


def _term(name: str, of: str, *, behind: bool = True) -> Term:
    return Term(name, of, QUANTITIES[name].symbol, QUANTITIES[name].unit, behind)


def _axis(name: str, letter: str) -> Axis:
    rate, torque = f"angular_rate_{letter}", f"{TORQUE}_{letter}"
    terms = [
        _term(f"{name}_damping", f"-{rate}", behind=False),
        _term(f"{name}_effectiveness", torque),
        *([_term("yaw_reaction", f"ddt({torque})")] if name == "yaw" else ()),
    ]
    references = (
        ReferenceSource(f"injected_torque_{letter}", axis=name),
        ReferenceSource(f"reference_{name}", axis=name),
        ReferenceSource(f"reference_angular_rate_{letter}", axis=name),
        *(ReferenceSource(channel, axis=name, distant=True) for channel in TILTED_BY.get(name, ())),
        ReferenceSource(f"pilot_{name}", in_control="pilot_sets_attitude", axis=name),
        ReferenceSource(f"feedback_reference_{name}", axis=name),
    )
    return Axis(
        name,
        (torque,),
        (f"ddt({rate})",),
        tuple(terms),
        (f"{name} acceleration", "rad/s²", "G u − D ω", "G u"),
        references,
        REFERENCE_LAGS,
        (rate, f"{name} rate", "rad/s"),
    )


AXES = ROLL, PITCH, YAW = _axis("roll", "x"), _axis("pitch", "y"), _axis("yaw", "z")
TERMS = tuple(term.name for axis in AXES for term in axis.terms)
DAMPINGS = tuple(f"{axis.name}_damping" for axis in AXES)
EFFECTS = tuple(f"{axis.name}_effectiveness" for axis in AXES)


def rate_panel(flight: PreparedFlight, axis: Axis) -> quantity.PlotData:
    """Rate about one axis, and its setpoint where the log has one."""
    label, wanted = f"{axis.name} rate\n[deg/s]", f"reference_{axis.rate}"
    return flight.plot_data(label, of=axis.rate, reference=wanted, scale=np.rad2deg(1.0))


# -- Select --

REFERENCES = tuple(source for axis in AXES for source in axis.references)
#: Band of spectral rows [Hz], and how far it reaches where references move the setpoints.
BAND_HZ, FURTHEST_HZ = (0.3, 8.0), 20.0
#: It ends at this share of a log's rate.
BAND_SHARE = 0.2
#: Steps of the grid [s], and from which rate of the gyroscope on the fine one is taken [Hz].
FINE_STEP_S, STEP_S, FINE_FROM_HZ = 0.005, 0.010, 95.0
#: PX4 issues torques, not thrust, at this rate, which its gyroscope's buffer rounds.
RATE_PARAMETER = "IMU_GYRO_RATEMAX"
#: What determines that a vehicle flies where no land detector is logged, by its mean.
LEVELS = ("input", "rotor_command", "rotor_speed")
#: No vehicle turns so fast; values beyond are in degrees a second [rad/s].
FASTEST_RATE = 40.0


def selected(log: Recording, options: FlightOptions, offered: tuple[Axis, ...]) -> Selection:
    """Channels of a log by role, of the axes that are logged."""
    check_vehicle(log, options, HELICOPTER)  # its blades turn it, behind a lag of their own
    remedy = "Log the torque setpoints at 50 Hz or more"
    family, _ = chosen_input(log, TABLES.channels.inputs, options.input, remedy=remedy)
    if family.name != TORQUE:
        raise UsageError(f"the input {TORQUE} for turning", f"'{options.input}'", "Leave --input out.")
    axes = [axis for axis in offered if axis.torque in log.channels and axis.rate in log.channels]
    if not axes:
        needed = " or ".join(f"{axis.torque} with {axis.rate}" for axis in offered)
        remedy = "Log torque setpoint and rate of an axis."
        raise MissingChannelError(f"{needed} in {log.name}", "a log without", remedy)
    rates = {axis.name: log.channel(axis.rate) for axis in axes}
    for rate in rates.values():
        refuse_degrees(rate, log)
    slowest = min(rate.rate_hz for rate in rates.values())
    missing = [axis.name for axis in offered if axis not in axes]
    looked_at = f"{' and '.join(axis.name for axis in axes)} {'is' if len(axes) == 1 else 'are'} looked at"
    return Selection(
        family,
        tuple(log.channel(axis.torque) for axis in axes),
        states=rates,
        responses={},
        log=with_headed_references(log),
        band_hz=(BAND_HZ[0], min(BAND_HZ[1], BAND_SHARE * slowest)),
        findings=tuple(
            Finding(f"no_{name}", f"Torque setpoint or rate of {name} is not logged: {looked_at} alone.")
            for name in missing
        )
        + limits(log),
        issued_within_s=float(np.median(np.diff(rates[axes[0].name].time_s))),  # once a rate, or oftener
        rate_parameter=RATE_PARAMETER,
        step_s=FINE_STEP_S if slowest >= FINE_FROM_HZ else STEP_S,
        matched_interpolation_filter=True,
        active=active,
    )


#: Frequencies in a doubling at which coherence of reference and setpoint is tested, and p-value of each.
LOOKED_AT, CHANCE = 6, 0.01


def _up_to_reach(columns: lagged_runs.AxisColumns, flight: PreparedFlight) -> lagged_runs.AxisColumns:
    """Equation of an axis up to the frequency at which its references' coherence with the setpoint ends."""
    (low, high), axis = columns.band_hz, AXES[columns.axis]
    furthest = min(FURTHEST_HZ, BAND_SHARE * min(flight.rates_hz[name] for name in (axis.name, "command")))
    if high < BAND_HZ[1] or furthest <= high:
        return columns
    frequency = np.geomspace(high, furthest, math.ceil(LOOKED_AT * math.log2(furthest / high)) + 1)
    setpoint = columns.moving({ACTUATOR_LAG.name: 0.0, DELAY.name: 0.0})[:, 0]
    for reference in columns.instruments.T[:: REFERENCE_LAGS[0] + 1]:
        pair = np.column_stack([reference, setpoint, setpoint])
        runs = spectra([pair[run] for run in columns.runs], columns.step_s)
        moved = local_polynomials(runs, frequency).significance < CHANCE
        last = np.flatnonzero(moved[1:] & moved[:-1])
        if last.size:
            high = max(high, float(frequency[last[-1] + 1]))
    return replace(columns, band_hz=(low, high))


def refuse_degrees(rate: Channel, log: Recording) -> None:
    """Refuse a rate that is faster than any vehicle turns."""
    fastest = float(np.nanmax(np.abs(rate.values), initial=0.0))
    usual = float(np.nanquantile(np.abs(rate.values), 0.99)) if rate.values.size else 0.0
    if usual > FASTEST_RATE:
        expected = f"body rates in rad/s in {log.name}"
        received = f"{rate.name} up to {fastest:.3g}, which look like degrees"
        raise InputError(expected, received, 'State the unit in a channel map (unit = "deg/s").')


#: What lies so close to a sample at a limit of the gyroscope's range does not count [s].
LIMIT_MARGIN_S = 0.02


def limits(log: Recording) -> tuple[Finding, ...]:
    """Rates at a limit of the gyroscope's range."""
    limited = [rate for rate in log.family("angular_rate") if rate.limited.any()]
    return tuple(Finding("clipped_gyroscope", f"{rate.at_limit()}, which do not count.") for rate in limited)


def within_range(log: Recording, grid: Grid) -> Bool[np.ndarray, " n"] | None:
    """Samples away from limits of the gyroscope's range; None for all."""
    times = np.sort(np.concatenate([rate.time_s[rate.limited] for rate in log.family("angular_rate")]))
    if not times.size:
        return None
    after = np.searchsorted(times, grid.time_s - LIMIT_MARGIN_S)
    return np.append(times, np.inf)[after] > grid.time_s + LIMIT_MARGIN_S


def active(log: Recording, grid: Grid, _input_level: Float[np.ndarray, " n"], /) -> Active:
    """Samples in the air: torque setpoints do not identify, so by the land detector."""
    counted = within_range(log, grid)
    members = next((members for family in LEVELS if (members := log.family(family))), [])
    if not members and "landed" not in log.channels:
        why = "nothing: neither a land detector nor thrust is logged"
        return Active(np.ones(grid.count, dtype=np.bool_), why, counted)
    levels = [on_grid(member, grid)[0] for member in members] or [np.ones(grid.count)]
    return replace(airborne_by_log(log, grid, np.mean(levels, axis=0)), counted=counted)


#: What that does to an effectiveness, as a share of it, and to the lag [s].
ROTOR_SHARE, ROTOR_LAG_S = 0.02, 0.001
ROTORS = "Rotors lag in speed, and their thrust goes with its square: large or noisy setpoints change the "
LAGS = (ACTUATOR_LAG.name, EFFECTIVE_LAG)
#: Two equal lags act, to second order, as one of 2^(1/2) times each with a delay: this share of that lag.
IMITATED_SHARE = 2.0**0.5 - 1.0


def _imitated_s(lag_s: float) -> float:
    """Delay by which one lag may imitate a second stage, or none a short lag [s]."""
    return IMITATED_SHARE * lag_s if lag_s > 0.0 else float(LAGS_S[0])


@dataclass(frozen=True)
class OrderChecks(verdict.MotionChecks):
    """Change of quantities by a second actuator stage that flights neither show nor exclude."""

    changes: Mapping[str, float] = field(default_factory=dict)
    #: How far the dampings that are left by drag beside the centre of mass reach down and up
    by_drag: Mapping[str, tuple[float, float]] = field(default_factory=dict)


def _second_stage(inputs: verdict.VerdictInputs, name: str) -> tuple[float, float]:
    """Change of a quantity by the order that was not selected, down and up."""
    lag_s, second = inputs.quantities[ACTUATOR_LAG.name].value, inputs.quantities.get(lagged_runs.SECOND_LAG)
    if inputs.order_given:
        return 0.0, 0.0
    change = inputs.checks.changes.get(name, 0.0)
    if second is None:
        imitated_s = _imitated_s(lag_s)
    else:
        imitated_s = math.hypot(lag_s - second.value, second.value) - lag_s
    ends = 0.0, change, {DELAY.name: -imitated_s, ACTUATOR_LAG.name: imitated_s}.get(name, 0.0)
    return -min(ends), max(ends)


def _second_stage_sentence(inputs: verdict.VerdictInputs) -> str:
    less, more = (1e3 * end for end in _second_stage(inputs, DELAY.name))
    of, by_ms, other = ("lag", more, "delay") if more > less else ("delay", less, "lag")
    what = f"of the {of} {by_ms:.2g} ms may be {other}"
    return f"A motor and its controller lag in two stages, which one lag and a delay imitate: {what}."


PARTS = (
    verdict.disagreement_part((*LAGS, DELAY.name, *TERMS, *BY_DRAG.values())),
    *verdict.clock_parts((*LAGS, DELAY.name), (*EFFECTS, "yaw_reaction")),
    verdict.SystematicPart(
        (*LAGS, DELAY.name, *TERMS), quantity.Counts.ADDED, _second_stage, _second_stage_sentence
    ),
    verdict.SystematicPart(
        DAMPINGS,
        quantity.Counts.ADDED,
        lambda inputs, name: inputs.checks.by_drag.get(name, 0.0),
        "Drag above or below the centre of mass may turn it: intervals reach to the damping without it.",
    ),
    verdict.SystematicPart(LAGS, quantity.Counts.ADDED, lambda *_: ROTOR_LAG_S, f"{ROTORS}lag by 1 ms."),
    verdict.SystematicPart(
        EFFECTS,
        quantity.Counts.ADDED,
        lambda inputs, name: ROTOR_SHARE * abs(inputs.quantities[name].value),
        f"{ROTORS}effectiveness by 2 %.",
    ),
)

#: Two lags that are nearly equal, and one that is next to none: their product over the square of their sum.
EQUAL_STAGES, LEAST_STAGE = 0.2, 0.02
#: What is so many standard errors from none is there: Akaike's criterion falls by 2.
TERM_ERRORS = 2.0


def refined(
    problem: LaggedRuns, solve: Solver[LaggedRuns], options: FlightOptions, flights: Flights
) -> tuple[LaggedRuns, Estimate]:
    """The estimate, with moments by drag and a second stage of the actuators where the flights show them."""
    estimate = solve(problem)
    if not _by_drag(estimate):
        try:
            wider = with_drag_moments(problem, flights)
            other = solve(wider)
        except (DataError, EstimationError):  # samples or instruments are too few for it
            pass
        else:
            problem, estimate = (wider, other) if _shows_drag(other) else (problem, estimate)
    return chosen_order(problem, estimate, solve, options)


def _by_drag(estimate: Estimate) -> list[str]:
    return [name for name in BY_DRAG.values() if name in estimate.names]


def _shows_drag(estimate: Estimate) -> bool:
    """Whether the instruments of all moments by drag are strong, and one moment is not zero."""
    strength, moments = dict(zip(estimate.names, estimate.first_stage, strict=True)), _by_drag(estimate)
    beyond = [abs(estimate.parameters[name]) > TERM_ERRORS * estimate.std_error(name) for name in moments]
    return any(beyond) and all(strength[name] >= STRONG_FIRST_STAGE for name in moments)


def chosen_order(
    problem: LaggedRuns, estimate: Estimate, solve: Solver[LaggedRuns], options: FlightOptions
) -> tuple[LaggedRuns, Estimate]:
    """The estimate, with a second stage of the actuators where the flights show one."""
    staged = replace(problem, nuisances=lagged_runs.with_order(problem.nuisances, 3))
    if options.order is not None or len(staged.nuisances) == len(problem.nuisances):
        return problem, estimate
    lag_s = estimate.nuisances[ACTUATOR_LAG.name]
    without_lag = lag_s <= LAGS_S[0] + AT_END * lagged_runs.TOLERANCE_S
    if without_lag:
        candidate = replace(problem, nuisances=lagged_runs.with_order(problem.nuisances, 1))
    elif DELAY.name not in estimate.names or estimate.std_error(DELAY.name) > _imitated_s(lag_s):
        return problem, estimate  # nothing to gain: a second stage changes the delay by less than is known
    else:
        # from two equal lags that the one imitates: from none on, the criterion falls to neither side
        delay_s = max(estimate.nuisances[DELAY.name] - _imitated_s(lag_s), 0.0)
        both_s = min(2.0**0.5 * lag_s, float(LAGS_S[-1]))
        values = {ACTUATOR_LAG.name: both_s, DELAY.name: delay_s, SECOND_STAGE.name: EQUAL_STAGES}
        candidate = replace(staged, warm_start=WarmStart(estimate.theta, values))
    try:
        other = solve(candidate)
    except EstimationError:
        return problem, estimate
    if without_lag or other.nuisances[SECOND_STAGE.name] > TERM_ERRORS * other.std_error(SECOND_STAGE.name):
        return candidate, other
    if other.nuisances[SECOND_STAGE.name] < LEAST_STAGE:
        return problem, estimate
    return problem, replace(estimate, other_order={**other.parameters, **other.nuisances})


TURN_LONGER = "Fly turns that last longer."
QUICKER = "Fly quicker steps, and log setpoints and rates faster."
LEAST_S = 15.0
EFFECTIVENESS = verdict.Limit(
    0.1, 0.25, zero=Status.REFUSED, narrower="Fly larger and quicker steps, or longer."
)
DAMPING = verdict.Limit(0.5, zero=Status.WEAK, narrower=TURN_LONGER)
LAG = verdict.Limit(0.25, 0.5, 0.02, 0.02, narrower=QUICKER)


def axis_rules(axis: Axis) -> tuple[verdict.Rule, ...]:
    """Rows of the quantities of an axis."""
    damping, effect, *_ = names = [term.name for term in axis.terms]
    names += [BY_DRAG[axis.name]] if axis.name in BY_DRAG else []
    opposite = f"setpoint and rate of {axis.name} have opposite signs"
    check = f"Check the axes and signs of {axis.torque} and {axis.rate}."
    pushed = "a torque of the air moved with the references"
    loop = f"The setpoint of {axis.name} answers the vehicle's disturbances"

    def answering(when: Callable[[verdict.VerdictInputs], bool], status: Status, words: str) -> verdict.Rule:
        def both(inputs: verdict.VerdictInputs) -> bool:
            return axis.answers(inputs.flights) and when(inputs)

        return verdict.Rule(tuple(names), both, status, words, TABLES.words.log_planned, Cause.INSTRUMENT)

    each = [
        verdict.flight_rules(TABLES.words, (name,), (effect, name, ACTUATOR_LAG.name), name) for name in names
    ]
    return (
        *chain.from_iterable(each),
        answering(
            lambda _: True, Status.PROVISIONAL, f"{loop}: how far that moves the numbers is not known."
        ),
        answering(
            lambda inputs: inputs.p_value < verdict.DOUBTFUL,
            Status.REFUSED,
            f"{loop}, and the references disagree: no interval is long enough for what that does.",
        ),
        verdict.below_zero_rule(effect, QUANTITIES[effect], Status.REFUSED, opposite, check),
        verdict.below_zero_rule(damping, QUANTITIES[damping], Status.WEAK, pushed, "Fly in calm air."),
        *EFFECTIVENESS.rules(effect, QUANTITIES[effect]),
        *(rule for name in names if name not in EFFECTS for rule in DAMPING.rules(name, QUANTITIES[name])),
    )


RULES = (
    verdict.seconds_rule(LEAST_S),
    *verdict.flight_rules(TABLES.words, (*LAGS, DELAY.name), (ACTUATOR_LAG.name,), EFFECTIVE_LAG),
    verdict.Rule(
        (*LAGS, DELAY.name),
        lambda inputs: all(
            low <= 0.0 <= high
            for low, high in [item.interval for name, item in inputs.quantities.items() if name in EFFECTS]
        ),
        Status.REFUSED,
        "No effectiveness is distinguished from zero, so that nothing shows the lag.",
        EFFECTIVENESS.narrower,
    ),
    verdict.longest_lag_rule(
        (), "Check that the setpoints are those of this vehicle, and their time stamps."
    ),
    *verdict.lag_rules(LAG, QUANTITIES[EFFECTIVE_LAG]),
    *(rule for axis in AXES for rule in axis_rules(axis)),
)


def turning(flights: Flights) -> tuple[Axis, ...]:
    """Roll and pitch, or what all flights log in their place."""
    logged = [axis for axis in AXES if all(axis.rate in flight.signals.channels for flight in flights)]
    return tuple(axis for axis in logged if axis is not YAW) or (YAW,)


def excitation(flights: Flights, axes: tuple[Axis, ...] = ()) -> str:
    """Standard deviations of the rates, of roll and pitch where no axes are given."""
    turned = axes or turning(flights)
    return deviations(
        flights, ((f"{axis.name} rate", axis.rate, "deg/s", np.rad2deg(1.0)) for axis in turned)
    )


def with_drag_moments(problem: LaggedRuns, flights: Flights) -> LaggedRuns:
    """The problem with what drag above or below the centre of mass does to roll and pitch."""
    tilting = [axis for axis in problem.axes if AXES[axis].name in BY_DRAG]
    columns = []
    for item in problem.columns:
        added, instruments = np.zeros((item.fixed.shape[0], len(tilting))), [item.instruments]
        if item.axis in tilting:
            added[:, tilting.index(item.axis)] = _velocity_across(flights[item.flight], AXES[item.axis])
            slow = item.instruments[:, :: REFERENCE_LAGS[0] + 1]
            for _ in range(ACROSS_LAGS[0] if slow.size else 0):
                slow = actuator_state(slow, step_s=item.step_s, lag_s=ACROSS_LAGS[1], delay_s=0.0)
                instruments.append(slow)
        added = np.hstack([item.fixed, added])
        columns.append(replace(item, fixed=added, instruments=np.hstack(instruments)))
    moments = [Parameter(name, QUANTITIES[name].unit) for name in (BY_DRAG[AXES[k].name] for k in tilting)]
    parameters = (*problem.parameters[: problem.still], *moments, *problem.parameters[problem.still :])
    return replace(problem, columns=tuple(columns), parameters=parameters)


def _velocity_across(flight: PreparedFlight, axis: Axis) -> Float[np.ndarray, " n"]:
    """Velocity to the left by roll, or forward by pitch, that the weight makes of the tilt [m/s]."""
    signals, weight = flight.signals, GRAVITY if axis == PITCH else -GRAVITY
    velocity = np.zeros(signals.sample_count)
    for run in flight.runs:
        tilt = integrated(signals.channel(axis.rate)[run], signals.step_s)
        velocity[run] = weight * integrated(tilt, signals.step_s)
    return velocity


def reach_by_drag(
    problem: LaggedRuns, estimate: Estimate, flights: Flights
) -> dict[str, tuple[float, float]]:
    """Reach of dampings if drag beside the centre of mass turns, where flights do not show it."""
    if _by_drag(estimate):
        return {}
    at = tuple(nuisance.known_at(estimate.nuisances[nuisance.name]) for nuisance in problem.nuisances)
    try:
        wider = with_drag_moments(replace(problem, nuisances=at, warm_start=None), flights)
        other = identify(wider, by_name(estimate.method))
    except (DataError, EstimationError):  # samples or instruments are too few for it
        return {}
    both = (
        (name, *estimate.interval(name), *other.interval(name)) for name in DAMPINGS if name in other.names
    )
    return {name: (max(low - least, 0.0), max(most - high, 0.0)) for name, low, high, least, most in both}


@dataclass(frozen=True)
class Rates(DeclaredMotion[LaggedRuns]):
    """p' = G u - D p + b about each axis, behind the lag of the actuators."""

    axes: tuple[Axis, ...] = AXES

    name = "rates"
    grids = LAGS_S, DELAYS_S
    words = TABLES.words
    equation = TABLES.equation
    quantities = QUANTITIES
    rules = RULES
    parts = PARTS
    channels = replace(TABLES.channels, references=REFERENCES)
    abilities = Abilities(
        refined=refined,
        prediction=Prediction(simple_models, multi_step=partial(equation_prediction, AXES)),
        excitation=excitation,
        coupled_axes=TABLES.coupled_axes,
    )

    def select(self, log: Recording, options: FlightOptions) -> Selection:
        return selected(log, options, self.axes)

    def problem(self, flights: Flights, rule: InstrumentRule) -> LaggedRuns:
        problem = super().problem(flights, rule)
        if not isinstance(rule, LaggedReferences):
            return problem
        columns = (_up_to_reach(column, flights[column.flight]) for column in problem.columns)
        return replace(problem, columns=tuple(columns))

    def checks(self, problem: LaggedRuns, estimate: Estimate, flights: Flights, /) -> OrderChecks:
        other, here = estimate.other_order, {**estimate.parameters, **estimate.nuisances}
        changes = {name: other[name] - value for name, value in here.items() if name in other}
        changes[EFFECTIVE_LAG] = sum(changes.get(item.name, 0.0) for item in (ACTUATOR_LAG, DELAY))
        return OrderChecks(changes, reach_by_drag(problem, estimate, flights))

    def view(self, flight: PreparedFlight) -> FlightView:
        symbols = f"u = {flight.input.name} of each axis, behind a lag τ and a delay d that all share"
        return FlightView(symbols, tuple(rate_panel(flight, axis) for axis in turning((flight,))))
