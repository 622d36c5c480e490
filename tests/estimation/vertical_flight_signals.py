"""Signals of simulated vertical flights, straight from the simulator of the models."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import eivor as ev
from eivor.models.lagged_runs import lag_and_delay
from eivor.models.separable import LaggedReferences
from eivor.motions.vertical.regression import VerticalFlight, vertical_problem
from eivor.signals.thrust_map import Power
from eivor.simulation.vertical import (
    AltitudeController,
    VerticalEnvironment,
    VerticalVehicles,
    simulate_vertical,
)

STEP_S = 0.01
FRICTION, GAIN, LAG_S = 0.4, 40.0, 0.05


@dataclass(frozen=True)
class Noise:
    """Standard deviations of the measurements and of the gust."""

    velocity: float = 0.03
    acceleration: float = 0.3
    gust: float = 0.0


def flights(count, *, seconds, noise, delay_s=0.0, seed=0):
    """Flights of one vehicle along random sums of sines, each with noise of its own."""
    rng = np.random.default_rng(seed)
    samples = round(seconds / STEP_S)
    time = STEP_S * np.arange(samples)[:, None]
    reference = np.zeros((3, samples, count))
    for hertz in (0.15, 0.4, 0.9, 1.7):
        pulsation = 2.0 * np.pi * hertz
        phase = pulsation * time + rng.uniform(0.0, 2.0 * np.pi, count)
        amplitude = 1.0 / pulsation**1.5
        reference += amplitude * np.stack(
            [np.sin(phase), pulsation * np.cos(phase), -(pulsation**2) * np.sin(phase)]
        )
    velocity_noise = noise.velocity * rng.standard_normal((samples, count))
    acceleration_noise = noise.acceleration * rng.standard_normal((samples, count))
    met = VerticalEnvironment(
        *reference,
        gust=noise.gust * rng.standard_normal((samples, count)),
        cos_tilt=np.ones((samples, count)),
        position_noise=0.003 * rng.standard_normal((samples, count)),
        velocity_noise=velocity_noise,
        acceleration_noise=acceleration_noise,
    )
    every = np.ones(count)
    motion = simulate_vertical(
        VerticalVehicles(FRICTION * every, GAIN * every, LAG_S * every, delay_s * every),
        met,
        step_s=STEP_S,
        controller=AltitudeController(1.2, 3.0, 0.5),
    )
    made = []
    for number in range(count):
        channels = {
            "velocity_z": motion.velocity[:, number] + velocity_noise[:, number],
            "specific_force_z": motion.specific_force[:, number] + acceleration_noise[:, number],
            "rotor_command_1": motion.command[:, number].copy(),
            "cos_tilt": np.ones(samples),
            "reference_position_z": reference[0, :, number].copy(),
            "reference_acceleration_z": reference[2, :, number].copy(),
        }
        declared = {
            "velocity_z": ev.WhiteNoise(noise.velocity),
            "specific_force_z": ev.WhiteNoise(noise.acceleration),
        }
        signals = ev.Signals(1.0 / STEP_S, channels, noise=declared)
        # The start is left out: the rotor then was where the model cannot know.
        made.append(VerticalFlight(signals, "rotor_command", False, (slice(100, samples),)))
    return made


def problem(*which, lags=None, delays=(0.0,)):
    """The separable problem of flights, by default with a coarse grid of lags."""
    grid = np.geomspace(0.01, 0.2, 6) if lags is None else lags
    rule = LaggedReferences(("reference_position_z", "reference_acceleration_z"))
    return vertical_problem(which, ev.VerticalMotion(Power(2.0)), rule, lag_and_delay(grid, delays))
