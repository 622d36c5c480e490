"""The closed loop: sensors, controller, rotors and body, step by step, of one flight or of several.

At each step the controller reads its sensors, if it is a loop's turn, and commands; then the body moves on,
with what reaches the rotors held. Row k of what is returned is the moment before that move, with the command
that is issued then.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from eivor.motions.rigid_body.coefficients import Value, coefficients_of, side_by_side, stacked
from eivor.motions.rigid_body.dynamics import ZERO, Body, Components, Triple, turned
from eivor.shapes import Float
from eivor.simulation.rigid_body.controller import (
    Cascade,
    Gains,
    Mixer,
    gains_of,
    gains_side_by_side,
    mixer_of,
    mixers_side_by_side,
)
from eivor.simulation.rigid_body.delay_line import DelayLine
from eivor.simulation.rigid_body.integrators import HeldInputs, Stepper
from eivor.simulation.rigid_body.sensors import LiveFilter, Sensor, low_pass
from eivor.simulation.rigid_body.spec import RigidBodyFlightSpec
from eivor.simulation.rigid_body.surroundings import Surroundings


@dataclass(frozen=True, slots=True)
class Flown:
    """What happened in one flight, a row for each step.

    Parameters
    ----------
    body : ndarray, shape (n, 13)
        Position [m], velocity [m/s], attitude w, x, y, z, body rates [rad/s].
    rotor_speed, rotor_command : ndarray, shape (n, rotors)
        [rad/s]; the command is issued at the row's time.
    thrust : ndarray, shape (n,)
        Collective thrust setpoint, a share of full thrust.
    torque : ndarray, shape (n, 3)
        Torque setpoints that the mixer got, what is injected included.
    wanted_rate : ndarray, shape (n, 3)
        Body rates that the attitude loop asked for [rad/s].
    """

    body: Float[np.ndarray, "n 13"]
    rotor_speed: Float[np.ndarray, "n rotors"]
    rotor_command: Float[np.ndarray, "n rotors"]
    thrust: Float[np.ndarray, " n"]
    torque: Float[np.ndarray, "n 3"]
    wanted_rate: Float[np.ndarray, "n 3"]


def fly(specs: Sequence[RigidBodyFlightSpec], met: Sequence[Surroundings]) -> Iterator[Flown]:
    """Fly specifications that agree in everything that `alike` compares, side by side.

    Parameters
    ----------
    specs : sequence of RigidBodyFlightSpec
        The flights. Performs no checks.
    met : sequence of Surroundings
        What each meets.

    Yields
    ------
    Flown
        Of each, in order, with arrays of its own.
    """
    series = _alone(specs[0], met[0]) if len(specs) == 1 else _together(specs, met)
    for flight in range(len(specs)):
        yield Flown(*(np.ascontiguousarray(part[..., flight]) for part in series))


def alike(spec: RigidBodyFlightSpec) -> tuple[object, ...]:
    """What flights that are simulated side by side have in common."""
    c = spec.controller
    loops = (c.rate_hz, c.attitude_hz, c.height_hz)
    return (spec.rate_hz, spec.count, spec.vehicle.rotors.count, loops, spec.integrator)


#: Steps for which what is read is laid out at a time.
CHUNK = 500

#: Series that a loop reads, one entry for each step: components of one row.
_Rows: TypeAlias = Sequence[Components] | Float[np.ndarray, "n _ flights"]
#: Body, rotor speeds, commands, thrust, torques and wanted rates of a step.
_Moment: TypeAlias = tuple[Body, list[Value], list[Value], Value, Triple, Triple]


@dataclass(frozen=True, slots=True)
class _Read:
    """What the loop reads at each step, in components."""

    height: _Rows
    attitude: _Rows
    injected: _Rows
    wind: _Rows
    disturbance: _Rows
    rate_error: _Rows
    attitude_error: _Rows
    velocity_error: _Rows
    position_error: _Rows


@dataclass(frozen=True, slots=True)
class _Senses:
    """The sensors that the controller reads."""

    rate: LiveFilter
    attitude: LiveFilter
    velocity: LiveFilter
    position: LiveFilter

    def seen(self, body: Body, read: _Read, row: int) -> tuple[Triple, list[Value], list[Value], list[Value]]:
        """Rates, attitude, velocity and position as the controller gets them."""
        p, q, r = self.rate.read(_sum(body[10:13], read.rate_error[row]))
        return (
            (p, q, r),
            self.attitude.read(turned(body[6:10], *read.attitude_error[row])),
            self.velocity.read(_sum(body[3:6], read.velocity_error[row])),
            self.position.read(_sum(body[0:3], read.position_error[row])),
        )


@dataclass(frozen=True, slots=True)
class _Loop:
    """Everything that a closed loop is made of."""

    specs: Sequence[RigidBodyFlightSpec]
    read: Callable[[int, int], _Read]
    senses: _Senses
    cascade: Cascade
    mixer: Mixer
    line: DelayLine
    stepper: Stepper
    body: Body
    speeds: list[Value]

    def run(self) -> Iterator[list[_Moment]]:
        """Fly to the end; some steps at a time, so that what is read and what happened takes little space."""
        first, cascade = self.specs[0], self.cascade
        control = first.controller
        every, attitude_every, height_every = (
            round(first.rate_hz / hz) for hz in (control.rate_hz, control.attitude_hz, control.height_hz)
        )
        holds = any(spec.controller.hold for spec in self.specs)
        body, speeds = self.body, self.speeds
        thrust = ZERO
        rates = torque = (ZERO, ZERO, ZERO)
        command = speeds
        for k in range(first.count):
            now = k % CHUNK
            if now == 0:
                read = self.read(k, k + CHUNK)
                moments: list[_Moment] = []
            seen_rates, attitude, velocity, position = self.senses.seen(body, read, now)
            if k % height_every == 0:
                _, x, y, _ = attitude
                cosine = 1.0 - 2.0 * (x * x + y * y)
                z, climb, acceleration = read.height[now]
                thrust = cascade.thrust((z, climb, acceleration), position[2], velocity[2], cosine)
            if k % attitude_every == 0:
                wanted = read.attitude[now]
                if holds:
                    wanted = cascade.holding(wanted, position[:2], velocity[:2])
                rates = cascade.rates(wanted, attitude)
            if k % every == 0:
                roll, pitch, yaw = _sum(cascade.torques(rates, seen_rates), read.injected[now])
                torque = (roll, pitch, yaw)
                command = self.mixer.commands(thrust, torque)
            moments.append((body, speeds, command, thrust, torque, rates))
            (wx, wy, wz), (mx, my, mz) = read.wind[now], read.disturbance[now]
            held = HeldInputs(self.line.pass_on(command), (wx, wy, wz), (mx, my, mz))
            body, speeds = self.stepper.step(body, speeds, held)
            if now == CHUNK - 1 or k == first.count - 1:
                yield moments


def _collected(loop: _Loop) -> list[Float[np.ndarray, "n ..."]]:
    """Every part of a moment as one array, whose last axis is the flight."""
    flights, series, start = len(loop.specs), [], 0
    for moments in loop.run():
        for number, part in enumerate(zip(*moments, strict=True)):
            values = np.array(part)
            # Of rotors, flights side by side have a list of one array.
            values = values.reshape(len(moments), *_SHAPES[number], flights)
            if start == 0:
                series.append(np.empty((loop.specs[0].count, *values.shape[1:])))
            series[number][start : start + len(moments)] = values
        start += len(moments)
    return series


#: Shapes of the parts of a moment, of one flight.
_SHAPES: tuple[tuple[int, ...], ...] = ((13,), (-1,), (-1,), (), (3,), (3,))


def _alone(spec: RigidBodyFlightSpec, met: Surroundings) -> list[Float[np.ndarray, "n ..."]]:
    """One flight, in floats."""
    vehicle, sensors, step_s = spec.vehicle, spec.sensors, spec.step_s
    hover: list[Value] = [vehicle.hover_speed] * vehicle.rotors.count
    loop = _Loop(
        specs=[spec],
        read=lambda first, last: _Read(
            *(getattr(met, name)[first:last].tolist() for name in _Read.__slots__)
        ),
        senses=_Senses(*(_filter_of(getattr(sensors, name), step_s) for name in SENSES)),
        cascade=_cascade(spec, gains_of(spec.controller, vehicle, sensors.angular_rate.lateness_s)),
        mixer=mixer_of(vehicle),
        line=DelayLine(round(vehicle.rotors.delay / step_s), hover),
        stepper=spec.integrator.stepper(coefficients_of(vehicle), step_s),
        body=_start(met).tolist(),
        speeds=hover,
    )
    return _collected(loop)


def _together(
    specs: Sequence[RigidBodyFlightSpec], met: Sequence[Surroundings]
) -> list[Float[np.ndarray, "n ..."]]:
    """Several flights, in arrays whose last axis is the flight."""
    first, vehicles = specs[0], [spec.vehicle for spec in specs]
    step_s = first.step_s
    hover = np.tile([vehicle.hover_speed for vehicle in vehicles], (first.vehicle.rotors.count, 1))
    gains = [gains_of(spec.controller, spec.vehicle, spec.sensors.angular_rate.lateness_s) for spec in specs]
    loop = _Loop(
        specs=specs,
        read=lambda start, stop: _Read(
            *(np.stack([getattr(one, name)[start:stop] for one in met], axis=-1) for name in _Read.__slots__)
        ),
        senses=_Senses(
            *(_filters_of([getattr(spec.sensors, name) for spec in specs], step_s) for name in SENSES)
        ),
        cascade=_cascade(first, gains_side_by_side(gains)),
        mixer=mixers_side_by_side(vehicles),
        line=DelayLine(np.array([round(vehicle.rotors.delay / step_s) for vehicle in vehicles]), [hover]),
        stepper=first.integrator.stepper(side_by_side(vehicles), step_s),
        body=np.stack([_start(one) for one in met], axis=1),
        speeds=[hover],
    )
    return _collected(loop)


#: Sensors that the controller reads, in the order of `_Senses`.
SENSES = ("angular_rate", "attitude", "velocity", "position")


def _cascade(spec: RigidBodyFlightSpec, gains: Gains) -> Cascade:
    return Cascade(gains, 1.0 / spec.controller.rate_hz, 1.0 / spec.controller.height_hz)


def _start(met: Surroundings) -> Float[np.ndarray, " 13"]:
    """On the reference, with the wind, at rest about its axes."""
    height, climb, _ = met.height[0]
    return np.array([0.0, 0.0, height, *met.wind[0, :2], climb, *met.attitude[0], 0.0, 0.0, 0.0])


def _filter_of(sensor: Sensor, step_s: float) -> LiveFilter:
    parts = _coefficients(sensor, step_s) if sensor.cutoff_hz else None
    return LiveFilter(parts, round(sensor.delay_s / step_s))


def _filters_of(sensors: Sequence[Sensor], step_s: float) -> LiveFilter:
    late = np.array([round(sensor.delay_s / step_s) for sensor in sensors])
    if not any(sensor.cutoff_hz for sensor in sensors):
        return LiveFilter(None, late)
    return LiveFilter(stacked([_coefficients(sensor, step_s) for sensor in sensors]), late)


def _coefficients(sensor: Sensor, step_s: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Numerator, and denominator after its 1; of a sensor without a filter what leaves all as it is."""
    if not sensor.cutoff_hz:
        return (1.0, 0.0, 0.0), (0.0, 0.0)
    b, a = low_pass(sensor.cutoff_hz, step_s)
    return tuple(b.tolist()), tuple(a[1:].tolist())


def _sum(first: Components, second: Components) -> list[Value]:
    return [a + b for a, b in zip(first, second, strict=True)]
