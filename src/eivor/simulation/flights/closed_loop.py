"""A fast closed-loop simulator of vertical motion, many flights side by side.

Each flight has an actuator with a lag and a delay behind a rotor speed command that is held for one
control period, viscous friction against the air, a vertical gust, and an altitude controller that sees
the same noisy measurements that are logged. Command, gust and tilt are held over a substep, so that
rotor state w, velocity v and height z have closed forms, which are used: with a command c,

    w = c + (w0 - c) exp(-t/tau)
    v' = -K v + D0 + D1 exp(-t/tau) + D2 exp(-2t/tau)

with D1 and D2 from the square of w. There is no step-size error; a flight is the same, to rounding,
whatever flies beside it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eivor.motions.vertical.model import GRAVITY
from eivor.shapes import Float

#: Substeps of one control period: delays are rounded to them.
SUBSTEPS = 5
#: Least and greatest thrust that may be commanded, in multiples of the weight.
THRUST_RANGE = np.array([[0.05], [3.0]])


@dataclass(frozen=True, slots=True)
class VerticalVehicles:
    """Physical parameters of several vehicles, arrays of shape (flights,).

    Parameters
    ----------
    viscous_friction : ndarray
        K [1/s], above zero, and neither 1/tau nor 2/tau.
    input_gain : ndarray
        K_u [m/s^2 per squared unit of rotor state].
    lag_s, delay_s : ndarray
        Actuator lag and command delay [s].
    """

    viscous_friction: Float[np.ndarray, " flights"]
    input_gain: Float[np.ndarray, " flights"]
    lag_s: Float[np.ndarray, " flights"]
    delay_s: Float[np.ndarray, " flights"]


@dataclass(frozen=True, slots=True)
class VerticalEnvironment:
    """What acts on the flights from outside, arrays of shape (samples, flights).

    Parameters
    ----------
    reference_position, reference_velocity, reference_acceleration : ndarray
        Trajectory [m, m/s, m/s^2].
    gust : ndarray
        Vertical wind [m/s].
    cos_tilt : ndarray
        Cosine of the tilt.
    position_noise, velocity_noise, acceleration_noise : ndarray
        Errors of the measurements [m, m/s, m/s^2].
    """

    reference_position: Float[np.ndarray, "samples flights"]
    reference_velocity: Float[np.ndarray, "samples flights"]
    reference_acceleration: Float[np.ndarray, "samples flights"]
    gust: Float[np.ndarray, "samples flights"]
    cos_tilt: Float[np.ndarray, "samples flights"]
    position_noise: Float[np.ndarray, "samples flights"]
    velocity_noise: Float[np.ndarray, "samples flights"]
    acceleration_noise: Float[np.ndarray, "samples flights"]


@dataclass(frozen=True, slots=True)
class AltitudeController:
    """Position, velocity and integral gains around the trajectory's feed-forward.

    See `simulation.records.control` for why that of sampled records is another one.

    Parameters
    ----------
    position_gain : float or ndarray, shape (flights,)
        Velocity asked for per metre of error [1/s].
    velocity_gain : float or ndarray
        Acceleration asked for per m/s of error [1/s].
    integral_gain : float or ndarray
        Acceleration asked for per metre of accumulated velocity error [1/s^2].
    """

    position_gain: float | Float[np.ndarray, " flights"] = 1.2
    velocity_gain: float | Float[np.ndarray, " flights"] = 3.0
    integral_gain: float | Float[np.ndarray, " flights"] = 1.0


@dataclass(frozen=True, slots=True)
class SimulatedMotion:
    """What happened, arrays of shape (samples, flights).

    Parameters
    ----------
    command, rotor_state : ndarray
        Commanded and actual rotor state; ``command[k]`` holds from sample k on.
    position, velocity, specific_force : ndarray
        True motion [m, m/s, m/s^2], z up.
    """

    command: Float[np.ndarray, "samples flights"]
    rotor_state: Float[np.ndarray, "samples flights"]
    position: Float[np.ndarray, "samples flights"]
    velocity: Float[np.ndarray, "samples flights"]
    specific_force: Float[np.ndarray, "samples flights"]


def simulate_vertical(
    vehicles: VerticalVehicles,
    environment: VerticalEnvironment,
    *,
    step_s: float,
    controller: AltitudeController,
    gain_share: Float[np.ndarray, "samples flights"] | None = None,
) -> SimulatedMotion:
    """Fly every vehicle through its environment under altitude control.

    Parameters
    ----------
    vehicles, environment : VerticalVehicles, VerticalEnvironment
        Equally many flights.
    step_s : float
        Control and logging period [s].
    controller : AltitudeController
        Gains of each flight, or the same ones for all.
    gain_share : ndarray, shape (samples, flights), optional
        What is left of each vehicle's K_u, which its controller does not know; all of it by default.

    Notes
    -----
    The flight starts in equilibrium on the trajectory. Performs no checks; linear in samples and flights.
    """
    count, flights = environment.gust.shape
    hover = np.sqrt(GRAVITY / vehicles.input_gain)
    state = hover.copy()
    z, v = environment.reference_position[0].copy(), environment.reference_velocity[0].copy()
    integral = np.zeros(flights)
    out = SimulatedMotion(*(np.empty((count, flights)) for _ in range(5)))
    history = CommandHistory(hover, vehicles.delay_s, step_s)
    substep = ExactSubstep(vehicles, step_s / SUBSTEPS)
    lifts = environment.cos_tilt if gain_share is None else gain_share * environment.cos_tilt
    for k in range(count):
        tilt, lift, gust = environment.cos_tilt[k], lifts[k], environment.gust[k]
        measured_z = z + environment.position_noise[k]
        measured_v = v + environment.velocity_noise[k]
        wanted_v = environment.reference_velocity[k] + controller.position_gain * (
            environment.reference_position[k] - measured_z
        )
        error_v = wanted_v - measured_v
        integral += error_v * step_s
        wanted_a = (
            environment.reference_acceleration[k]
            + controller.velocity_gain * error_v
            + controller.integral_gain * integral
        )
        thrust = np.clip((GRAVITY + wanted_a) / (vehicles.input_gain * tilt), *THRUST_RANGE * hover**2)
        command = np.sqrt(thrust)
        out.command[k], out.rotor_state[k], out.position[k], out.velocity[k] = command, state, z, v
        out.specific_force[k] = vehicles.input_gain * lift * state**2 - vehicles.viscous_friction * (v - gust)
        history.push(command)
        for number in range(SUBSTEPS):
            state, z, v = substep.end(history.reaching(number), state, z, v, gust, lift)
    return out


class CommandHistory:
    """Commands of the last control periods, and what reaches the actuator in each substep.

    Parameters
    ----------
    hover : ndarray, shape (flights,)
        Command before the record.
    delay_s : ndarray, shape (flights,)
        Delays [s], rounded to whole substeps.
    step_s : float
        Control period [s].
    """

    def __init__(
        self, hover: Float[np.ndarray, " flights"], delay_s: Float[np.ndarray, " flights"], step_s: float
    ) -> None:
        self._substeps = np.rint(delay_s / step_s * SUBSTEPS).astype(np.int64)
        self._depth = int(self._substeps.max(initial=0)) // SUBSTEPS + 2
        self._past = np.tile(hover, (self._depth, 1))
        self._flight = np.arange(hover.size)

    def push(self, command: Float[np.ndarray, " flights"]) -> None:
        """Add the command of the period that begins."""
        self._past = np.roll(self._past, 1, axis=0)
        self._past[0] = command

    def reaching(self, substep: int) -> Float[np.ndarray, " flights"]:
        """Command that each actuator receives in this substep of the present period."""
        periods_back = -((substep - self._substeps) // SUBSTEPS)
        reached: Float[np.ndarray, " flights"] = self._past[periods_back, self._flight]
        return reached


class ExactSubstep:
    """Closed-form motion over one substep with command, gust and tilt held.

    Parameters
    ----------
    vehicles : VerticalVehicles
        The vehicles.
    duration_s : float
        Length of the substep [s].
    """

    def __init__(self, vehicles: VerticalVehicles, duration_s: float) -> None:
        K, h = vehicles.viscous_friction, duration_s
        rate = 1.0 / np.maximum(vehicles.lag_s, 1e-9)
        self._K, self._K_u, self._h = K, vehicles.input_gain, h
        self._decay = np.exp(-rate * h)
        self._damping = np.exp(-K * h)
        # Responses of v, and integrals, of the three parts of the driving acceleration.
        self._held = -np.expm1(-K * h) / K
        self._slow = (self._decay - self._damping) / (K - rate)
        self._fast = (self._decay**2 - self._damping) / (K - 2.0 * rate)
        self._slow_integral = -np.expm1(-rate * h) / rate
        self._fast_integral = -np.expm1(-2.0 * rate * h) / (2.0 * rate)

    def end(
        self,
        command: Float[np.ndarray, " flights"],
        state: Float[np.ndarray, " flights"],
        z: Float[np.ndarray, " flights"],
        v: Float[np.ndarray, " flights"],
        gust: Float[np.ndarray, " flights"],
        lift: Float[np.ndarray, " flights"],
    ) -> tuple[Float[np.ndarray, " flights"], Float[np.ndarray, " flights"], Float[np.ndarray, " flights"]]:
        """Rotor state, height and velocity at the end; K_u times `lift` is what the state does upwards."""
        away = state - command
        gain = self._K_u * lift
        D0 = gain * command**2 + self._K * gust - GRAVITY
        D1, D2 = 2.0 * gain * command * away, gain * away**2
        velocity = self._damping * v + self._held * D0 + self._slow * D1 + self._fast * D2
        # The equation of motion, integrated: K times the height gained is impulse less momentum.
        impulse = self._h * D0 + self._slow_integral * D1 + self._fast_integral * D2
        return command + self._decay * away, z + (impulse - (velocity - v)) / self._K, velocity
