"""The cascade that keeps a simulated vehicle up: height, attitude and rates, each loop at its own rate.

Like an autopilot: the height loop asks for a collective thrust, the attitude loop for body rates, the rate
loop for torques. Torques and thrust are normalised: a torque setpoint of 1 is that of the rotors of one side
at full speed while those of the other stand still, a thrust of 1 that of all rotors at full speed. The mixer
inverts the rotors' geometry and the thrust of a rotor, and cuts commands off at the rotors' limits.

Everything is written on components, floats or arrays; see `eivor.motions.rigid_body.dynamics`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from eivor.errors import ParameterError
from eivor.motions.rigid_body.coefficients import Value, stacked
from eivor.motions.rigid_body.dynamics import Components, Triple, into_body, rotation, turned
from eivor.motions.rigid_body.parameter_ranges import within
from eivor.motions.rigid_body.vehicle import Vehicle
from eivor.motions.vertical.model import GRAVITY

#: No loop is quicker than this, however quick the rotors are [1/s].
LARGEST_RATE_GAIN, LARGEST_ATTITUDE_GAIN, LARGEST_CLIMB_GAIN = 40.0, 12.0, 5.0
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

    Parameters
    ----------
    rate_hz, attitude_hz, height_hz : float
        How often each loop runs [Hz]: the simulation's rate over a whole number.
    quickness : float
        Gain of the rate loop times T, less on an axis with little torque.
    attitude_share : float
        Gain of the attitude loop over that of the rate loop; half of it in yaw.
    integral_share : float
        Integral gain of the rate loop over the square of its gain.
    derivative_share : float
        Derivative time of the rate loop over T.
    derivative_cutoff_hz : float
        Of the first-order filter of that derivative [Hz].
    climb_quickness : float
        Gain of the climb rate's loop times T and half a period of the height loop.
    height_share, climb_integral_share : float
        Gain of the height loop over that of the climb rate's, and of its integrator over the square of that.
    hold : float
        Gain towards the place where the flight began [1/s]: zero for a vehicle that flies attitudes and
        drifts.

    Raises
    ------
    ParameterError
        When a value is out of its range.
    """

    rate_hz: float = 500.0
    attitude_hz: float = 250.0
    height_hz: float = 50.0
    quickness: float = 0.6
    attitude_share: float = 0.5
    integral_share: float = 0.05
    derivative_share: float = 0.0
    derivative_cutoff_hz: float = 30.0
    climb_quickness: float = 0.35
    height_share: float = 0.3
    climb_integral_share: float = 0.05
    hold: float = 0.0

    def __post_init__(self) -> None:
        within(self, RANGES, "Correct the controller.")


#: What each number of a controller may be.
RANGES = {
    "rate_hz": (10.0, 1e4),
    "attitude_hz": (10.0, 1e4),
    "height_hz": (1.0, 1e4),
    "quickness": (0.01, 2.0),
    "attitude_share": (0.01, 1.0),
    "integral_share": (0.0, 0.5),
    "derivative_share": (0.0, 2.0),
    "derivative_cutoff_hz": (0.1, 1e4),
    "climb_quickness": (0.01, 1.0),
    "height_share": (0.01, 0.6),
    "climb_integral_share": (0.0, 0.25),
    "hold": (0.0, 1.0),
}


@dataclass(frozen=True, slots=True)
class Gains:
    """Numbers of the loops, of one flight or of several.

    Parameters
    ----------
    rate, integral, derivative : tuple
        Normalised torque on each axis per rad/s, per rad and per rad/s^2.
    attitude : tuple
        Rate asked for per rad on each axis [1/s].
    climb, climb_integral, height : float or ndarray, shape (flights,)
        Acceleration asked for per m/s and per m of accumulated error, climb rate per m.
    hold : float or ndarray, shape (flights,)
        Velocity asked for per metre [1/s].
    derivative_decay : float or ndarray, shape (flights,)
        What is left of the filtered derivative after a period of the rate loop.
    weight, full_thrust : float or ndarray, shape (flights,)
        [N].
    mass : float or ndarray, shape (flights,)
        [kg].
    """

    rate: tuple[Value, ...]
    integral: tuple[Value, ...]
    derivative: tuple[Value, ...]
    attitude: tuple[Value, ...]
    climb: Value
    climb_integral: Value
    height: Value
    hold: Value
    derivative_decay: Value
    weight: Value
    full_thrust: Value
    mass: Value


def gains_of(controller: FlightController, vehicle: Vehicle, sensing_s: float) -> Gains:
    """Gains that suit a vehicle.

    Parameters
    ----------
    controller : FlightController
        How quick the loops are.
    vehicle : Vehicle
        What they control.
    sensing_s : float
        Delay of the measured rates, with that of their filter [s].
    """
    rotors = vehicle.rotors
    slowness = max(rotors.lag_up, rotors.lag_down) + rotors.delay + sensing_s + 0.5 / controller.rate_hz
    quickest = min(controller.quickness / slowness, LARGEST_RATE_GAIN)
    effectiveness = control_effectiveness(vehicle)
    # An axis that is weak, as yaw is, would be at its limit from noise alone.
    rates = [min(quickest, LARGEST_TORQUE_PER_RATE * gain) for gain in effectiveness]
    attitude = [min(controller.attitude_share * rate, LARGEST_ATTITUDE_GAIN) for rate in rates]
    climb = min(controller.climb_quickness / (slowness + 0.5 / controller.height_hz), LARGEST_CLIMB_GAIN)
    loops = list(zip(rates, effectiveness, strict=True))
    decay = np.exp(-2.0 * np.pi * controller.derivative_cutoff_hz / controller.rate_hz)
    return Gains(
        rate=tuple(rate / gain for rate, gain in loops),
        integral=tuple(controller.integral_share * rate**2 / gain for rate, gain in loops),
        derivative=tuple(controller.derivative_share * slowness * rate / gain for rate, gain in loops),
        attitude=(attitude[0], attitude[1], 0.5 * attitude[2]),
        climb=climb,
        climb_integral=controller.climb_integral_share * climb**2,
        height=controller.height_share * climb,
        hold=controller.hold,
        derivative_decay=float(decay),
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
    roll, pitch, yaw = (limit / own for limit, own in zip(limits, vehicle.inertia[:3], strict=True))
    return roll, pitch, yaw


def between(value: Value, low: Value, high: Value) -> Value:
    """Value, cut off at two limits."""
    if isinstance(value, np.ndarray):
        return np.minimum(np.maximum(value, low), high)
    return min(max(value, low), high)


class Cascade:
    """The three loops of a flight, or of several side by side, and what they remember.

    Parameters
    ----------
    gains : Gains
        Their numbers.
    rate_period_s, height_period_s : float
        Of rate and height loop [s].
    """

    def __init__(self, gains: Gains, rate_period_s: float, height_period_s: float) -> None:
        self._gains = gains
        self._rate_period_s, self._height_period_s = rate_period_s, height_period_s
        self._integral: list[Value] = [0.0, 0.0, 0.0]
        self._climb_integral: Value = 0.0
        self._before: Triple | None = None
        self._derivative: list[Value] = [0.0, 0.0, 0.0]
        self._differentiates = bool(np.any(np.array(gains.derivative)))

    def thrust(self, reference: Triple, height: Value, climb: Value, cosine: Value) -> Value:
        """Collective thrust, as a share of the full one.

        Parameters
        ----------
        reference : three components
            Height [m], climb rate [m/s] and acceleration [m/s^2] that are asked for.
        height, climb, cosine : component
            As measured: height [m], climb rate [m/s], cosine of the tilt.
        """
        g = self._gains
        wanted_height, wanted_climb, acceleration = reference
        error = wanted_climb + g.height * (wanted_height - height) - climb
        self._climb_integral = self._climb_integral + error * self._height_period_s
        acceleration = acceleration + g.climb * error + g.climb_integral * self._climb_integral
        upward = g.weight + g.mass * acceleration
        thrust = upward / between(cosine, LEAST_COSINE, 1.0)
        return between(thrust, LEAST_WEIGHT * g.weight, MOST_THRUST * g.full_thrust) / g.full_thrust

    def holding(self, wanted: Components, place: Components, drift: Components) -> list[Value]:
        """Attitude that is asked for, tilted towards the place where the flight began.

        Parameters
        ----------
        wanted : four components
            Attitude from outside, w, x, y, z.
        place, drift : two components
            Measured position [m] and velocity [m/s] in the world, forward and left of the start.
        """
        hold = self._gains.hold
        most = MOST_HOLDING_TILT * GRAVITY
        forward, left = (
            between(HOLD_DAMPING * hold * (-hold * away - speed), -most, most)
            for away, speed in zip(place, drift, strict=True)
        )
        ahead, aside, _ = into_body(rotation(*wanted), forward, left, 0.0)
        return turned(wanted, -aside / GRAVITY, ahead / GRAVITY, 0.0)

    def rates(self, wanted: Components, attitude: Components) -> Triple:
        """Body rates [rad/s] that turn an attitude towards the one that is asked for."""
        a, b, c, d = wanted
        w, x, y, z = attitude
        # vector part of conj(attitude) wanted, by the shorter way round
        way = 4.0 * (a * w + b * x + c * y + d * z >= 0.0) - 2.0
        roll, pitch, yaw = self._gains.attitude
        return (
            way * roll * (w * b - a * x - y * d + z * c),
            way * pitch * (w * c - a * y - z * b + x * d),
            way * yaw * (w * d - a * z - x * c + y * b),
        )

    def torques(self, wanted: Triple, measured: Triple) -> Triple:
        """Normalised torques that bring the body rates to those that are asked for."""
        g, period = self._gains, self._rate_period_s
        error = [asked - is_now for asked, is_now in zip(wanted, measured, strict=True)]
        self._integral = [
            between(held + gain * period * one, -LARGEST_INTEGRAL, LARGEST_INTEGRAL)
            for held, gain, one in zip(self._integral, g.integral, error, strict=True)
        ]
        torque = [gain * one + held for gain, one, held in zip(g.rate, error, self._integral, strict=True)]
        if self._differentiates:
            torque = [
                one - gain * slope
                for one, gain, slope in zip(torque, g.derivative, self._slopes(measured), strict=True)
            ]
        return between(torque[0], -1.0, 1.0), between(torque[1], -1.0, 1.0), between(torque[2], -1.0, 1.0)

    def _slopes(self, measured: Triple) -> list[Value]:
        """Derivatives of the measured rates, filtered."""
        decay, before = self._gains.derivative_decay, self._before or measured
        self._before = measured
        self._derivative = [
            decay * held + (1.0 - decay) * (now - then) / self._rate_period_s
            for held, now, then in zip(self._derivative, measured, before, strict=True)
        ]
        return self._derivative


@dataclass(frozen=True, slots=True)
class Mixer:
    """From normalised thrust and torques to the rotors' commands.

    Parameters
    ----------
    shares : tuple
        Of each rotor, or of all as arrays of shape (rotors, flights): its thrust [N] per unit of thrust,
        roll, pitch and yaw.
    thrust_linear, thrust_quadratic : float or ndarray, shape (flights,)
        Of a rotor.
    least, most : float or ndarray, shape (flights,)
        Thrust of a rotor at its limits [N].
    """

    shares: tuple[tuple[Value, Value, Value, Value], ...]
    thrust_linear: Value
    thrust_quadratic: Value
    least: Value
    most: Value

    def commands(self, thrust: Value, torques: Triple) -> list[Value]:
        """Rotor speeds whose thrusts have this sum and these torques, as far as the rotors can."""
        roll, pitch, yaw = torques
        linear, quadratic = self.thrust_linear, self.thrust_quadratic
        speeds = []
        for up, left, down, around in self.shares:
            force = between(up * thrust + left * roll + down * pitch + around * yaw, self.least, self.most)
            speeds.append(2.0 * force / (linear + (linear * linear + 4.0 * quadratic * force) ** 0.5))
        return speeds


def mixer_of(vehicle: Vehicle) -> Mixer:
    """Mixer of one vehicle, in floats.

    Raises
    ------
    ParameterError
        When the rotors cannot give thrust and torque about each axis independently.
    """
    rotors = vehicle.rotors
    x, y, _ = np.array(rotors.positions).T
    geometry = np.stack([np.ones(rotors.count), y, -x, rotors.torque_ratio * np.array(rotors.spins)])
    scale = np.array([vehicle.full_thrust, *torque_limits(vehicle)])
    if np.any(scale <= 0.0) or np.linalg.matrix_rank(geometry / scale[:, None], tol=1e-9) < 4:
        raise ParameterError(
            "rotors that give thrust and a torque about each axis independently",
            f"{rotors.count} rotors that do not",
            "Correct positions and spins; neighbours turn opposite ways.",
        )
    shares = np.linalg.pinv(geometry / scale[:, None]).tolist()
    full = rotors.thrust(rotors.highest_speed)
    return Mixer(
        shares=tuple((up, left, down, around) for up, left, down, around in shares),
        thrust_linear=rotors.thrust_linear,
        thrust_quadratic=rotors.thrust_quadratic,
        least=max(rotors.thrust(rotors.lowest_speed), IDLE * full),
        most=full,
    )


def mixers_side_by_side(vehicles: Sequence[Vehicle]) -> Mixer:
    """Mixer of several vehicles with equally many rotors, in arrays."""
    each = [mixer_of(vehicle) for vehicle in vehicles]
    # (rotors, 4, flights)
    shares = np.array([one.shares for one in each]).transpose(1, 2, 0)
    up, left, down, around = (np.ascontiguousarray(shares[:, part]) for part in range(4))
    names = ("thrust_linear", "thrust_quadratic", "least", "most")
    return Mixer(
        ((up, left, down, around),), *(stacked([getattr(one, name) for one in each]) for name in names)
    )


def gains_side_by_side(each: Sequence[Gains]) -> Gains:
    """Gains of several flights, in arrays."""
    return Gains(*(stacked([getattr(one, name) for one in each]) for name in Gains.__slots__))
