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
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import TypeVar

import numpy as np
from jaxtyping import Bool, Float

from eivor.errors import EivorError, UsageError
from eivor.signals.filters import actuator_state
from eivor.signals.recording import GRAVITY
from eivor.simulation.environment import (
    SensorNoise,
    Trajectory,
    TrajectoryKind,
    altitude_reference,
    gusts,
)
from eivor.simulation.vertical import (
    LOST_M,
    THRUST_RANGE,
    TILT_CORRELATION_S,
    TILT_SMOOTHING_S,
    AltitudeController,
)
from validation.effective_parameters import FlightTruth, effective_parameters

#: Step of the simulation [s]; controllers and delays are whole steps.
STEP_S = 0.002
#: The velocity loop is never quicker than this [1/s].
LARGEST_VELOCITY_GAIN = 5.0


class Reference(StrEnum):
    """What the altitude reference does; the first three as `eivor.simulation` has them."""

    STEPS = "steps"
    MULTISINE = "multisine"
    CHIRP = "chirp"
    RAMPS = "ramps"
    SINE = "sine"


class Jitter(StrEnum):
    """What is irregular in a log: nothing, the stamps that it writes, or the instants that it samples."""

    NONE = "none"
    STAMPS = "stamps"
    INSTANTS = "instants"


@dataclass(frozen=True, slots=True)
class VehicleSpec:
    """A vehicle, its surroundings and its controller; unlisted units are SI."""

    viscous_friction: float = 0.4  # K [1/s] and the coefficient of v|v| [1/m]
    quadratic_drag: float = 0.0
    hover_input: float = 0.5  # Command at which it hovers, a share of full command
    thrust_share: float = 1.0  # Thrust goes as (1 - s) w + s w^p with the rotor state w
    thrust_power: float = 2.0
    rotor_spread: float = (
        0.0  # Commands of half the rotors are this share above the mean, of the others below
    )
    actuator_lag: float = 0.04  # Time constant of the rotor upwards, and delay of its command [s]
    delay: float = 0.0
    slower_down: float = 1.0  # Time constant downwards over that upwards
    load_sag: float = 0.0  # c in the speed w (1 - c (x^3 - 1)) with x = w over its value at hover
    voltage_sag: float = 0.0  # Share of the voltage that is lost over the flight; speed follows it
    payload: float = 0.0  # Share of the mass that is dropped at half of the flight
    slew: float = 0.0  # Largest rate of the command that reaches the rotor [1/s]; none for zero
    ceiling: float = 0.0  # Largest command that does; none for zero
    # Thrust gains 1 / (1 - (R / 4 z)^2) above a ground that is `least_height` below the lowest reference; no
    # ground for a radius of zero
    rotor_radius: float = 0.0
    least_height: float = 2.0
    # Largest speed of the horizontal flight [m/s], and the friction along the body's x [1/s]
    horizontal_speed: float = 0.0
    horizontal_friction: float = 0.3
    # Share of the horizontal speed that goes along with the climbs, from 0 to 1; the rest goes back and forth
    # by itself
    diagonal: float = 0.0
    gust_rms: float = 0.0  # Vertical wind: its standard deviation and correlation time, and its mean
    gust_correlation: float = 1.0
    updraft: float = 0.0
    tilt_rms: float = 0.03  # Standard deviation of roll and pitch [rad], before they are smoothed
    controller_hz: float = 100.0  # Rate of the controller
    quickness: float = 0.35  # As in `eivor.simulation.vertical`
    position_share: float = 0.3
    integral_share: float = 0.05

    @property
    def gains(self) -> AltitudeController:
        late = self.actuator_lag + self.delay + 0.5 / self.controller_hz
        velocity = min(self.quickness / late, LARGEST_VELOCITY_GAIN)
        return AltitudeController(self.position_share * velocity, velocity, self.integral_share * velocity**2)

    @property
    def controller_steps(self) -> int:
        return round(1.0 / (self.controller_hz * STEP_S))


@dataclass(frozen=True, slots=True)
class LoggerSpec:
    command_hz: float = 100.0  # Rates; commands are never logged faster than the controller gives them
    reference_hz: float = 100.0
    velocity_hz: float = 100.0
    acceleration_hz: float = 100.0
    attitude_hz: float = 100.0
    jitter: Jitter = Jitter.NONE  # What is irregular
    jitter_s: float = 0.0  # Its standard deviation [s], at most `LARGEST_JITTER` of a channel's period
    dropouts: float = 0.0  # Times a minute at which the logger loses all channels, for so long at most [s]
    longest_dropout: float = 0.5
    even_stamps: bool = False  # Commands have the stamps of the logger's clock, not those of the controller
    filled_hz: float = 0.0  # Rate to which the last command logged is repeated; none for zero
    command_drift: float = 0.0  # Share by which the clock of the commands is fast
    duplicates: float = 0.0  # Share of the samples that are written twice
    # Of accelerometer, velocity, position and attitude
    noise: SensorNoise = field(default_factory=SensorNoise)
    accelerometer_bias: float = 0.0  # Constant error along the body's z [m/s^2]
    velocity_delay: float = 0.0  # Pure delays and time constants of low-pass filters [s]
    velocity_filter: float = 0.0
    acceleration_delay: float = 0.0
    acceleration_filter: float = 0.0
    velocity_scale: float = 1.0  # What a true value of one is measured as
    acceleration_scale: float = 1.0
    tilt_error: float = 0.0  # Error of the pitch that attitude and accelerometer share [rad]
    voltage_logged: bool = False  # Whether the battery's voltage is in the log
    # Velocity and acceleration come from an estimator that learns the accelerometer's bias with this time
    # constant and fuses a velocity that is so late [s]; none when the time constant is zero
    bias_time: float = 0.0
    fused_late: float = 0.0


@dataclass(frozen=True, slots=True)
class FlightSpec:
    vehicle: VehicleSpec = field(default_factory=VehicleSpec)  # What flies
    logger: LoggerSpec = field(default_factory=LoggerSpec)  # What records it
    reference: Reference = Reference.MULTISINE  # The altitude's
    frequency: float = 0.3  # Of a reference that is one sine [Hz]
    vigour: float = 0.8  # Share of the speed and acceleration that an excitation may reach
    duration: float = 60.0  # [s]
    seed: int = 0  # Of all random streams
    # Name of a vehicle of RotorPy, which then flies in place of the own simulator's; empty for none
    multirotor: str = ""

    def __post_init__(self) -> None:
        for what, seconds in (("period", 1.0 / self.vehicle.controller_hz), ("delay", self.vehicle.delay)):
            steps = seconds / STEP_S
            if abs(steps - round(steps)) > 1e-6:
                raise UsageError(
                    f"a {what} of whole steps of {STEP_S} s", f"{seconds:g} s", "Choose another one."
                )
        if not self.duration >= 2.0:
            raise UsageError("a flight of two seconds or more", f"{self.duration:g} s", "Fly longer.")

    @property
    def steps(self) -> int:
        return round(self.duration / STEP_S)


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
    thrust_of, controller = Thrust(spec), _Controller(spec, met)
    scale = (supply(spec, met.position.size) * met.cos_tilt).tolist()
    lighter = _lighter(spec, met.position.size)
    friction, coupling = ((lighter * part).tolist() for part in _along_vertical(spec, met))
    gust, floor = met.gust.tolist(), float(met.position.min()) - spec.least_height
    lags = (spec.actuator_lag, spec.actuator_lag * spec.slower_down)
    up, down = (math.exp(-0.5 * STEP_S / lag) for lag in lags)
    late, every = round(spec.delay / STEP_S), spec.controller_steps
    slew, ceiling = STEP_S * spec.slew or math.inf, spec.ceiling or math.inf
    state, z, v = spec.hover_input, float(met.position[0]), float(met.velocity[0])
    command = acting = spec.hover_input
    thrust = thrust_of(spec.hover_input)
    commands = [command] * late
    rows = []
    for k, lifted in enumerate(scale):
        if k % every == 0:
            command = controller.command(k, z, v, thrust_of)
        commands.append(command)
        acting += min(max(min(commands[k], ceiling) - acting, -slew), slew)
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
        gains = self._gains
        error = self._wanted[k] - float(gains.position_gain) * z - v
        self._integral += error * self._period
        feedback = float(gains.velocity_gain) * error + float(gains.integral_gain) * self._integral
        requested = (self._weight[k] + feedback) / self._cosine[k]
        return thrust_of.command(min(max(requested, self._least), self._most))


def supply(spec: VehicleSpec, steps: int) -> Float[np.ndarray, " steps"]:
    """What a falling voltage leaves of the thrust for a mass: speed goes with it, and thrust with speed."""
    left = 1.0 - spec.voltage_sag * np.arange(steps) / steps
    return np.asarray(left ** Thrust(spec).exponent * _lighter(spec, steps))


def _lighter(spec: VehicleSpec, steps: int) -> Float[np.ndarray, " steps"]:
    """Mass at the start over the mass at each step."""
    return 1.0 / (1.0 - spec.payload * (2 * np.arange(steps) >= steps))


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


#: A rotor has one lag when its states are within this share of the hover state of those that follow with one.
ONE_LAG = 1e-6
#: Accuracy of lag and delay [s].
TOLERANCE_S = 1e-5


def effective_lag(
    truth: FlightTruth,
    command: Float[np.ndarray, "n rotors"],
    thrust: Callable[[Float[np.ndarray, "n rotors"]], Float[np.ndarray, "n rotors"]],
    rows: Bool[np.ndarray, " n"],
) -> float:
    """Sum of the first-order lag and the delay that best describe the true thrust from the commands [s]."""
    from scipy.optimize import minimize

    step_s = float(truth.time_s[1] - truth.time_s[0])
    started = np.vstack([truth.rotor_state[:1], command])

    def state(lag_s: float, delay_s: float) -> Float[np.ndarray, "n rotors"]:
        return actuator_state(started, step_s=step_s, lag_s=lag_s, delay_s=delay_s)[1:]

    def lifted(states: Float[np.ndarray, "n rotors"]) -> Float[np.ndarray, " used"]:
        column = (truth.cos_tilt * thrust(states).mean(axis=1))[rows]
        return np.asarray(column - column.mean())

    nominal = truth.actuator_lag + truth.delay
    separated = np.abs(state(truth.actuator_lag, truth.delay) - truth.rotor_state).max()
    true = lifted(truth.rotor_state)
    if separated <= ONE_LAG * truth.hover_input or not true.any():
        return nominal

    def unexplained(nuisances: Float[np.ndarray, " 2"]) -> float:
        one_lag = lifted(state(*np.abs(nuisances).tolist()))
        return 1.0 - float((one_lag @ true) ** 2 / ((one_lag @ one_lag) * (true @ true)))

    start = np.array([truth.actuator_lag, truth.delay])
    settings = {"xatol": TOLERANCE_S, "fatol": np.inf}
    simplex = start + np.array([[0.0, 0.0], [0.2 * nominal, 0.0], [0.0, 0.2 * nominal]])
    solution = minimize(
        unexplained, start, method="Nelder-Mead", options={**settings, "initial_simplex": simplex}
    )
    return float(np.abs(solution.x).sum())


#: Rotor states, as shares of that at hover, among which the one that carries the weight is looked for.
NEAR_HOVER = np.linspace(0.5, 1.5, 4001)


@dataclass(frozen=True, slots=True)
class Flown:
    """A flight's noise-free motion on one clock, n instants."""

    truth: FlightTruth  # Its arrays and nominal parameters
    # Static thrust [m/s^2] of rotor states, elementwise
    thrust: Callable[[Float[np.ndarray, "m rotors"]], Float[np.ndarray, "m rotors"]]
    supply: Float[np.ndarray, " n"]  # What the voltage leaves of the thrust
    command: Float[np.ndarray, "n rotors"]  # In force from each instant on
    reference: Trajectory  # Of the altitude
    position: Float[np.ndarray, " n"]  # Height [m] and vertical velocity [m/s]
    velocity: Float[np.ndarray, " n"]
    horizontal: Float[np.ndarray, " n"] | None  # Velocity along x [m/s], where it is logged
    attitude: Float[np.ndarray, "n 4"]  # Quaternion [w, x, y, z] from body to world
    force_body: Float[np.ndarray, "n 3"]  # Specific force along the body's axes [m/s^2]
    flew: bool  # False when the vehicle was lost
    shares: tuple[float, ...] = (1.0,)  # Commands of rotors over `command`

    def effective(self, used_s: Float[np.ndarray, " m"], used: Bool[np.ndarray, " m"]) -> dict[str, float]:
        """Values that an estimator without any error would give over the samples that were used."""
        truth = self.truth
        rows = np.interp(truth.time_s, used_s, used.astype(np.float64), left=0.0, right=0.0) > 0.5
        friction, gain, hover = truth.viscous_friction, truth.input_gain, truth.hover_input
        supplied = replace(truth, cos_tilt=truth.cos_tilt * self.supply)
        try:
            parameters = effective_parameters(supplied, rows, self.thrust)
        except EivorError:  # Rows that tell nothing: the nominal values stand.
            pass
        else:
            friction = parameters.viscous_friction
            thrust = parameters.input_gain * float(self.supply[rows].mean())
            gain = thrust * GRAVITY / truth.hover_input**2 / np.square(self.shares).mean()
            air = truth.air_velocity_z[rows].mean() - self.velocity[rows].mean()
            weight = (GRAVITY - parameters.intercept + friction * air) / thrust
            states = truth.hover_input * NEAR_HOVER
            hover = float(np.interp(weight, self.thrust(states[:, None])[:, 0], states))
        return {
            "viscous_friction": friction,
            "input_gain": gain,
            "effective_lag": effective_lag(supplied, self.command, self.thrust, rows),
            "hover_input": hover,
        }


#: The altitude's shape is made at this step and read between it; sines have no need of more [s].
SHAPE_STEP_S = 0.01
#: Ramps: climb rates [m/s], how long each is kept [s], and the height that they stay within [m].
RAMP_SPEED, RAMP_SECONDS, RAMP_HEIGHT = 1.8, (1.5, 4.0), 4.0
#: Largest speed [m/s] and acceleration [m/s^2] of a single sine.
SINE_LIMITS = (1.8, 3.5)
#: Horizontal flight goes back and forth with this acceleration at most [m/s^2].
HORIZONTAL_ACCELERATION = 2.5


def altitude(spec: FlightSpec, rng: np.random.Generator) -> Trajectory:
    """Reference of the altitude at every step of the simulation."""
    time = STEP_S * np.arange(spec.steps)
    if spec.reference is Reference.RAMPS:
        return _ramps(time, rng, spec.vigour)
    if spec.reference is Reference.SINE:
        return _sine(time, spec, rng)
    count = round(spec.duration / SHAPE_STEP_S) + 1
    shape = altitude_reference(
        TrajectoryKind(spec.reference.value), count=count, step_s=SHAPE_STEP_S, rng=rng, vigour=spec.vigour
    )
    coarse = SHAPE_STEP_S * np.arange(count)
    return Trajectory(
        *(np.interp(time, coarse, part) for part in (shape.position, shape.velocity, shape.acceleration))
    )


def _ramps(time: Float[np.ndarray, " n"], rng: np.random.Generator, vigour: float) -> Trajectory:
    """Climbs and descents at speeds that jump, which turn back before they leave the heights allowed."""
    velocity = np.zeros(time.size)
    start, height = 0.0, 0.0
    while start < time[-1]:
        seconds = rng.uniform(*RAMP_SECONDS)
        speed = vigour * rng.uniform(-RAMP_SPEED, RAMP_SPEED)
        if abs(height + speed * seconds) > RAMP_HEIGHT:
            speed = -speed
        velocity[(time >= start) & (time < start + seconds)] = speed
        start, height = start + seconds, height + speed * seconds
    return Trajectory(np.cumsum(velocity) * STEP_S, velocity, np.zeros(time.size))


def _sine(time: Float[np.ndarray, " n"], spec: FlightSpec, rng: np.random.Generator) -> Trajectory:
    pulsation = 2.0 * np.pi * spec.frequency
    size = spec.vigour * min(SINE_LIMITS[0] / pulsation, SINE_LIMITS[1] / pulsation**2)
    angle = pulsation * time + rng.uniform(0.0, 2.0 * np.pi)
    return Trajectory(
        size * np.sin(angle), size * pulsation * np.cos(angle), -size * pulsation**2 * np.sin(angle)
    )


def horizontal_velocity(
    spec: FlightSpec, vertical: Trajectory, rng: np.random.Generator
) -> Float[np.ndarray, " n"]:
    """Velocity along the world's x [m/s] at every step: along with the climbs, back and forth, or none."""
    vehicle = spec.vehicle
    count = vertical.position.size
    if vehicle.horizontal_speed == 0.0:
        return np.zeros(count)
    time = STEP_S * np.arange(count)
    pulsation = HORIZONTAL_ACCELERATION / vehicle.horizontal_speed * rng.uniform(0.8, 1.0)
    current = np.sin(pulsation * time + rng.uniform(0.0, 2.0 * np.pi))
    fastest = float(np.abs(vertical.velocity).max())
    along = vertical.velocity / fastest if fastest > 0.0 else np.zeros(count)
    share = vehicle.diagonal
    return np.asarray(vehicle.horizontal_speed * (share * along + (1.0 - share) * current))


def pitch(spec: FlightSpec, horizontal: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Pitch [rad] that makes the horizontal acceleration, against the drag."""
    acceleration = np.gradient(horizontal, STEP_S)
    drag = spec.vehicle.horizontal_friction * horizontal
    return np.asarray(np.arctan((acceleration + drag) / GRAVITY))


def stream(spec: FlightSpec, name: str) -> np.random.Generator:
    seed = np.random.SeedSequence(spec.seed, spawn_key=(zlib.crc32(name.encode()),))
    return np.random.Generator(np.random.PCG64(seed))


def fly_own(spec: FlightSpec, seen_errors: tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]) -> Flown:
    reference = altitude(spec, stream(spec, "altitude"))
    horizontal = horizontal_velocity(spec, reference, stream(spec, "horizontal"))
    wander = _wander(spec)
    met = Surroundings(
        position=reference.position,
        velocity=reference.velocity,
        acceleration=reference.acceleration,
        gust=_wind(spec),
        pitch=wander[:, 0] + pitch(spec, horizontal),
        roll=wander[:, 1],
        horizontal=horizontal,
        position_noise=seen_errors[0],
        velocity_noise=seen_errors[1],
    )
    return _simulated(spec, reference, met, fly(spec.vehicle, met))


def _wander(spec: FlightSpec) -> Float[np.ndarray, "n 2"]:
    """Pitch and roll that are held against the air [rad]."""
    angles = gusts(
        count=spec.steps,
        axes=2,
        step_s=STEP_S,
        rms=spec.vehicle.tilt_rms,
        correlation_s=TILT_CORRELATION_S,
        rng=stream(spec, "tilt"),
    )
    return actuator_state(angles, step_s=STEP_S, lag_s=TILT_SMOOTHING_S, delay_s=0.0)


def _wind(spec: FlightSpec) -> Float[np.ndarray, " n"]:
    blown = gusts(
        count=spec.steps,
        axes=1,
        step_s=STEP_S,
        rms=spec.vehicle.gust_rms,
        correlation_s=spec.vehicle.gust_correlation,
        rng=stream(spec, "wind"),
    )
    return np.asarray(spec.vehicle.updraft + blown[:, 0])


def _simulated(spec: FlightSpec, reference: Trajectory, met: Surroundings, motion: Motion) -> Flown:
    coupling = _along_vertical(spec.vehicle, met)[1]
    truth = FlightTruth(
        time_s=STEP_S * np.arange(spec.steps),
        # of what the horizontal speed adds its mean alone: the rest is a disturbance that goes with the tilt
        specific_force_z=motion.force - coupling + coupling.mean(),
        air_velocity_z=motion.velocity - met.gust,
        rotor_state=motion.rotor_state[:, None],
        cos_tilt=met.cos_tilt,
        actuator_lag=spec.vehicle.actuator_lag,
        delay=spec.vehicle.delay,
        viscous_friction=spec.vehicle.viscous_friction,
        input_gain=GRAVITY / spec.vehicle.hover_input**2,
        hover_input=spec.vehicle.hover_input,
    )
    along, spread = np.gradient(met.horizontal, STEP_S), spec.vehicle.rotor_spread
    return Flown(
        truth=truth,
        thrust=Thrust(spec.vehicle),
        supply=supply(spec.vehicle, spec.steps),
        command=motion.command[:, None],
        reference=reference,
        position=motion.position,
        velocity=motion.velocity,
        horizontal=met.horizontal,
        attitude=_quaternion(met.pitch, met.roll),
        force_body=_in_body(met.pitch, met.roll, along, motion.force),
        flew=bool(np.abs(motion.position - reference.position).max() < LOST_M),
        shares=(1.0 + spread, 1.0 - spread) if spread else (1.0,),
    )


def _quaternion(theta: Float[np.ndarray, " n"], phi: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 4"]:
    """Attitude that is pitched by theta, then rolled by phi."""
    c, s, cr, sr = np.cos(theta / 2), np.sin(theta / 2), np.cos(phi / 2), np.sin(phi / 2)
    return np.stack([c * cr, c * sr, s * cr, -s * sr], axis=1)


def _in_body(
    theta: Float[np.ndarray, " n"],
    phi: Float[np.ndarray, " n"],
    along: Float[np.ndarray, " n"],
    up: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "n 3"]:
    """Specific force along x and z of the world, in the body's axes."""
    forward = along * np.cos(theta) - up * np.sin(theta)
    plane = along * np.sin(theta) + up * np.cos(theta)
    return np.stack([forward, plane * np.sin(phi), plane * np.cos(phi)], axis=1)
