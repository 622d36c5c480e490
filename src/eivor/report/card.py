"""The flight card: what to fly and what to log so that the next flight can be identified."""

from __future__ import annotations

from typing import Any

from eivor.flights.motion import Motion
from eivor.flights.result import FlightEstimate
from eivor.flights.words import CardSection
from eivor.inference.verdict import Status
from eivor.logs.formats import log_format
from eivor.signals.recording import Recording


def flight_card(result: FlightEstimate) -> tuple[CardSection, ...]:
    """What to fly and log instead; empty when the flight is identified."""
    if result.verdict.status is Status.IDENTIFIED:
        return ()
    return result.motion.advice(result.prepared[0].recording.format)


def missing_channels(recording: Recording, motion: Motion[Any]) -> tuple[str, ...]:
    """Channels without which the motion cannot be identified, and that the log lacks."""
    missing = [name for name in motion.needed if name not in recording.channels]
    if not any(recording.family(family.name) for family in motion.inputs):
        missing.append("input")
    return tuple(missing)


def logging_advice_for(recording: Recording, channel: str) -> tuple[str, ...]:
    """What to log so that `channel` is there; empty for logs whose format has no advice."""
    known = log_format(recording.format)
    return known.advice(channel) if known is not None else ()
