"""The flight that comes with the package, over many seeds."""

from __future__ import annotations

from dataclasses import replace

import pytest
from scipy.stats import binom

from eivor.lab.scenario_files import shipped_flight
from eivor.motions.identify import identify_flight
from eivor.simulation.vertical import simulate_vertical_flights

SEEDS = 14
#: The bounds are crossed by chance once in a thousand sets of seeds.
CHANCE = 1e-3


@pytest.mark.calibration
def test_it_is_accepted_and_its_intervals_hold_the_truth():
    """Seeds from zero on, none left out; 95 % intervals of four quantities each."""
    specs = [replace(shipped_flight(), seed=seed) for seed in range(SEEDS)]
    accepted, held = 0, dict.fromkeys(("viscous_friction", "input_gain", "effective_lag", "hover_input"), 0)
    for spec, flight in zip(specs, simulate_vertical_flights(specs), strict=True):
        fit = identify_flight(flight.recording)
        accepted += fit.verdict.status.value == "identified"
        for name in held:
            truth = spec.actuator_lag + spec.delay if name == "effective_lag" else getattr(spec, name)
            low, high = fit.interval(name)
            held[name] += low <= truth <= high
    assert accepted >= binom.ppf(CHANCE, SEEDS, 0.95)
    assert min(held.values()) >= binom.ppf(CHANCE, SEEDS, 0.93), held
    assert sum(held.values()) >= binom.ppf(CHANCE, 4 * SEEDS, 0.93), held
