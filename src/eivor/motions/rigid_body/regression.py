"""Regression problem of the rigid body: columns, instruments and velocities."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from eivor.flights.prepared import PreparedFlight
from eivor.models.lagged_runs import (
    ACTUATOR_LAG,
    DELAY,
    AxisColumns,
    LaggedRuns,
    lag_and_delay,
    measured_state,
)
from eivor.models.regression import Parameter
from eivor.models.separable import (
    DrivenSignals,
    InstrumentRule,
    LaggedReferences,
    NoInstruments,
    Nuisance,
    Prior,
    Values,
)
from eivor.models.signal_regression import cross_fitted
from eivor.motions.rates.verdict import AXES, PITCH, ROLL
from eivor.motions.rigid_body.vehicle import (
    ALONG,
    COUPLING,
    DAMPING,
    DRAG,
    DRAG_MOMENT,
    DRIVING,
    FORCE_X_EQUATION,
    FORCE_Z_EQUATION,
    GAIN,
    GYROSCOPIC_MOMENT,
    LIFT,
    LIFT_MOMENT,
    MOVING,
    OFFSET,
    PITCH_EQUATION,
    QUADRATIC_DRAG,
    REACTION,
    ROLL_EQUATION,
    THRUST,
    YAW_EQUATION,
    KnownNumber,
    KnownVehicle,
    RotorLayout,
)
from eivor.motions.vertical.model import GRAVITY
from eivor.signals.channels import family_members
from eivor.signals.filters import actuator_state, low_passed, shifted_by, time_derivative
from eivor.signals.signals import Signals
from eivor.signals.thrust_map import input_map
from eivor.tools import Float

# -- Translational lift --


def squares_across(
    layout: RotorLayout, velocity: Float[np.ndarray, "3 n"], yaw_rate: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "rotors n"]:
    """Square of the velocity across each rotor [(m/s)^2], of a body's velocity on its own axes."""
    x, y = -layout.pitch, layout.roll
    forward, left = velocity[0] - np.outer(y, yaw_rate), velocity[1] + np.outer(x, yaw_rate)
    return forward**2 + left**2


def lift_moments(
    layout: RotorLayout, velocity: Float[np.ndarray, "3 n"], yaw_rate: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "2 n"]:
    """Moments of these squares about x and y: what lift turns, but for a constant."""
    return np.stack([layout.roll, layout.pitch]) @ squares_across(layout, velocity, yaw_rate)


# -- Rotor moments --

#: Axes along which a velocity turns the vehicle about each axis.
ALONG_OTHERS = ((1, 2), (0, 2), (0, 1))


def drag_moments(axis: int, velocity: Float[np.ndarray, "3 n"]) -> Float[np.ndarray, "2 n"]:
    """What drag beside the centre of mass turns about an axis, but for the two constants."""
    return velocity[list(ALONG_OTHERS[axis])]


def gyroscopic_moment(
    axis: int, rates: Float[np.ndarray, "3 n"], spin: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """What rotors that spin turn about x or y, but for their inertia over the body's."""
    return rates[PITCH_EQUATION] * spin if axis == ROLL_EQUATION else -rates[ROLL_EQUATION] * spin


#: Parameters of these moments, side by side.
ALL_DRAG_MOMENTS = tuple(item for pair in DRAG_MOMENT for item in pair)


# -- Body velocity --

NEEDED = (*(f"velocity_{axis}" for axis in "xyz"), *(f"attitude_{part}" for part in "wxyz"))


def body_velocity(signals: Signals) -> Float[np.ndarray, "n 3"] | None:
    """Velocity forward, left and up of the body [m/s]; None where velocity or attitude are not known."""
    if not set(NEEDED) <= set(signals.channels):
        return None
    return on_body_axes(signals, *(signals.channel(f"velocity_{axis}") for axis in "xyz"))


def force_by_velocity(signals: Signals) -> Float[np.ndarray, "n 3"] | None:
    """What an accelerometer would read where the velocity changes as it does [m/s^2]; None likewise."""
    if not set(NEEDED) <= set(signals.channels):
        return None
    forward, left, up = (
        time_derivative(signals.channel(f"velocity_{axis}"), signals.step_s) for axis in "xyz"
    )
    return on_body_axes(signals, forward, left, up + GRAVITY)


def on_body_axes(
    signals: Signals, u: Float[np.ndarray, " n"], v: Float[np.ndarray, " n"], s: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 3"]:
    """A vector of the world, turned into the body's axes."""
    w, x, y, z = (signals.channel(f"attitude_{part}") for part in "wxyz")
    length = np.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = (part / np.where(length > 0.0, length, 1.0) for part in (w, x, y, z))
    return np.column_stack(
        [
            (1.0 - 2.0 * (y * y + z * z)) * u + 2.0 * (x * y + w * z) * v + 2.0 * (x * z - w * y) * s,
            2.0 * (x * y - w * z) * u + (1.0 - 2.0 * (x * x + z * z)) * v + 2.0 * (y * z + w * x) * s,
            2.0 * (x * z + w * y) * u + 2.0 * (y * z - w * x) * v + (1.0 - 2.0 * (x * x + y * y)) * s,
        ]
    )


def swift_velocity(velocity: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Velocity times its size, what a body's own drag goes with."""
    return np.linalg.norm(velocity, axis=1)[:, None] * velocity


# -- Inferred velocity --

FORCE = "specific_force_body_z"
#: Lowest frequency at which the integral serves [Hz].
FROM_HZ = 0.2
#: Half of a variation at this frequency is taken out of an integral [Hz].
TAKEN_OUT_HZ = FROM_HZ / 4.0


def inferred_velocity(signals: Signals, runs: Sequence[slice]) -> Float[np.ndarray, " n"] | None:
    """Velocity along z within each run [m/s], zero elsewhere; None without a specific force along z."""
    if FORCE not in signals.channels:
        return None
    velocity = np.zeros(signals.sample_count)
    for run in runs:
        excess = signals.channel(FORCE)[run] - GRAVITY * _cos_tilt(signals, run)
        velocity[run] = _integrated(excess - excess.mean(), signals.step_s)
    return velocity


def _cos_tilt(signals: Signals, run: slice) -> Float[np.ndarray, " length"]:
    parts = [f"attitude_{part}" for part in "wxyz"]
    if set(parts) <= set(signals.channels):
        w, x, y, z = (signals.channel(part)[run] for part in parts)
        return np.asarray(1.0 - 2.0 * (x * x + y * y) / np.maximum(w * w + x * x + y * y + z * z, 1e-12))
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


# -- Predicted --

#: Successive lags of references, how many and how long [s]: for turning, for velocity across, for height.
QUICK, SLOW, HEIGHT = (14, 0.04), (4, 1.0), (4, 0.15)
#: Axis of turning that tilts the thrust forward, and left.
TILTED = (PITCH_EQUATION, ROLL_EQUATION)


@dataclass(frozen=True)
class Predictors:
    """Exogenous signals of one flight, with their lags."""

    flight: PreparedFlight
    rule: LaggedReferences

    def of_axis(self, axis: int, lags: tuple[int, float]) -> Float[np.ndarray, "n p"]:
        """References of an axis with their lags; those of no axis of turning are of height."""
        turning = {source.channel: item.number for item in AXES for source in item.references}
        names = tuple(name for name in self.rule.channels if turning.get(name, FORCE_Z_EQUATION) == axis)
        signals = self.flight.signals
        driven = DrivenSignals(signals, np.zeros(signals.sample_count))
        return replace(self.rule, channels=names, lags=lags).columns(driven)

    def predicted(
        self, values: Float[np.ndarray, " n"], axis: int, lags: tuple[int, float]
    ) -> Float[np.ndarray, " n"]:
        """Prediction by the references of one axis, within what the values were."""
        used = self.flight.used
        result = cross_fitted(self.of_axis(axis, lags), values[:, None], used)[:, 0]
        return np.clip(result, values[used].min(), values[used].max()) if used.any() else result


def predicted_flight(flight: PreparedFlight, layout: RotorLayout, rule: LaggedReferences) -> PreparedFlight:
    """The same flight with predictions in place of its commands, rates and velocity."""
    signals, says = flight.signals, Predictors(flight, rule)
    channels = dict(signals.channels)
    for axis in (ROLL_EQUATION, PITCH_EQUATION, YAW_EQUATION):
        name = AXES[axis].rate
        channels[name] = says.predicted(signals.channel(name), axis, QUICK)
    channels |= _rotors(flight, layout, says)
    velocity = body_velocity(signals)
    if velocity is not None:
        by_axis = ((TILTED[0], SLOW), (TILTED[1], SLOW), (FORCE_Z_EQUATION, HEIGHT))
        for along, (axis, lags) in enumerate(by_axis):
            channels[f"velocity_{'xyz'[along]}"] = says.predicted(velocity[:, along], axis, lags)
        for part in "wxyz":
            channels[f"attitude_{part}"] = np.full(signals.sample_count, float(part == "w"))
    return replace(flight, signals=replace(signals, channels=channels))


def _rotors(
    flight: PreparedFlight, layout: RotorLayout, says: Predictors
) -> dict[str, Float[np.ndarray, " n"]]:
    """Commands of the rotors, put together of what lifts and what turns."""
    logged = flight.signals.family(flight.input.name)
    parts = np.column_stack([layout.roll, layout.pitch, layout.yaw, np.ones(layout.count)])
    shares = np.linalg.lstsq(parts, logged.T, rcond=None)[0].T
    chosen = (*((axis, QUICK) for axis in range(FORCE_X_EQUATION)), (FORCE_Z_EQUATION, HEIGHT))
    pairs, used = zip(shares.T, chosen, strict=True), logged[flight.used]
    selected = np.column_stack([says.predicted(share, axis, lags) for share, (axis, lags) in pairs])
    rotors = np.clip(selected @ parts.T, used.min(), used.max())
    return {f"{flight.input.name}_{number + 1}": column for number, column in enumerate(rotors.T)}


# -- Instruments --

#: Lags for which columns are instruments; delays, of a state that was measured [s].
INSTRUMENT_LAGS_S = (0.01, 0.03, 0.07, 0.15)
INSTRUMENT_DELAYS_S = (-0.02, 0.0, 0.02)

#: The moving columns of an equation in some flight, at a lag and a delay.
Columns = Callable[[Values], Float[np.ndarray, "n k"]]


@dataclass(frozen=True)
class AxisInstruments:
    """Instruments of every equation of one flight."""

    flight: PreparedFlight
    layout: RotorLayout
    rule: InstrumentRule

    def of_axis(self, axis: int, columns_of: Callable[[PreparedFlight], Columns]) -> Float[np.ndarray, "n p"]:
        """Columns for one equation; none where the rule has none."""
        signals = self.flight.signals
        if isinstance(self.rule, NoInstruments):
            return np.empty((signals.sample_count, 0))
        if not isinstance(self.rule, LaggedReferences):
            level = signals.family(self.flight.input.name).mean(axis=1)
            return self.rule.columns(DrivenSignals(signals, level))
        if axis < FORCE_X_EQUATION:
            return self._turning(axis, columns_of(self._predicted))
        says = Predictors(self.flight, self.rule)
        if axis == FORCE_Z_EQUATION:
            across = self._velocity[:, 0] ** 2 + self._velocity[:, 1] ** 2
            return np.column_stack([says.of_axis(FORCE_Z_EQUATION, HEIGHT), across, self._swift[:, 2]])
        along = axis - FORCE_X_EQUATION
        return np.column_stack([says.of_axis(TILTED[along], SLOW), self._swift[:, along]])

    @cached_property
    def _predicted(self) -> PreparedFlight:
        if not isinstance(self.rule, LaggedReferences):
            return self.flight
        return predicted_flight(self.flight, self.layout, self.rule)

    def _turning(self, axis: int, moving: Columns) -> Float[np.ndarray, "n p"]:
        """Columns for several lags, and the product of the other two rates."""
        nodes = [(lag, 0.0) for lag in INSTRUMENT_LAGS_S]
        if self.flight.input.measured:
            nodes = [(0.0, delay) for delay in INSTRUMENT_DELAYS_S]
        columns = [moving({ACTUATOR_LAG.name: lag, DELAY.name: delay}) for lag, delay in nodes]
        first, second = (self._predicted.signals.channel(AXES[(axis + n) % 3].rate) for n in (1, 2))
        return np.column_stack([*columns, first * second, *self._spun(axis), *self._moments(axis)])

    def _spun(self, axis: int) -> list[Float[np.ndarray, " n"]]:
        """What rotors that spin turn in the predicted flight."""
        if axis == YAW_EQUATION:
            return []
        signals = self._predicted.signals
        rates = np.stack([signals.channel(item.rate) for item in AXES])
        return [gyroscopic_moment(axis, rates, signals.family(self.flight.input.name) @ self.layout.yaw)]

    def _moments(self, axis: int) -> list[Float[np.ndarray, " n"]]:
        """What drag and lift turn in the predicted flight, where velocity is known."""
        signals = self._predicted.signals
        if body_velocity(signals) is None:
            return []
        dragged = [*drag_moments(axis, self._velocity.T)]
        if axis == YAW_EQUATION:
            return dragged
        lifted = lift_moments(self.layout, self._velocity.T, signals.channel(AXES[YAW_EQUATION].rate))
        return [*dragged, lifted[axis]]

    @cached_property
    def _velocity(self) -> Float[np.ndarray, "n 3"]:
        """Predicted velocity on the body's axes; zero where it is not known."""
        velocity = body_velocity(self._predicted.signals)
        return np.zeros((self.flight.signals.sample_count, 3)) if velocity is None else velocity

    @cached_property
    def _swift(self) -> Float[np.ndarray, "n 3"]:
        return swift_velocity(self._velocity)


# -- Onboard filters --


@dataclass(frozen=True, slots=True)
class OnboardFilter:
    """A low-pass of second order that one axis' sensor has."""

    step_s: float
    cutoff_hz: float
    taken_s: float  # Delay that has been taken off the sensor's stamps [s]

    def __call__(self, column: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return a column as the sensor would have logged it."""
        late = low_passed(column[:, None], step_s=self.step_s, cutoff_hz=self.cutoff_hz)
        own_s = math.sqrt(2.0) / (2.0 * math.pi * self.cutoff_hz)
        early_s = min(max(self.taken_s, 0.0), own_s)
        return (shifted_by(late, step_s=self.step_s, delay_s=-early_s) if early_s else late)[:, 0]


def onboard_filter(flight: PreparedFlight, vehicle: KnownVehicle, axis: int) -> OnboardFilter | None:
    """Filter of the sensor whose values an equation explains; None where none is known."""
    turning = axis < FORCE_X_EQUATION
    cutoff_hz = vehicle.gyro_cutoff_hz if turning else vehicle.accelerometer_cutoff_hz
    if cutoff_hz is None:
        return None
    name = AXES[axis].rate if turning else f"specific_force_body_{ALONG[axis - FORCE_X_EQUATION]}"
    return OnboardFilter(flight.signals.step_s, cutoff_hz, flight.recording.channel(name).delay_s)


def as_logged(
    columns: Mapping[Parameter, Float[np.ndarray, " n"]], axis: int, sensor: OnboardFilter | None
) -> dict[Parameter, Float[np.ndarray, " n"]]:
    """Columns of an equation, those behind its sensor's filter that are not made of filtered rates."""
    if sensor is None:
        return dict(columns)
    return {
        name: sensor(values) if axis >= FORCE_X_EQUATION or name in DRIVING else values
        for name, values in columns.items()
    }


# -- Finite differences --


def before(values: Float[np.ndarray, "*parts n"]) -> Float[np.ndarray, "*parts n"]:
    """Values at the sample before; the first one stays."""
    return np.concatenate([values[..., :1], values[..., :-1]], axis=-1)


def mean_over_step(values: Float[np.ndarray, "*parts n"]) -> Float[np.ndarray, "*parts n"]:
    """Mean over the step that ends at each sample, of what is nearly straight within it."""
    return 0.5 * (values + before(values))


def change_over_step(values: Float[np.ndarray, "*parts n"], step_s: float) -> Float[np.ndarray, "*parts n"]:
    """Mean of the derivative over the step that ends at each sample, exactly."""
    return (values - before(values)) / step_s


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


def searched_lag_and_delay(known: KnownNumber | None = None) -> tuple[Nuisance, Nuisance]:
    """Lag and delay of commands, both continuous; of a delay that is known, what is known of it [s]."""
    lag, delay = lag_and_delay(SEARCH_LAGS_S, SEARCH_DELAYS_S)
    lag = replace(lag, tolerance=TOLERANCE_S)
    if known is not None and not known.std:
        return lag, delay.known_at(known.value)
    if known is not None:
        delay = replace(delay, prior=Prior(known.value, known.std))
    return lag, replace(delay, tolerance=TOLERANCE_S)


@dataclass(frozen=True, slots=True)
class RotorSums:
    """Sums over a flight's rotors, see `RotorLayout.sums`."""

    state: Float[np.ndarray, "7 n"]
    thrust: Float[np.ndarray, "7 n"]
    mean_thrust: Float[np.ndarray, "7 n"]  # The latter's mean over the step that ends there


@dataclass
class RotorStates:
    """What all axes ask of a flight's rotors."""

    flight: PreparedFlight
    layout: RotorLayout
    _last: tuple[tuple[float, float], RotorSums] | None = None

    def sums_at(self, lag_s: float, delay_s: float) -> RotorSums:
        """Sums over the rotors at a lag and a delay."""
        if self._last is None or self._last[0] != (lag_s, delay_s):
            thrust_of, weights = input_map(self.flight.input_map), self.layout.sums
            half_s = 0.5 * self.flight.signals.step_s
            state, between = (self._moved(lag_s, delay_s + later) for later in (0.0, half_s))
            thrust, halfway = (weights @ thrust_of(item).T for item in (state, between))
            # Simpson's rule: a rotor follows its command smoothly within a step
            mean = (before(thrust) + 4.0 * halfway + thrust) / 6.0
            self._last = (lag_s, delay_s), RotorSums(weights @ state.T, thrust, mean)
        return self._last[1]

    @cached_property
    def across(self) -> Float[np.ndarray, " n"]:
        """Square of the velocity across the rotors, its mean over them."""
        return squares_across(self.layout, self.velocity, self.rates[2]).mean(axis=0)

    @cached_property
    def rates(self) -> Float[np.ndarray, "3 n"]:
        """Body rates."""
        return np.stack([self.flight.signals.channel(axis.rate) for axis in AXES])

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

    def _moved(self, lag_s: float, delay_s: float) -> Float[np.ndarray, "n rotors"]:
        step_s = self.flight.signals.step_s
        if self.flight.input.measured:
            return shifted_by(self._logged, step_s=step_s, delay_s=delay_s)
        return actuator_state(self._logged, step_s=step_s, lag_s=lag_s, delay_s=delay_s)


@dataclass(frozen=True)
class RotorColumns:
    """Columns of what the rotors do to one axis, among those of all."""

    states: RotorStates
    axis: int  # Number of the equation
    moving: tuple[Parameter, ...]  # Parameters of all moving columns
    usual: float
    common_rotor_inertia: tuple[float, float] | None = None

    def __call__(self, nuisance_values: Values) -> Float[np.ndarray, "n k"]:
        """Columns at a lag and a delay, of the parameters of this equation."""
        lag_s, delay_s = nuisance_values[ACTUATOR_LAG.name], nuisance_values[DELAY.name]
        axis = self._of_axis(self.states.sums_at(lag_s, delay_s))
        selected = {self.moving[index]: axis[self.moving[index]] for index in self.indices}
        return np.stack(list(as_logged(selected, self.axis, self._sensor).values())).T

    @cached_property
    def indices(self) -> tuple[int, ...]:
        """Places of this equation's parameters among those of all moving columns."""
        moving_here = {*MOVING[self.axis]}
        if self.common_rotor_inertia is not None and self.axis in (ROLL_EQUATION, PITCH_EQUATION):
            moving_here.add(REACTION)
        return tuple(index for index, item in enumerate(self.moving) if item in moving_here)

    @cached_property
    def _sensor(self) -> OnboardFilter | None:
        return onboard_filter(self.states.flight, self.states.layout.vehicle, self.axis)

    def _of_axis(self, sums: RotorSums) -> dict[Parameter, Float[np.ndarray, " n"]]:
        axis, (count, _, _, xx, _, yy, _) = self.axis, self.states.layout.sums.sum(axis=1).tolist()
        dragged = -dragged_by(axis, sums.state, self.states.velocity, self.states.rates) / self.usual
        if axis >= FORCE_X_EQUATION:
            return {
                DRAG[axis - FORCE_X_EQUATION]: dragged / count,
                THRUST: sums.thrust[0],
                LIFT: self.states.across,
            }
        damped, mean = mean_over_step(dragged), sums.mean_thrust
        neighbours = self._rotor_moments(sums)
        if axis == YAW_EQUATION:
            spinning = change_over_step(sums.state[6], self.states.flight.signals.step_s)
            return {
                GAIN[YAW_EQUATION]: mean[6],
                REACTION: spinning,
                DAMPING[YAW_EQUATION]: damped / (xx + yy),
                **neighbours,
            }
        arms, square = ((mean[2], yy), (-mean[1], xx))[axis]
        spinning = mean_over_step(gyroscopic_moment(axis, self.states.rates, sums.state[6]))
        return {
            GAIN[axis]: arms,
            OFFSET[axis]: mean[0],
            DAMPING[axis]: damped / square,
            **self._spun(spinning),
            **neighbours,
        }

    def _spun(self, spinning: Float[np.ndarray, " n"]) -> dict[Parameter, Float[np.ndarray, " n"]]:
        """What rotors that spin turn about roll or pitch, by the parameter that it goes with."""
        if self.common_rotor_inertia is None:
            return {GYROSCOPIC_MOMENT[self.axis]: spinning}
        return {REACTION: self.common_rotor_inertia[self.axis] * spinning}

    def _rotor_moments(self, sums: RotorSums) -> dict[Parameter, Float[np.ndarray, " n"]]:
        """What drag beside the centre of mass turns: the means of the velocities at the rotors."""
        states, results = self.states, {}
        for parameter, along in zip(DRAG_MOMENT[self.axis], ALONG_OTHERS[self.axis], strict=True):
            dragged = dragged_by(FORCE_X_EQUATION + along, sums.state, states.velocity, states.rates)
            results[parameter] = mean_over_step(dragged) / (states.layout.count * self.usual)
        return results


def dragged_by(
    axis: int,
    state: Float[np.ndarray, "7 n"],
    velocity: Float[np.ndarray, "3 n"],
    rates: Float[np.ndarray, "3 n"],
) -> Float[np.ndarray, " n"]:
    """Sum over the rotors of state times the velocity at each: along an axis, or its moment about one."""
    total, x, y, xx, xy, yy, _ = state
    (u, v, w), (p, q, r) = velocity, rates
    if axis == ROLL_EQUATION:
        return w * y + p * yy - q * xy
    if axis == PITCH_EQUATION:
        return q * xx - p * xy - w * x
    if axis == YAW_EQUATION:
        return v * x - u * y + r * (xx + yy)
    if axis == FORCE_Z_EQUATION:
        return w * total + p * y - q * x
    return u * total - r * y if axis == FORCE_X_EQUATION else v * total + r * x


def rigid_body_problem(
    flights: tuple[PreparedFlight, ...], layout: RotorLayout, rule: InstrumentRule
) -> LaggedRuns:
    """Regressions of the flights for each lag and delay."""
    terms, usual = _terms(flights), usual_state(flights)
    columns = tuple(
        item
        for number, flight in enumerate(flights)
        for item in _flight(number, flight, layout, rule, terms, usual)
    )
    measured = all(flight.input.measured for flight in flights)
    nuisances = measured_state() if measured else searched_lag_and_delay(layout.vehicle.delay)
    return LaggedRuns(columns, (*terms.fixed, *terms.moving), nuisances)


@dataclass(frozen=True)
class Terms:
    """What the equations of flights have, given what all of them logged."""

    forces: tuple[int, ...]  # Axes along which the specific force is known, from 0
    velocity: bool  # The velocity on the body's axes is known

    @property
    def fixed(self) -> tuple[Parameter, ...]:
        """Parameters of the columns that stay."""
        body = tuple(QUADRATIC_DRAG[along] for along in self.forces) if self.velocity else ()
        return (*COUPLING, *body, *(LIFT_MOMENT if self.velocity else ()))

    @property
    def moving(self) -> tuple[Parameter, ...]:
        """Parameters of the columns that move with lag and delay."""
        drag = tuple(DRAG[along] for along in self.forces)
        lift = (LIFT,) if self.velocity and 2 in self.forces else ()
        thrust = (THRUST,) if 2 in self.forces else ()
        neighbours = (*GYROSCOPIC_MOMENT, *(ALL_DRAG_MOMENTS if self.velocity else ()))
        return (*GAIN, *DAMPING, *OFFSET, REACTION, *neighbours, *thrust, *drag, *lift)

    @property
    def lagged_instruments(self) -> tuple[Parameter, ...]:
        """Those of them whose columns are instruments at several lags."""
        return tuple(item for item in self.moving if item not in {*GYROSCOPIC_MOMENT, *ALL_DRAG_MOMENTS})


def _terms(flights: tuple[PreparedFlight, ...]) -> Terms:
    known = set.intersection(*(set(flight.signals.channels) for flight in flights))
    velocity = set(NEEDED) <= known
    forces = tuple(
        along
        for along, name in enumerate(ALONG)
        if f"specific_force_body_{name}" in known and (velocity or along == 2)
    )
    return Terms(forces, velocity)


def _flight(
    number: int, flight: PreparedFlight, layout: RotorLayout, rule: InstrumentRule, terms: Terms, usual: float
) -> list[AxisColumns]:
    signals = flight.signals
    states, instruments = RotorStates(flight, layout), AxisInstruments(flight, layout, rule)
    slowest = min(rate for role, rate in flight.rates_hz.items() if rate and role != "command")

    def columns(axis: int, responses: Float[np.ndarray, "n r"]) -> AxisColumns:
        staying = np.zeros((len(responses), len(terms.fixed)))
        for parameter, item in _staying(axis, terms, states).items():
            staying[:, terms.fixed.index(parameter)] = item
        low, high = TURNING_BAND_HZ if axis < FORCE_X_EQUATION else FORCE_BAND_HZ
        if axis >= FORCE_X_EQUATION and not terms.velocity:
            low = FROM_HZ
        moving = RotorColumns(states, axis, terms.moving, usual)

        def columns_of(other: PreparedFlight) -> Columns:
            return replace(moving, states=RotorStates(other, layout), moving=terms.lagged_instruments)

        return AxisColumns(
            signals.step_s,
            flight.runs,
            responses,
            staying,
            moving,
            instruments.of_axis(axis, columns_of),
            number,
            axis,
            (low, min(high, BAND_SHARE * slowest)),
            flight.usable,
            moving.indices,
        )

    changes = change_over_step(states.rates, signals.step_s)
    turning = [columns(axis, changes[axis][:, None]) for axis in range(FORCE_X_EQUATION)]
    by_velocity = force_by_velocity(signals) if terms.velocity else None
    forces = []
    for along in terms.forces:
        measured = [signals.channel(f"specific_force_body_{ALONG[along]}")]
        if by_velocity is not None:
            sensor = onboard_filter(flight, layout.vehicle, FORCE_X_EQUATION + along)
            measured.append(_behind(sensor, by_velocity[:, along]))
        forces.append(columns(FORCE_X_EQUATION + along, np.column_stack(measured)))
    return [*turning, *forces]


def _staying(axis: int, terms: Terms, states: RotorStates) -> dict[Parameter, Float[np.ndarray, " n"]]:
    """Columns of an equation that no lag moves."""
    layout, velocity, rates = states.layout, states.velocity, states.rates
    if axis >= FORCE_X_EQUATION:
        if not terms.velocity:
            return {}
        swift = -swift_velocity(velocity.T)[:, axis - FORCE_X_EQUATION]
        sensor = onboard_filter(states.flight, layout.vehicle, axis)
        return {QUADRATIC_DRAG[axis - FORCE_X_EQUATION]: _behind(sensor, swift)}
    results = {COUPLING[axis]: rates[(axis + 1) % 3] * rates[(axis + 2) % 3]}
    if terms.velocity and axis != YAW_EQUATION:
        results[LIFT_MOMENT[axis]] = lift_moments(layout, velocity, rates[YAW_EQUATION])[axis]
    return {parameter: mean_over_step(result) for parameter, result in results.items()}


def _behind(sensor: OnboardFilter | None, column: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    return column if sensor is None else sensor(column)


def usual_state(flights: tuple[PreparedFlight, ...]) -> float:
    """State of a rotor that gives the mean thrust of flights."""
    chosen = input_map(flights[0].input_map)
    return chosen.inverse(float(np.mean([chosen(flight.used_input).mean() for flight in flights])))


# -- Surrogate --

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
