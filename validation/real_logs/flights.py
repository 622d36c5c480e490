"""Flights of either simulator, each with the log that a real logger would have made of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from eivor.logs.common import on_channel_clock
from eivor.motions.vertical.model import GRAVITY
from eivor.signals.channels import held_by_default, unit_of
from eivor.signals.filters import actuator_state
from eivor.signals.recording import Channel, Frame, Recording, clean_channel
from eivor.simulation.environment import (
    NoiseKind,
    SensorErrors,
    SensorNoise,
    Trajectory,
    TrajectoryKind,
    sensor_errors,
)
from validation.flight_recipe.rotorpy_flight import RotorpyFlightSpec, Vehicle, simulate_rotorpy_flight
from validation.real_logs.closed_loop import STEP_S, FlightSpec, Flown, Jitter, fly_own, stream

#: A channel's jitter is at most this share of its period, or loggers would write heaps of stamps.
LARGEST_JITTER = 0.35
#: The logger is lost for so long at least [s].
DROPOUT_S = 0.05


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

    def channel(self, name: str, clock: Clock, values: Float[np.ndarray, " n"], source: str) -> Channel:
        kept = ~self._lost(clock.instants)
        times = np.where(self.rng.random(int(kept.sum())) < self.spec.logger.duplicates, 2, 1)
        stamps, series = (np.repeat(part[kept], times) for part in (clock.stamps, values))
        return clean_channel(name, stamps, series, unit_of(name), source=source, held=held_by_default(name))

    def _lost(self, instants: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
        after = instants[:, None]
        return np.asarray(((after >= self.gaps[:, 0]) & (after < self.gaps[:, 1])).any(axis=1))


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
            noise=SensorNoise(NoiseKind.WHITE, *[0.0] * 5),
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
        reference=Trajectory(
            *(log[f"reference_{part}_z"] for part in ("position", "velocity", "acceleration"))
        ),
        position=log["position_z"],
        velocity=log["velocity_z"],
        horizontal=None,
        attitude=np.stack([log[f"attitude_{axis}"] for axis in "wxyz"], axis=1),
        force_body=np.stack([log[f"specific_force_body_{axis}"] for axis in "xyz"], axis=1),
        flew=flight.flew,
    )


SOURCE = "simulated sensor"
#: Voltage of the full battery, and the rate at which it is logged.
FULL_VOLTAGE, VOLTAGE_HZ = 16.0, 10.0


@dataclass(frozen=True)
class Topics:
    """Clocks of a log, and the errors of its sensors at their samples."""

    clocks: Mapping[str, Clock]  # Of command, reference, velocity, acceleration, attitude
    slow: SensorErrors  # Errors of position and velocity, and of the accelerometer
    quick: SensorErrors
    attitude: Float[np.ndarray, "n 3"]  # Small rotations of the attitude [rad]

    def seen(self, spec: FlightSpec) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Errors of position and velocity that the controller sees, at every step of the simulation."""
        time = STEP_S * np.arange(spec.steps)
        latest = np.searchsorted(self.clocks["velocity"].instants, time, side="right") - 1
        index = np.maximum(latest, 0)
        return self.slow.position[index, 2], self.slow.velocity[index, 2]


def topics(spec: FlightSpec) -> Topics:
    """Clocks and errors of a flight's log; they are known before it flies, for its controller sees them."""
    logger = spec.logger
    rates = {
        "reference": logger.reference_hz,
        "velocity": logger.velocity_hz,
        "acceleration": logger.acceleration_hz,
        "attitude": logger.attitude_hz,
    }
    clocks = {name: topic_clock(spec, rate, stream(spec, f"clock {name}")) for name, rate in rates.items()}
    clocks["command"] = command_clock(spec, stream(spec, "clock command"))

    def errors(name: str) -> SensorErrors:
        count = clocks[name].instants.size
        return sensor_errors(logger.noise, count=count, axes=3, rng=stream(spec, f"errors {name}"))

    return Topics(clocks, errors("velocity"), errors("acceleration"), errors("attitude").attitude)


def log_of(spec: FlightSpec, flight: Flown, record: Topics) -> Recording:
    written = writer(spec, stream(spec, "writer"))
    channels = [*_commands(flight, record, written), *_references(flight, record, written)]
    if spec.logger.bias_time > 0.0:
        channels += _estimates(spec, flight, record, written)
    else:
        channels += [*_velocities(spec, flight, record, written), *_forces(spec, flight, record, written)]
    channels += _attitude(spec, flight, record, written)
    if spec.logger.voltage_logged:
        channels.append(_voltage(spec, written))
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
    return [
        on_channel_clock(written.channel(f"rotor_command_{number + 1}", clock, values[held], SOURCE))
        for number, values in enumerate(flight.command.T)
    ]


def _references(flight: Flown, record: Topics, written: Writer) -> list[Channel]:
    clock, time = record.clocks["reference"], flight.truth.time_s
    held = np.searchsorted(time, clock.instants + 1e-9, side="right") - 1
    parts = ("position", "velocity", "acceleration")
    return [
        written.channel(
            f"reference_{part}_z", clock, np.asarray(getattr(flight.reference, part))[held], SOURCE
        )
        for part in parts
    ]


def _velocities(spec: FlightSpec, flight: Flown, record: Topics, written: Writer) -> list[Channel]:
    clock, logger, errors = record.clocks["velocity"], spec.logger, record.slow
    late = {"delay": logger.velocity_delay, "filtered": logger.velocity_filter}
    scale = logger.velocity_scale
    up = scale * _read(flight, flight.velocity, clock.instants, **late) + errors.velocity[:, 2]
    height = _read(flight, flight.position, clock.instants, **late) + errors.position[:, 2]
    channels = [
        written.channel("position_z", clock, height, SOURCE),
        written.channel("velocity_z", clock, up, SOURCE),
    ]
    if flight.horizontal is None:
        return channels
    along = scale * _read(flight, flight.horizontal, clock.instants, **late) + errors.velocity[:, 0]
    return [
        *channels,
        written.channel("velocity_x", clock, along, SOURCE),
        written.channel("velocity_y", clock, errors.velocity[:, 1], SOURCE),
    ]


def _forces(spec: FlightSpec, flight: Flown, record: Topics, written: Writer) -> list[Channel]:
    clock = record.clocks["acceleration"]
    return [
        written.channel(f"specific_force_body_{axis}", clock, values, SOURCE)
        for axis, values in zip("xyz", _accelerometer(spec, flight, record).T, strict=True)
    ]


def _accelerometer(spec: FlightSpec, flight: Flown, record: Topics) -> Float[np.ndarray, "n 3"]:
    """What the accelerometer reads at its instants [m/s^2]."""
    clock, logger = record.clocks["acceleration"], spec.logger
    late = {"delay": logger.acceleration_delay, "filtered": logger.acceleration_filter}
    read = np.stack([_read(flight, axis, clock.instants, **late) for axis in flight.force_body.T], axis=1)
    return (
        logger.acceleration_scale * read + record.quick.acceleration + [0.0, 0.0, logger.accelerometer_bias]
    )


def _attitude(spec: FlightSpec, flight: Flown, record: Topics, written: Writer) -> list[Channel]:
    from scipy.spatial.transform import Rotation

    clock = record.clocks["attitude"]
    parts = np.stack(
        [np.interp(clock.instants, flight.truth.time_s, part) for part in flight.attitude.T], axis=1
    )
    true = Rotation.from_quat(parts[:, [1, 2, 3, 0]])
    wrong = Rotation.from_rotvec([0.0, spec.logger.tilt_error, 0.0])
    measured = (wrong * true * Rotation.from_rotvec(record.attitude)).as_quat()
    return [
        written.channel(f"attitude_{axis}", clock, values, SOURCE)
        for axis, values in zip("xyzw", measured.T, strict=True)
    ]


def _estimates(spec: FlightSpec, flight: Flown, record: Topics, written: Writer) -> list[Channel]:
    """Height, velocity and acceleration as an estimator of the vehicle's state makes them."""
    clock, logger = record.clocks["velocity"], spec.logger
    force = told_vertical_force(spec, flight, record)
    fused = (
        _read(flight, flight.velocity, clock.instants, delay=logger.fused_late) + record.slow.velocity[:, 2]
    )
    velocity, acceleration = estimated(clock.instants, force - GRAVITY, fused, bias_time=logger.bias_time)
    height = _read(flight, flight.position, clock.instants) + record.slow.position[:, 2]
    source = "estimator"
    return [
        written.channel("position_z", clock, height, source),
        written.channel("velocity_z", clock, velocity, source),
        written.channel("acceleration_z", clock, acceleration, source),
    ]


def told_vertical_force(spec: FlightSpec, flight: Flown, record: Topics) -> Float[np.ndarray, " n"]:
    """Vertical specific force that the accelerometer gives the estimator, at the velocity's instants."""
    instants = record.clocks["velocity"].instants
    true = _read(flight, flight.truth.specific_force_z, instants)
    noise = record.quick.acceleration[:, 2]
    index = np.minimum(np.searchsorted(record.clocks["acceleration"].instants, instants), noise.size - 1)
    return true + noise[index] + spec.logger.accelerometer_bias


def _voltage(spec: FlightSpec, written: Writer) -> Channel:
    clock = topic_clock(spec, VOLTAGE_HZ, stream(spec, "clock voltage"))
    left = 1.0 - spec.vehicle.voltage_sag * clock.instants / spec.duration
    noise = 0.02 * stream(spec, "errors voltage").standard_normal(left.size)
    return written.channel("battery_voltage", clock, FULL_VOLTAGE * left + noise, SOURCE)


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
