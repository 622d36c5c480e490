"""Cascaded controller with sensors and delays."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
import scipy

from eivor import checks
from eivor.errors import ParameterError
from eivor.motions.rigid_body import dynamics
from eivor.motions.rigid_body.dynamics import Components, Triple, Value
from eivor.motions.rigid_body.vehicle import Vehicle
from eivor.signals.noise import MeasurementNoise, WhiteNoise
from eivor.signals.recording import GRAVITY
from eivor.tools import Float, Int

#: No loop is quicker than this, however quick the rotors are [1/s].
LARGEST_RATE_GAIN, LARGEST_ATTITUDE_GAIN, LARGEST_CLIMB_GAIN = 40.0, 12.0, 5.0
#: Gain of the attitude loop over that of the rate loop, half of it in yaw; of the climb rate's loop times T
#: and half a period of the height loop; of the height loop over that, and of its integrator over its square.
ATTITUDE_SHARE, CLIMB_QUICKNESS, HEIGHT_SHARE, CLIMB_INTEGRAL_SHARE = 0.5, 0.35, 0.3, 0.05
#: Of the first-order filter of the rate loop's derivative [Hz].
DERIVATIVE_CUTOFF_HZ = 30.0
#: Largest gain of the rate loop in normalised torque [per rad/s].
LARGEST_TORQUE_PER_RATE = 0.5
#: Largest part of a torque setpoint that the integrator may hold.
LARGEST_INTEGRAL = 0.3
#: Share of the weight that is the least thrust, and of full thrust that is the largest.
LEAST_WEIGHT, MOST_THRUST = 0.05, 0.9
#: The least thrust of a rotor that is commanded, as a share of its full one.
IDLE = 1e-3
#: Thrust is raised for a tilt of up to so much: the least cosine.
LEAST_COSINE = 0.5
#: Gain of the velocity of a vehicle that holds its place, over that of the place; its largest tilt [rad].
HOLD_DAMPING, MOST_HOLDING_TILT = 3.0, 0.3


@dataclass(frozen=True, slots=True)
class FlightController:
    """Rates and quickness of the loops.

    Quickness is relative to the vehicle: T is the sum of the rotors' lag and delay, the delays of gyroscope
    and filter, and half a period of the rate loop.
    """

    # How often each loop runs [Hz]: the simulation's rate over a whole number
    rate_hz: Annotated[float, (10.0, 1e4)] = 500.0
    attitude_hz: Annotated[float, (10.0, 1e4)] = 250.0
    height_hz: Annotated[float, (1.0, 1e4)] = 50.0
    # Gain of the rate loop times T, less on an axis with little torque
    quickness: Annotated[float, (0.01, 2.0)] = 0.6
    # Integral gain of the rate loop over the square of its gain
    integral_share: Annotated[float, (0.0, 0.5)] = 0.05
    derivative_share: Annotated[float, (0.0, 2.0)] = 0.0  # Derivative time of the rate loop over T
    # Gain towards the place where the flight began [1/s]: zero for a vehicle that flies attitudes and drifts
    hold: Annotated[float, (0.0, 1.0)] = 0.0

    def __post_init__(self) -> None:
        checks.in_ranges(self, "Correct the controller.")


@dataclass(frozen=True, slots=True)
class Gains:
    """Numbers of the loops, of one flight or of several."""

    rate: tuple[Value, ...]
    integral: tuple[Value, ...]
    derivative: tuple[Value, ...]
    attitude: tuple[Value, ...]  # [1/s]
    climb: Value  # shape (flights,)
    climb_integral: Value  # shape (flights,)
    height: Value  # shape (flights,)
    hold: Value  # shape (flights,), [1/s]
    weight: Value  # shape (flights,)
    full_thrust: Value  # shape (flights,)
    mass: Value  # shape (flights,), [kg]


def gains_of(controller: FlightController, vehicle: Vehicle, sensing_s: float) -> Gains:
    """Gains that suit a vehicle."""
    rotors = vehicle.rotors
    slowness = max(rotors.lag_up, rotors.lag_down) + rotors.delay + sensing_s + 0.5 / controller.rate_hz
    quickest = min(controller.quickness / slowness, LARGEST_RATE_GAIN)
    effectiveness = control_effectiveness(vehicle)
    # An axis that is weak, as yaw is, would be at its limit from noise alone.
    rates = [min(quickest, LARGEST_TORQUE_PER_RATE * gain) for gain in effectiveness]
    attitude = [min(ATTITUDE_SHARE * rate, LARGEST_ATTITUDE_GAIN) for rate in rates]
    climb = min(CLIMB_QUICKNESS / (slowness + 0.5 / controller.height_hz), LARGEST_CLIMB_GAIN)
    loops = list(zip(rates, effectiveness, strict=True))
    return Gains(
        rate=tuple(rate / gain for rate, gain in loops),
        integral=tuple(controller.integral_share * rate**2 / gain for rate, gain in loops),
        derivative=tuple(controller.derivative_share * slowness * rate / gain for rate, gain in loops),
        attitude=(attitude[0], attitude[1], 0.5 * attitude[2]),
        climb=climb,
        climb_integral=CLIMB_INTEGRAL_SHARE * climb**2,
        height=HEIGHT_SHARE * climb,
        hold=controller.hold,
        weight=vehicle.mass * GRAVITY,
        full_thrust=vehicle.full_thrust,
        mass=vehicle.mass,
    )


def torque_limits(vehicle: Vehicle) -> tuple[float, float, float]:
    """Torques [N m] of the setpoints 1 about each axis: the rotors of one side at full speed, no others."""
    rotors = vehicle.rotors
    full = rotors.thrust(rotors.highest_speed)
    roll = sum(max(y, 0.0) for _, y, _ in rotors.positions)
    pitch = sum(max(-x, 0.0) for x, _, _ in rotors.positions)
    yaw = rotors.torque_ratio * sum(max(spin, 0) for spin in rotors.spins)
    return full * roll, full * pitch, full * yaw


def control_effectiveness(vehicle: Vehicle) -> tuple[float, float, float]:
    """Angular acceleration [rad/s^2] per unit of each torque setpoint, rotors within their limits."""
    limits = torque_limits(vehicle)
    roll, pitch, yaw = (limit / item for limit, item in zip(limits, vehicle.inertia[:3], strict=True))
    return roll, pitch, yaw


def clipped(value: Value, low: Value, high: Value) -> Value:
    """Value clipped to two limits."""
    if isinstance(value, np.ndarray):
        return np.minimum(np.maximum(value, low), high)
    return min(max(value, low), high)


class Cascade:
    """The three loops of a flight, or of several side by side, and their states."""

    def __init__(self, gains: Gains, rate_period_s: float, height_period_s: float) -> None:
        self._gains = gains
        self._rate_period_s, self._height_period_s = rate_period_s, height_period_s
        self._integral: list[Value] = [0.0, 0.0, 0.0]
        self._climb_integral: Value = 0.0
        self._previous: Triple | None = None
        self._derivative: list[Value] = [0.0, 0.0, 0.0]
        self._decay = float(np.exp(-2.0 * np.pi * DERIVATIVE_CUTOFF_HZ * rate_period_s))
        self._differentiates = bool(np.any(np.array(gains.derivative)))

    def thrust(self, reference: Triple, height: Value, climb: Value, cosine: Value) -> Value:
        g = self._gains
        height_reference, climb_reference, acceleration = reference
        error = climb_reference + g.height * (height_reference - height) - climb
        self._climb_integral = self._climb_integral + error * self._height_period_s
        acceleration = acceleration + g.climb * error + g.climb_integral * self._climb_integral
        upward = g.weight + g.mass * acceleration
        thrust = upward / clipped(cosine, LEAST_COSINE, 1.0)
        return clipped(thrust, LEAST_WEIGHT * g.weight, MOST_THRUST * g.full_thrust) / g.full_thrust

    def holding(self, reference: Components, components: Components, drift: Components) -> list[Value]:
        """Attitude setpoint, tilted towards the position where the flight began."""
        hold = self._gains.hold
        limit = MOST_HOLDING_TILT * GRAVITY
        forward, left = (
            clipped(HOLD_DAMPING * hold * (-hold * offset - speed), -limit, limit)
            for offset, speed in zip(components, drift, strict=True)
        )
        forward_tilt, left_tilt, _ = dynamics.into_body(dynamics.rotation(*reference), forward, left, 0.0)
        return dynamics.turned(reference, -left_tilt / GRAVITY, forward_tilt / GRAVITY, 0.0)

    def rates(self, setpoint: Components, attitude: Components) -> Triple:
        """Body-rate setpoints [rad/s] that turn the attitude towards its setpoint."""
        a, b, c, d = setpoint
        w, x, y, z = attitude
        # vector part of conj(attitude) wanted, by the shorter way round
        twice_sign = 4.0 * (a * w + b * x + c * y + d * z >= 0.0) - 2.0
        roll, pitch, yaw = self._gains.attitude
        return (
            twice_sign * roll * (w * b - a * x - y * d + z * c),
            twice_sign * pitch * (w * c - a * y - z * b + x * d),
            twice_sign * yaw * (w * d - a * z - x * c + y * b),
        )

    def torques(self, setpoints: Triple, measured: Triple) -> Triple:
        """Normalised torques of the rate loop's PID law."""
        g, period = self._gains, self._rate_period_s
        error = [item - reading for item, reading in zip(setpoints, measured, strict=True)]
        self._integral = [
            clipped(held + gain * period * item, -LARGEST_INTEGRAL, LARGEST_INTEGRAL)
            for held, gain, item in zip(self._integral, g.integral, error, strict=True)
        ]
        torque = [gain * item + held for gain, item, held in zip(g.rate, error, self._integral, strict=True)]
        if self._differentiates:
            torque = [
                item - gain * slope
                for item, gain, slope in zip(torque, g.derivative, self._slopes(measured), strict=True)
            ]
        roll, pitch, yaw = (clipped(item, -1.0, 1.0) for item in torque)
        return roll, pitch, yaw

    def _slopes(self, measured: Triple) -> list[Value]:
        decay, previous = self._decay, self._previous or measured
        self._previous = measured
        self._derivative = [
            decay * derivative + (1.0 - decay) * (now - last) / self._rate_period_s
            for derivative, now, last in zip(self._derivative, measured, previous, strict=True)
        ]
        return self._derivative


@dataclass(frozen=True, slots=True)
class Mixer:
    """Allocation of normalised thrust and torques to the rotors."""

    shares: tuple[tuple[Value, Value, Value, Value], ...]
    thrust_linear: Value  # shape (flights,)
    thrust_quadratic: Value  # shape (flights,)
    least: Value  # shape (flights,)
    most: Value  # shape (flights,)

    def commands(self, thrust: Value, torques: Triple) -> list[Value]:
        """Rotor speeds for a thrust and torques, within the rotors' limits."""
        roll, pitch, yaw = torques
        linear, quadratic = self.thrust_linear, self.thrust_quadratic
        speeds = []
        for up, left, down, around in self.shares:
            force = clipped(up * thrust + left * roll + down * pitch + around * yaw, self.least, self.most)
            speeds.append(2.0 * force / (linear + (linear * linear + 4.0 * quadratic * force) ** 0.5))
        return speeds


def mixer_of(vehicle: Vehicle) -> Mixer:
    """Mixer of one vehicle, in floats."""
    rotors = vehicle.rotors
    x, y, _ = np.array(rotors.positions).T
    geometry = np.stack([np.ones(rotors.count), y, -x, rotors.torque_ratio * np.array(rotors.spins)])
    scale = np.array([vehicle.full_thrust, *torque_limits(vehicle)])
    if np.any(scale <= 0.0) or np.linalg.matrix_rank(geometry / scale[:, None], tol=1e-9) < 4:
        expected = "rotors that give thrust and a torque about each axis independently"
        remedy = "Correct positions and spins; neighbours turn opposite ways."
        raise ParameterError(expected, f"{rotors.count} rotors that do not", remedy)
    shares = np.linalg.pinv(geometry / scale[:, None]).tolist()
    full = rotors.thrust(rotors.highest_speed)
    return Mixer(
        shares=tuple((up, left, down, around) for up, left, down, around in shares),
        thrust_linear=rotors.thrust_linear,
        thrust_quadratic=rotors.thrust_quadratic,
        least=max(rotors.thrust(rotors.lowest_speed), IDLE * full),
        most=full,
    )


def stacked_mixer(vehicles: Sequence[Vehicle]) -> Mixer:
    """Mixer of several vehicles with equally many rotors, in arrays."""
    mixers = [mixer_of(vehicle) for vehicle in vehicles]
    # (rotors, 4, flights)
    shares = np.array([item.shares for item in mixers]).transpose(1, 2, 0)
    up, left, down, around = (np.ascontiguousarray(shares[:, part]) for part in range(4))
    return dynamics.stacked(mixers, shares=((up, left, down, around),))


class DelayLine:
    """Delay of one step or more, equal or not among flights side by side."""

    def __init__(self, delay_s: Any, step_s: float, initial: Sequence[Value] | None = None) -> None:
        self._delay = steps = np.rint(np.array(delay_s) / step_s).astype(np.int64)
        self._uniform, self._longest = bool(np.all(steps == steps[0])), int(steps.max())
        self._past: deque[list[Value]] = deque(maxlen=self._longest + 1)
        self._rings = [] if initial is None else self._filled(list(initial))
        self._step = 0

    def _filled(self, values: list[Value]) -> list[np.ndarray]:
        """Past of those values; of flights that differ in arrays whose first axis is the step."""
        self._past.extend([values] * self._longest)
        return [] if self._uniform else [np.stack([value] * (self._longest + 1)) for value in values]

    def push(self, values: list[Value]) -> list[Value]:
        """Send values, and return those that arrive in this step."""
        if self._longest == 0:
            return values
        if not self._past:
            self._rings = self._filled(values)
        if self._uniform:
            self._past.append(values)
            return self._past[0]
        rows = (self._step - self._delay) % (self._longest + 1)
        for ring, value in zip(self._rings, values, strict=True):
            ring[self._step % (self._longest + 1)] = value
        self._step += 1
        flights = np.arange(rows.size)
        return [np.moveaxis(ring[rows, ..., flights], 0, -1) for ring in self._rings]


Readings = Float[np.ndarray, "count axes"]

#: Stamps never err by more than this part of their period.
LARGEST_JITTER = 0.45


@dataclass(frozen=True, slots=True)
class Sensor:
    """How a quantity is measured, alike on each axis."""

    # Of the readings, before the filter
    noise: MeasurementNoise = field(default_factory=lambda: WhiteNoise(0.0))
    bias: Annotated[float, checks.finite] = 0.0  # Constant error, in the unit of the quantity
    rate_hz: Annotated[float, (0.0, 1e5)] = 0.0  # At which it is logged [Hz]; every reading where zero
    # Of the filter, a low-pass of the second order with Butterworth's damping [Hz]; none where zero
    cutoff_hz: Annotated[float, (0.0, 1e5)] = 0.0
    # By which readings are late [s], rounded to steps of the simulation
    delay_s: Annotated[float, (0.0, 1.0)] = 0.0
    offset_s: Annotated[float, (0.0, 1.0)] = 0.0  # Time of the first one that is logged [s], rounded likewise
    jitter_s: Annotated[float, (0.0, 1.0)] = 0.0  # Standard deviation of the stamps' error [s]

    def __post_init__(self) -> None:
        checks.in_ranges(self, "Correct the sensor.")

    @property
    def lateness_s(self) -> float:
        """Delay of slow signals: its own and its filter's [s]."""
        return self.delay_s + (np.sqrt(2.0) / (2.0 * np.pi * self.cutoff_hz) if self.cutoff_hz else 0.0)

    def errors(self, count: int, axes: int, rng: np.random.Generator) -> Readings:
        """Errors of the true values before the filter, one row for each step."""
        return self.bias + np.column_stack([self.noise.sample(count, rng) for _ in range(axes)])

    def readings(self, raw: Readings, step_s: float) -> Readings:
        """Output of filter and delay, both at rest at the first value."""
        delay = round(self.delay_s / step_s)
        filtered = raw
        if self.cutoff_hz:
            b, a = map(np.array, self.low_pass(step_s))
            before = np.outer(scipy.signal.lfilter_zi(b, a), raw[0])
            filtered = scipy.signal.lfilter(b, a, raw, axis=0, zi=before)[0]
        rows = np.maximum(np.arange(raw.shape[0]) - delay, 0)
        return filtered[rows]

    def low_pass(self, step_s: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Numerator and denominator of the filter at a rate; of no filter a gain of one."""
        if not self.cutoff_hz:
            return (1.0, 0.0, 0.0), (1.0, 0.0, 0.0)
        if not self.cutoff_hz < 0.5 / step_s:
            expected = "a filter whose cut-off lies below half the simulation's rate"
            received = f"{self.cutoff_hz:g} Hz at {1.0 / step_s:g} Hz"
            raise ParameterError(expected, received, "Lower it, or raise the rate.")
        b, a = scipy.signal.butter(2, self.cutoff_hz, fs=1.0 / step_s)
        return tuple(b.tolist()), tuple(a.tolist())

    def rows(self, count: int, step_s: float) -> Int[np.ndarray, " rows"]:
        first = round(self.offset_s / step_s)
        if not self.rate_hz:
            return np.arange(first, count)
        number = int((count - first) * step_s * self.rate_hz) + 1
        rows = first + np.rint(np.arange(number) / (self.rate_hz * step_s)).astype(np.int64)
        return np.unique(rows[rows < count])

    def stamps(
        self, rows: Int[np.ndarray, " rows"], step_s: float, rng: np.random.Generator
    ) -> Float[np.ndarray, " rows"]:
        error = self.jitter_s * rng.standard_normal(rows.size)
        limit = LARGEST_JITTER * (float(np.diff(rows).min()) if rows.size > 1 else 1.0) * step_s
        return rows * step_s + np.clip(error, -limit, limit)


class LiveFilter:
    """A sensor's filter and delay while a flight goes on, on components; the same numbers as `readings`."""

    def __init__(self, sensors: Sequence[Sensor], step_s: float) -> None:
        parts = [sensor.low_pass(step_s) for sensor in sensors]
        self._filter = dynamics.together(parts) if any(sensor.cutoff_hz for sensor in sensors) else None
        self._delay = DelayLine([sensor.delay_s for sensor in sensors], step_s)
        self._state: list[tuple[Value, Value]] | None = None

    def read(self, raw: list[Value]) -> list[Value]:
        """Filtered and delayed reading, one component for each axis."""
        if self._filter is None:
            return self._delay.push(raw)
        (b0, b1, b2), (_, a1, a2) = self._filter
        if self._state is None:
            self._state = [((1.0 - b0) * x, (b2 - a2) * x) for x in raw]
        readings, state = [], []
        for x, (state_1, state_2) in zip(raw, self._state, strict=True):
            y = b0 * x + state_1
            readings.append(y)
            state.append((b1 * x - a1 * y + state_2, b2 * x - a2 * y))
        self._state = state
        return self._delay.push(readings)
