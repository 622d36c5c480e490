"""Specification of simulated rigid-body flights, and the integration of their dynamics."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Annotated, TypeAlias

import numpy as np

from eivor import checks
from eivor.errors import ParameterError
from eivor.motions.rigid_body.dynamics import (
    Body,
    Coefficients,
    Triple,
    Value,
    body_derivative,
    speed_derivative,
)
from eivor.motions.rigid_body.vehicle import Rotors, Vehicle
from eivor.signals.noise import WhiteNoise
from eivor.simulation.controller import FlightController, Sensor
from eivor.simulation.environment import TrajectoryKind, altitude_reference
from eivor.simulation.excitation import Disturbance, Excitation
from eivor.tools import Float

#: State of the body, and of its rotors.
Moved: TypeAlias = tuple[Body, list[Value]]

#: State of body and rotors a step later, of a flight or of several side by side, under what is held over it:
#: commands, velocity of the air in the world [m/s], and torque from outside on the body's axes [N m].
Stepper: TypeAlias = Callable[[Body, Sequence[Value], Sequence[Value], Triple, Triple], Moved]
#: Neither wind nor torque.
STILL: Triple = (0.0, 0.0, 0.0)


def runge_kutta(coefficients: Coefficients, step_s: float) -> Stepper:
    """Return steps of this length [s] by the classical method of the fourth order."""
    c, h = coefficients, step_s
    half = rotor_course(c, h / 2.0)

    def spin_up(speeds: Sequence[Value], command: Sequence[Value]) -> Sequence[Value]:
        return speed_derivative(c, speeds, command) if c.gyroscopic else ()

    def step(
        body: Body, speeds: Sequence[Value], command: Sequence[Value], wind: Triple, disturbance: Triple
    ) -> Moved:
        middle = half(speeds, command)
        end, change = half(middle, command), spin_up(middle, command)
        k1 = body_derivative(c, body, speeds, spin_up(speeds, command), wind, disturbance)
        k2 = body_derivative(c, _stepped(body, k1, h / 2.0), middle, change, wind, disturbance)
        k3 = body_derivative(c, _stepped(body, k2, h / 2.0), middle, change, wind, disturbance)
        k4 = body_derivative(c, _stepped(body, k3, h), end, spin_up(end, command), wind, disturbance)
        # Six times the mean slope.
        slope = [p + 2.0 * (q + r) + s for p, q, r, s in zip(k1, k2, k3, k4, strict=True)]
        return _unit_attitude(_stepped(body, slope, h / 6.0)), end

    return step


def rotor_course(
    coefficients: Coefficients, time_s: float
) -> Callable[[Sequence[Value], Sequence[Value]], list[Value]]:
    """Speeds of rotors that much later, by speeds and a held command: the closed form."""
    down = _decay(time_s * coefficients.rate_down)
    difference = _decay(time_s * coefficients.rate_up) - down

    def after(speeds: Sequence[Value], command: Sequence[Value]) -> list[Value]:
        return [
            item + (speed - item) * (down + difference * (item > speed))
            for speed, item in zip(speeds, command, strict=True)
        ]

    return after


def _decay(lags: Value) -> Value:
    return math.exp(-lags) if isinstance(lags, float) else np.exp(-lags)


def _stepped(state: Body, slope: Sequence[Value], time_s: float) -> Body:
    if isinstance(state, np.ndarray):
        return state + time_s * np.array(slope)
    return [x + time_s * k for x, k in zip(state, slope, strict=True)]


def _unit_attitude(body: Body) -> Body:
    w, x, y, z = body[6:10]
    short = (w * w + x * x + y * y + z * z) ** -0.5
    if isinstance(body, np.ndarray):
        body[6:10] *= short
    else:
        body[6:10] = [w * short, x * short, y * short, z * short]
    return body


def _noisy(std: float) -> Sensor:
    return Sensor(noise=WhiteNoise(std))


@dataclass(frozen=True, slots=True)
class AxisExcitations:
    """A series about each axis of the body, or none."""

    roll: Excitation | None = None  # About the axes that point forward, left and up
    pitch: Excitation | None = None
    yaw: Excitation | None = None


@dataclass(frozen=True, slots=True)
class TorqueDisturbance:
    """Torques from outside, as the angular acceleration that each would give by itself."""

    roll: Disturbance | None = None  # About the axes that point forward, left and up [rad/s^2]
    pitch: Disturbance | None = None
    yaw: Disturbance | None = None


@dataclass(frozen=True, slots=True)
class Wind:
    """Velocity of the air in the world."""

    steady: tuple[float, ...] = (0.0, 0.0, 0.0)  # What does not change, on three axes [m/s]
    x: Disturbance | None = None  # Gusts along each axis of the world [m/s]
    y: Disturbance | None = None
    z: Disturbance | None = None

    def __post_init__(self) -> None:
        if len(self.steady) != 3 or not all(abs(speed) <= 50.0 for speed in self.steady):
            expected = "a steady wind of three speeds up to 50 m/s"
            raise ParameterError(expected, f"{self.steady}", "Correct the wind.")


@dataclass(frozen=True, slots=True)
class Sensors:
    """What the vehicle measures; a sensor that is described has the noise of its description, else none."""

    # Body rates [rad/s], which the rate loop gets; of .02 rad/s of white noise when left out
    angular_rate: Sensor = field(default_factory=lambda: _noisy(0.02))
    # Accelerometer in the centre of mass [m/s^2]; of .5 m/s^2
    specific_force: Sensor = field(default_factory=lambda: _noisy(0.5))
    # In the world [m/s, m]; of .05 m/s and .02 m
    velocity: Sensor = field(default_factory=lambda: _noisy(0.05))
    position: Sensor = field(default_factory=lambda: _noisy(0.02))
    # Its errors are small rotations about the body's axes [rad]; of .002 rad. It has no filter
    attitude: Sensor = field(default_factory=lambda: _noisy(0.002))
    rotor_speed: Sensor | None = None  # [rad/s]; not logged when left out

    def __post_init__(self) -> None:
        if self.attitude.cutoff_hz:
            remedy = "Leave it out: quaternions are not averaged part by part."
            received = f"cutoff_hz={self.attitude.cutoff_hz:g}"
            raise ParameterError("an attitude without a filter", received, remedy)


@dataclass(frozen=True, slots=True)
class Logged:
    """How often what is no measurement is logged; at every step of the simulation where zero."""

    rotor_command_hz: Annotated[float, (0.0, 1e5)] = 0.0  # Commands of the rotors [Hz]
    # Setpoints of thrust, torques and rates, and injected torques [Hz]: the values of that moment
    setpoint_hz: Annotated[float, (0.0, 1e5)] = 0.0
    reference_hz: Annotated[float, (0.0, 1e5)] = 0.0  # References of height and attitude [Hz]
    omitted: tuple[str, ...] = ()  # Channels that are not logged, `rotor_command_*` for those of all rotors

    def __post_init__(self) -> None:
        checks.in_ranges(self, "Correct it.")


@dataclass(frozen=True, slots=True)
class RigidBodyFlightSpec:
    """Everything that a flight is a function of."""

    vehicle: Vehicle  # What flies
    # Steps of the simulation per second [Hz], over which commands, wind and torques from outside are held
    rate_hz: Annotated[float, (20.0, 1e4)] = 500.0
    duration: Annotated[float, (0.1, 3600.0)] = 30.0  # Of the flight [s]
    trajectory: TrajectoryKind = TrajectoryKind.MULTISINE  # The height reference
    # Share of the speed and acceleration that an excitation of the height may reach
    vigour: Annotated[float, (0.01, 2.0)] = 1.0
    # Roll, pitch and yaw that are requested [rad], yaw first
    attitude: AxisExcitations = field(default_factory=AxisExcitations)
    # What is added to the normalised torque setpoints
    injection: AxisExcitations = field(default_factory=AxisExcitations)
    controller: FlightController = field(default_factory=FlightController)  # Its loops
    wind: Wind = field(default_factory=Wind)  # Of the air
    torque_disturbance: TorqueDisturbance = field(default_factory=TorqueDisturbance)  # From outside
    sensors: Sensors = field(default_factory=Sensors)  # What is measured, and how
    logged: Logged = field(default_factory=Logged)  # How often the rest is logged
    seed: Annotated[int, (0, 2**63)] = 0  # Of the random streams

    def __post_init__(self) -> None:
        checks.in_ranges(self, "Correct the flight's description.")
        for name in ("rate_hz", "attitude_hz", "height_hz"):
            self._whole(f"{name} of the controller", self.rate_hz / getattr(self.controller, name))
        self._whole("attitude_hz of the controller", self.controller.rate_hz / self.controller.attitude_hz)
        self._whole("height_hz of the controller", self.controller.rate_hz / self.controller.height_hz)
        steps = self.vehicle.rotors.delay * self.rate_hz
        if abs(steps - round(steps)) > 1e-6:
            raise ParameterError(
                f"a delay of the rotors that is a multiple of {self.step_s:g} s, a step of the simulation",
                f"{self.vehicle.rotors.delay}",
                "Correct it, or the simulation's rate_hz.",
            )

    def _whole(self, what: str, periods: float) -> None:
        if not (periods > 0.5 and abs(periods - round(periods)) < 1e-6):
            expected = f"{what} that is the rate of the simulation, and of its rate loop, over a whole number"
            remedy = f"The simulation has {self.rate_hz:g} Hz, its rate loop {self.controller.rate_hz:g} Hz."
            raise ParameterError(expected, f"{periods:g} periods of these in one of its own", remedy)

    @property
    def step_s(self) -> float:
        return 1.0 / self.rate_hz

    @property
    def count(self) -> int:
        return round(self.duration * self.rate_hz)


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What one flight meets, a row for each step."""

    height: Float[np.ndarray, "n 3"]  # [m]
    attitude: Float[np.ndarray, "n 4"]
    injected: Float[np.ndarray, "n 3"]
    wind: Float[np.ndarray, "n 3"]  # Velocity of the air [m/s]
    disturbance: Float[np.ndarray, "n 3"]  # Torque from outside [N m]
    rate_error: Float[np.ndarray, "n 3"]
    attitude_error: Float[np.ndarray, "n 3"]
    velocity_error: Float[np.ndarray, "n 3"]
    position_error: Float[np.ndarray, "n 3"]
    force_error: Float[np.ndarray, "n 3"]
    speed_error: Float[np.ndarray, "n rotors"]


def surroundings_of(spec: RigidBodyFlightSpec) -> Surroundings:
    """Draw everything that a flight meets."""
    height, angles, injected, air, torque, *sensing = streams(spec.seed)
    count, step_s, sensors = spec.count, spec.step_s, spec.sensors
    reference = altitude_reference(
        spec.trajectory, count=count, step_s=step_s, rng=height, vigour=spec.vigour
    )
    accelerations = _series(_about(spec.torque_disturbance), count, step_s, torque)
    rotors = spec.vehicle.rotors.count
    of_speeds = sensors.rotor_speed
    period = round(spec.rate_hz / spec.controller.rate_hz)
    held = np.arange(count) // period * period  # what is injected is held as torque setpoints are
    return Surroundings(
        height=np.column_stack([reference.position, reference.velocity, reference.acceleration]),
        attitude=quaternions(_series(_about(spec.attitude), count, step_s, angles)),
        injected=_series(_about(spec.injection), count, step_s, injected)[held],
        wind=np.array(spec.wind.steady)
        + _series((spec.wind.x, spec.wind.y, spec.wind.z), count, step_s, air),
        disturbance=accelerations @ spec.vehicle.inertia_matrix,
        rate_error=sensors.angular_rate.errors(count, 3, sensing[0]),
        attitude_error=sensors.attitude.errors(count, 3, sensing[1]),
        velocity_error=sensors.velocity.errors(count, 3, sensing[2]),
        position_error=sensors.position.errors(count, 3, sensing[3]),
        force_error=sensors.specific_force.errors(count, 3, sensing[4]),
        speed_error=of_speeds.errors(count, rotors, sensing[5]) if of_speeds else np.zeros((count, rotors)),
    )


def streams(seed: int) -> list[np.random.Generator]:
    """Streams of the sources of randomness; the last one is that of the stamps' errors."""
    return [np.random.Generator(np.random.PCG64(s)) for s in np.random.SeedSequence(seed).spawn(12)]


def quaternions(angles: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 4"]:
    """Attitudes w, x, y, z of roll, pitch and yaw [rad]: yaw first, then pitch, then roll."""
    (a, b, c), (d, e, f) = np.cos(0.5 * angles).T, np.sin(0.5 * angles).T
    return np.column_stack(
        [a * b * c + d * e * f, d * b * c - a * e * f, a * e * c + d * b * f, a * b * f - d * e * c]
    )


def _about(axes: AxisExcitations | TorqueDisturbance) -> tuple[Excitation | None, ...]:
    return axes.roll, axes.pitch, axes.yaw


def _series(
    sources: tuple[Excitation | None, ...], count: int, step_s: float, rng: np.random.Generator
) -> Float[np.ndarray, "count axes"]:
    """Each source's series from a stream of its own; zeros where there is none."""
    streams = rng.spawn(len(sources))
    series = [
        np.zeros(count) if source is None else source.sample(count, step_s, stream)
        for source, stream in zip(sources, streams, strict=True)
    ]
    return np.column_stack(series)


def vehicle_text(spec: RigidBodyFlightSpec, name: str) -> str:
    """Text of the vehicle file of a flight's vehicle; what a flight is to identify is not in it."""
    rotors, sensors = spec.vehicle.rotors, spec.sensors
    lines = ["# The simulated vehicle as it is: every number is exact.", f"name = {_text(name)}"]
    lines.append(f"mass = {spec.vehicle.mass!r}")
    filtered = {"gyro": sensors.angular_rate, "accelerometer": sensors.specific_force}
    lines += [f"{key}_cutoff_hz = {item.cutoff_hz!r}" for key, item in filtered.items() if item.cutoff_hz]
    lines += ["", "[rotors]", f"positions = {[[x, y] for x, y, _ in rotors.positions]}"]
    lines += [f"spins = {list(rotors.spins)}", "speed_scale = 1.0", f"torque_ratio = {rotors.torque_ratio!r}"]
    lines.append(f"thrust_map = {_text(_thrust_map(rotors))}")
    return "\n".join(lines) + "\n"


def _text(words: str) -> str:
    return json.dumps("".join(word if word.isprintable() else "?" for word in words), ensure_ascii=False)


def _thrust_map(rotors: Rotors) -> str:
    if not rotors.thrust_linear:
        return "square"
    if not rotors.thrust_quadratic:
        return "linear"
    return f"mixed:{rotors.thrust_quadratic / (rotors.thrust_linear + rotors.thrust_quadratic)!r}"
