"""What optional terms need of options and logs, and what is missing for them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from eivor.errors import InputError, MissingChannelError, UsageError
from eivor.flights.options import FlightOptions
from eivor.flights.prepared import PreparedFlight
from eivor.motions.vertical.flights import VerticalFlight
from eivor.motions.vertical.surroundings import VOLTAGE, ground, height_logged, height_over_ground, voltage
from eivor.motions.vertical.terms import GroundEffect, VoltageTerm


def check_terms(options: FlightOptions, radius: float | None = None) -> None:
    """Refuse a term near the ground without the rotors' radius.

    Parameters
    ----------
    options : FlightOptions
        With the terms, and perhaps the radius.
    radius : float, optional
        Of the vehicle that was named [m].

    Raises
    ------
    UsageError
        With what to give.
    """
    if GroundEffect.word in options.terms and options.rotor_radius is None and radius is None:
        raise UsageError(
            f"the radius of a rotor with the term {GroundEffect.word}, which counts heights in radii",
            "none",
            "Give it in metres, half a propeller's diameter: --rotor-radius 0.12, or a vehicle file with it.",
        )


def check_flights(flights: Sequence[PreparedFlight], options: FlightOptions) -> None:
    """Refuse a term that a flight does not log enough for.

    Raises
    ------
    MissingChannelError
        For a channel that is absent.
    InputError
        When a log does not tell where the ground is, or its input is no command.
    """
    for flight in flights:
        if not flight.runs:
            continue
        name = flight.recording.name
        if GroundEffect.word in options.terms:
            _check_ground(flight, name)
        if VoltageTerm.word in options.terms:
            _check_voltage(flight, name)


def _check_ground(flight: PreparedFlight, name: str) -> None:
    if height_logged(flight) is None:
        raise MissingChannelError(
            f"the channel position_z for the term {GroundEffect.word}",
            f"{name}, which has none",
            "Log the height, or leave the term out.",
        )
    if ground(flight) is None:
        raise InputError(
            f"a log that begins or ends on the ground, whose height the term {GroundEffect.word} needs",
            f"{name}, whose height is never below that of the flight",
            "Log from before take-off or until after landing, or leave the term out.",
        )


def _check_voltage(flight: PreparedFlight, name: str) -> None:
    if voltage(flight) is None:
        raise MissingChannelError(
            f"the channel {VOLTAGE} for the term {VoltageTerm.word}",
            f"{name}, which has none",
            "Log the battery's voltage, or leave the term out.",
        )
    if flight.input.measured:
        raise InputError(
            f"commands for the term {VoltageTerm.word}: what they give follows the voltage",
            f"{flight.input.name} of {name}, which was measured",
            "Leave the term out, or name the commands with --input.",
        )


def mean_voltage(flights: Sequence[PreparedFlight]) -> float | None:
    """Mean over flights of the mean voltage while each was used; None where one does not log it [V]."""
    means: list[float] = []
    for flight in flights:
        if flight.runs:
            volts = voltage(flight)
            if volts is None:
                return None
            means.append(float(volts[flight.used].mean()))
    mean = float(np.mean(means)) if means else math.nan
    return mean if math.isfinite(mean) else None


def with_surroundings(
    cut: VerticalFlight, flight: PreparedFlight, radius: float | None, reference_voltage: float | None
) -> VerticalFlight:
    """A flight with its height in rotor radii, and its voltage over the one given less one, as far as told.

    Parameters
    ----------
    cut : VerticalFlight
        What the regressions need of it.
    flight : PreparedFlight
        The same, on the same samples.
    radius : float, optional
        Of a rotor [m].
    reference_voltage : float, optional
        None where none is known [V].
    """
    height, volts = height_over_ground(flight), voltage(flight)
    radii = None if height is None or radius is None else height / radius
    away = None if volts is None or reference_voltage is None else volts / reference_voltage - 1.0
    return replace(cut, radii=radii, voltage=away)
