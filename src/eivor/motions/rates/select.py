"""Channels of the turning motion: rates, torque setpoints, and what tells when the vehicle flies."""

from __future__ import annotations

import numpy as np

from eivor.errors import InputError, MissingChannelError
from eivor.flights.airborne import Active, airborne_by_log
from eivor.flights.grid import Grid, on_grid
from eivor.flights.options import FlightOptions
from eivor.flights.selection import InputFamily, Selection, chosen_input
from eivor.motions.rates.axes import AXES, PITCH, ROLL, TORQUE, Axis
from eivor.shapes import Float
from eivor.signals.recording import ROTARY_WING, Channel, Finding, Recording

INPUTS = (InputFamily(TORQUE, numbered=False),)
REFERENCES = tuple(source for axis in AXES for source in axis.references)
#: Band of spectral rows [Hz], of rates that are logged fast; else up to this share of their rate.
BAND_HZ = (0.3, 8.0)
BAND_SHARE = 0.2
#: Steps of the grid [s], and from which rate of the gyroscope on the fine one is taken [Hz].
FINE_STEP_S, STEP_S, FINE_FROM_HZ = 0.005, 0.010, 95.0
#: What tells that a vehicle flies where no land detector is logged, by its mean.
LEVELS = ("input", "rotor_command", "rotor_speed")
#: No vehicle turns so fast; values beyond are in degrees a second [rad/s].
FASTEST_RATE = 40.0


def axes_of(log: Recording) -> tuple[Axis, ...]:
    """Axes whose setpoint and rate are both in a log."""
    return tuple(axis for axis in AXES if axis.torque in log.channels and axis.rate in log.channels)


def selected(log: Recording, options: FlightOptions) -> Selection:
    """Channels of a log by role.

    Raises
    ------
    MissingChannelError
        When torque setpoints or rates of roll and pitch are not in the log.
    InputError
        When the log says that it is of a vehicle without rotors, or rates are in degrees.
    """
    if log.vehicle not in ("", ROTARY_WING):
        raise InputError(
            "a log of a multirotor",
            f"{log.name}, which says that it is of a {log.vehicle}",
            "Rotors turn it by their thrust; name another motion with --model if you have one.",
        )
    family, _ = chosen_input(log, INPUTS, options.input, remedy="Log the torque setpoints at 50 Hz or more")
    for axis in (ROLL, PITCH):
        if axis.torque not in log.channels:
            raise MissingChannelError(
                f"{axis.torque} in {log.name}",
                "a log without it",
                "Log the torque setpoints of roll and pitch.",
            )
        log.channel(axis.rate)
    axes = axes_of(log)
    rates = {axis.name: log.channel(axis.rate) for axis in axes}
    for rate in rates.values():
        refuse_degrees(rate, log)
    slowest = min(rate.rate_hz for rate in rates.values())
    return Selection(
        family,
        tuple(log.channel(axis.torque) for axis in axes),
        states=rates,
        responses={},
        band_hz=(BAND_HZ[0], min(BAND_HZ[1], BAND_SHARE * slowest)),
        findings=(_NO_YAW,) if len(axes) < len(AXES) else (),
        issued_within_s=float(np.median(np.diff(log.channel(ROLL.rate).time_s))),  # once a rate, or oftener
        step_s=FINE_STEP_S if slowest >= FINE_FROM_HZ else STEP_S,
        spread_alike=True,
    )


_NO_YAW = Finding(
    "no_yaw", "Torque setpoint or rate of yaw is not logged: roll and pitch are looked at alone."
)


def refuse_degrees(rate: Channel, log: Recording) -> None:
    """Refuse a rate that is faster than any vehicle turns.

    Raises
    ------
    InputError
        When it is.
    """
    fastest = float(np.nanmax(np.abs(rate.values), initial=0.0))
    usual = float(np.nanquantile(np.abs(rate.values), 0.99)) if rate.values.size else 0.0
    if usual > FASTEST_RATE:
        raise InputError(
            f"body rates in rad/s in {log.name}",
            f"{rate.name} up to {fastest:.3g}, which look like degrees",
            'State the unit in a channel map (unit = "deg/s").',
        )


def active(log: Recording, grid: Grid) -> Active:
    """Samples in the air: torque setpoints do not tell, so by the land detector, or by thrust or rotors."""
    level: Float[np.ndarray, " n"] | None = None
    for family in LEVELS:
        members = log.family(family)
        if level is None and members:
            level = np.mean([on_grid(one, grid)[0] for one in members], axis=0)
    if level is None and "landed" not in log.channels:
        return Active(
            np.ones(grid.count, dtype=np.bool_), "nothing: neither a land detector nor thrust is logged"
        )
    return airborne_by_log(log, grid, np.ones(grid.count) if level is None else level)
