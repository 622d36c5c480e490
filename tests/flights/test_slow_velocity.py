"""A velocity that is logged at 10 Hz moves the gain by less than its interval."""

from __future__ import annotations

import numpy as np
import pytest

from eivor.motions.identify import identify_flight
from eivor.signals.recording import Channel, Recording
from eivor.simulation.vertical import VerticalFlightSpec, simulate_vertical_flights

SEEDS = range(50, 58)


@pytest.mark.thorough
def test_gains_are_not_small():
    specs = [VerticalFlightSpec(seed=seed, duration=60.0) for seed in SEEDS]
    errors = []
    for spec, flight in zip(specs, simulate_vertical_flights(specs), strict=True):
        channels = dict(flight.recording.channels)
        for name in ("velocity_z", "position_z"):
            channel = channels[name]
            channels[name] = Channel(name, channel.time_s[::10], channel.values[::10], channel.unit)
        fit = identify_flight(Recording("slow", "simulated", channels))
        gain = fit.quantities["input_gain"]
        errors.append((gain.value / spec.input_gain - 1.0, gain.std_error / spec.input_gain))
    error, scatter = np.array(errors).T
    # lines between the stamps make it 0.55 % too small, twice what chance does to eight flights
    assert abs(error.mean()) < 2.0 * np.sqrt(np.mean(scatter**2) / error.size)
    assert abs(error.mean()) < 0.003
