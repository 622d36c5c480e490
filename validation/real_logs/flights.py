"""Flights of either simulator, each with the log that a real logger would have made of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eivor.logs.common import on_channel_clock
from eivor.signals.channels import held_by_default, unit_of
from eivor.signals.filters import actuator_state
from eivor.signals.recording import GRAVITY, Channel, Frame, Recording, clean_channel
from eivor.simulation.environment import Errors, NoiseKind, SensorNoise, Trajectory, TrajectoryKind
from validation.flight_recipe.rotorpy_flight import RotorpyFlightSpec, Vehicle, simulate_rotorpy_flight
from validation.real_logs.closed_loop import STEP_S, FlightSpec, Flown, Jitter, fly_own, stream

#: A channel's jitter is at most this share of its period, or loggers would write heaps of stamps.
LARGEST_JITTER = 0.35
#: The logger is lost for so long at least [s].
DROPOUT_S = 0.05
SOURCE = "simulated sensor"
REFERENCES = ("position", "velocity", "acceleration")


@dataclass(frozen=True, slots=True)
class Clock:
    instants: Float[np.ndarray, " n"]  # When they were taken [s]
    stamps: Float[np.ndarray, " n"]  # When the log says that they were [s]


def topic_clock(spec: FlightSpec, rate_hz: float, rng: np.random.Generator) -> Clock:
    """Clock of a topic that the logger samples itself, out of step with every other."""
    period = 1.0 / rate_hz
    regular = rng.uniform(0.0, period) + period * np.arange(int(spec.duration * rate_hz) - 1)
    return _jittered(spec, regular, period, rng)


def command_clock(spec: FlightSpec, rng: np.random.Generator) -> Clock:
    every = STEP_S * spec.vehicle.controller_steps
    period = max(1.0 / spec.logger.command_hz, every)
    ticks = rng.uniform(0.0, period) + period * np.arange(int(spec.duration / period) - 1)
    if spec.logger.jitter is Jitter.INSTANTS:
        ticks = _jittered(spec, ticks, period, rng).instants
    if spec.logger.even_stamps:
        return Clock(ticks, ticks)
    issued = every * np.unique(np.floor(ticks / every + 1e-9))
    return (
        _jittered(spec, issued, period, rng) if spec.logger.jitter is Jitter.STAMPS else Clock(issued, issued)
    )


def _jittered(
    spec: FlightSpec, regular: Float[np.ndarray, " n"], period: float, rng: np.random.Generator
) -> Clock:
    size = min(spec.logger.jitter_s, LARGEST_JITTER * period)
    moved = np.maximum(regular + size * rng.standard_normal(regular.size), 0.0)
    if spec.logger.jitter is Jitter.INSTANTS:
        moved = np.sort(moved)
        return Clock(moved, moved)
    return Clock(regular, moved if spec.logger.jitter is Jitter.STAMPS else regular)


@dataclass(frozen=True)
class Writer:
    """What happens to every topic on its way into the log: gaps, and samples that are written twice."""

    spec: FlightSpec  # The flight
    gaps: Float[np.ndarray, "m 2"]  # Begin and end [s] of what is lost
    rng: np.random.Generator  # Picks what is written twice

    def channels(
        self, clock: Clock, values: Mapping[str, Float[np.ndarray, " n"]], source: str = SOURCE
    ) -> list[Channel]:
        """Channels of one clock, by name."""
        after, results = clock.instants[:, None], []
        kept = ~((after >= self.gaps[:, 0]) & (after < self.gaps[:, 1])).any(axis=1)
        for name, series in values.items():
            times = np.where(self.rng.random(int(kept.sum())) < self.spec.logger.duplicates, 2, 1)
            stamps, written = (np.repeat(part[kept], times) for part in (clock.stamps, series))
            unit, held = unit_of(name), held_by_default(name)
            results.append(clean_channel(name, stamps, written, unit, source=source, held=held))
        return results


def writer(spec: FlightSpec, rng: np.random.Generator) -> Writer:
    count = int(rng.poisson(spec.logger.dropouts * spec.duration / 60.0))
    begin = rng.uniform(0.0, spec.duration, count)
    return Writer(
        spec,
        np.stack([begin, begin + rng.uniform(DROPOUT_S, spec.logger.longest_dropout, count)], axis=1),
        rng,
    )


#: How quickly the velocity follows what is fused, L [1/s].
FUSING_RATE = 3.0


def estimated(
    time_s: Float[np.ndarray, " n"],
    acceleration: Float[np.ndarray, " n"],
    fused: Float[np.ndarray, " n"],
    *,
    bias_time: float,
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Velocity [m/s] and acceleration [m/s^2] that the estimator gives."""
    velocity, bias = float(fused[0]), 0.0
    velocities, accelerations = np.empty(time_s.size), np.empty(time_s.size)
    steps = np.diff(time_s, prepend=time_s[0]).tolist()
    for k, (step, measured, seen) in enumerate(
        zip(steps, acceleration.tolist(), fused.tolist(), strict=True)
    ):
        innovation = seen - velocity
        current = measured - bias
        velocity += step * (current + FUSING_RATE * innovation)
        bias -= step * FUSING_RATE / bias_time * innovation
        velocities[k], accelerations[k] = velocity, current
    return velocities, accelerations


def fly_rotorpy(spec: FlightSpec) -> Flown:
    """Fly one of RotorPy's multirotors at 100 Hz, with sensors that the controller sees without noise."""
    flight = simulate_rotorpy_flight(
        RotorpyFlightSpec(
            vehicle=Vehicle(spec.multirotor),
            actuator_lag=spec.vehicle.actuator_lag,
            delay=spec.vehicle.delay,
            gust_rms=spec.vehicle.gust_rms,
            gust_correlation=spec.vehicle.gust_correlation,
            noise=SensorNoise(NoiseKind.WHITE, *[0.0] * 4),
            rate_noise=0.0,
            trajectory=TrajectoryKind(spec.reference.value),
            seed=spec.seed,
            duration=spec.duration,
        )
    )
    log = {name: channel.values for name, channel in flight.recording.channels.items()}
    gain = flight.truth.input_gain
    return Flown(
        truth=flight.truth,
        thrust=lambda states: gain * states**2,
        supply=np.ones(flight.truth.time_s.size),
        command=np.stack(
            [log[f"rotor_command_{rotor + 1}"] for rotor in range(flight.truth.rotor_state.shape[1])], axis=1
        ),
        reference=Trajectory(*(log[f"reference_{part}_z"] for part in REFERENCES)),
        position=log["position_z"],
        velocity=log["velocity_z"],
        horizontal=None,
        attitude=np.stack([log[f"attitude_{axis}"] for axis in "wxyz"], axis=1),
        force_body=np.stack([log[f"specific_force_body_{axis}"] for axis in "xyz"], axis=1),
        flew=flight.flew,
    )


#: Voltage of the full battery, and the rate at which it is logged.
FULL_VOLTAGE, VOLTAGE_HZ = 16.0, 10.0


@dataclass(frozen=True)
class Topics:
    """Clocks of a log, and the errors of its sensors at their samples."""

    clocks: Mapping[str, Clock]  # Of command, reference, velocity, acceleration, attitude
    slow: Errors  # Errors of position and velocity, and of the accelerometer
    quick: Errors
    attitude: Float[np.ndarray, "n 3"]  # Small rotations of the attitude [rad]

    def seen(self, spec: FlightSpec) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Errors of position and velocity that the controller sees, at every step of the simulation."""
        time = STEP_S * np.arange(spec.steps)
        latest = np.searchsorted(self.clocks["velocity"].instants, time, side="right") - 1
        index = np.maximum(latest, 0)
        return self.slow["position"][index, 2], self.slow["velocity"][index, 2]


def topics(spec: FlightSpec) -> Topics:
    """Clocks and errors of a flight's log; they are known before it flies, for its controller sees them."""
    logger = spec.logger
    clocks = {
        name: topic_clock(spec, getattr(logger, f"{name}_hz"), stream(spec, f"clock {name}"))
        for name in ("reference", "velocity", "acceleration", "attitude")
    }
    clocks["command"] = command_clock(spec, stream(spec, "clock command"))

    def errors(name: str) -> Errors:
        count = clocks[name].instants.size
        return logger.noise.errors(count, 3, stream(spec, f"errors {name}"))

    return Topics(clocks, errors("velocity"), errors("acceleration"), errors("attitude")["attitude"])


def log_of(spec: FlightSpec, flight: Flown, record: Topics) -> Recording:
    written = writer(spec, stream(spec, "writer"))
    moved = [_estimates] if spec.logger.bias_time > 0.0 else [_velocities, _forces]
    makers = [_commands, _references, *moved, _attitude, *([_voltage] if spec.logger.voltage_logged else [])]
    channels = [channel for maker in makers for channel in maker(flight, record, written)]
    return Recording(
        name=f"flight {spec.seed}",
        format="simulation",
        channels={channel.name: channel for channel in channels},
        frame=Frame.Z_UP,
        input_map="square",
    )


def _commands(flight: Flown, record: Topics, written: Writer) -> list[Channel]:
    clock = record.clocks["command"]
    # A command is in force from its instant on; a rounding error must not make it the one before.
    held = np.searchsorted(flight.truth.time_s, clock.instants + 1e-9, side="right") - 1
    logger, instants, stamps = written.spec.logger, clock.instants, clock.stamps
    if logger.filled_hz:
        instants = stamps = np.arange(instants[0], instants[-1], 1.0 / logger.filled_hz)
        held = held[np.searchsorted(clock.instants, instants + 1e-9, side="right") - 1]
    clock = Clock(instants, stamps * (1.0 + logger.command_drift))
    commands = {
        f"rotor_command_{number + 1}": each[held]
        for number, each in enumerate((flight.command * flight.shares).T)
    }
    return [on_channel_clock(channel) for channel in written.channels(clock, commands)]


def _references(flight: Flown, record: Topics, written: Writer) -> list[Channel]:
    clock = record.clocks["reference"]
    held = np.searchsorted(flight.truth.time_s, clock.instants + 1e-9, side="right") - 1
    parts = {part: np.asarray(getattr(flight.reference, part)) for part in REFERENCES}
    return written.channels(clock, {f"reference_{part}_z": values[held] for part, values in parts.items()})


def _velocities(flight: Flown, record: Topics, written: Writer) -> list[Channel]:
    clock, logger, errors = record.clocks["velocity"], written.spec.logger, record.slow
    late = {"delay": logger.velocity_delay, "filtered": logger.velocity_filter}
    scale = logger.velocity_scale
    values = {
        "position_z": _read(flight, flight.position, clock.instants, **late) + errors["position"][:, 2],
        "velocity_z": scale * _read(flight, flight.velocity, clock.instants, **late)
        + errors["velocity"][:, 2],
    }
    if flight.horizontal is not None:
        along = scale * _read(flight, flight.horizontal, clock.instants, **late)
        values |= {"velocity_x": along + errors["velocity"][:, 0], "velocity_y": errors["velocity"][:, 1]}
    return written.channels(clock, values)


def _forces(flight: Flown, record: Topics, written: Writer) -> list[Channel]:
    clock, logger = record.clocks["acceleration"], written.spec.logger
    late = {"delay": logger.acceleration_delay, "filtered": logger.acceleration_filter}
    read = np.stack([_read(flight, axis, clock.instants, **late) for axis in flight.force_body.T], axis=1)
    measured = (
        logger.acceleration_scale * read
        + record.quick["acceleration"]
        + [0.0, 0.0, logger.accelerometer_bias]
    )
    values = zip("xyz", measured.T, strict=True)
    return written.channels(clock, {f"specific_force_body_{axis}": item for axis, item in values})


def _attitude(flight: Flown, record: Topics, written: Writer) -> list[Channel]:
    from scipy.spatial.transform import Rotation

    clock = record.clocks["attitude"]
    parts = np.stack(
        [np.interp(clock.instants, flight.truth.time_s, part) for part in flight.attitude.T], axis=1
    )
    true = Rotation.from_quat(parts[:, [1, 2, 3, 0]])
    wrong = Rotation.from_rotvec([0.0, written.spec.logger.tilt_error, 0.0])
    measured = (wrong * true * Rotation.from_rotvec(record.attitude)).as_quat()
    values = zip("xyzw", measured.T, strict=True)
    return written.channels(clock, {f"attitude_{axis}": item for axis, item in values})


def _estimates(flight: Flown, record: Topics, written: Writer) -> list[Channel]:
    """Height, velocity and acceleration as an estimator of the vehicle's state makes them."""
    clock, logger = record.clocks["velocity"], written.spec.logger
    noise = record.quick["acceleration"][:, 2]
    latest = np.searchsorted(record.clocks["acceleration"].instants, clock.instants)
    force = _read(flight, flight.truth.specific_force_z, clock.instants)
    force = force + noise[np.minimum(latest, noise.size - 1)] + logger.accelerometer_bias
    fused = _read(flight, flight.velocity, clock.instants, delay=logger.fused_late)
    fused = fused + record.slow["velocity"][:, 2]
    velocity, acceleration = estimated(clock.instants, force - GRAVITY, fused, bias_time=logger.bias_time)
    height = _read(flight, flight.position, clock.instants) + record.slow["position"][:, 2]
    values = {"position_z": height, "velocity_z": velocity, "acceleration_z": acceleration}
    return written.channels(clock, values, "estimator")


def _voltage(_flight: Flown, _record: Topics, written: Writer) -> list[Channel]:
    spec = written.spec
    clock = topic_clock(spec, VOLTAGE_HZ, stream(spec, "clock voltage"))
    left = 1.0 - spec.vehicle.voltage_sag * clock.instants / spec.duration
    noise = 0.02 * stream(spec, "errors voltage").standard_normal(left.size)
    return written.channels(clock, {"battery_voltage": FULL_VOLTAGE * left + noise})


def _read(
    flight: Flown,
    values: Float[np.ndarray, " n"],
    instants: Float[np.ndarray, " m"],
    *,
    delay: float = 0.0,
    filtered: float = 0.0,
) -> Float[np.ndarray, " m"]:
    """Values at instants, through a low-pass filter and late by a delay [s]."""
    time = flight.truth.time_s
    if filtered > 0.0:
        step = float(time[1] - time[0])
        values = actuator_state(values[:, None], step_s=step, lag_s=filtered, delay_s=0.0)[:, 0]
    return np.interp(instants - delay, time, values)


@dataclass(frozen=True)
class LoggedFlight:
    recording: Recording  # The log
    flown: Flown  # What is true of it


def logged_flight(spec: FlightSpec) -> LoggedFlight:
    reported = topics(spec)
    flight = fly_rotorpy(spec) if spec.multirotor else fly_own(spec, reported.seen(spec))
    return LoggedFlight(log_of(spec, flight, reported), flight)
