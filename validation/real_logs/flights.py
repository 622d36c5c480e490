"""Flights of either simulator, each with the log that a real logger would have made of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from eivor.signals.recording import Recording
from validation.real_logs.flown import Flown
from validation.real_logs.own_flights import fly_own
from validation.real_logs.rotorpy_flights import fly_rotorpy
from validation.real_logs.sensors import log_of, topics
from validation.real_logs.spec import FlightSpec


@dataclass(frozen=True)
class LoggedFlight:
    """A log and what happened.

    Parameters
    ----------
    recording : Recording
        The log.
    flown : Flown
        What is true of it.
    """

    recording: Recording
    flown: Flown


def logged_flights(specs: Sequence[FlightSpec]) -> list[LoggedFlight]:
    """Fly and log each specification, in order.

    Parameters
    ----------
    specs : sequence of FlightSpec
        All of one duration, and all of one simulator. Which flights are flown together makes no difference
        to any of them beyond rounding.

    Notes
    -----
    About .1 s for a minute of flight of the own simulator, ten or more for one of RotorPy's.
    """
    told = [topics(spec) for spec in specs]
    if specs[0].multirotor:
        flown = [fly_rotorpy(spec) for spec in specs]
    else:
        seen = [each.seen(spec) for spec, each in zip(specs, told, strict=True)]
        flown = fly_own(specs, seen)
    return [
        LoggedFlight(log_of(spec, each, clocks), each)
        for spec, each, clocks in zip(specs, flown, told, strict=True)
    ]
