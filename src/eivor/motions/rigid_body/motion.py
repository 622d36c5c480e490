"""The motion of the rigid body: selection of channels, quantities, full-band fit."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import cast

import numpy as np

from eivor.errors import DataError, EstimationError, InputError, UsageError
from eivor.estimation.estimate import Estimate
from eivor.estimation.linear import OUTPUT_ERROR, LinearMethod, first_steps
from eivor.estimation.methods import by_name
from eivor.flights import motion
from eivor.flights.grid import Active, Grid
from eivor.flights.lag_prior import EFFECTIVE_LAG, LAG_SUMS, joint_quantities, lag_quantities, linear_quantity
from eivor.flights.options import FlightOptions
from eivor.flights.prepared import PreparedFlight, Selection, check_vehicle, chosen_input
from eivor.flights.quantity import Implications, Quantity, QuantityEstimate, Trace
from eivor.flights.references import with_headed_references
from eivor.flights.timestamps import with_corrected_stamps
from eivor.inference.distributions import normal_quantile
from eivor.models.lagged_runs import ACTUATOR_LAG, ASYMMETRIES, ASYMMETRY, AxisColumns, LaggedRuns
from eivor.models.separable import InstrumentRule, NoInstruments, Nuisance, WarmStart
from eivor.motions.equation import AxisEquation, DeclaredMotion, simple_models
from eivor.motions.rates.motion import (
    AXES,
    RATE_PARAMETER,
    active,
    excitation,
    limits,
    rate_panel,
    refuse_degrees,
)
from eivor.motions.rigid_body import regression, verdict
from eivor.motions.rigid_body.compatibility import SLOPE_S, in_still_air, with_one_clock, with_velocity
from eivor.motions.rigid_body.dynamics import ATTITUDE, continuous, vector_part
from eivor.motions.rigid_body.output_error import NOT_NEGATIVE, refined_by_output_error
from eivor.motions.rigid_body.physical_parameters import Combinations, physical_parameters
from eivor.motions.rigid_body.predict import rigid_body_prediction
from eivor.motions.rigid_body.regression import AT_HOVER, BAND_SHARE, FORCE_X_EQUATION, TABLES, noisier
from eivor.motions.rigid_body.vehicle import KnownVehicle, load_vehicle, shipped_vehicles, vehicle_from_record
from eivor.motions.vertical.select import TABLES as HEIGHT
from eivor.signals.recording import Channel, Finding, Recording
from eivor.signals.signals import Signals
from eivor.tools import Float

# -- Attitude order --

#: Over which turning is looked at [s]: longer than a sensor's noise, shorter than a turn.
OVER_S = 0.04
#: Residual of the rates, as a share of them: larger by a wrong order, smaller by the right one.
WRONG, RIGHT = 0.8, 0.5
#: Orders that attitudes are written in, by the signed place of w, x, y, z among the logged four.
ORDERS = {
    "x, y, z, w": ((3, 1), (0, 1), (1, 1), (2, 1)),
    "w, x, y, z from world to body": ((0, 1), (1, -1), (2, -1), (3, -1)),
    "x, y, z, w from world to body": ((3, 1), (0, -1), (1, -1), (2, -1)),
}
AS_NAMED = ((0, 1), (1, 1), (2, 1), (3, 1))


def refuse_other_turns(attitude: Sequence[Channel], rates: Sequence[Channel], log_name: str) -> None:
    """Refuse an attitude that turns otherwise than the gyroscope says, where another order or unit does."""
    time = attitude[0].time_s
    if len({item.values.size for item in attitude}) != 1:
        return
    logged = continuous(np.stack([item.values for item in attitude]))
    known = np.isfinite(logged).all(axis=0)
    time, logged = time[known], logged[:, known]
    lag = max(1, round(OVER_S / float(np.median(np.diff(time))))) if time.size > 1 else 1
    if time.size <= 2 * lag:
        return
    angles = np.stack([_angle(rate, time) for rate in rates])
    width = np.maximum(time[lag:] - time[:-lag], 1e-9)
    measured = (angles[:, lag:] - angles[:, :-lag]) / width
    size = float(np.sqrt(np.mean(measured**2)))
    if not size > 0.0:
        return

    def residual_share(order: Sequence[tuple[int, int]]) -> float:
        parts = np.stack([sign * logged[item] for item, sign in order])
        return float(np.sqrt(np.mean((_rates_of(parts, lag) / width - measured) ** 2))) / size

    if residual_share(AS_NAMED) <= WRONG:
        return
    by_attitude = _rates_of(logged, lag) / width
    degrees = float(np.sqrt(np.mean((by_attitude - np.deg2rad(measured)) ** 2)))
    if degrees < RIGHT * np.deg2rad(size):
        fast = "and others that turn 57 times as fast as the attitude, which look like degrees"
        remedy = 'State the unit in a channel map (unit = "deg/s").'
        raise InputError(f"body rates in rad/s in {log_name}", f"{rates[0].name} {fast}", remedy)
    results = {name: residual_share(order) for name, order in ORDERS.items()}
    best = min(results, key=lambda name: results[name])
    if results[best] < RIGHT:
        received = f"one that turns as the gyroscope says only when it is read as {best}"
        remedy = "Map its four parts in this order, with the signs that turn it from body to world."
        raise InputError(f"an attitude w, x, y, z from body to world in {log_name}", received, remedy)


def _angle(rate: Channel, time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Angle by which a rate has turned at times, from some time on [rad]."""
    known = np.isfinite(rate.values)
    t, values = rate.time_s[known], rate.values[known]
    angle = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(t))])
    return np.interp(time_s, t, angle)


def _rates_of(parts: Float[np.ndarray, "4 n"], separated: int) -> Float[np.ndarray, "3 m"]:
    """Small turns on the body's axes between attitudes so many samples apart [rad]."""
    return 2.0 * vector_part(parts[:, :-separated], parts[:, separated:])


# -- Select --

#: What was asked of height, without the thrust command itself, and of attitude.
REFERENCES = (
    *(reference for axis in AXES for reference in axis.references),
    *(item for item in HEIGHT.channels.references if item.channel.startswith("reference_")),
)
#: The grid's step is that of the gyroscope, within these [s].
SHORTEST_STEP_S, LONGEST_STEP_S = 0.002, 0.010
#: All that any of the equations uses [Hz].
BAND_HZ = (0.05, 20.0)
#: Rotors that never differ by more than this share of their largest command turn nothing.
NO_DIFFERENCE = 1e-9
#: Quaternions that are further from one in length are none.
UNIT_WITHIN = 0.05


def selected(log: Recording, options: FlightOptions, vehicle: KnownVehicle) -> Selection:
    """Channels of a log by role."""
    log, stamp_findings = with_corrected_stamps(log)
    check_vehicle(log, options)
    original, log, spans_s = log, with_velocity(log), (options.window or log.span_s,)
    log, clock_notes = with_one_clock(log, spans_s, vehicle.gyro_cutoff_hz)
    log, wind = in_still_air(log, spans_s)
    remedy = "Log the rotor commands or speeds at 100 Hz or more"
    family, commands = chosen_input(log, TABLES.channels.inputs, options.input, remedy=remedy)
    family = replace(family, input_map=vehicle.thrust_map)
    if len(commands) != vehicle.count:
        expected = f"{vehicle.count} rotors, as the vehicle has"
        remedy = "Give the vehicle file of this vehicle, or map the channels of all its rotors."
        raise InputError(expected, f"{len(commands)} channels {family.name} in {log.name}", remedy)
    _refuse_no_differences(commands, vehicle, log)
    rates = {axis.name: log.channel(axis.rate) for axis in AXES}
    for rate in rates.values():
        refuse_degrees(rate, log)
    _refuse_no_quaternion(log)
    forces = {f"force_{axis}": log.channels.get(f"specific_force_body_{axis}") for axis in "xyz"}
    moving, tilted = ({*names} <= {*log.channels} for names in (regression.NEEDED, ATTITUDE))
    known = regression.NEEDED if moving else ATTITUDE if tilted else ()
    conditions = _without_flips(tuple(log.channel(name) for name in known))
    if tilted:
        refuse_other_turns([original.channel(name) for name in ATTITUDE], tuple(rates.values()), log.name)
    step_s = float(np.median(np.diff(rates["roll"].time_s)))
    return Selection(
        family,
        commands,
        states=rates,
        responses=forces,
        conditions=conditions,
        band_hz=BAND_HZ,
        findings=(
            *stamp_findings,
            *limits(log),
            *(Finding("clocks_apart", text) for text in clock_notes),
            *(Finding("wind", text) for text in wind),
            *_findings(forces, moving, sloped=regression.NEEDED[0] not in original.channels),
        ),
        log=with_headed_references(log),
        issued_within_s=step_s,
        rate_parameter=RATE_PARAMETER,
        step_s=float(np.clip(step_s, SHORTEST_STEP_S, LONGEST_STEP_S)),
        matched_interpolation_filter=True,
        active=settled,
    )


def _refuse_no_differences(commands: tuple[Channel, ...], vehicle: KnownVehicle, log: Recording) -> None:
    if len({command.time_s.size for command in commands}) != 1:
        return
    values = np.stack([command.values for command in commands])
    values = values[:, np.isfinite(values).all(axis=0)]
    if not values.shape[1] or not (values.max() > values.min()):
        return  # nothing varies at all, which is reported about every motion
    arms = zip(AXES, vehicle.arms[1:], strict=True)
    differences = {axis.name: np.ptp(arm / np.abs(arm).sum() @ values) for axis, arm in arms}
    tolerance = NO_DIFFERENCE * np.abs(values).max()
    unmoved = [name for name, difference in differences.items() if difference <= tolerance]
    if unmoved:
        expected = f"rotor commands that differ about roll, pitch and yaw in {log.name}"
        remedy = "Log every rotor's own command, not the collective one, and fly steps of each angle."
        raise InputError(expected, f"commands that never turn it about {', '.join(unmoved)}", remedy)


def _without_flips(conditions: tuple[Channel, ...]) -> tuple[Channel, ...]:
    """Attitudes that can be interpolated: a quaternion and its opposite are one attitude."""
    parts = [condition for condition in conditions if condition.name in ATTITUDE]
    if len({part.time_s.tobytes() for part in parts}) != 1:
        return conditions
    rows = continuous(np.stack([part.values for part in parts]))
    smooth = {part.name: replace(part, values=row) for part, row in zip(parts, rows, strict=True)}
    return tuple(smooth.get(condition.name, condition) for condition in conditions)


def _refuse_no_quaternion(log: Recording) -> None:
    known = [log.channels[name].values for name in ATTITUDE if name in log.channels]
    if len(known) != 4 or len({part.size for part in known}) != 1:
        return
    length = np.sqrt(sum(part * part for part in known))
    if length.size and float(np.nanmedian(np.abs(length - 1.0))) > UNIT_WITHIN:
        expected, received = "an attitude quaternion of length 1", f"{float(np.nanmedian(length)):.3g}"
        remedy = "Map its four parts w, x, y, z in this order, from body to world."
        raise InputError(f"{expected} in {log.name}", f"a length of {received}", remedy)


def _findings(forces: dict[str, Channel | None], moving: bool, sloped: bool) -> Iterator[Finding]:
    if moving and sloped:
        text = f"Velocity is not logged: it is the slope of the position over {SLOPE_S:g} s."
        yield Finding("velocity_by_position", text)
    if not moving:
        yield Finding(
            "no_body_velocity",
            "Velocity or attitude is not logged: no result for drag along x and y and of "
            "translational lift. Drag along z rests on the accelerometer's integral over less than 5 s.",
        )
    absent = [name.removeprefix("force_") for name, channel in forces.items() if channel is None]
    if absent:
        yield Finding("no_body_force", f"No specific force along {', '.join(absent)}: no result for it.")


def viscous_friction(problem: LaggedRuns, estimate: Estimate) -> dict[str, QuantityEstimate]:
    """Friction along z at the speeds of the flights: d_z at hover, and c_z sum |v| v_z^2 / sum v_z^2."""
    linear, quadratic = regression.DRAG[2].name, regression.QUADRATIC_DRAG[2].name
    if not {linear, quadratic} <= set(estimate.parameters):
        return {}
    parts = [np.zeros((0, 3))]
    for column in problem.columns:
        if column.axis == regression.FORCE_Z_EQUATION:
            signals = regression.body_equation(column).rotors.signals
            parts += column.cut(np.column_stack([signals.channel(name) for name in regression.MOVED]))
    velocity = np.concatenate(parts).T
    squared = velocity[2] ** 2
    if not squared.sum() > 0.0:
        return {}
    ratio, by_joint = verdict.hover_over_usual(problem, estimate)
    share = float(np.linalg.norm(velocity, axis=0) @ squared / squared.sum())
    gradient = ratio * estimate.direction(linear) + share * estimate.direction(quadratic)
    index = [estimate.names.index(name) for name in (linear, quadratic)]
    by_rotors, by_body = estimate.values[index].tolist()
    gradient += by_rotors * by_joint
    value = ratio * by_rotors + share * by_body
    return {regression.FRICTION.name: linear_quantity(estimate, regression.FRICTION.unit, value, gradient)}


#: Its upper end [Hz]: further up is next to nothing but vibration.
FULL_BAND_HZ = 60.0
#: It is worth its rows where it is so many times the lower one.
WIDER = 1.5
#: Estimates in it, each with the weights of the one before: those of a biased one are not yet the noise's.
PASSES = 2
#: Lags within this factor of the one of the lower band are searched.
NEAR = 2.0


def refined_band(
    problem: LaggedRuns, estimate: Estimate, estimated: Callable[[LaggedRuns], Estimate]
) -> tuple[LaggedRuns, Estimate]:
    """The problem in the whole band, and its estimate, where axes disagree about the lag."""
    if verdict.lag_consistency_test(estimate) is None:
        return problem, estimate
    full_band = in_full_band(problem)
    if full_band is problem:
        return problem, estimate
    for _ in range(PASSES):
        last = estimate
        nuisances = tuple(_near(nuisance, last.nuisances[nuisance.name]) for nuisance in problem.nuisances)
        full_band = replace(full_band, nuisances=nuisances, warm_start=WarmStart(last.theta, last.nuisances))
        estimate = estimated(full_band)
    return full_band, estimate


#: A term stays where it is so many standard errors from none: Akaike's criterion falls by 2.
TERM_ERRORS = 2.0


def refined_structure(
    problem: LaggedRuns, estimate: Estimate, estimated: Callable[[LaggedRuns], Estimate]
) -> tuple[LaggedRuns, Estimate, Mapping[str, tuple[float, float]]]:
    """Problem with two lags and products of inertia where significant; steps of the others."""
    method = by_name(estimate.method)
    if not isinstance(method, LinearMethod):
        return problem, estimate, {}
    nuisances = problem.nuisances
    if set(estimate.nuisances) == {*LAG_SUMS[EFFECTIVE_LAG]} and ACTUATOR_LAG.name in estimate.names:
        nuisances = (*nuisances, Nuisance(ASYMMETRY, ASYMMETRIES, tolerance=1e-4))
    try:
        fuller = verdict.with_products(problem, estimate.parameters, regression.PRODUCT, nuisances=nuisances)
        steps = first_steps(method, estimate, fuller)
    except (DataError, EstimationError, np.linalg.LinAlgError):  # these terms are collinear in the flights
        return problem, estimate, {}
    significant = {name: step for name, (step, error) in steps.items() if abs(step) > TERM_ERRORS * error}
    left_out = {name: step_and_error for name, step_and_error in steps.items() if name not in significant}
    if not significant:
        return problem, estimate, left_out
    values = {**estimate.parameters, **estimate.nuisances, **significant}
    products = [item for item in regression.PRODUCT if item.name in significant]
    if ASYMMETRY.name in significant:
        values[ASYMMETRY.name] = float(np.clip(significant[ASYMMETRY.name], *ASYMMETRIES))
        # a search is nearly at its end: between its ends one value is enough
        grids = (np.unique([item.first, values[item.name], item.grid[-1]]) for item in nuisances)
        nuisances = tuple(replace(item, grid=grid) for item, grid in zip(nuisances, grids, strict=True))
    else:
        nuisances = problem.nuisances
    refined = verdict.with_products(problem, estimate.parameters, products, nuisances=nuisances)
    theta = np.array([values[item.name] for item in refined.parameters])
    start = WarmStart(theta, {item.name: values[item.name] for item in nuisances})
    refined = replace(refined, warm_start=start)
    try:
        return refined, estimated(refined), left_out
    except (DataError, EstimationError):
        return problem, estimate, left_out


def in_full_band(problem: LaggedRuns) -> LaggedRuns:
    """The problem with rows of turning up to `FULL_BAND_HZ`, unchanged where rates are too low."""
    columns = tuple(_whole(column) for column in problem.columns)
    pairs = zip(columns, problem.columns, strict=True)
    if not any(new.band_hz[1] >= WIDER * old.band_hz[1] for new, old in pairs):
        return problem
    noisier = None if problem.noisier is None else in_full_band(problem.noisier)
    return replace(problem, columns=columns, noisier=noisier)


def _whole(axis_columns: AxisColumns) -> AxisColumns:
    if axis_columns.axis >= FORCE_X_EQUATION:
        return axis_columns
    flight, (low, high) = regression.body_equation(axis_columns).rotors.flight, axis_columns.band_hz
    reaches = BAND_SHARE * min(flight.rates_hz[name] for name in (AXES[axis_columns.axis].name, "command"))
    return replace(axis_columns, band_hz=(low, max(high, min(FULL_BAND_HZ, reaches))))


def _near(nuisance: Nuisance, value: float) -> Nuisance:
    if nuisance.name != ACTUATOR_LAG.name or not nuisance.searched:
        return nuisance
    near = nuisance.grid[(nuisance.grid >= value / NEAR) & (nuisance.grid <= value * NEAR)]
    return replace(nuisance, grid=near) if near.size > 1 and near[0] <= value <= near[-1] else nuisance


#: What the rotors did before a log begins in the air is not known, and matters for so long [s].
SETTLED_S = 1.0


def settled(log: Recording, grid: Grid, input_level: Float[np.ndarray, " n"]) -> Active:
    """Samples in the air at which the rotors no longer know how they began."""
    result, converged = active(log, grid, input_level), grid.steps - grid.steps[0] >= SETTLED_S / grid.step_s
    return replace(result, mask=result.mask & converged)


@dataclass(frozen=True)
class RigidBody(DeclaredMotion[LaggedRuns]):
    """Turning about three axes and the force along them, behind the lag of the rotors."""

    vehicle: KnownVehicle | None = None

    name = "rigid-body"
    axes = regression.EQUATIONS
    words = TABLES.words
    equation = TABLES.equation
    quantities = regression.QUANTITIES
    rules = verdict.all_rules(regression.QUANTITIES)
    parts = verdict.PARTS
    channels = replace(TABLES.channels, references=REFERENCES)

    @property
    def abilities(self) -> motion.Abilities:  # type: ignore[override]
        return motion.Abilities(
            vehicle=motion.VehicleSupport(
                lambda vehicle: replace(self, vehicle=load_vehicle(vehicle)),
                None if self.vehicle is None else asdict(self.vehicle),
                lambda record: replace(self, vehicle=vehicle_from_record(record)),
            ),
            check=lambda _options: self.known_vehicle,
            refined=self._refined,
            prediction=motion.Prediction(
                simple_models,
                multi_step=lambda flights, models, refused: rigid_body_prediction(
                    flights, self.known_vehicle, models, refused
                ),
                output_error=refined_by_output_error,
            ),
            implications=self._implications,
            excitation=partial(excitation, axes=AXES),
            whitened=True,
        )

    @property
    def known_vehicle(self) -> KnownVehicle:
        """Where the rotors are."""
        if self.vehicle is None:
            raise UsageError(
                "a vehicle: places and spins of its rotors determine what turns it",
                "none",
                f"Give one with --vehicle: a file, which `eivor vehicle new` begins, or one of "
                f"{', '.join(shipped_vehicles())}.",
            )
        return self.vehicle

    def select(self, log: Recording, options: FlightOptions) -> Selection:
        return selected(log, options, self.known_vehicle)

    def axes_of(self, flights: motion.Flights) -> Sequence[Mapping[int, AxisEquation]]:
        return [*regression.equations_of(flights, self.known_vehicle)]

    def signals(self, _flight: PreparedFlight, axis: AxisEquation) -> Signals:
        return cast("regression.BodyEquation", axis).rotors.signals

    def lagged_runs(self, flights: motion.Flights, rule: InstrumentRule) -> LaggedRuns:
        nuisances = regression.lag_and_delay(flights, self.known_vehicle.delay)
        problem = super().lagged_runs(flights, rule)
        columns = (replace(c, band_hz=regression.body_equation(c).band_hz) for c in problem.columns)
        return replace(problem, columns=tuple(columns), nuisances=nuisances)

    def problem(self, flights: motion.Flights, rule: InstrumentRule) -> LaggedRuns:
        problem = self.lagged_runs(flights, rule)
        if not all(map(regression.noises_known, flights)):
            return problem
        surrogates = tuple(map(noisier, flights))
        return replace(problem, noisier=self.lagged_runs(surrogates, NoInstruments()))

    def _refined(
        self,
        problem: LaggedRuns,
        solve: motion.Solver[LaggedRuns],
        _options: FlightOptions,
        _flights: motion.Flights,
        /,
    ) -> tuple[LaggedRuns, Estimate]:
        """Less steady winds, with the structure that the flights show, and one inertia of the rotors."""
        estimate, made_of = solve(problem), partial(self.problem, rule=NoInstruments())
        for _ in range(PASSES):
            calm = verdict.with_air_at_rest(problem, estimate.nuisances, made_of)
            problem, estimate = (problem, estimate) if calm is problem else (calm, solve(calm))
        problem, estimate, left_out = refined_structure(problem, estimate, solve)
        problem, estimate = refined_band(*verdict.refined_rotor_inertia(problem, estimate, solve), solve)
        return problem, replace(estimate, left_out=left_out)

    def derive(self, problem: LaggedRuns, estimate: Estimate) -> Mapping[str, QuantityEstimate]:
        joint, (ratio, by_joint) = joint_quantities(estimate), verdict.hover_over_usual(problem, estimate)
        at_hover = {
            name: linear_quantity(
                estimate,
                item.unit,
                ratio * item.value,
                ratio * estimate.direction(name) + item.value * by_joint,
            )
            for name, item in joint.items()
            if name in {parameter.name for parameter in AT_HOVER}
        }
        results = {
            **joint,
            **at_hover,
            **verdict.gyroscopic_moments(problem, joint),
            **viscous_friction(problem, estimate),
            **lag_quantities(problem, estimate),
        }
        for name, (step, error) in estimate.left_out.items():  # what the first step says of it
            half = normal_quantile(0.95) * error
            results[name] = QuantityEstimate(step, "", error, (step - half, step + half))
        if OUTPUT_ERROR in estimate.method:  # it searches for no drag below zero
            results |= {name: replace(results[name], lowest=0.0) for name in {*results} & NOT_NEGATIVE}
        return {name: results[name] for name in regression.QUANTITIES if name in results}

    def _implications(self, estimate: Estimate, quantities: Mapping[str, Quantity]) -> Implications:
        if self.vehicle is None:
            return Implications()
        combinations = Combinations.of_estimate(estimate).finite().reaching(quantities)
        parameters = physical_parameters(combinations, self.vehicle)
        return Implications(tuple(parameters.numbers.values()), parameters.contradictions)

    def checks(
        self, problem: LaggedRuns, estimate: Estimate, flights: motion.Flights, /
    ) -> verdict.RigidBodyChecks:
        cutoff_hz = self.known_vehicle.gyro_cutoff_hz
        early_s = max(verdict.filter_early_s(cutoff_hz, flight.rates_hz[AXES[0].name]) for flight in flights)
        order = verdict.observed_order(flights, self.known_vehicle)
        if order is not None:
            return verdict.RigidBodyChecks(order, filter_early_s=early_s)
        wind = verdict.steady_wind(problem, flights)
        lags = verdict.lag_consistency_test(estimate)
        made_of = partial(self.problem, rule=NoInstruments())
        by_wind = verdict.half_widths_by_wind(problem, estimate, flights, made_of)
        shifts = verdict.possible_shifts(estimate, lags)
        refined = estimate.unrefined is not None
        return verdict.RigidBodyChecks(None, wind, lags, early_s, by_wind, shifts, refined)

    def traces(self, problem: LaggedRuns, estimate: Estimate) -> tuple[Trace, ...]:
        drives = {term.parameter for _, term in regression.TERMS if regression.drives(term.of)}
        driving = [number for number, parameter in enumerate(problem.parameters) if parameter in drives]
        results = []
        for axis in problem.axes:
            series = problem.series_in_band(estimate.nuisances, axis, estimate.theta, driving)
            measured, predicted, driven = series.T
            trace = *self.axes[axis].trace, measured, predicted, driven
            results.append(Trace(*trace, problem.band_hz(axis)))
        return tuple(results)

    def view(self, flight: PreparedFlight) -> motion.FlightView:
        how = "measured" if flight.input.measured else "commands, behind a lag τ and a delay d that all share"
        symbols = f"n = {flight.input.name} of {len(flight.driving)} rotors (map: {flight.input_map}), {how}"
        return motion.FlightView(symbols, tuple(rate_panel(flight, axis) for axis in AXES))
