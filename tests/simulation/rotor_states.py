"""Recordings of simulated flights with the rotors' states."""

from __future__ import annotations

from eivor.simulation.environment import simulated_recording
from eivor.simulation.vertical import SIMULATOR


def actual_state_recording(flight):
    """Recording in which the rotor's actual state stands in place of its command (`rotor_speed_1`)."""
    log, truth = flight.recording, flight.truth
    held = {key: channel.values for key, channel in log.channels.items() if key.startswith("reference_")}
    sampled = {
        key: channel.values
        for key, channel in log.channels.items()
        if key not in held and not key.startswith("rotor_")
    }
    sampled["rotor_speed_1"] = truth.rotor_state[:, 0]
    return simulated_recording(log.name, simulator=SIMULATOR, time_s=truth.time_s, held=held, sampled=sampled)
