"""The flight card: what to fly and what to log so that the next flight can be identified."""

from __future__ import annotations

from dataclasses import dataclass

from eivor.errors import UsageError
from eivor.flights.prepare import INPUTS
from eivor.flights.result import FlightEstimate
from eivor.inference.verdict import Status
from eivor.logs import logging_advice
from eivor.signals.recording import Recording

_MANOEUVRES = (
    "Calm air, at least 3 m above the ground, position (or altitude) mode, tilt below 20°.",
    "60 s of height steps of 2 m, up and down, a new one every 3 to 6 s at uneven times; or a sweep of the "
    "height setpoint of ±1 m from 0.1 to 0.5 Hz. Climb and descend at about 2 m/s.",
    "Fly it two or three times and give all the logs: eivor identify LOG1 LOG2 LOG3 pools them.",
)
_SETPOINTS = {
    "ulog": (
        "trajectory_setpoint or vehicle_local_position_setpoint (the height reference), "
        "vehicle_thrust_setpoint (the command), manual_control_setpoint (the stick, when a pilot flies).",
    ),
}
_TABLE_SETPOINTS = (
    "reference_position_z (the height reference), rotor_command_1.. or input (the command), pilot_throttle "
    "(the stick, when a pilot flies).",
)


@dataclass(frozen=True, slots=True)
class CardSection:
    """One part of the card.

    Parameters
    ----------
    title : str
        A few words.
    sentences : tuple of str
        What to do.
    """

    title: str
    sentences: tuple[str, ...]


def flight_card(result: FlightEstimate) -> tuple[CardSection, ...]:
    """What to fly and log instead; empty when the flight is identified."""
    if result.verdict.status is Status.IDENTIFIED:
        return ()
    log_format = result.prepared[0].recording.format
    return (
        CardSection("Fly", _MANOEUVRES),
        CardSection("Log", _general_advice(log_format)),
        CardSection("Setpoints", _SETPOINTS.get(log_format, _TABLE_SETPOINTS)),
    )


def missing_channels(recording: Recording) -> tuple[str, ...]:
    """Channels without which nothing can be identified, and that the log lacks: velocity and an input."""
    missing = [] if "velocity_z" in recording.channels else ["velocity_z"]
    if not any(recording.family(family) for family in INPUTS):
        missing.append("input")
    return tuple(missing)


def logging_advice_for(recording: Recording, channel: str) -> tuple[str, ...]:
    """What to log so that `channel` is there; empty for logs whose format has no advice."""
    try:
        return logging_advice(recording.format, channel)
    except UsageError:
        return ()


def _general_advice(log_format: str) -> tuple[str, ...]:
    try:
        return logging_advice(log_format)
    except UsageError:
        return logging_advice("csv")
