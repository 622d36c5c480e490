"""A closed loop of vertical motion with all that real flights have.

At every step of `STEP_S` the rotor state w follows its command exactly, w = c + (w0 - c) exp(-h/tau); the
thrust is its mean over the step by Simpson's rule, and the friction enters by the trapezoidal rule. With x =
w over its value at hover,

    f = cos(tilt) T(x) s(t) G(z) - K_z (v - gust) - c (v - gust)|v - gust| + D_x,   v' = f - g,

T the static thrust with its sag under load, s the sag of the voltage, G the ground's effect, K_z and D_x what
friction along the body's axes leaves along the vertical while the vehicle is pitched.

One flight is a loop over numbers, which is quicker than one over short arrays of several flights.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from jaxtyping import Float

from eivor.motions.vertical.model import GRAVITY
from eivor.simulation.vertical import THRUST_RANGE
from validation.real_logs.spec import STEP_S, VehicleSpec

State = TypeVar("State", float, np.ndarray)


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What a flight meets, arrays of shape (steps,)."""

    position: Float[np.ndarray, " steps"]  # Reference [m, m/s, m/s^2]
    velocity: Float[np.ndarray, " steps"]
    acceleration: Float[np.ndarray, " steps"]
    gust: Float[np.ndarray, " steps"]  # Vertical wind, its mean included [m/s]
    pitch: Float[np.ndarray, " steps"]  # [rad]
    roll: Float[np.ndarray, " steps"]
    horizontal: Float[np.ndarray, " steps"]  # Velocity along x [m/s]
    position_noise: Float[np.ndarray, " steps"]  # Errors of what the controller sees [m, m/s]
    velocity_noise: Float[np.ndarray, " steps"]

    @property
    def cos_tilt(self) -> Float[np.ndarray, " steps"]:
        """Cosine of the tilt."""
        return np.asarray(np.cos(self.pitch) * np.cos(self.roll))


@dataclass(frozen=True, slots=True)
class Motion:
    """What happened, arrays of shape (steps,)."""

    command: Float[np.ndarray, " steps"]  # Command in force from a step on, and the rotor's state
    rotor_state: Float[np.ndarray, " steps"]
    position: Float[np.ndarray, " steps"]  # Height [m], vertical velocity [m/s] and specific force [m/s^2]
    velocity: Float[np.ndarray, " steps"]
    force: Float[np.ndarray, " steps"]


class Thrust:
    """Static thrust of a vehicle's rotor."""

    def __init__(self, spec: VehicleSpec) -> None:
        self._spec = spec
        linear = (1.0 - spec.thrust_share) * spec.hover_input
        curved = spec.thrust_share * spec.hover_input**spec.thrust_power
        self._norm = GRAVITY / (linear + curved)
        #: Exponent near hover, with which the controller turns thrust into commands.
        self.exponent = (linear + spec.thrust_power * curved) / (linear + curved)

    def __call__(self, state: State) -> State:
        """Thrust [m/s^2] of a rotor state, with what it loses under load."""
        spec = self._spec
        speed = state * (1.0 - spec.load_sag * ((state / spec.hover_input) ** 3 - 1.0))
        share = spec.thrust_share
        return self._norm * ((1.0 - share) * speed + share * speed**spec.thrust_power)

    def command(self, thrust: float) -> float:
        """Command that a controller gives for a thrust [m/s^2]."""
        return float(self._spec.hover_input * (thrust / GRAVITY) ** (1.0 / self.exponent))


def fly(spec: VehicleSpec, met: Surroundings) -> Motion:
    """Fly a vehicle through its surroundings under altitude control."""
    thrust_of, controller = Thrust(spec), _Controller(spec, met)
    scale = (supply(spec, met.position.size) * met.cos_tilt).tolist()
    friction, coupling = (part.tolist() for part in _along_vertical(spec, met))
    gust, floor = met.gust.tolist(), float(met.position.min()) - spec.least_height
    up, down = (math.exp(-0.5 * STEP_S / lag) for lag in (spec.actuator_lag, _lag_down(spec)))
    late, every = round(spec.delay / STEP_S), spec.controller_steps
    state, z, v = spec.hover_input, float(met.position[0]), float(met.velocity[0])
    command, thrust = spec.hover_input, thrust_of(spec.hover_input)
    commands = [command] * late
    rows = []
    for k, lifted in enumerate(scale):
        if k % every == 0:
            command = controller.command(k, z, v, thrust_of)
        commands.append(command)
        acting = commands[k]
        decay, away = down if acting < state else up, state - acting
        end = acting + decay * decay * away
        middle_thrust, end_thrust = thrust_of(acting + decay * away), thrust_of(end)
        lift, air = lifted * _over_ground(spec, z - floor), v - gust[k]
        still = lift * thrust + coupling[k] - spec.quadratic_drag * air * abs(air)
        rows.append((state, z, v, still - friction[k] * air))
        drive = still + lift * (4.0 * middle_thrust + end_thrust - 5.0 * thrust) / 6.0 - GRAVITY
        damping = 0.5 * STEP_S * friction[k]
        velocity = (v * (1.0 - damping) + STEP_S * (drive + friction[k] * gust[k])) / (1.0 + damping)
        z += 0.5 * STEP_S * (v + velocity)
        state, v, thrust = end, velocity, end_thrust
    return Motion(np.array(commands[late:]), *np.array(rows).T.copy())


class _Controller:
    """Altitude control: position, velocity and integral around the reference."""

    def __init__(self, spec: VehicleSpec, met: Surroundings) -> None:
        self._gains, self._period = spec.gains, STEP_S * spec.controller_steps
        wanted = met.velocity + self._gains.position_gain * (met.position - met.position_noise)
        self._wanted = (wanted - met.velocity_noise).tolist()
        self._weight = (met.acceleration + GRAVITY).tolist()
        self._cosine = np.cos(met.pitch).tolist()
        self._least, self._most = (float(share[0]) * GRAVITY for share in THRUST_RANGE)
        self._integral = 0.0

    def command(self, k: int, z: float, v: float, thrust_of: Thrust) -> float:
        """Command that is computed at a step."""
        gains = self._gains
        error = self._wanted[k] - float(gains.position_gain) * z - v
        self._integral += error * self._period
        feedback = float(gains.velocity_gain) * error + float(gains.integral_gain) * self._integral
        requested = (self._weight[k] + feedback) / self._cosine[k]
        return thrust_of.command(min(max(requested, self._least), self._most))


def _lag_down(spec: VehicleSpec) -> float:
    return spec.actuator_lag * spec.slower_down


def supply(spec: VehicleSpec, steps: int) -> Float[np.ndarray, " steps"]:
    """What a falling voltage leaves of the thrust: speed goes with it, and thrust with speed."""
    left = 1.0 - spec.voltage_sag * np.arange(steps) / steps
    return np.asarray(left ** Thrust(spec).exponent)


def _along_vertical(
    spec: VehicleSpec, met: Surroundings
) -> tuple[Float[np.ndarray, " steps"], Float[np.ndarray, " steps"]]:
    """Friction [1/s] along the vertical of a pitched vehicle, and what its horizontal speed adds [m/s^2]."""
    sine, cosine = np.sin(met.pitch), np.cos(met.pitch)
    sideways, along = spec.horizontal_friction, spec.viscous_friction
    return along * cosine**2 + sideways * sine**2, (sideways - along) * sine * cosine * met.horizontal


def _over_ground(spec: VehicleSpec, height: float) -> float:
    if not spec.rotor_radius:
        return 1.0
    share = spec.rotor_radius / (4.0 * max(height, 0.5 * spec.rotor_radius))
    return 1.0 / (1.0 - share * share)
