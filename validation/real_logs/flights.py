"""Flights of either simulator, each with the log that a real logger would have made of it."""

from __future__ import annotations

from dataclasses import dataclass

from eivor.signals.recording import Recording
from validation.real_logs.flown import Flown
from validation.real_logs.own_flights import fly_own
from validation.real_logs.rotorpy_flights import fly_rotorpy
from validation.real_logs.sensors import log_of, topics
from validation.real_logs.spec import FlightSpec


@dataclass(frozen=True)
class LoggedFlight:
    """A log and what happened."""

    recording: Recording  # The log
    flown: Flown  # What is true of it


def logged_flight(spec: FlightSpec) -> LoggedFlight:
    """Fly and log a flight."""
    reported = topics(spec)
    flight = fly_rotorpy(spec) if spec.multirotor else fly_own(spec, reported.seen(spec))
    return LoggedFlight(log_of(spec, flight, reported), flight)
