"""Channels of the vertical motion: velocity, specific force, tilt, and what drives the rotors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from eivor.errors import InputError
from eivor.flights.options import FlightOptions
from eivor.flights.prepared import PreparedFlight
from eivor.flights.references import ReferenceSource
from eivor.flights.selection import InputFamily, Limit, Selection, chosen_input
from eivor.motions.vertical.attitude import vertical_row
from eivor.motions.vertical.model import GRAVITY
from eivor.shapes import Float
from eivor.signals.recording import ROTARY_WING, Channel, Finding, Recording

#: Families of channels that may drive the model, in order of preference; telemetry of a few hertz is none
#: where commands are logged.
INPUTS = (
    InputFamily("rotor_command", input_map="square", numbered=True),
    InputFamily("rotor_speed", measured=True, input_map="square", numbered=True, least_rate_hz=19.5),
    InputFamily("input"),
    InputFamily("actuator_output", numbered=True),
)
#: Measured states that tell the lag where commands are the input.
TELEMETRY = ("rotor_speed",)
#: What the vehicle was asked to do: what an identification mode adds to the throttle, the setpoints of a
#: trajectory, and the pilot's stick. The velocity
#: setpoint that a position loop computes answers the vehicle. In modes without height control nothing feeds
#: back to the thrust, which is its own instrument: the stick is what it was made of, logged more slowly.
REFERENCES = (
    ReferenceSource("input", open_loop="input_open_loop"),
    ReferenceSource("injected_throttle"),
    ReferenceSource("reference_position_z"),
    ReferenceSource("reference_velocity_z"),
    ReferenceSource("reference_acceleration_z"),
    ReferenceSource("pilot_throttle", in_control="pilot_in_control"),
    ReferenceSource("feedback_reference_velocity_z"),
)
#: Band of spectral rows [Hz]; the upper end is lower when velocity is logged near 10 Hz.
BAND_HZ = (0.04, 5.0)
SLOW_BAND_HZ = (0.04, 4.0)
SLOW_VELOCITY_HZ = 15.0
#: The logged acceleration is preferred to the accelerometer and attitude unless it is slower than this.
SLOW_ACCELERATION_HZ = 20.0


def selected(log: Recording, options: FlightOptions) -> Selection:
    """Channels of a log by role, tilt limited.

    Raises
    ------
    MissingChannelError, UsageError
        When velocity or input are not in the log.
    InputError
        When the log says that it is of a vehicle without rotors.
    """
    if log.vehicle not in ("", ROTARY_WING):
        raise InputError(
            "a log of a vehicle that hovers on its rotors",
            f"{log.name}, which says that it is of a {log.vehicle}",
            "The vertical motion is that of multirotors; name another motion with --model if you have one.",
        )
    family, commands = chosen_input(
        log, INPUTS, options.input, remedy="Log the thrust setpoint or the rotor commands at 50 Hz or more"
    )
    velocity = log.channel("velocity_z")
    force, tilt, findings = _force_and_tilt(log)
    return Selection(
        family,
        commands,
        states={"velocity": velocity},
        responses={"acceleration": force},
        conditions=() if tilt is None else (tilt,),
        constants={"cos_tilt": 1.0},
        limits=(Limit("cos_tilt", low=float(np.cos(np.deg2rad(options.max_tilt_deg)))),),
        band_hz=SLOW_BAND_HZ if velocity.rate_hz < SLOW_VELOCITY_HZ else BAND_HZ,
        findings=tuple(findings),
    )


def open_loop_findings(flights: tuple[PreparedFlight, ...]) -> list[Finding]:
    """Say that the thrust command is its own instrument, where it is."""
    openly = {source.channel for source in REFERENCES if source.open_loop}
    return [
        Finding(
            "open_loop_input",
            f"No loop acts on the {reference} in this mode of flight: it is its own instrument.",
        )
        for reference in dict.fromkeys(r.name for f in flights for r in f.references if r.usable)
        if reference in openly
    ]


def _force_and_tilt(log: Recording) -> tuple[Channel | None, Channel | None, list[Finding]]:
    """World-up specific force and cosine of tilt, each on a clock of its own."""
    attitude = [log.channels.get(f"attitude_{axis}") for axis in "wxyz"]
    present = [channel for channel in attitude if channel is not None]
    row = vertical_row(present) if len(present) == 4 else None
    findings: list[Finding] = []
    tilt = _told(log, "cos_tilt", findings)
    if tilt is None and row is not None:
        tilt = Channel("cos_tilt", row[0], row[1][:, 2], "", "attitude quaternion")
    if tilt is None:
        findings.append(
            Finding("no_attitude", "No attitude is logged: the vehicle is taken as level throughout.")
        )
    force = _told(log, "specific_force_z", findings)
    logged = _told(log, "acceleration_z", findings)
    if force is None and logged is not None:
        force = replace(logged, name="specific_force_z", values=logged.values + GRAVITY)
    body = [log.channels.get(f"specific_force_body_{axis}") for axis in "xyz"]
    if force is None or force.rate_hz < SLOW_ACCELERATION_HZ:
        rotated = _rotated(body, row)
        if rotated is not None and (force is None or rotated.rate_hz > force.rate_hz):
            force = rotated
    if force is None:
        why = (
            "Without an attitude the accelerometer cannot be turned to the world's axes"
            if row is None and any(body)
            else "No accelerometer is logged"
        )
        findings.append(Finding("no_accelerometer", f"{why}: only the velocity's derivative is used."))
    return force, tilt, findings


def _told(log: Recording, name: str, findings: list[Finding]) -> Channel | None:
    """Channel of that name if it has two numbers or more; a finding when it is there and has not."""
    channel = log.channels.get(name)
    if channel is None or np.isfinite(channel.values).sum() >= 2:
        return channel
    findings.append(Finding("empty_channel", f"The channel {name} is empty; the flight is used without it."))
    return None


def _rotated(
    body: list[Channel | None], row: tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]] | None
) -> Channel | None:
    """World-up specific force from the body's and the attitude, on the accelerometer's clock."""
    axes = [channel for channel in body if channel is not None]
    if len(axes) != 3 or row is None or row[0].size == 0:
        return None
    time = axes[2].time_s
    if not all(channel.time_s.size for channel in axes):
        return None
    columns = [
        channel.values
        if np.array_equal(channel.time_s, time)
        else np.interp(time, channel.time_s, channel.values)
        for channel in axes
    ]
    up = [np.interp(time, row[0], row[1][:, axis]) for axis in range(3)]
    values = sum((u * column for u, column in zip(up, columns, strict=True)), np.zeros(time.size))
    inside = (time >= row[0][0]) & (time <= row[0][-1])
    return Channel("specific_force_z", time[inside], values[inside], "m/s^2", "accelerometer and attitude")
