"""A closed loop of vertical motion with all that real flights have, several flights side by side.

At every step of `STEP_S` the rotor state w follows its command exactly, w = c + (w0 - c) exp(-h/tau); the
thrust is its mean over the step by Simpson's rule, and the friction enters by the trapezoidal rule. With x =
w over its value at hover,

    f = cos(tilt) T(x) s(t) G(z) - K_z (v - gust) - c (v - gust)|v - gust| + D_x,   v' = f - g,

T the static thrust with its sag under load, s the sag of the voltage, G the ground's effect, K_z and D_x what
friction along the body's axes leaves along the vertical while the vehicle is pitched.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from eivor.motions.vertical.model import GRAVITY
from eivor.simulation.flights.closed_loop import THRUST_RANGE
from validation.real_logs.spec import STEP_S, VehicleSpec


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What the flights meet, arrays of shape (steps, flights).

    Parameters
    ----------
    position, velocity, acceleration : ndarray
        Reference [m, m/s, m/s^2].
    gust : ndarray
        Vertical wind, its mean included [m/s].
    pitch, roll : ndarray
        [rad].
    horizontal : ndarray
        Velocity along x [m/s].
    position_noise, velocity_noise : ndarray
        Errors of what the controller sees [m, m/s].
    """

    position: Float[np.ndarray, "steps flights"]
    velocity: Float[np.ndarray, "steps flights"]
    acceleration: Float[np.ndarray, "steps flights"]
    gust: Float[np.ndarray, "steps flights"]
    pitch: Float[np.ndarray, "steps flights"]
    roll: Float[np.ndarray, "steps flights"]
    horizontal: Float[np.ndarray, "steps flights"]
    position_noise: Float[np.ndarray, "steps flights"]
    velocity_noise: Float[np.ndarray, "steps flights"]


@dataclass(frozen=True, slots=True)
class Motion:
    """What happened, arrays of shape (steps, flights).

    Parameters
    ----------
    command, rotor_state : ndarray
        Command in force from a step on, and the rotor's state.
    position, velocity, force : ndarray
        Height [m], vertical velocity [m/s] and specific force [m/s^2].
    cos_tilt : ndarray
        Cosine of the tilt.
    """

    command: Float[np.ndarray, "steps flights"]
    rotor_state: Float[np.ndarray, "steps flights"]
    position: Float[np.ndarray, "steps flights"]
    velocity: Float[np.ndarray, "steps flights"]
    force: Float[np.ndarray, "steps flights"]
    cos_tilt: Float[np.ndarray, "steps flights"]


class Vehicles:
    """Parameters of the flights as arrays of shape (flights,), and what follows from them.

    Parameters
    ----------
    specs : sequence of VehicleSpec
        One for each flight.
    """

    def __init__(self, specs: tuple[VehicleSpec, ...]) -> None:
        def each(name: str) -> Float[np.ndarray, " flights"]:
            return np.array([float(getattr(spec, name)) for spec in specs])

        self.friction, self.quadratic, self.hover = (
            each(name) for name in ("viscous_friction", "quadratic_drag", "hover_input")
        )
        self.share, self.power, self.load_sag = (
            each(name) for name in ("thrust_share", "thrust_power", "load_sag")
        )
        self.voltage_sag, self.sideways = each("voltage_sag"), each("horizontal_friction")
        self.radius, self.least_height = each("rotor_radius"), each("least_height")
        self.lag_up, self.slower_down = each("actuator_lag"), each("slower_down")
        self.delay_steps = np.rint(each("delay") / STEP_S).astype(np.int64)
        self.controller_steps = np.array([spec.controller_steps for spec in specs])
        gains = [spec.gains for spec in specs]
        self.position_gain = np.array([gain.position_gain for gain in gains])
        self.velocity_gain = np.array([gain.velocity_gain for gain in gains])
        self.integral_gain = np.array([gain.integral_gain for gain in gains])
        linear, curved = (1.0 - self.share) * self.hover, self.share * self.hover**self.power
        self._norm = GRAVITY / (linear + curved)
        #: Exponent of the thrust near hover, with which the controller turns thrust into commands.
        self.exponent = (linear + self.power * curved) / (linear + curved)

    def thrust(self, state: Float[np.ndarray, "*k flights"]) -> Float[np.ndarray, "*k flights"]:
        """Thrust [m/s^2] of rotor states, with what it loses under load."""
        x = state / self.hover
        speed = state * (1.0 - self.load_sag * (x**3 - 1.0))
        return self._norm * ((1.0 - self.share) * speed + self.share * speed**self.power)

    def command(self, thrust: Float[np.ndarray, " flights"]) -> Float[np.ndarray, " flights"]:
        """Command that a controller gives for a thrust [m/s^2]."""
        return self.hover * (thrust / GRAVITY) ** (1.0 / self.exponent)


def fly(specs: tuple[VehicleSpec, ...], met: Surroundings) -> Motion:
    """Fly every vehicle through its surroundings under altitude control.

    Parameters
    ----------
    specs : tuple of VehicleSpec
        One for each flight.
    met : Surroundings
        What they meet.

    Notes
    -----
    Begins in equilibrium on the reference. Linear in steps; performs no checks.
    """
    vehicles = Vehicles(specs)
    steps, flights = met.position.shape
    command, rotor, height, climb, force = (np.empty((steps, flights)) for _ in range(5))
    out = Motion(command, rotor, height, climb, force, _cos_tilt(met))
    scale = supply(vehicles, steps) * out.cos_tilt
    friction, coupling = _along_vertical(vehicles, met)
    floor = met.position.min(axis=0) - vehicles.least_height
    loop = _Controller(vehicles, met, _due(vehicles, steps))
    reached = np.tile(vehicles.hover, (int(vehicles.delay_steps.max()) + 1, 1))
    depth, which = reached.shape[0], np.arange(flights)
    half = {name: np.exp(-0.5 * STEP_S / lag) for name, lag in _lags(vehicles).items()}
    state, z, v = vehicles.hover.copy(), met.position[0].copy(), met.velocity[0].copy()
    thrust = vehicles.thrust(state)
    for k in range(steps):
        reached[k % depth] = out.command[k] = loop.command(k, z, v)
        acting = reached[(k - vehicles.delay_steps) % depth, which]
        decay = np.where(acting < state, half["down"], half["up"])
        middle = acting + decay * (state - acting)
        end = acting + decay**2 * (state - acting)
        after = vehicles.thrust(np.stack([middle, end]))
        lift = scale[k] * _over_ground(vehicles, z - floor)
        still = lift * thrust + coupling[k] - _quadratic(vehicles, v - met.gust[k])
        out.rotor_state[k], out.position[k], out.velocity[k] = state, z, v
        out.force[k] = still - friction[k] * (v - met.gust[k])
        drive = still + lift * (4.0 * after[0] + after[1] - 5.0 * thrust) / 6.0 - GRAVITY
        damping = 0.5 * STEP_S * friction[k]
        velocity = (v * (1.0 - damping) + STEP_S * (drive + friction[k] * met.gust[k])) / (1.0 + damping)
        z = z + 0.5 * STEP_S * (v + velocity)
        state, v, thrust = end, velocity, after[1]
    return out


class _Controller:
    """Altitude control at each flight's own rate; between its instants the command is held."""

    def __init__(self, vehicles: Vehicles, met: Surroundings, due: Bool[np.ndarray, "steps flights"]) -> None:
        self._vehicles, self._met, self._due = vehicles, met, due
        self._any: list[bool] = np.any(due, axis=1).tolist()
        self._period = STEP_S * vehicles.controller_steps
        self._integral = np.zeros(vehicles.hover.size)
        self._held = vehicles.hover.copy()

    def command(
        self, k: int, z: Float[np.ndarray, " flights"], v: Float[np.ndarray, " flights"]
    ) -> Float[np.ndarray, " flights"]:
        """Command of a step."""
        if not self._any[k]:
            return self._held
        own, met, due = self._vehicles, self._met, self._due[k]
        wanted = met.velocity[k] + own.position_gain * (met.position[k] - z - met.position_noise[k])
        error = wanted - v - met.velocity_noise[k]
        self._integral = np.where(due, self._integral + error * self._period, self._integral)
        asked = (
            met.acceleration[k] + own.velocity_gain * error + own.integral_gain * self._integral + GRAVITY
        ) / np.cos(met.pitch[k])
        thrust = np.clip(asked, *(THRUST_RANGE[:, 0] * GRAVITY))
        self._held = np.where(due, own.command(thrust), self._held)
        return self._held


def _due(vehicles: Vehicles, steps: int) -> Bool[np.ndarray, "steps flights"]:
    """At which steps each controller computes."""
    numbers: Int[np.ndarray, " steps"] = np.arange(steps)
    return numbers[:, None] % vehicles.controller_steps == 0


def _lags(vehicles: Vehicles) -> dict[str, Float[np.ndarray, " flights"]]:
    return {"up": vehicles.lag_up, "down": vehicles.lag_up * vehicles.slower_down}


def _cos_tilt(met: Surroundings) -> Float[np.ndarray, "steps flights"]:
    return np.cos(met.pitch) * np.cos(met.roll)


def supply(vehicles: Vehicles, steps: int) -> Float[np.ndarray, "steps flights"]:
    """What a falling voltage leaves of the thrust: speed goes with it, and thrust with speed."""
    left = 1.0 - vehicles.voltage_sag * (np.arange(steps) / steps)[:, None]
    return np.asarray(left**vehicles.exponent)


def _along_vertical(
    vehicles: Vehicles, met: Surroundings
) -> tuple[Float[np.ndarray, "steps flights"], Float[np.ndarray, "steps flights"]]:
    """Friction [1/s] along the vertical of a pitched vehicle, and what its horizontal speed adds [m/s^2]."""
    sine, cosine = np.sin(met.pitch), np.cos(met.pitch)
    friction = vehicles.friction * cosine**2 + vehicles.sideways * sine**2
    return friction, (vehicles.sideways - vehicles.friction) * sine * cosine * met.horizontal


def _over_ground(vehicles: Vehicles, height: Float[np.ndarray, " flights"]) -> Float[np.ndarray, " flights"]:
    share = vehicles.radius / (4.0 * np.maximum(height, 0.5 * vehicles.radius + 1e-9))
    return np.asarray(1.0 / (1.0 - share**2))


def _quadratic(vehicles: Vehicles, speed: Float[np.ndarray, " flights"]) -> Float[np.ndarray, " flights"]:
    return np.asarray(vehicles.quadratic * speed * np.abs(speed))
