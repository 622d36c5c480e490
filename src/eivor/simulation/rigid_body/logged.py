"""What a log of a flight holds: each sensor's channels and each group of setpoints on stamps of their own.

| channels | unit | how |
|---|---|---|
| `angular_rate_*`, `specific_force_body_*`, `velocity_*`, `position_*`, `attitude_*` | SI | measured |
| `rotor_speed_*` | rad/s | measured, when there is such a sensor |
| `rotor_command_*` | rad/s | held |
| `input`, `torque_setpoint_*` | normalised | held; torques as the mixer got them, what is injected included |
| `injected_torque_*` | normalised | held; only where something is injected |
| `feedback_reference_angular_rate_*` | rad/s | held; what the attitude loop asked for |
| `reference_position_z`, `reference_velocity_z`, `reference_acceleration_z` | SI | held |
| `reference_roll`, `_pitch`, `_yaw` | rad | held; asked for from outside, without what holds the place |
"""

from __future__ import annotations

from collections.abc import Mapping
from fnmatch import fnmatch

import numpy as np

from eivor.shapes import Float
from eivor.signals.attitude import roll_pitch_yaw
from eivor.signals.canonical import held_by_default, unit_of
from eivor.signals.recording import Channel, Frame, Recording
from eivor.simulation.rigid_body.loop import Flown
from eivor.simulation.rigid_body.sensors import Sensor
from eivor.simulation.rigid_body.spec import RigidBodyFlightSpec
from eivor.simulation.rigid_body.surroundings import Surroundings, stamping_stream

#: Source of the channels.
SIMULATOR = "rigid body"


def recording_of(
    spec: RigidBodyFlightSpec, met: Surroundings, flown: Flown, force: Float[np.ndarray, "n 3"]
) -> Recording:
    """Log of a flight.

    Parameters
    ----------
    spec : RigidBodyFlightSpec
        The flight.
    met : Surroundings
        What it met.
    flown : Flown
        What happened.
    force : ndarray, shape (n, 3)
        True specific force on the body's axes [m/s^2].
    """
    rng = stamping_stream(spec)
    channels: dict[str, Channel] = {}
    for sensor, series in _measured(spec, met, flown, force):
        rows = sensor.rows(spec.count, spec.step_s)
        _add(channels, spec, sensor.stamps(rows, spec.step_s, rng), rows, series)
    for rate_hz, series in _told(spec, met, flown):
        rows = Sensor(rate_hz=rate_hz).rows(spec.count, spec.step_s)
        _add(channels, spec, rows * spec.step_s, rows, series)
    return Recording(
        name=f"rigid body, {spec.trajectory}, seed {spec.seed}",
        format="simulation",
        channels=channels,
        frame=Frame.Z_UP,
        input_map=_map_of(spec),
    )


def _map_of(spec: RigidBodyFlightSpec) -> str:
    """Square, where the rotors' thrust goes with it."""
    return "" if spec.vehicle.rotors.thrust_linear else "square"


def _add(
    channels: dict[str, Channel],
    spec: RigidBodyFlightSpec,
    time_s: Float[np.ndarray, " rows"],
    rows: np.ndarray,
    series: Mapping[str, Float[np.ndarray, " n"]],
) -> None:
    """Add the rows of some series under their names, those apart that are left out."""
    for name, values in series.items():
        if not any(fnmatch(name, left_out) for left_out in spec.logged.left_out):
            channels[name] = Channel(
                name, time_s, values[rows], unit_of(name), source=SIMULATOR, held=held_by_default(name)
            )


def _measured(
    spec: RigidBodyFlightSpec, met: Surroundings, flown: Flown, force: Float[np.ndarray, "n 3"]
) -> list[tuple[Sensor, dict[str, Float[np.ndarray, " n"]]]]:
    """Each sensor with its readings at every step."""
    sensors, step_s, body = spec.sensors, spec.step_s, flown.body
    attitude = turned_by(body[:, 6:10], met.attitude_error)

    def logged(sensor: Sensor, raw: Float[np.ndarray, "n axes"]) -> Float[np.ndarray, "n axes"]:
        return sensor.averages(sensor.readings(raw, step_s), step_s)

    velocity = logged(sensors.velocity, body[:, 3:6] + met.velocity_error)
    position = logged(sensors.position, body[:, 0:3] + met.position_error)
    rates = logged(sensors.angular_rate, body[:, 10:13] + met.rate_error)
    forces = logged(sensors.specific_force, force + met.force_error)
    measured = [
        (sensors.angular_rate, _named("angular_rate", "xyz", rates)),
        (sensors.specific_force, _named("specific_force_body", "xyz", forces)),
        (sensors.velocity, _named("velocity", "xyz", velocity)),
        (sensors.position, _named("position", "xyz", position)),
        (sensors.attitude, _named("attitude", "wxyz", sensors.attitude.readings(attitude, step_s))),
    ]
    if sensors.rotor_speed is not None:
        speeds = logged(sensors.rotor_speed, flown.rotor_speed + met.speed_error)
        measured.append((sensors.rotor_speed, _numbered("rotor_speed", speeds)))
    return measured


def _told(
    spec: RigidBodyFlightSpec, met: Surroundings, flown: Flown
) -> list[tuple[float, dict[str, Float[np.ndarray, " n"]]]]:
    """Commands, setpoints and references, with the rate of each group."""
    logged = spec.logged
    setpoints = {
        "input": flown.thrust,
        **_named("torque_setpoint", "xyz", flown.torque),
        **_named("feedback_reference_angular_rate", "xyz", flown.wanted_rate),
    }
    if met.injected.any():
        setpoints |= _named("injected_torque", "xyz", met.injected)
    height = ("reference_position_z", "reference_velocity_z", "reference_acceleration_z")
    asked = (*height, "reference_roll", "reference_pitch", "reference_yaw")
    series = [*met.height.T, *roll_pitch_yaw(met.attitude.T)]
    return [
        (logged.rotor_command_hz, _numbered("rotor_command", flown.rotor_command)),
        (logged.setpoint_hz, setpoints),
        (logged.reference_hz, dict(zip(asked, series, strict=True))),
    ]


def turned_by(
    attitude: Float[np.ndarray, "n 4"], angles: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 4"]:
    """Attitudes turned about their own axes by small angles."""
    from eivor.motions.rigid_body.dynamics import turned

    return np.column_stack(turned(list(attitude.T), *angles.T))


def _named(stem: str, parts: str, series: Float[np.ndarray, "n parts"]) -> dict[str, Float[np.ndarray, " n"]]:
    return {f"{stem}_{part}": series[:, i] for i, part in enumerate(parts)}


def _numbered(stem: str, series: Float[np.ndarray, "n rotors"]) -> dict[str, Float[np.ndarray, " n"]]:
    return {f"{stem}_{i + 1}": series[:, i] for i in range(series.shape[1])}
