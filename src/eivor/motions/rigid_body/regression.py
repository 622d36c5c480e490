"""Regression problem of the rigid body: terms of its equations, columns, instruments and velocities."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from operator import itemgetter

import numpy as np

from eivor.flights.motion import motion_tables
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import QuantityTable
from eivor.models import lagged_runs, separable
from eivor.models.regression import Parameter
from eivor.models.signal_regression import cross_fitted
from eivor.motions.rates.motion import AXES, PITCH, ROLL
from eivor.motions.rigid_body.dynamics import ATTITUDE, VELOCITY, Rows, felt, into_body, rotation
from eivor.motions.rigid_body.vehicle import KnownNumber, KnownVehicle
from eivor.signals.channels import family_members
from eivor.signals.filters import Series, low_passed, shifted_by, time_derivative
from eivor.signals.recording import GRAVITY
from eivor.signals.signals import Signals
from eivor.signals.thrust_map import input_map
from eivor.tools import Float

# -- Terms --

TURNING = ("roll", "pitch", "yaw")
ALONG = ("x", "y", "z")
#: Numbers of the equations: turning first, then the specific force along each axis.
ROLL_EQUATION, PITCH_EQUATION, YAW_EQUATION, FORCE_X_EQUATION = range(4)
FORCE_Z_EQUATION = 5
#: Axes along which a velocity turns the vehicle about each axis.
ALONG_OTHERS = ((1, 2), (0, 2), (0, 1))

TABLES = motion_tables("eivor.motions.rigid_body")
QUANTITIES = QuantityTable(TABLES.quantities)


def _parameters(name: str, *of: str) -> tuple[Parameter, ...]:
    """Parameters whose names hold those of axes, with the units of their quantities."""
    return tuple(Parameter(item, QUANTITIES[item].unit) for item in map(name.format, of))


COUPLING, DAMPING = _parameters("{}_coupling", *TURNING), _parameters("{}_damping", *TURNING)
DRAG = _parameters("drag_{}", *ALONG)
#: Of the body, which goes with the size of the velocity, beside what the rotors drag.
QUADRATIC_DRAG = _parameters("quadratic_drag_{}", *ALONG)
#: The first is that of the linear and the quadratic drag along z together, at the speeds of a flight.
FRICTION, LIFT, REACTION, THRUST = _parameters(
    "{}", "viscous_friction", "translational_lift", "rotor_reaction", "thrust_gain"
)
#: What the lift of rotors that meet unequal air turns: k_h / I, which is h alpha_p / (N alpha_z) of N rotors.
LIFT_MOMENT = _parameters("{}_by_lift", *TURNING[:2])
#: What drag beside the centre of mass turns: of each axis, by the velocities along the other two.
DRAG_MOMENT = tuple(
    _parameters(f"{name}_by_drag_{{}}", *(ALONG[along] for along in others))
    for name, others in zip(TURNING, ALONG_OTHERS, strict=True)
)
ALL_DRAG_MOMENTS = tuple(item for pair in DRAG_MOMENT for item in pair)
#: What goes with the states of the rotors: these are for rotors at hover.
AT_HOVER = (*DAMPING, *DRAG, *ALL_DRAG_MOMENTS)
#: Of rotors that spin: J / Ixx and J / Iyy.
GYROSCOPIC_MOMENT = _parameters("{}_by_spin", *TURNING[:2])
GAIN, OFFSET = _parameters("{}_gain", *TURNING), _parameters("{}_offset", *TURNING[:2])
#: Elements of the inertia matrix off its diagonal, over Ixx; minus the products of inertia.
PRODUCT = _parameters("product_{}", "xy", "xz", "yz")
#: Rows and columns of these elements.
PAIRS = ((0, 1), (0, 2), (1, 2))


@dataclass(frozen=True)
class BodyMotion:
    """Rotors, velocity through the air and rates on the body's axes, at samples or starts."""

    vehicle: KnownVehicle
    usual: float  # State of a rotor at hover, nearly, for which damping and drag are
    state: Float[np.ndarray, "7 n"]  # Sums over the rotors, see `KnownVehicle.sums`
    thrust: Float[np.ndarray, "7 n"]
    spin_up: Series  # Derivative in time of the states with their spins
    velocity: Float[np.ndarray, "3 n"]
    rates: Float[np.ndarray, "3 n"]
    turning: Float[np.ndarray, "3 n"]  # Derivative of the rates in time

    def by_product(self, axis: int, pair: int) -> Series:
        """What an element of the inertia matrix off its diagonal leaves of an axis' turning."""
        (i, j), (after, last) = PAIRS[pair], ((axis + 1) % 3, (axis + 2) % 3)
        momentum, change = np.zeros_like(self.rates), np.zeros_like(self.rates)
        momentum[[i, j]], change[[i, j]] = self.rates[[j, i]], self.turning[[j, i]]
        return momentum[after] * self.rates[last] - momentum[last] * self.rates[after] - change[axis]

    @cached_property
    def shares(self) -> Float[np.ndarray, "7 n"]:
        """States over the usual one."""
        return self.state / self.usual

    def dragged(self, axis: int) -> Series:
        """Sum over the rotors of usual states times the velocity at each: along an axis, or about one."""
        total, x, y, xx, xy, yy, _ = self.shares
        (u, v, w), (p, q, r) = self.velocity, self.rates
        if axis == ROLL_EQUATION:
            return w * y + p * yy - q * xy
        if axis == PITCH_EQUATION:
            return q * xx - p * xy - w * x
        if axis == YAW_EQUATION:
            return v * x - u * y + r * (xx + yy)
        if axis == FORCE_Z_EQUATION:
            return w * total + p * y - q * x
        return u * total - r * y if axis == FORCE_X_EQUATION else v * total + r * x

    @cached_property
    def across(self) -> Float[np.ndarray, "rotors n"]:
        """Square of the velocity across each rotor [(m/s)^2]."""
        x, y, yaw_rate = -self.vehicle.pitch, self.vehicle.roll, self.rates[2]
        forward, left = self.velocity[0] - np.outer(y, yaw_rate), self.velocity[1] + np.outer(x, yaw_rate)
        return forward**2 + left**2

    def gyroscopic(self, axis: int) -> Series:
        """What rotors that spin turn about x or y, but for their inertia over the body's."""
        spin, (p, q, _) = self.state[6], self.rates
        return q * spin if axis == ROLL_EQUATION else -p * spin


@dataclass(frozen=True)
class RigidTerm:
    """A parameter times a column, in one equation."""

    parameter: Parameter
    equation: int
    index: int  # Among the terms of its kind
    formula: Callable[[BodyMotion, int], Series]
    moves: bool = True  # With lag and delay
    driving: bool = False  # What the rotors do by themselves
    by_velocity: bool = False  # Only where the velocity on the body's axes is known

    def column(self, of: BodyMotion) -> Series:
        return self.formula(of, self.index)


def _terms(
    parameters: Iterable[Parameter],
    equations: Iterable[int],
    formula: Callable[[BodyMotion, int], Series],
    **kind: bool,
) -> Iterator[RigidTerm]:
    """Terms of one kind."""
    for index, (parameter, equation) in enumerate(zip(parameters, equations, strict=True)):
        yield RigidTerm(parameter, equation, index, formula, **kind)


def _rolled(of: BodyMotion) -> tuple[Series, ...]:
    """Thrusts with the arms by which they turn about each axis."""
    return of.thrust[2], -of.thrust[1], of.thrust[6]


def _damped(of: BodyMotion, axis: int) -> Series:
    _, _, _, xx, _, yy, _ = of.vehicle.sums.sum(axis=1).tolist()
    return -of.dragged(axis) / (yy, xx, xx + yy)[axis]


_TILTING, _AXES, _FORCES = range(2), range(3), range(3, 6)
#: Terms of all equations, those first that no lag moves.
TERMS = (
    *_terms(
        COUPLING, _AXES, lambda of, axis: of.rates[(axis + 1) % 3] * of.rates[(axis + 2) % 3], moves=False
    ),
    *_terms(
        QUADRATIC_DRAG,
        _FORCES,
        lambda of, along: -np.linalg.norm(of.velocity, axis=0) * of.velocity[along],
        moves=False,
        by_velocity=True,
    ),
    *_terms(
        LIFT_MOMENT,
        _TILTING,
        lambda of, axis: (of.vehicle.roll, of.vehicle.pitch)[axis] @ of.across,
        moves=False,
        by_velocity=True,
    ),
    *_terms(GAIN, _AXES, lambda of, axis: _rolled(of)[axis], driving=True),
    *_terms(DAMPING, _AXES, _damped),
    *_terms(OFFSET, _TILTING, lambda of, _: of.thrust[0], driving=True),
    *_terms([REACTION], [2], lambda of, _: of.spin_up, driving=True),
    *_terms(GYROSCOPIC_MOMENT, _TILTING, BodyMotion.gyroscopic),
    *_terms(
        ALL_DRAG_MOMENTS,
        (0, 0, 1, 1, 2, 2),
        lambda of, index: (
            of.dragged(FORCE_X_EQUATION + ALONG_OTHERS[index // 2][index % 2]) / of.vehicle.count
        ),
        by_velocity=True,
    ),
    *_terms([THRUST], [5], lambda of, _: of.thrust[0], driving=True),
    *_terms(DRAG, _FORCES, lambda of, along: -of.dragged(FORCE_X_EQUATION + along) / of.vehicle.count),
    *_terms([LIFT], [5], lambda of, _: of.across.mean(axis=0), by_velocity=True),
)
DRIVING = tuple(term.parameter for term in TERMS if term.driving)

# -- Velocity --

NEEDED = (*VELOCITY, *ATTITUDE)


def body_velocity(signals: Signals) -> Float[np.ndarray, "n 3"] | None:
    """Velocity forward, left and up of the body [m/s]; None where velocity or attitude are not known."""
    known = set(NEEDED) <= set(signals.channels)
    return on_body_axes(signals, *map(signals.channel, VELOCITY)) if known else None


def force_by_velocity(signals: Signals) -> Float[np.ndarray, "n 3"] | None:
    """What an accelerometer would read where the velocity changes as it does [m/s^2]; None likewise."""
    if not set(NEEDED) <= set(signals.channels):
        return None
    return felt(_rows(signals), np.stack([*map(signals.channel, VELOCITY)]), signals.step_s).T


def on_body_axes(signals: Signals, u: Series, v: Series, s: Series) -> Float[np.ndarray, "n 3"]:
    """A vector of the world, turned into the body's axes."""
    return np.column_stack(into_body(_rows(signals), u, v, s))


def _rows(signals: Signals) -> Rows:
    """Rotation of the attitude, and none where it has no length."""
    w, x, y, z = (signals.channel(part) for part in ATTITUDE)
    return rotation(np.where(w * w + x * x + y * y + z * z > 0.0, w, 1.0), x, y, z)


FORCE = "specific_force_body_z"
#: Lowest frequency at which the integral serves [Hz].
FROM_HZ = 0.2
#: Half of a variation at this frequency is taken out of an integral [Hz].
TAKEN_OUT_HZ = FROM_HZ / 4.0


def inferred_velocity(signals: Signals, runs: Sequence[slice]) -> Series | None:
    """Velocity along z within each run [m/s], zero elsewhere; None without a specific force along z."""
    if FORCE not in signals.channels:
        return None
    velocity = np.zeros(signals.sample_count)
    for run in runs:
        excess = signals.channel(FORCE)[run] - GRAVITY * _cos_tilt(signals, run)
        velocity[run] = _integrated(excess - excess.mean(), signals.step_s)
    return velocity


def _cos_tilt(signals: Signals, run: slice) -> Float[np.ndarray, " length"]:
    if set(ATTITUDE) <= set(signals.channels):
        return np.asarray(_rows(signals)[2][2])[run]
    roll, pitch = (_integrated(signals.channel(axis.rate)[run], signals.step_s) for axis in (ROLL, PITCH))
    return np.asarray(np.cos(roll) * np.cos(pitch))


def _integrated(rate: Float[np.ndarray, " length"], step_s: float) -> Float[np.ndarray, " length"]:
    """Integral without its slow parts, of Butterworth's shape (second order, once forward and once back)."""
    summed = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]))]) * step_s
    level = summed - np.linspace(summed[0], summed[-1], summed.size)
    frequency = np.fft.rfftfreq(level.size, step_s)
    kept = np.zeros(frequency.size)
    kept[1:] = 1.0 / (1.0 + (TAKEN_OUT_HZ / frequency[1:]) ** 4)
    return np.asarray(np.fft.irfft(kept * np.fft.rfft(level), level.size))


# -- Instruments --

#: Successive lags of references, how many and how long [s]: for turning, for velocity across, for height.
QUICK, SLOW, HEIGHT = (14, 0.04), (4, 1.0), (4, 0.15)
#: Axis of turning that tilts the thrust forward, and left.
TILTED = (PITCH_EQUATION, ROLL_EQUATION)
#: Lags for which columns are instruments; delays, of a state that was measured [s].
INSTRUMENT_LAGS_S = (0.01, 0.03, 0.07, 0.15)
INSTRUMENT_DELAYS_S = (-0.02, 0.0, 0.02)


@dataclass(frozen=True)
class AxisInstruments:
    """Instruments of every equation of one flight: references with their lags, and what they predict."""

    flight: PreparedFlight
    vehicle: KnownVehicle
    rule: separable.LaggedReferences

    def of_axis(self, axis: int, columns: RotorColumns) -> Float[np.ndarray, "n p"]:
        """Columns for one equation, some of them like columns of what its rotors do."""
        if axis < FORCE_X_EQUATION:
            states = replace(columns.states, flight=self._predicted, _last=None)
            return self._turning(axis, replace(columns, states=states))
        velocity, along = self._motion.velocity, axis - FORCE_X_EQUATION
        quadratic = np.linalg.norm(velocity, axis=0) * velocity[along]
        if axis == FORCE_Z_EQUATION:
            across = velocity[0] ** 2 + velocity[1] ** 2
            return np.column_stack([self._references(FORCE_Z_EQUATION, HEIGHT), across, quadratic])
        return np.column_stack([self._references(TILTED[along], SLOW), quadratic])

    def _references(self, axis: int, lags: tuple[int, float]) -> Float[np.ndarray, "n p"]:
        """References of an axis with their lags; those of no axis of turning are of height."""
        turning = {source.channel: number for number, item in enumerate(AXES) for source in item.references}
        names = tuple(name for name in self.rule.channels if turning.get(name, FORCE_Z_EQUATION) == axis)
        signals = self.flight.signals
        return replace(self.rule, channels=names, lags=lags).columns(signals, np.zeros(signals.sample_count))

    def _by_references(self, values: Series, axis: int, lags: tuple[int, float]) -> Series:
        """Prediction by the references of one axis, within what the values were."""
        used = self.flight.used
        result = cross_fitted(self._references(axis, lags), values[:, None], used)[:, 0]
        return np.clip(result, values[used].min(), values[used].max()) if used.any() else result

    @cached_property
    def _rotors(self) -> dict[str, Series]:
        """Commands of the rotors, put together of what lifts and what turns."""
        name, vehicle = self.flight.input.name, self.vehicle
        logged = self.flight.signals.family(name)
        parts = np.column_stack([vehicle.roll, vehicle.pitch, vehicle.yaw, np.ones(vehicle.count)])
        shares = np.linalg.lstsq(parts, logged.T, rcond=None)[0].T
        chosen = (*((axis, QUICK) for axis in range(FORCE_X_EQUATION)), (FORCE_Z_EQUATION, HEIGHT))
        pairs, used = zip(shares.T, chosen, strict=True), logged[self.flight.used]
        selected = np.column_stack([self._by_references(share, axis, lags) for share, (axis, lags) in pairs])
        rotors = np.clip(selected @ parts.T, used.min(), used.max())
        return {f"{name}_{number + 1}": column for number, column in enumerate(rotors.T)}

    @cached_property
    def _predicted(self) -> PreparedFlight:
        """The same flight with predictions in place of its commands, rates and velocity."""
        signals, says = self.flight.signals, self._by_references
        channels = dict(signals.channels)
        for axis in (ROLL_EQUATION, PITCH_EQUATION, YAW_EQUATION):
            name = AXES[axis].rate
            channels[name] = says(signals.channel(name), axis, QUICK)
        channels |= self._rotors
        velocity = body_velocity(signals)
        if velocity is not None:
            by_axis = ((TILTED[0], SLOW), (TILTED[1], SLOW), (FORCE_Z_EQUATION, HEIGHT))
            for along, (axis, lags) in enumerate(by_axis):
                channels[f"velocity_{'xyz'[along]}"] = says(velocity[:, along], axis, lags)
            for part in "wxyz":
                channels[f"attitude_{part}"] = np.full(signals.sample_count, float(part == "w"))
        return replace(self.flight, signals=replace(signals, channels=channels))

    @cached_property
    def _motion(self) -> BodyMotion:
        """The predicted flight with what is commanded in place of states; no velocity where none is known."""
        signals = self._predicted.signals
        rates = np.stack([signals.channel(item.rate) for item in AXES])
        known = body_velocity(signals)
        velocity = np.zeros_like(rates) if known is None else known.T
        commands = self.vehicle.sums @ signals.family(self.flight.input.name).T
        unchanged = np.zeros(signals.sample_count)
        turning = np.stack([time_derivative(rate, signals.step_s) for rate in rates])
        return BodyMotion(self.vehicle, 1.0, commands, commands, unchanged, velocity, rates, turning)

    def _turning(self, axis: int, moving: RotorColumns) -> Float[np.ndarray, "n p"]:
        """Columns for several lags, and what couplings, spins, drag and lift turn in the predicted flight."""
        nodes = [(lag, 0.0) for lag in INSTRUMENT_LAGS_S]
        if self.flight.input.measured:
            nodes = [(0.0, delay) for delay in INSTRUMENT_DELAYS_S]
        columns = [
            moving({lagged_runs.ACTUATOR_LAG.name: lag, lagged_runs.DELAY.name: delay})
            for lag, delay in nodes
        ]
        of, known = self._motion, set(NEEDED) <= set(self._predicted.signals.channels)
        names = {COUPLING[axis], *GYROSCOPIC_MOMENT, *(LIFT_MOMENT if known else ())}
        turned = [term.column(of) for term in TERMS if term.equation == axis and term.parameter in names]
        turned += [of.by_product(axis, pair) for pair in range(len(PRODUCT))]
        dragged = of.velocity[list(ALONG_OTHERS[axis])] if known else ()
        return np.column_stack([*columns, *turned, *dragged])


#: Values of a sensor as its filter leaves them.
Filter = Callable[[Series], Series]


def filtered(column: Series, step_s: float, cutoff_hz: float, taken_s: float) -> Series:
    """Column behind a low-pass of second order, whose delay was taken off the stamps as far as given [s]."""
    late = low_passed(column[:, None], step_s=step_s, cutoff_hz=cutoff_hz)
    early_s = min(max(taken_s, 0.0), math.sqrt(2.0) / (2.0 * math.pi * cutoff_hz))
    return (shifted_by(late, step_s=step_s, delay_s=-early_s) if early_s else late)[:, 0]


def onboard_filter(flight: PreparedFlight, vehicle: KnownVehicle, axis: int) -> Filter | None:
    """Filter of the sensor whose values an equation explains; None where none is known."""
    turning = axis < FORCE_X_EQUATION
    cutoff_hz = vehicle.gyro_cutoff_hz if turning else vehicle.accelerometer_cutoff_hz
    if cutoff_hz is None:
        return None
    name = AXES[axis].rate if turning else f"specific_force_body_{ALONG[axis - FORCE_X_EQUATION]}"
    taken_s = flight.recording.channel(name).delay_s
    return partial(filtered, step_s=flight.signals.step_s, cutoff_hz=cutoff_hz, taken_s=taken_s)


def before(values: Float[np.ndarray, "*parts n"]) -> Float[np.ndarray, "*parts n"]:
    """Values at the sample before; the first one stays."""
    return np.concatenate([values[..., :1], values[..., :-1]], axis=-1)


def mean_over_step(values: Float[np.ndarray, "*parts n"]) -> Float[np.ndarray, "*parts n"]:
    """Mean over the step that ends at each sample, of what is nearly straight within it."""
    return 0.5 * (values + before(values))


def change_over_step(values: Float[np.ndarray, "*parts n"], step_s: float) -> Float[np.ndarray, "*parts n"]:
    """Mean of the derivative over the step that ends at each sample, exactly."""
    return (values - before(values)) / step_s


def as_logged(term: RigidTerm, of: BodyMotion, sensor: Filter | None) -> Series:
    """Column of a term behind its sensor's filter, where it is not made of filtered rates."""
    column = term.column(of)
    if term.equation < FORCE_X_EQUATION and not term.driving:
        return mean_over_step(column)
    return column if sensor is None else sensor(column)


# -- Flights --

#: Bands of spectral rows [Hz]: of turning, and of forces.
TURNING_BAND_HZ = (0.05, 20.0)
FORCE_BAND_HZ = (0.05, 8.0)
#: No band reaches beyond this share of the rate of what is measured.
BAND_SHARE = 0.2
#: Lags and delays that a search begins with [s]: in a band up to 20 Hz neighbours differ by little.
SEARCH_LAGS_S = np.geomspace(0.005, 0.2, 12)
SEARCH_DELAYS_S = np.linspace(0.0, 0.03, 4)
#: Accuracy of both [s]: gains are wrong by 5 % for a delay that is wrong by a millisecond.
TOLERANCE_S = 3e-7


def searched_lag_and_delay(known: KnownNumber | None = None) -> tuple[separable.Nuisance, separable.Nuisance]:
    """Lag and delay of commands, both continuous; of a delay that is known, what is known of it [s]."""
    lag, delay = lagged_runs.lag_and_delay(SEARCH_LAGS_S, SEARCH_DELAYS_S)
    lag = replace(lag, tolerance=TOLERANCE_S)
    if known is not None and not known.std:
        return lag, delay.known_at(known.value)
    if known is not None:
        delay = replace(delay, prior=separable.Prior(known.value, known.std))
    return lag, replace(delay, tolerance=TOLERANCE_S)


@dataclass
class RotorStates:
    """What all axes ask of a flight's rotors."""

    flight: PreparedFlight
    vehicle: KnownVehicle
    usual: float  # State of a rotor at hover, nearly, for which damping and drag are
    _last: tuple[tuple[float, ...], tuple[BodyMotion, BodyMotion]] | None = None

    def at(
        self, lag_s: float = 0.0, delay_s: float = 0.0, second_stage: float = 0.0, asymmetry: float = 0.0
    ) -> tuple[BodyMotion, BodyMotion]:
        """What columns are made of at a lag and a delay; the same with means over steps of what drives."""
        path = (lag_s, delay_s, second_stage, asymmetry)
        if self._last is None or self._last[0] != path:
            thrust_of, weights = input_map(self.flight.input_map), self.vehicle.sums
            step_s = self.flight.signals.step_s
            state, between = (
                self._moved(lag_s, delay_s + later, second_stage, asymmetry) for later in (0.0, 0.5 * step_s)
            )
            thrust, halfway = (weights @ thrust_of(item).T for item in (state, between))
            # Simpson's rule: a rotor follows its command smoothly within a step
            mean, states = (before(thrust) + 4.0 * halfway + thrust) / 6.0, weights @ state.T
            now = states, thrust, time_derivative(states[6], step_s)
            of = BodyMotion(self.vehicle, self.usual, *now, self.velocity, self.rates, self.turning)
            means = replace(of, thrust=mean, spin_up=change_over_step(states[6], step_s))
            self._last = path, (of, means)
        return self._last[1]

    @cached_property
    def rates(self) -> Float[np.ndarray, "3 n"]:
        return np.stack([self.flight.signals.channel(axis.rate) for axis in AXES])

    @cached_property
    def turning(self) -> Float[np.ndarray, "3 n"]:
        return np.stack([time_derivative(rate, self.flight.signals.step_s) for rate in self.rates])

    @cached_property
    def velocity(self) -> Float[np.ndarray, "3 n"]:
        """Velocity through the air on the body's axes; zero where it is not known, nor can be inferred."""
        result = body_velocity(self.flight.signals)
        if result is not None:
            return np.ascontiguousarray(result.T)
        unknown, along_z = np.zeros_like(self.rates), inferred_velocity(self.flight.signals, self.flight.runs)
        unknown[2] = 0.0 if along_z is None else along_z
        return unknown

    @cached_property
    def _logged(self) -> Float[np.ndarray, "n rotors"]:
        """What was logged of the rotors, each rotor's values side by side in memory."""
        return np.asfortranarray(self.flight.signals.family(self.flight.input.name))

    def _moved(
        self, lag_s: float, delay_s: float, second_stage: float, asymmetry: float
    ) -> Float[np.ndarray, "n rotors"]:
        path = {"lag_s": lag_s, "delay_s": delay_s, "second_stage": second_stage, "asymmetry": asymmetry}
        return self.flight.input.state(self._logged, self.flight.signals.step_s, **path)


@dataclass(frozen=True)
class RotorColumns:
    """Columns of what the rotors do to one axis, among those of all."""

    states: RotorStates
    axis: int  # Number of the equation
    moving: tuple[Parameter, ...]  # Parameters of all moving columns
    common_rotor_inertia: tuple[float, float] | None = None

    def __call__(self, nuisance_values: separable.Values) -> Float[np.ndarray, "n k"]:
        now, means = self.states.at(**lagged_runs.actuators(nuisance_values))
        of = means if self.axis < FORCE_X_EQUATION else now
        sensor = onboard_filter(self.states.flight, self.states.vehicle, self.axis)
        return np.stack([share * as_logged(term, of, sensor) for _, share, term in self._terms]).T

    @property
    def indices(self) -> tuple[int, ...]:
        """Places of this equation's parameters among those of all moving columns."""
        return tuple(index for index, *_ in self._terms)

    @cached_property
    def _terms(self) -> list[tuple[int, float, RigidTerm]]:
        """Place of the parameter, factor and term of each column."""
        results = []
        for term in TERMS:
            parameter, share = term.parameter, 1.0
            if self.common_rotor_inertia is not None and parameter in GYROSCOPIC_MOMENT:
                parameter, share = REACTION, self.common_rotor_inertia[term.index]
            if term.equation == self.axis and parameter in self.moving:
                results.append((self.moving.index(parameter), share, term))
        return sorted(results, key=itemgetter(0))


def rigid_body_problem(
    flights: tuple[PreparedFlight, ...], vehicle: KnownVehicle, rule: separable.InstrumentRule
) -> lagged_runs.LaggedRuns:
    """Regressions of the flights for each lag and delay."""
    known = set.intersection(*(set(flight.signals.channels) for flight in flights))
    usual = usual_state(flights)
    velocity = set(NEEDED) <= known
    forces = {
        FORCE_X_EQUATION + along
        for along, name in enumerate(ALONG)
        if f"specific_force_body_{name}" in known and (velocity or along == 2)
    }
    equations = {*range(FORCE_X_EQUATION), *forces}
    terms = [term for term in TERMS if term.equation in equations and (velocity or not term.by_velocity)]
    states = [RotorStates(flight, vehicle, usual) for flight in flights]
    made = [_flight(number, item, rule, terms) for number, item in enumerate(states)]
    columns = tuple(column for of_flight in made for column in of_flight)
    measured = all(flight.input.measured for flight in flights)
    nuisances = lagged_runs.measured_state() if measured else searched_lag_and_delay(vehicle.delay)
    parameters = (term.parameter for moves in (False, True) for term in terms if term.moves is moves)
    return lagged_runs.LaggedRuns(columns, tuple(parameters), nuisances)


def _flight(
    number: int, states: RotorStates, rule: separable.InstrumentRule, terms: list[RigidTerm]
) -> Iterator[lagged_runs.AxisColumns]:
    flight, signals, vehicle = states.flight, states.flight.signals, states.vehicle
    level = signals.family(flight.input.name).mean(axis=1)
    by_references = None
    if isinstance(rule, separable.LaggedReferences):
        by_references = AxisInstruments(flight, vehicle, rule)
    slowest = min(rate for role, rate in flight.rates_hz.items() if rate and role != "command")
    changes = change_over_step(states.rates, signals.step_s)
    by_velocity = force_by_velocity(signals) if any(term.by_velocity for term in terms) else None
    steady = [term for term in terms if not term.moves]
    moving = tuple(term.parameter for term in terms if term.moves)
    lagged = tuple(item for item in moving if item not in {*GYROSCOPIC_MOMENT, *ALL_DRAG_MOMENTS})
    for axis in sorted({term.equation for term in terms}):
        sensor = onboard_filter(flight, vehicle, axis)
        if axis < FORCE_X_EQUATION:
            (low, high), responses = TURNING_BAND_HZ, [changes[axis]]
        else:
            along, (low, high) = axis - FORCE_X_EQUATION, FORCE_BAND_HZ
            responses = [signals.channel(f"specific_force_body_{ALONG[along]}")]
            low = FROM_HZ if by_velocity is None else low
            if by_velocity is not None:
                derived = by_velocity[:, along]
                responses.append(derived if sensor is None else sensor(derived))
        fixed = np.zeros((signals.sample_count, len(steady)))
        for index, term in enumerate(steady):
            if term.equation == axis:
                fixed[:, index] = as_logged(term, states.at()[0], sensor)
        columns = RotorColumns(states, axis, moving)
        made = (
            rule.columns(signals, level)
            if by_references is None
            else by_references.of_axis(axis, replace(columns, moving=lagged))
        )
        yield lagged_runs.AxisColumns(
            signals.step_s,
            flight.runs,
            np.column_stack(responses),
            fixed,
            columns,
            made,
            number,
            axis,
            (low, min(high, BAND_SHARE * slowest)),
            flight.usable,
            columns.indices,
        )


def usual_state(flights: tuple[PreparedFlight, ...]) -> float:
    """State of a rotor at hover: it gives the mean thrust of flights, over the mean specific force in g."""
    chosen, force = input_map(flights[0].input_map), "specific_force_body_z"
    thrust = float(np.mean([chosen(flight.used_input).mean() for flight in flights]))
    forces = [
        flight.signals.channel(force)[flight.used].mean()
        for flight in flights
        if force in flight.signals.channels
    ]
    load = float(np.mean(forces)) / GRAVITY if forces else 1.0
    return chosen.inverse(thrust / load if 0.5 < load < 2.0 else thrust)


def hover_state(flight: PreparedFlight, vehicle: KnownVehicle, thrust: float) -> float | None:
    """State of a rotor at which thrust of that gain carries the weight; None unless it lifts."""
    gain = thrust * vehicle.count
    return input_map(flight.input_map).inverse(GRAVITY / gain) if gain > 0.0 else None


#: Of the surrogate's noises: a flight has the same estimate every time.
SEED = 0


def noises_known(flight: PreparedFlight) -> bool:
    """Whether noises are declared of all that is measured, and in every equation."""
    channels = flight.signals.channels
    speeds = family_members(flight.input.name, channels) if flight.input.measured else ()
    forces = {f"specific_force_body_{along}" for along in ALONG} & set(channels)
    return {*speeds, *(axis.rate for axis in AXES), *forces} <= set(flight.signals.noise)


def noisier(flight: PreparedFlight) -> PreparedFlight:
    """The flight with so much more of every noise that is declared."""
    signals, rng = flight.signals, np.random.default_rng(SEED)
    more = {
        name: values + signals.noise[name].sample(signals.sample_count, rng)
        for name, values in signals.channels.items()
        if name in signals.noise
    }
    return replace(flight, signals=replace(signals, channels={**signals.channels, **more}))
