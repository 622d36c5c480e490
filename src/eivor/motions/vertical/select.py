"""Selection of channels for the vertical motion, and its words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import msgspec
import numpy as np

from eivor.errors import ShapeError
from eivor.estimation.estimate import Estimate
from eivor.flights.motion import motion_tables
from eivor.flights.options import FlightOptions
from eivor.flights.prepared import PreparedFlight, Selection, check_vehicle, chosen_input
from eivor.flights.quantity import QuantityTable
from eivor.flights.verdict import SLOW_COMMAND_HZ
from eivor.motions.vertical.model import CurveFamily
from eivor.signals.recording import GRAVITY, Channel, Finding, Recording
from eivor.tools import Float


def vertical_row(attitude: list[Channel]) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
    """Stamps [s], and the last row of the rotation from body to world at each."""
    if any(not np.array_equal(channel.time_s, attitude[0].time_s) for channel in attitude[1:]):
        received = f"{', '.join(f'{channel.time_s.size} stamps of {channel.name}' for channel in attitude)}"
        remedy = "Bring them to the same stamps first: quaternions are not interpolated part by part."
        raise ShapeError("the four parts of an attitude on one clock", received, remedy)
    w, x, y, z = (channel.values for channel in attitude)
    square = w**2 + x**2 + y**2 + z**2
    square = np.where(square > 0.0, square, np.nan)
    row = np.stack([2.0 * (x * z - w * y), 2.0 * (y * z + w * x), square - 2.0 * (x**2 + y**2)], axis=1)
    return attitude[0].time_s, row / square[:, None]


class FittedCurve(msgspec.Struct, frozen=True):
    """A map that was found out, and estimates with maps to either side."""

    family: CurveFamily
    value: float
    bias_std: float  # Standard deviation of the accelerometer's bias that was assumed, [m/s^2]
    below: tuple[float, Estimate]
    above: tuple[float, Estimate]


TABLES = motion_tables("eivor.motions.vertical")
QUANTITIES = QuantityTable(TABLES.quantities)
INPUTS = TABLES.channels.inputs
#: Band of spectral rows [Hz]; the upper end is lower when velocity is logged near 10 Hz.
VERTICAL_BAND_HZ = (0.04, 5.0)
SLOW_BAND_HZ = (0.04, 4.0)
SLOW_VELOCITY_HZ = 15.0
#: The logged acceleration is preferred to the accelerometer and attitude unless it is slower than this.
SLOW_ACCELERATION_HZ = 20.0


def selected(log: Recording, options: FlightOptions) -> Selection:
    """Channels of a log by role, tilt limited."""
    check_vehicle(log, options)
    family, commands = chosen_input(
        log, INPUTS, options.input, remedy="Log the thrust setpoint or the rotor commands at 50 Hz or more"
    )
    force, tilt, findings = _force_and_tilt(log)
    if "velocity_z" not in log.channels and "position_z" in log.channels:
        log = replace(log, channels={**log.channels, "velocity_z": slope(log.channel("position_z"))})
        sloped = "Velocity is not logged: it is the slope of the height between its stamps."
        findings.append(Finding("velocity_by_position", sloped))
    velocity = log.channel("velocity_z")
    return Selection(
        family,
        commands,
        states={"velocity": velocity},
        responses={"acceleration": force},
        conditions=() if tilt is None else (tilt,),
        constants={"cos_tilt": 1.0},
        at_least={"cos_tilt": float(np.cos(np.deg2rad(options.max_tilt_deg)))},
        band_hz=SLOW_BAND_HZ if velocity.rate_hz < SLOW_VELOCITY_HZ else VERTICAL_BAND_HZ,
        # what was measured is spread over time as slow commands are by the line between their stamps
        matched_interpolation_filter=min(command.rate_hz for command in commands) < SLOW_COMMAND_HZ,
        findings=tuple(findings),
        log=log,
    )


def slope(height: Channel) -> Channel:
    """Velocity between the stamps of a height, in the middle of each step."""
    known = np.isfinite(height.values)
    time, values = height.time_s[known], height.values[known]
    middle, rate = time[:-1] + 0.5 * np.diff(time), np.diff(values) / np.diff(time)
    return Channel(
        "velocity_z",
        middle,
        rate,
        "m/s",
        f"slope of {height.name}",
        estimated=height.estimated,
        delay_s=height.delay_s,
    )


def open_loop_findings(flights: tuple[PreparedFlight, ...]) -> list[Finding]:
    """Say that the thrust command is its own instrument, where it is."""
    openly = {source.channel for source in TABLES.channels.references if source.open_loop}
    usable = dict.fromkeys(name for flight in flights for name in flight.usable_references)
    words = "in this mode of flight: it is its own instrument."
    openly_used = [name for name in usable if name in openly]
    return [Finding("open_loop_input", f"No loop acts on the {name} {words}") for name in openly_used]


def _force_and_tilt(log: Recording) -> tuple[Channel | None, Channel | None, list[Finding]]:
    """World-up specific force and cosine of tilt, each on a clock of its own."""
    attitude = [log.channels.get(f"attitude_{axis}") for axis in "wxyz"]
    present = [channel for channel in attitude if channel is not None]
    row = vertical_row(present) if len(present) == 4 else None
    findings: list[Finding] = []
    tilt = _usable_channel(log, "cos_tilt", findings)
    if tilt is None and row is not None:
        tilt = Channel("cos_tilt", row[0], row[1][:, 2], "", "attitude quaternion")
    if tilt is None:
        level = "No attitude is logged: the vehicle is taken as level throughout."
        findings.append(Finding("no_attitude", level))
    force = _usable_channel(log, "specific_force_z", findings)
    logged = _usable_channel(log, "acceleration_z", findings)
    if force is None and logged is not None:
        force = replace(logged, name="specific_force_z", values=logged.values + GRAVITY)
    body = [log.channels.get(f"specific_force_body_{axis}") for axis in "xyz"]
    if force is None or force.rate_hz < SLOW_ACCELERATION_HZ:
        turned = rotated(body, row)
        if turned is not None and (force is None or turned.rate_hz > force.rate_hz):
            force = turned
    limited = [channel for channel in (force, *body) if channel is not None and channel.limited.any()]
    if limited:
        stops = f"{limited[0].at_limit()}: only the velocity's derivative is used."
        findings.append(Finding("clipped_accelerometer", stops))
        return None, tilt, findings
    if force is None:
        why = "No accelerometer is logged"
        if row is None and any(body):
            why = "Without an attitude the accelerometer cannot be turned to the world's axes"
        findings.append(Finding("no_accelerometer", f"{why}: only the velocity's derivative is used."))
    return force, tilt, findings


def _usable_channel(log: Recording, name: str, findings: list[Finding]) -> Channel | None:
    """Channel of that name if it has two numbers or more; a finding when it is there and has not."""
    channel = log.channels.get(name)
    if channel is None or np.isfinite(channel.values).sum() >= 2:
        return channel
    findings.append(Finding("empty_channel", f"The channel {name} is empty; the flight is used without it."))
    return None


def rotated(
    body: Sequence[Channel | None], row: tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]] | None
) -> Channel | None:
    """World-up specific force from the body's and the attitude, on the accelerometer's clock."""
    axes = [channel for channel in body if channel is not None and channel.time_s.size]
    if len(axes) != 3 or row is None or row[0].size == 0:
        return None
    time, values = axes[2].time_s, np.zeros(axes[2].time_s.size)
    for channel, upward in zip(axes, row[1].T, strict=True):
        same = np.array_equal(channel.time_s, time)
        column = channel.values if same else np.interp(time, channel.time_s, channel.values)
        values += np.interp(time, row[0], upward) * column
    inside = (time >= row[0][0]) & (time <= row[0][-1])
    return Channel("specific_force_z", time[inside], values[inside], "m/s^2", "accelerometer and attitude")
