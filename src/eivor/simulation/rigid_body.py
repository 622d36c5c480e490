"""Simulated flights of a rigid body."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from itertools import count, groupby
from typing import Any, TypeAlias

import numpy as np

from eivor.motions.rigid_body.dynamics import (
    ZERO,
    Body,
    Components,
    EffectiveParameters,
    Triple,
    Value,
    coefficients_of,
    effective_parameters,
    side_by_side,
    specific_force,
    stacked,
    turned,
)
from eivor.signals.channels import held_by_default, roll_pitch_yaw, unit_of
from eivor.signals.recording import CONTROLLER_RATE, Channel, Frame, Recording
from eivor.simulation.controller import (
    Cascade,
    DelayLine,
    LiveFilter,
    Sensor,
    control_effectiveness,
    gains_of,
    low_pass,
    mixer_of,
    mixers_side_by_side,
)
from eivor.simulation.environment import SimulatedFlight
from eivor.simulation.rigid_body_spec import (
    RigidBodyFlightSpec,
    Surroundings,
    runge_kutta,
    streams,
    surroundings_of,
)
from eivor.tools import Float, Int

Series: TypeAlias = Float[np.ndarray, " n"]
Vectors: TypeAlias = Float[np.ndarray, "n 3"]


@dataclass(frozen=True, slots=True)
class ClosedLoopRecord:
    """What happened in one flight, a row for each step."""

    body: Float[np.ndarray, "n 13"]  # Position [m], velocity [m/s], attitude w, x, y, z, body rates [rad/s]
    rotor_speed: Float[np.ndarray, "n rotors"]  # [rad/s]
    rotor_command: Float[np.ndarray, "n rotors"]  # [rad/s]
    thrust: Series  # Collective thrust setpoint, a share of full thrust
    torque: Vectors
    wanted_rate: Vectors  # [rad/s]


def fly(specs: Sequence[RigidBodyFlightSpec], met: Sequence[Surroundings]) -> Iterator[ClosedLoopRecord]:
    """Fly specifications whose `shared_settings` are the same, side by side."""
    count, flights, start = specs[0].count, len(specs), 0
    series: list[Float[np.ndarray, "n ..."]] = []
    for moments in _moments(specs, met):
        for number, (part, shape) in enumerate(zip(zip(*moments, strict=True), _SHAPES, strict=True)):
            # Of rotors, flights side by side have a list of one array.
            values = np.array(part).reshape(len(moments), *shape, flights)
            if start == 0:
                series.append(np.empty((count, *values.shape[1:])))
            series[number][start : start + len(moments)] = values
        start += len(moments)
    for flight in range(flights):
        yield ClosedLoopRecord(*(np.ascontiguousarray(part[..., flight]) for part in series))


def shared_settings(spec: RigidBodyFlightSpec) -> tuple[object, ...]:
    """What flights that are simulated side by side have in common."""
    c = spec.controller
    loops = (c.rate_hz, c.attitude_hz, c.height_hz)
    return (spec.rate_hz, spec.count, spec.vehicle.rotors.count, loops)


#: Steps for which what is read is laid out at a time.
CHUNK = 500

#: Series that a loop reads, one entry for each step: components of one row.
_Rows: TypeAlias = Sequence[Components] | Float[np.ndarray, "n _ flights"]
#: Body, rotor speeds, commands, thrust, torques and wanted rates of a step.
_Moment: TypeAlias = tuple[Body, list[Value], list[Value], Value, Triple, Triple]

#: What the loop reads at each step; the rest is of the log.
READ = Surroundings.__slots__[:9]

#: Shapes of the parts of a moment, of one flight.
_SHAPES: tuple[tuple[int, ...], ...] = ((13,), (-1,), (-1,), (), (3,), (3,))


def _moments(specs: Sequence[RigidBodyFlightSpec], met: Sequence[Surroundings]) -> Iterator[list[_Moment]]:
    """Fly to the end; some steps at a time, so that what is read and what happened takes little space."""
    first, vehicles, alone = specs[0], [spec.vehicle for spec in specs], len(specs) == 1
    step_s, control, late = first.step_s, first.controller, [spec.vehicle.rotors.delay for spec in specs]
    gains = [gains_of(spec.controller, spec.vehicle, spec.sensors.angular_rate.lateness_s) for spec in specs]
    cascade = Cascade(_together(gains), 1.0 / control.rate_hz, 1.0 / control.height_hz)
    senses = [_filter_of([getattr(spec.sensors, name) for spec in specs], step_s) for name in SENSES]
    mixer = mixer_of(vehicles[0]) if alone else mixers_side_by_side(vehicles)
    stepper = runge_kutta(coefficients_of(vehicles[0]) if alone else side_by_side(vehicles), step_s)
    body: Body = _start(met[0]).tolist() if alone else np.stack([_start(item) for item in met], axis=1)
    hover = np.tile([vehicle.hover_speed for vehicle in vehicles], (vehicles[0].rotors.count, 1))
    speeds: list[Value] = hover[:, 0].tolist() if alone else [hover]
    line = DelayLine(_steps(late, step_s), speeds)
    every, attitude_every, height_every = (
        round(first.rate_hz / hz) for hz in (control.rate_hz, control.attitude_hz, control.height_hz)
    )
    holds = any(spec.controller.hold for spec in specs)
    thrust = ZERO
    rates = torque = (ZERO, ZERO, ZERO)
    command = speeds
    for k in range(first.count):
        now = k % CHUNK
        if now == 0:
            read, moments = _read(met, k), list[_Moment]()
        seen = (
            _sum(body[10:13], read["rate_error"][now]),
            turned(body[6:10], *read["attitude_error"][now]),
            _sum(body[3:6], read["velocity_error"][now]),
            _sum(body[0:3], read["position_error"][now]),
        )
        (p, q, r), attitude, velocity, position = (
            sense.read(raw) for sense, raw in zip(senses, seen, strict=True)
        )
        if k % height_every == 0:
            _, x, y, _ = attitude
            cosine = 1.0 - 2.0 * (x * x + y * y)
            z, climb, acceleration = read["height"][now]
            thrust = cascade.thrust((z, climb, acceleration), position[2], velocity[2], cosine)
        if k % attitude_every == 0:
            wanted = read["attitude"][now]
            if holds:
                wanted = cascade.holding(wanted, position[:2], velocity[:2])
            rates = cascade.rates(wanted, attitude)
        if k % every == 0:
            roll, pitch, yaw = _sum(cascade.torques(rates, (p, q, r)), read["injected"][now])
            torque = (roll, pitch, yaw)
            command = mixer.commands(thrust, torque)
        moments.append((body, speeds, command, thrust, torque, rates))
        (wx, wy, wz), (mx, my, mz) = read["wind"][now], read["disturbance"][now]
        body, speeds = stepper(body, speeds, line.pass_on(command), (wx, wy, wz), (mx, my, mz))
        if now == CHUNK - 1 or k == first.count - 1:
            yield moments


def _read(met: Sequence[Surroundings], start: int) -> dict[str, _Rows]:
    """What the loop reads of the next steps: floats of one flight, arrays of several."""
    rows = {name: [getattr(item, name)[start : start + CHUNK] for item in met] for name in READ}
    return {name: of[0].tolist() if len(met) == 1 else np.stack(of, axis=-1) for name, of in rows.items()}


def _together(each: Sequence[Any]) -> Any:
    """Floats of one flight as they are, those of several as arrays whose last axis is the flight."""
    return each[0] if len(each) == 1 else stacked(each)


#: Sensors that the controller reads, as the loop reads them.
SENSES = ("angular_rate", "attitude", "velocity", "position")


def _start(met: Surroundings) -> Float[np.ndarray, " 13"]:
    height, climb, _ = met.height[0]
    return np.array([0.0, 0.0, height, *met.wind[0, :2], climb, *met.attitude[0], 0.0, 0.0, 0.0])


def _filter_of(sensors: Sequence[Sensor], step_s: float) -> LiveFilter:
    parts = [_coefficients(sensor, step_s) for sensor in sensors]
    late = _steps([sensor.delay_s for sensor in sensors], step_s)
    return LiveFilter(_together(parts) if any(sensor.cutoff_hz for sensor in sensors) else None, late)


def _steps(times_s: Sequence[float], step_s: float) -> Int[np.ndarray, " flights"]:
    return np.array([round(time_s / step_s) for time_s in times_s])


def _coefficients(sensor: Sensor, step_s: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Numerator, and denominator after its 1; of a sensor without a filter what leaves all as it is."""
    if not sensor.cutoff_hz:
        return (1.0, 0.0, 0.0), (0.0, 0.0)
    b, a = low_pass(sensor.cutoff_hz, step_s)
    return tuple(b.tolist()), tuple(a[1:].tolist())


def _sum(first: Components, second: Components) -> list[Value]:
    return [a + b for a, b in zip(first, second, strict=True)]


SIMULATOR = "rigid body"


def recording_of(
    spec: RigidBodyFlightSpec, met: Surroundings, flight: ClosedLoopRecord, force: Vectors
) -> Recording:
    """Log of a flight."""
    rng = streams(spec.seed)[-1]
    channels: dict[str, Channel] = {}
    for sensor, series in (*_measured(spec, met, flight, force), *_logged_series(spec, met, flight)):
        rows = sensor.rows(spec.count, spec.step_s)
        time_s = sensor.stamps(rows, spec.step_s, rng)
        for name, values in series.items():
            if not any(fnmatch(name, item) for item in spec.logged.omitted):
                held, unit = held_by_default(name), unit_of(name)
                channels[name] = Channel(
                    name, time_s, values[rows], unit, source=SIMULATOR, held=held, estimated=False
                )
    logged_hz = [rate or math.inf for rate in (spec.logged.rotor_command_hz, spec.logged.setpoint_hz)]
    whole = min(logged_hz) >= spec.controller.rate_hz
    return Recording(
        name=f"rigid body, {spec.trajectory}, seed {spec.seed}",
        format="simulation",
        channels=channels,
        frame=Frame.Z_UP,
        parameters={CONTROLLER_RATE: spec.controller.rate_hz} if whole else {},
        input_map="" if spec.vehicle.rotors.thrust_linear else "square",
    )


def _measured(
    spec: RigidBodyFlightSpec, met: Surroundings, flight: ClosedLoopRecord, force: Vectors
) -> list[tuple[Sensor, dict[str, Series]]]:
    sensors, step_s, body = spec.sensors, spec.step_s, flight.body
    attitude = np.column_stack(turned(list(body[:, 6:10].T), *met.attitude_error.T))

    velocity = sensors.velocity.readings(body[:, 3:6] + met.velocity_error, step_s)
    position = sensors.position.readings(body[:, 0:3] + met.position_error, step_s)
    rates = sensors.angular_rate.readings(body[:, 10:13] + met.rate_error, step_s)
    forces = sensors.specific_force.readings(force + met.force_error, step_s)
    measured = [
        (sensors.angular_rate, _named("angular_rate", rates, "xyz")),
        (sensors.specific_force, _named("specific_force_body", forces, "xyz")),
        (sensors.velocity, _named("velocity", velocity, "xyz")),
        (sensors.position, _named("position", position, "xyz")),
        (sensors.attitude, _named("attitude", sensors.attitude.readings(attitude, step_s), "wxyz")),
    ]
    if sensors.rotor_speed is not None:
        speeds = sensors.rotor_speed.readings(flight.rotor_speed + met.speed_error, step_s)
        measured.append((sensors.rotor_speed, _named("rotor_speed", speeds, count(1))))
    return measured


def _logged_series(
    spec: RigidBodyFlightSpec, met: Surroundings, flight: ClosedLoopRecord
) -> list[tuple[Sensor, dict[str, Series]]]:
    logged = spec.logged
    setpoints = {
        "input": flight.thrust,
        **_named("torque_setpoint", flight.torque, "xyz"),
        **_named("feedback_reference_angular_rate", flight.wanted_rate, "xyz"),
    }
    if met.injected.any():
        setpoints |= _named("injected_torque", met.injected, "xyz")
    height = ("reference_position_z", "reference_velocity_z", "reference_acceleration_z")
    references = (*height, "reference_roll", "reference_pitch", "reference_yaw")
    series = [*met.height.T, *roll_pitch_yaw(met.attitude.T)]
    rates = (logged.rotor_command_hz, logged.setpoint_hz, logged.reference_hz)
    commands = _named("rotor_command", flight.rotor_command, count(1))
    all_series = (commands, setpoints, dict(zip(references, series, strict=True)))
    return [(Sensor(rate_hz=rate), each) for rate, each in zip(rates, all_series, strict=True)]


def _named(stem: str, series: Float[np.ndarray, "n parts"], parts: Iterable[object]) -> dict[str, Series]:
    return {f"{stem}_{part}": values for part, values in zip(parts, series.T, strict=False)}


#: Steps of all flights that are simulated side by side: some hundred megabytes.
BATCH_STEPS = 1_200_000
#: A vehicle this far from its height [m], or with so small a cosine of its tilt, is lost.
LOST_M, LOST_COSINE = 5.0, 0.17


@dataclass(frozen=True, slots=True)
class RigidBodyTruth:
    """What is true of a flight, a row for each step of the simulation, without errors of sensors."""

    record: ClosedLoopRecord
    specific_force: Vectors  # On the body's axes [m/s^2]
    air_velocity: Vectors  # Of the vehicle through the air, in the world [m/s]
    parameters: EffectiveParameters  # Combinations of the vehicle's parameters that the flight shows
    control_effectiveness: tuple[float, float, float]  # [rad/s^2]


RigidBodyFlight: TypeAlias = SimulatedFlight[RigidBodyTruth]


def simulate_rigid_body_flights(specs: Sequence[RigidBodyFlightSpec]) -> Iterator[RigidBodyFlight]:
    """Fly each specification and give its log and its truth, in order."""
    for _, group in groupby(specs, shared_settings):
        together = list(group)
        most = max(BATCH_STEPS // together[0].count, 1)
        for start in range(0, len(together), most):
            batch = together[start : start + most]
            met = [surroundings_of(spec) for spec in batch]
            for spec, item, entry in zip(batch, met, fly(batch, met), strict=True):
                yield _flight(spec, item, entry)


def _flight(spec: RigidBodyFlightSpec, met: Surroundings, flight: ClosedLoopRecord) -> RigidBodyFlight:
    body = flight.body
    force = specific_force(
        side_by_side([spec.vehicle]),
        np.ascontiguousarray(body.T),
        [np.ascontiguousarray(flight.rotor_speed.T)],
        (met.wind[:, 0], met.wind[:, 1], met.wind[:, 2]),
    )
    truth = RigidBodyTruth(
        record=flight,
        specific_force=np.column_stack(force),
        air_velocity=body[:, 3:6] - met.wind,
        parameters=effective_parameters(spec.vehicle),
        control_effectiveness=control_effectiveness(spec.vehicle),
    )
    cosine = 1.0 - 2.0 * (body[:, 7] ** 2 + body[:, 8] ** 2)
    away = np.abs(body[:, 2] - met.height[:, 0])
    flew = bool(away.max() < LOST_M and cosine.min() > LOST_COSINE)
    return SimulatedFlight(recording_of(spec, met, flight, truth.specific_force), truth, flew)
