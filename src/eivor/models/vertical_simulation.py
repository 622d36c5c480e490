"""A fast closed-loop simulator of vertical motion, many flights side by side.

Each flight has an actuator with a lag and a delay behind a rotor speed command that is held for one
control period, viscous friction against the air, a vertical gust, and an altitude controller that sees
the same noisy measurements that are logged. Between control instants the rotor's state is exact and the
velocity is integrated exactly for thrust that is piecewise quadratic (Simpson) in substeps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eivor.models.vertical import GRAVITY

#: Substeps of one control period.
SUBSTEPS = 5


@dataclass(frozen=True, slots=True)
class VerticalVehicles:
    """Physical parameters of several vehicles, arrays of shape (flights,).

    Parameters
    ----------
    viscous_friction : ndarray
        K [1/s].
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

    Parameters
    ----------
    position_gain : float
        Velocity asked for per metre of error [1/s].
    velocity_gain : float
        Acceleration asked for per m/s of error [1/s].
    integral_gain : float
        Acceleration asked for per metre of accumulated velocity error [1/s^2].
    """

    position_gain: float = 1.2
    velocity_gain: float = 3.0
    integral_gain: float = 1.0


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
) -> SimulatedMotion:
    """Fly every vehicle through its environment under altitude control.

    Parameters
    ----------
    vehicles, environment : VerticalVehicles, VerticalEnvironment
        Equally many flights.
    step_s : float
        Control and logging period [s].
    controller : AltitudeController
        Same gains for every flight.

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
    for k in range(count):
        tilt, gust = environment.cos_tilt[k], environment.gust[k]
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
        thrust = np.clip((GRAVITY + wanted_a) / (vehicles.input_gain * tilt), 0.05 * hover**2, 3.0 * hover**2)
        command = np.sqrt(thrust)
        out.command[k], out.rotor_state[k], out.position[k], out.velocity[k] = command, state, z, v
        out.specific_force[k] = vehicles.input_gain * tilt * state**2 - vehicles.viscous_friction * (v - gust)
        history.push(command)
        state, z, v = _advance(vehicles, history, state, z, v, gust, tilt, step_s)
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


def _advance(
    vehicles: VerticalVehicles,
    history: CommandHistory,
    state: Float[np.ndarray, " flights"],
    z: Float[np.ndarray, " flights"],
    v: Float[np.ndarray, " flights"],
    gust: Float[np.ndarray, " flights"],
    tilt: Float[np.ndarray, " flights"],
    step_s: float,
) -> tuple[Float[np.ndarray, " flights"], Float[np.ndarray, " flights"], Float[np.ndarray, " flights"]]:
    """Rotor state, height and velocity one control period later; gust and tilt are held."""
    h = step_s / SUBSTEPS
    K = vehicles.viscous_friction
    half = np.exp(-0.5 * h / np.maximum(vehicles.lag_s, 1e-9))
    decay_half = np.exp(-0.5 * h * K)
    for substep in range(SUBSTEPS):
        target = history.reaching(substep)
        middle = target + (state - target) * half
        end = target + (middle - target) * half
        drive = [vehicles.input_gain * tilt * w**2 + K * gust - GRAVITY for w in (state, middle, end)]
        earlier = v
        v = decay_half**2 * v + h / 6.0 * (decay_half**2 * drive[0] + 4.0 * decay_half * drive[1] + drive[2])
        z = z + 0.5 * h * (earlier + v)
        state = end
    return state, z, v
