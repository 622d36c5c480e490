"""Records of a scenario in which a parameter changes at a sample; all noises stay as they were."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from eivor.lab.records import Scenario, simulate
from eivor.signals.signals import Signals


def changed_record(
    scenario: Scenario, rng: np.random.Generator, parameter: str, factor: float, sample: int
) -> Signals:
    """Measured signals of a scenario in open loop whose disturbance is in the equation."""
    record = simulate(scenario, rng)
    before, after = scenario, replace(scenario, **{parameter: factor * getattr(scenario, parameter)})
    true, measured = record.truth.channels, record.signals
    u, velocity = true["input"], true["velocity_z"].copy()
    for k in range(max(sample, 1), u.size):
        now = after if k > sample else before  # what held over the step to sample k
        velocity[k] = now.vehicle.decay * velocity[k - 1] + now.input_gain * now.vehicle.held * u[k - 1]
    friction = np.full(u.size, before.viscous_friction)
    gain = np.full(u.size, before.input_gain)
    friction[sample:], gain[sample:] = after.viscous_friction, after.input_gain
    acceleration = gain * u - friction * velocity + true["disturbance"]
    channels = dict(measured.channels)
    for name, series in (("velocity_z", velocity), ("acceleration_z", acceleration)):
        channels[name] = measured.channels[name] - true[name] + series
    return Signals(measured.rate_hz, channels, noise=measured.noise)
