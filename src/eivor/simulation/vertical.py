"""Simulated vertical flights in closed loop."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, TypeAlias, TypeVar

import numpy as np

from eivor import checks
from eivor.errors import ParameterError, UsageError
from eivor.signals.filters import actuator_state
from eivor.signals.recording import GRAVITY, Recording
from eivor.simulation import environment as surroundings
from eivor.simulation.controller import DelayLine
from eivor.simulation.environment import KnownLog, SimulatedFlight, TrajectoryKind, altitude_reference, gusts
from eivor.strict_toml import package_tables
from eivor.tools import Float

Parts = TypeVar("Parts")
Flights = Float[np.ndarray, " flights"]
Samples = Float[np.ndarray, "samples *flights"]

#: Substeps of one control period: delays are rounded to them.
SUBSTEPS = 5
#: Least and greatest thrust that may be commanded, in multiples of the weight.
THRUST_RANGE = np.array([[0.05], [3.0]])


@dataclass(frozen=True, slots=True)
class VerticalVehicles:
    """Physical parameters of several vehicles, arrays of shape (flights,)."""

    viscous_friction: Flights  # K [1/s], above zero, and neither 1/tau nor 2/tau
    input_gain: Flights  # K_u [m/s^2 per squared unit of rotor state]
    lag_s: Flights
    delay_s: Flights


@dataclass(frozen=True, slots=True)
class VerticalEnvironment:
    """References, wind and sensor noise of flights: arrays (samples, flights), of one flight (samples,)."""

    reference_position: Samples  # [m, m/s, m/s^2]
    reference_velocity: Samples  # [m, m/s, m/s^2]
    reference_acceleration: Samples  # [m, m/s, m/s^2]
    gust: Samples  # Vertical wind [m/s]
    cos_tilt: Samples
    position_noise: Samples  # [m, m/s, m/s^2]
    velocity_noise: Samples  # [m, m/s, m/s^2]
    acceleration_noise: Samples  # [m, m/s, m/s^2]


@dataclass(frozen=True, slots=True)
class AltitudeController:
    """Position, velocity and integral gains around the trajectory's feed-forward."""

    position_gain: float | Flights = 1.2  # [1/s]
    velocity_gain: float | Flights = 3.0  # [1/s]
    integral_gain: float | Flights = 1.0  # [1/s^2]


@dataclass(frozen=True, slots=True)
class SimulatedMotion:
    """Commands and states of flights, arrays of shape (samples, flights)."""

    command: Samples  # [k]
    rotor_state: Samples  # [k]
    position: Samples  # [m, m/s, m/s^2]
    velocity: Samples  # [m, m/s, m/s^2]
    specific_force: Samples  # [m, m/s, m/s^2]


def simulate_vertical(
    vehicles: VerticalVehicles,
    environment: VerticalEnvironment,
    *,
    step_s: float,
    controller: AltitudeController,
    gain_share: Samples | None = None,
) -> SimulatedMotion:
    """Fly every vehicle through its environment under altitude control."""
    count, flights = environment.gust.shape
    hover = np.sqrt(GRAVITY / vehicles.input_gain)
    state = hover.copy()
    z, v = environment.reference_position[0].copy(), environment.reference_velocity[0].copy()
    integral = np.zeros(flights)
    out = SimulatedMotion(*(np.empty((count, flights)) for _ in range(5)))
    line = DelayLine(vehicles.delay_s, step_s / SUBSTEPS, [hover])
    substep = exact_substep(vehicles, step_s / SUBSTEPS)
    lifts = environment.cos_tilt if gain_share is None else gain_share * environment.cos_tilt
    for k in range(count):
        tilt, lift, gust = environment.cos_tilt[k], lifts[k], environment.gust[k]
        measured_z = z + environment.position_noise[k]
        measured_v = v + environment.velocity_noise[k]
        error_z = environment.reference_position[k] - measured_z
        velocity_setpoint = environment.reference_velocity[k] + controller.position_gain * error_z
        error_v = velocity_setpoint - measured_v
        integral += error_v * step_s
        acceleration_setpoint = (
            environment.reference_acceleration[k]
            + controller.velocity_gain * error_v
            + controller.integral_gain * integral
        )
        thrust = (GRAVITY + acceleration_setpoint) / (vehicles.input_gain * tilt)
        command = np.sqrt(np.clip(thrust, *THRUST_RANGE * hover**2))
        out.command[k], out.rotor_state[k], out.position[k], out.velocity[k] = command, state, z, v
        out.specific_force[k] = vehicles.input_gain * lift * state**2 - vehicles.viscous_friction * (v - gust)
        for _ in range(SUBSTEPS):
            delayed = np.asarray(line.push([command])[0])
            state, z, v = substep(delayed, state, z, v, gust, lift)
    return out


def exact_substep(vehicles: VerticalVehicles, h: float) -> Callable[..., tuple[Flights, Flights, Flights]]:
    """Closed-form motion over one substep [s] with command, gust and tilt held."""
    K, rate = vehicles.viscous_friction, 1.0 / np.maximum(vehicles.lag_s, 1e-9)
    decay, damping = np.exp(-rate * h), np.exp(-K * h)
    # Responses of v, and their integrals, to the three parts of the driving acceleration.
    held = -np.expm1(-K * h) / K
    slow, slow_integral = (decay - damping) / (K - rate), -np.expm1(-rate * h) / rate
    fast, fast_integral = (decay**2 - damping) / (K - 2.0 * rate), -np.expm1(-2.0 * rate * h) / (2.0 * rate)

    def end(
        command: Flights, state: Flights, z: Flights, v: Flights, gust: Flights, lift: Flights
    ) -> tuple[Flights, Flights, Flights]:
        """Rotor state, height and velocity at the end; K_u times `lift` is the upward gain of the state."""
        deviation, gain = state - command, vehicles.input_gain * lift
        D0 = gain * command**2 + K * gust - GRAVITY
        D1, D2 = 2.0 * gain * command * deviation, gain * deviation**2
        velocity = damping * v + held * D0 + slow * D1 + fast * D2
        # The equation of motion, integrated: K times the height gained is impulse less momentum.
        impulse = h * D0 + slow_integral * D1 + fast_integral * D2
        return command + decay * deviation, z + (impulse - (velocity - v)) / K, velocity

    return end


#: Step of the controller and of the log [s].
STEP_S = 0.01
#: The velocity loop is never quicker than this [1/s].
LARGEST_VELOCITY_GAIN = 5.0


@dataclass(frozen=True, slots=True)
class VerticalFlightSpec:
    """Everything that a flight is a function of."""

    viscous_friction: Annotated[float, (1e-3, 2.0)] = 0.4  # K [1/s]
    hover_input: Annotated[float, (0.1, 0.9)] = 0.5  # Command at which it hovers, a share of full command
    # Time constant of the rotor and delay of its command [s]; the delay a multiple of 0.002
    actuator_lag: Annotated[float, (1e-3, 0.3)] = 0.04
    delay: Annotated[float, (0.0, 0.2)] = 0.0
    # Standard deviation [m/s] and correlation time [s] of the vertical wind
    gust_rms: Annotated[float, (0.0, 5.0)] = 0.0
    gust_correlation: Annotated[float, (0.01, 100.0)] = 1.0
    # Of accelerometer, velocity, position and attitude
    noise: surroundings.SensorNoise = field(default_factory=surroundings.SensorNoise)
    accelerometer_bias: Annotated[float, (-2.0, 2.0)] = 0.0  # Constant error of the specific force [m/s^2]
    # Standard deviation of roll and of pitch [rad], before they are smoothed
    tilt_rms: Annotated[float, (0.0, 0.2)] = 0.05
    # Final factor of K_u, unknown to the controller
    gain_after: Annotated[float, (0.4, 2.0)] = 1.0
    # When it begins to change [s], and how long it takes [s]: zero for at once
    gain_changes_at: Annotated[float, (0.0, 3600.0)] = 30.0
    gain_changes_over: Annotated[float, (0.0, 3600.0)] = 0.0
    trajectory: TrajectoryKind = TrajectoryKind.MULTISINE  # The altitude reference
    # Share of the speed and acceleration that an excitation may reach
    vigour: Annotated[float, (0.01, 2.0)] = 1.0
    # Gain of the velocity loop times the sum of lag, delay and half a control step
    quickness: Annotated[float, (0.01, 0.6)] = 0.35
    # Gain of the position loop over that of the velocity loop. Of the integrator over its square
    position_share: Annotated[float, (0.01, 0.6)] = 0.3
    integral_share: Annotated[float, (0.0, 0.25)] = 0.05
    seed: int = 0  # Of the random streams
    duration: Annotated[float, (2.0, 3600.0)] = 60.0  # Of the flight [s], a multiple of 0.01

    def __post_init__(self) -> None:
        checks.in_ranges(self, "Correct the flight's specification.")
        substeps = self.delay / STEP_S * SUBSTEPS
        if abs(substeps - round(substeps)) > 1e-6:
            expected = f"a delay that is a multiple of {STEP_S / SUBSTEPS:g} s"
            raise UsageError(expected, f"{self.delay}", "The simulator delays whole substeps.")

    @property
    def count(self) -> int:
        return round(self.duration / STEP_S)

    @property
    def input_gain(self) -> float:
        """K_u at the beginning [m/s^2 per squared share of full command]."""
        return GRAVITY / self.hover_input**2

    @property
    def gain_share(self) -> Float[np.ndarray, " samples"]:
        """K_u at each stamp over that at the beginning."""
        elapsed = STEP_S * np.arange(self.count) - self.gain_changes_at
        progress = np.clip(elapsed / max(self.gain_changes_over, STEP_S), 0.0, 1.0)
        return np.asarray(1.0 + (self.gain_after - 1.0) * progress)

    @property
    def controller(self) -> AltitudeController:
        velocity = min(self.quickness / (self.actuator_lag + self.delay + STEP_S / 2), LARGEST_VELOCITY_GAIN)
        return AltitudeController(self.position_share * velocity, velocity, self.integral_share * velocity**2)


#: A flight whose truth is its environment and its motion.
VerticalFlight: TypeAlias = SimulatedFlight[tuple[VerticalEnvironment, SimulatedMotion]]
#: Flights that are simulated side by side: memory stays flat, about a megabyte for a minute of each.
BATCH = 48
#: Roll and pitch wander with this correlation time, and are smooth over the second one [s].
TILT_CORRELATION_S = 1.0
TILT_SMOOTHING_S = 0.15
#: A vehicle this far from its reference is lost [m].
LOST_M = 5.0
SIMULATOR = "vertical"


def simulate_vertical_flights(specs: Sequence[VerticalFlightSpec]) -> Iterator[VerticalFlight]:
    """Fly each specification and give its log and its truth, in order."""
    if len({spec.count for spec in specs}) > 1:
        durations = sorted({spec.duration for spec in specs})
        raise UsageError("flights of one duration", f"durations {durations} s", "Simulate them separately.")
    for first in range(0, len(specs), BATCH):
        yield from _batch(specs[first : first + BATCH])


def _surroundings(spec: VerticalFlightSpec) -> tuple[VerticalEnvironment, Samples]:
    """Environment of one flight, in arrays of shape (samples,), and its measured tilt."""
    shape, air, sensors, attitude = (
        np.random.Generator(np.random.PCG64(s)) for s in np.random.SeedSequence(spec.seed).spawn(4)
    )
    count = spec.count
    reference = altitude_reference(spec.trajectory, count=count, step_s=STEP_S, rng=shape, vigour=spec.vigour)
    wind, angles = (
        gusts(count=count, axes=axes, step_s=STEP_S, rms=rms, correlation_s=correlation_s, rng=rng)
        for axes, rms, correlation_s, rng in (
            (1, spec.gust_rms, spec.gust_correlation, air),
            (2, spec.tilt_rms, TILT_CORRELATION_S, attitude),
        )
    )
    smooth = actuator_state(angles, step_s=STEP_S, lag_s=TILT_SMOOTHING_S, delay_s=0.0)
    errors = spec.noise.errors(count, 2, sensors)
    noises = (errors[name][:, 0] for name in ("position", "velocity", "acceleration"))
    series = [*reference, wind[:, 0], np.cos(smooth).prod(axis=1), *noises]
    return VerticalEnvironment(*series), np.cos(smooth + errors["attitude"]).prod(axis=1)


def stacked(kind: type[Parts], items: Sequence[object], names: Sequence[str] = ()) -> Parts:
    """Fields of several flights stacked along a last axis, optionally under other names."""
    fields = names or kind.__annotations__
    return kind(*(np.stack([getattr(item, name) for item in items], axis=-1) for name in fields))


def _batch(specs: Sequence[VerticalFlightSpec]) -> Iterator[VerticalFlight]:
    environments, tilts = zip(*map(_surroundings, specs), strict=True)
    environment = stacked(VerticalEnvironment, environments)
    motion = simulate_vertical(
        stacked(VerticalVehicles, specs, ("viscous_friction", "input_gain", "actuator_lag", "delay")),
        environment,
        step_s=STEP_S,
        controller=stacked(AltitudeController, [spec.controller for spec in specs]),
        gain_share=np.stack([spec.gain_share for spec in specs], axis=1),
    )
    for number, (spec, single, tilt) in enumerate(zip(specs, environments, tilts, strict=True)):
        title = f"vertical simulator, {spec.trajectory}, seed {spec.seed}"
        recording = vertical_recording(
            title, SIMULATOR, environment, motion, number, cos_tilt=tilt, bias=spec.accelerometer_bias
        )
        moved = SimulatedMotion(*(getattr(motion, name)[:, number] for name in SimulatedMotion.__slots__))
        flew = bool(np.abs(moved.position - single.reference_position).max() < LOST_M)
        yield SimulatedFlight(recording, (single, moved), flew)


def vertical_recording(
    name: str,
    simulator: str,
    environment: VerticalEnvironment,
    motion: SimulatedMotion,
    number: int,
    *,
    cos_tilt: Samples | None = None,
    bias: float = 0.0,
) -> Recording:
    """Log of one of several flights; without a tilt as measured that of the environment."""
    force = motion.specific_force[:, number] + environment.acceleration_noise[:, number]
    references = ("reference_position", "reference_velocity", "reference_acceleration")
    series = {
        "rotor_command_1": motion.command[:, number],
        **{f"{item}_z": getattr(environment, item)[:, number] for item in references},
        "position_z": motion.position[:, number] + environment.position_noise[:, number],
        "velocity_z": motion.velocity[:, number] + environment.velocity_noise[:, number],
        "specific_force_z": force + bias,
        "cos_tilt": environment.cos_tilt[:, number] if cos_tilt is None else cos_tilt,
    }
    return surroundings.simulated_recording(name, simulator, STEP_S * np.arange(force.size), series)


def logs_of_flights(specs: Sequence[VerticalFlightSpec]) -> Iterator[KnownLog]:
    """Logs of flights of one duration, in order; many are flown side by side."""
    for spec, flight in zip(specs, simulate_vertical_flights(specs), strict=True):
        if not flight.flew:
            expected = "a flight that follows its reference within 5 m"
            remedy = "Make the gusts weaker, or the trajectory less vigorous."
            raise ParameterError(expected, f"one that is lost with the seed {spec.seed}", remedy)
        # Without its input map, which is the rotors' own default.
        recording = replace(flight.recording, input_map="")
        yield KnownLog(recording, 1.0 / STEP_S, spec.count, spec.seed, _flight_truth(spec))


def _flight_truth(spec: VerticalFlightSpec) -> dict[str, object]:
    levels = ("acceleration", "velocity", "position", "attitude")
    numbers = ("viscous_friction", "input_gain", "actuator_lag", "delay", "hover_input")
    changes = ("gust_rms", "gain_after", "gain_changes_at", "gain_changes_over")
    return {
        **{name: getattr(spec, name) for name in numbers},
        "units": package_tables("eivor.simulation", "truth.toml")["vertical_units"],
        "noise": {"kind": str(spec.noise.kind)} | {name: getattr(spec.noise, name) for name in levels},
        **{name: getattr(spec, name) for name in changes},
        "trajectory": str(spec.trajectory),
    }
