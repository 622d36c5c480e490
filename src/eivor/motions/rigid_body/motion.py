"""The motion of the rigid body."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial

import numpy as np

from eivor.errors import UsageError
from eivor.estimation.estimate import Estimate
from eivor.flights.grid import Active, Grid
from eivor.flights.lag_prior import EFFECTIVE_LAG, LAG_QUANTITIES, joint_quantities, lag_quantities
from eivor.flights.motion import (
    Abilities,
    Flights,
    FlightView,
    LogChannels,
    Motion,
    OptionSupport,
    Prediction,
    Refinement,
    Solver,
    VehicleSupport,
)
from eivor.flights.options import FlightOptions
from eivor.flights.prepared import PreparedFlight, Selection
from eivor.flights.quantity import (
    Implications,
    Implied,
    Kind,
    QuantityEstimate,
    QuantitySpec,
    QuantityTable,
    Trace,
    Words,
    flight_card,
)
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY, AxisColumns, LaggedRuns
from eivor.models.separable import InstrumentRule, NoInstruments, Nuisance, WarmStart
from eivor.motions.equation import simple_models
from eivor.motions.rates.motion import AXES, active, rate_panel, rates_std
from eivor.motions.rigid_body.physical_parameters import (
    Combinations,
    PhysicalEstimateRow,
    physical_parameters,
)
from eivor.motions.rigid_body.predict import rigid_body_prediction
from eivor.motions.rigid_body.regression import (
    BAND_SHARE,
    RotorColumns,
    noises_known,
    noisier,
    rigid_body_problem,
)
from eivor.motions.rigid_body.select import INPUTS, REFERENCES, selected
from eivor.motions.rigid_body.terms import (
    ALL_DRAG_MOMENTS,
    ALONG,
    COUPLING,
    DAMPING,
    DRAG,
    DRIVING,
    FORCE_X_EQUATION,
    FORCE_Z_EQUATION,
    FRICTION,
    GAIN,
    GYROSCOPIC_MOMENT,
    LIFT,
    LIFT_MOMENT,
    OFFSET,
    QUADRATIC_DRAG,
    REACTION,
    TERMS,
    THRUST,
    TURNING,
    RigidTerm,
)
from eivor.motions.rigid_body.vehicle import (
    KnownVehicle,
    load_vehicle,
    shipped_vehicles,
    vehicle_from_record,
)
from eivor.motions.rigid_body.verdict import (
    FLY,
    PARTS,
    RigidBodyChecks,
    all_rules,
    filter_early_s,
    filters_not_passed,
    gyroscopic_moments,
    lag_consistency_test,
    observed_order,
    refined_rotor_inertia,
    steady_wind,
)
from eivor.motions.vertical.model import GRAVITY
from eivor.signals.recording import Recording
from eivor.signals.thrust_map import input_map
from eivor.tools import Float

# -- Quantities --


def at_hover(problem: LaggedRuns, joint: Mapping[str, QuantityEstimate]) -> dict[str, QuantityEstimate]:
    """Parameters with drag and damping for the rotors' state at hover, where thrust determines that."""
    result, ratio = dict(joint), _hover_over_usual(problem, joint)
    for parameter in (*DRAG, *DAMPING):
        item = result.get(parameter.name)
        if item is not None:
            result[parameter.name] = item.times(ratio)
    return result


def viscous_friction(problem: LaggedRuns, estimate: Estimate) -> dict[str, QuantityEstimate]:
    """Friction along z at the speeds of the flights: d_z at hover, and c_z sum |v| v_z^2 / sum v_z^2."""
    linear, quadratic = DRAG[2].name, QUADRATIC_DRAG[2].name
    climbs = [column for column in problem.columns if column.axis == FORCE_Z_EQUATION]
    if not {linear, quadratic} <= set(estimate.parameters) or not climbs:
        return {}
    products = np.sum([_climbed(climb) for climb in climbs], axis=0)
    if not products[1] > 0.0:
        return {}
    ratio = _hover_over_usual(problem, joint_quantities(estimate))
    share = float(products[0] / products[1])
    gradient = ratio * estimate.direction(linear) + share * estimate.direction(quadratic)
    index = [estimate.names.index(name) for name in (linear, quadratic)]

    of_rotors, of_body = estimate.values[index].tolist()
    value, covariance = ratio * of_rotors + share * of_body, estimate.joint_covariance
    half = covariance.half_width(gradient, 0.95)
    interval = value - half, value + half
    return {FRICTION.name: QuantityEstimate(value, FRICTION.unit, covariance.std_error(gradient), interval)}


def _climbed(axis_columns: AxisColumns) -> Float[np.ndarray, " 2"]:
    """Sums of |v| v_z^2 and of v_z^2 over what counts of a flight."""
    if not isinstance(axis_columns.moving, RotorColumns):
        return np.zeros(2)
    velocity = axis_columns.moving.states.velocity
    counted = np.zeros(velocity.shape[1], dtype=np.bool_)
    for run in axis_columns.runs:
        inside = axis_columns.counted(run)
        counted[run] = True if inside is None else inside
    squared = velocity[2, counted] ** 2
    return np.array([np.linalg.norm(velocity[:, counted], axis=0) @ squared, squared.sum()])


def _hover_over_usual(problem: LaggedRuns, joint: Mapping[str, QuantityEstimate]) -> float:
    """State of a rotor at hover over that which drag and damping are identified for."""
    columns = problem.columns[0].moving
    if THRUST.name not in joint or not isinstance(columns, RotorColumns):
        return 1.0
    gain = joint[THRUST.name].value * columns.states.vehicle.count
    if not gain > 0.0:
        return 1.0
    return input_map(columns.states.flight.input_map).inverse(GRAVITY / gain) / columns.states.usual


# -- Full-band fit --

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
    if lag_consistency_test(estimate) is None:
        return problem, estimate
    whole = in_full_band(problem)
    if whole is problem:
        return problem, estimate
    for _ in range(PASSES):
        best = estimate
        nuisances = tuple(_near(nuisance, best.nuisances[nuisance.name]) for nuisance in problem.nuisances)
        whole = replace(whole, nuisances=nuisances, warm_start=WarmStart(best.theta, best.nuisances))
        estimate = estimated(whole)
    return whole, estimate


def in_full_band(problem: LaggedRuns) -> LaggedRuns:
    """The same problem with rows of turning up to `FULL_BAND_HZ`; itself where the logs do not reach far."""
    columns = tuple(_whole(column) for column in problem.columns)
    pairs = zip(columns, problem.columns, strict=True)
    if not any(new.band_hz[1] >= WIDER * old.band_hz[1] for new, old in pairs):
        return problem
    noisier = None if problem.noisier is None else in_full_band(problem.noisier)
    return replace(problem, columns=columns, noisier=noisier)


def _whole(axis_columns: AxisColumns) -> AxisColumns:
    if axis_columns.axis >= FORCE_X_EQUATION or not isinstance(axis_columns.moving, RotorColumns):
        return axis_columns
    flight, (low, high) = axis_columns.moving.states.flight, axis_columns.band_hz
    reaches = BAND_SHARE * min(flight.rates_hz[name] for name in (AXES[axis_columns.axis].name, "command"))
    return replace(axis_columns, band_hz=(low, max(high, min(FULL_BAND_HZ, reaches))))


def _near(nuisance: Nuisance, value: float) -> Nuisance:
    """A lag with the values of its grid near the one that was found."""
    if nuisance.name != ACTUATOR_LAG.name or not nuisance.searched:
        return nuisance
    near = nuisance.grid[(nuisance.grid >= value / NEAR) & (nuisance.grid <= value * NEAR)]
    return replace(nuisance, grid=near) if near.size > 1 and near[0] <= value <= near[-1] else nuisance


# -- QuantitySpec --

EQUATION = (
    "p' = beta_1 q r + alpha_p sum y phi - d_p p + b; "
    "s_z = alpha_z sum phi - d_z v_z - c_z |v| v_z + h (v_x^2 + v_y^2) + b",
    "phi = map(n); tau n' + n = command(t - d); p rate, v velocity, s force on body axes; others alike",
)
_HEADLINE = (THRUST, *GAIN[:2])


def _spec(term: RigidTerm) -> QuantitySpec:
    """How a parameter is called; those that need more than rates and rotors are optional."""
    unit, headline = term.parameter.unit, term.parameter in _HEADLINE
    return QuantitySpec(
        term.words,
        term.symbol,
        unit,
        shown_unit=unit.replace("^2", "²").replace("^3", "³"),
        optional=term.by_velocity or term.equation >= FORCE_X_EQUATION,
        headline=headline,
        in_rows=headline,
    )


_SPECS = {term.parameter.name: _spec(term) for term in TERMS} | {
    **LAG_QUANTITIES,
    EFFECTIVE_LAG: replace(LAG_QUANTITIES[EFFECTIVE_LAG], headline=True, in_rows=True),
    FRICTION.name: QuantitySpec(
        "viscous friction", "K", FRICTION.unit, kind=Kind.DERIVED, shown_unit="1/s", optional=True
    ),
}
_PARAMETERS = (*COUPLING, *DAMPING, *DRAG, *QUADRATIC_DRAG, FRICTION, LIFT, *LIFT_MOMENT, *ALL_DRAG_MOMENTS)
_ORDER = (
    *(item.name for item in (THRUST, *GAIN)),
    EFFECTIVE_LAG,
    *(item.name for item in (*_PARAMETERS, *GYROSCOPIC_MOMENT, REACTION, *OFFSET)),
    ACTUATOR_LAG.name,
    DELAY.name,
)
QUANTITIES = QuantityTable({name: _SPECS[name] for name in _ORDER})
_MANOEUVRES = (
    "Calm air, at least 3 m above the ground.",
    "60 s: steps of roll and pitch of about 15°, of yaw of about 45°, and of height of 1 m, at uneven times, "
    "each by itself and some together. A few fast straight legs along the body's axes.",
)


_NEEDED = (
    "Rotor commands, rates, accelerometer, velocity and attitude, and what was asked of height and attitude."
)
WORDS = Words(
    title="Rigid body",
    model="rigid_body",
    identified="thrust, roll and pitch gain and the lag are identified, within their intervals.",
    refused="the flight does not identify the gains of thrust, roll and pitch.",
    fly=FLY,
    no_reference="None is logged: no setpoint of height or attitude, no injected sweep.",
    no_lag="The rotor speeds were measured:\nthere is no lag to find.",
    advice=partial(flight_card, fly=_MANOEUVRES, needed=(_NEEDED,)),
)


# -- Motion --

#: What the rotors did before a log begins in the air is not known, and matters for so long [s].
SETTLED_S = 1.0


def settled(log: Recording, grid: Grid, input_level: Float[np.ndarray, " n"]) -> Active:
    """Samples in the air at which the rotors no longer know how they began."""
    result, converged = active(log, grid, input_level), grid.steps - grid.steps[0] >= SETTLED_S / grid.step_s
    return replace(result, mask=result.mask & converged)


def excitation(flights: Flights) -> str:
    """Standard deviations of the rates."""
    roll, pitch, yaw = rates_std(flights, AXES)
    turned = f"Roll, pitch and yaw turned at {roll:.2g}, {pitch:.2g} and {yaw:.2g} deg/s"
    return f"{turned} (standard deviations)."


def refined(
    problem: LaggedRuns, solve: Solver[LaggedRuns], _options: FlightOptions, /
) -> tuple[LaggedRuns, Estimate]:
    """With one inertia of the rotors about all axes where the flights identify it."""
    return refined_band(*refined_rotor_inertia(problem, solve), solve)


@dataclass(frozen=True)
class RigidBody(Motion[LaggedRuns]):
    """Turning about three axes and the force along them, behind the lag of the rotors."""

    vehicle: KnownVehicle | None = None
    pooled: bool = False

    name = "rigid-body"
    words = WORDS
    equation = EQUATION
    quantities = QUANTITIES
    rules = all_rules(QUANTITIES)
    parts = PARTS
    channels = LogChannels(INPUTS, tuple(axis.rate for axis in AXES), REFERENCES)

    @property
    def abilities(self) -> Abilities:  # type: ignore[override]
        """What only some motions can do."""
        return Abilities(
            vehicle=VehicleSupport(
                lambda vehicle: replace(self, vehicle=load_vehicle(vehicle)),
                None if self.vehicle is None else asdict(self.vehicle),
                lambda record: replace(self, vehicle=vehicle_from_record(record)),
            ),
            options=OptionSupport(
                lambda _options: self._refuse_no_vehicle(),
                lambda flights, _options: replace(self, pooled=len(flights) > 1),
            ),
            refinement=Refinement(refined),
            prediction=Prediction(
                simple_models,
                multi_step=lambda flights, models, refused: rigid_body_prediction(
                    flights, self.known_vehicle, models, refused
                ),
            ),
            implications=self._implications,
            excitation=excitation,
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

    def _refuse_no_vehicle(self) -> None:
        _ = self.known_vehicle

    def select(self, log: Recording, options: FlightOptions) -> Selection:
        """Rotors, rates, forces, velocity and attitude."""
        return replace(selected(log, options, self.known_vehicle), active=settled)

    def problem(self, flights: Flights, rule: InstrumentRule) -> LaggedRuns:
        """Regressions of the flights for each lag and delay."""
        problem = rigid_body_problem(flights, self.known_vehicle, rule)
        if not all(map(noises_known, flights)):
            return problem
        surrogates = tuple(map(noisier, flights))
        return replace(problem, noisier=rigid_body_problem(surrogates, self.known_vehicle, NoInstruments()))

    def derive(self, problem: LaggedRuns, estimate: Estimate) -> Mapping[str, QuantityEstimate]:
        """Parameters of the equations that are there, and the lag."""
        joint = joint_quantities(estimate)
        results = {
            **at_hover(problem, joint),
            **gyroscopic_moments(problem, joint),
            **viscous_friction(problem, estimate),
            **lag_quantities(problem, estimate),
        }
        return {name: results[name] for name in QUANTITIES if name in results}

    def _implications(self, estimate: Estimate) -> Implications:
        if self.vehicle is None:
            return Implications()
        parameters = physical_parameters(Combinations.of_estimate(estimate), self.vehicle)
        return Implications(tuple(map(_implied, parameters.rows)), parameters.contradictions)

    def checks(self, problem: LaggedRuns, estimate: Estimate, flights: Flights, /) -> RigidBodyChecks:
        """Where a flight contradicts the vehicle file: its rotors' order, and the filters it names."""
        cutoff_hz = self.known_vehicle.gyro_cutoff_hz
        early_s = max(filter_early_s(cutoff_hz, flight.rates_hz[AXES[0].name]) for flight in flights)
        order = observed_order(flights, self.known_vehicle)
        if order is not None:
            return RigidBodyChecks(order, filter_early_s=early_s)
        wind, lags = steady_wind(problem, estimate.nuisances, flights), lag_consistency_test(estimate)
        # of a pool's flight the whole pool is asked about filters
        of_pool = self.pooled and len(flights) == 1
        filters = None if of_pool else filters_not_passed(problem, estimate, flights, self.known_vehicle)
        return RigidBodyChecks(None, wind, lags, filters, early_s)

    def traces(self, problem: LaggedRuns, estimate: Estimate) -> tuple[Trace, ...]:
        """Angular acceleration about each axis and force along it, within the bands."""
        driving = [number for number, parameter in enumerate(problem.parameters) if parameter in DRIVING]
        results = []
        for axis in problem.axes:
            series = problem.series_in_band(estimate.nuisances, axis, estimate.theta, driving)
            words, unit = f"{(*TURNING, '', '', '')[axis]} acceleration", "rad/s²"
            if axis >= FORCE_X_EQUATION:
                words, unit = f"specific force along {ALONG[axis - FORCE_X_EQUATION]}", "m/s²"
            measured, predicted, driven = series.T
            band_hz = problem.band_hz(axis)
            results.append(Trace(words, unit, "model", "rotors", measured, predicted, driven, band_hz))
        return tuple(results)

    def view(self, flight: PreparedFlight) -> FlightView:
        """What n is, and the rates."""
        how = "measured" if flight.input.measured else "commands, behind a lag τ and a delay d that all share"
        symbols = f"n = {flight.input.name} of {flight.actuators} rotors (map: {flight.input_map}), {how}"
        return FlightView(symbols, tuple(rate_panel(flight, axis) for axis in AXES))


def _implied(row: PhysicalEstimateRow) -> Implied:
    item = row.estimate
    if item is None:
        return Implied(row.name, row.words, "", "", None, None, None, row.sentence)
    numbers = item.value, item.std_error, item.interval
    return Implied(row.name, row.words, item.symbol, item.unit, *numbers, row.sentence)
