"""The open loop that goes with a scenario under control: its input is what the reference alone makes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from eivor.lab.disturbances import GivenDisturbance
from eivor.lab.records import ALWAYS_MEASURED, OpenLoop, Scenario, simulate
from eivor.simulation.excitation import GivenSeries


def open_loop(scenario: Scenario, seed: int) -> Scenario:
    """Scenario with one realised input, disturbance and strengths of noises, and nothing that answers them."""
    quiet = replace(scenario, noise={}, noise_to_signal={}, disturbance=None, disturbance_to_signal=None)
    record, undisturbed = (simulate(item, np.random.default_rng(seed)) for item in (scenario, quiet))
    return replace(
        scenario,
        control=OpenLoop(),
        excitation=GivenSeries(tuple(undisturbed.truth.channel("input").tolist())),
        noise={name: record.signals.noise[name] for name in ALWAYS_MEASURED},
        noise_to_signal={},
        disturbance=GivenDisturbance(tuple(record.truth.channel("disturbance").tolist())),
        disturbance_to_signal=None,
    )
