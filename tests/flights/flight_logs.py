"""Logs of flights for tests: one simulated vehicle under altitude control, and ways to change its log."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

import eivor as ev
from eivor.flights.prepare import prepare
from eivor.models.lagged_runs import lag_and_delay
from eivor.models.separable import LaggedReferences
from eivor.motions.vertical.motion import Vertical
from eivor.motions.vertical.regression import VerticalFlight, vertical_problem
from eivor.signals.recording import CONTROLLER_RATE, Channel, Recording
from eivor.signals.thrust_map import Power
from eivor.simulation.vertical import (
    AltitudeController,
    VerticalEnvironment,
    VerticalVehicles,
    simulate_vertical,
)

STEP_S = 0.01
FRICTION, GAIN, LAG_S = 0.4, 40.0, 0.05
HOVER = float(np.sqrt(9.80665 / GAIN))
HELD = (
    *("rotor_command_1", "input", "reference_position_z", "reference_velocity_z", "landed"),
    *("ground_contact"),
)


def flown(
    count=1,
    *,
    seconds=30.0,
    seed=0,
    noise=1.0,
    amplitude=1.0,
    gust=0.0,
    delay_s=0.0,
    hertz=(0.15, 0.4, 0.9, 1.7),
    friction=FRICTION,
):
    """Flights along random sums of sines; `amplitude` 0 is a hover."""
    rng = np.random.default_rng(seed)
    samples = round(seconds / STEP_S)
    time = STEP_S * np.arange(samples)
    reference = np.zeros((3, samples, count))
    for pulsation in 2.0 * np.pi * np.array(hertz):
        phase = pulsation * time[:, None] + rng.uniform(0.0, 2.0 * np.pi, count)
        reference += (amplitude / pulsation**1.5) * np.stack(
            [np.sin(phase), pulsation * np.cos(phase), -(pulsation**2) * np.sin(phase)]
        )
    errors = noise * np.array([0.003, 0.03, 0.3])[:, None, None] * rng.standard_normal((3, samples, count))
    met = VerticalEnvironment(
        *reference,
        gust=gust * rng.standard_normal((samples, count)),
        cos_tilt=np.ones((samples, count)),
        position_noise=errors[0],
        velocity_noise=errors[1],
        acceleration_noise=errors[2],
    )
    every = np.ones(count)
    vehicles = VerticalVehicles(friction * every, GAIN * every, LAG_S * every, delay_s * every)
    motion = simulate_vertical(vehicles, met, step_s=STEP_S, controller=AltitudeController(1.2, 3.0, 0.5))
    return [
        recording(
            {
                "position_z": 5.0 + motion.position[:, i] + errors[0, :, i],
                "velocity_z": motion.velocity[:, i] + errors[1, :, i],
                "specific_force_z": motion.specific_force[:, i] + errors[2, :, i],
                "cos_tilt": np.ones(samples),
                "rotor_command_1": motion.command[:, i].copy(),
                "reference_position_z": reference[0, :, i].copy(),
                "reference_velocity_z": reference[1, :, i].copy(),
            },
            name=f"flight {i}",
        )
        for i in range(count)
    ]


def recording(columns, *, name="flight", time_s=None):
    """Recording whose channels share one clock, 100 Hz unless stamps are given, with every command."""
    count = next(iter(columns.values())).size
    time = STEP_S * np.arange(count) if time_s is None else time_s
    channels = {key: channel(key, time, values) for key, values in columns.items()}
    parameters = {CONTROLLER_RATE: 1.0 / float(np.median(np.diff(time)))}
    input_map = "square" if "rotor_command_1" in columns else ""
    return Recording(name, "frame", channels, parameters=parameters, input_map=input_map)


def channel(name, time_s, values):
    """Channel that is held when its name is that of a command or a setpoint."""
    return Channel(
        name, np.array(time_s, dtype=float), np.array(values, dtype=float), "", "test", name in HELD
    )


def prepare_vertical(log, options):
    """Log made ready for the vertical motion."""
    return prepare(log, Vertical(), options)


def changed(log, *drop, **channels):
    """Log without some channels and with others: whole channels, or values on the log's first clock."""
    kept = {key: value for key, value in log.channels.items() if key not in drop}
    clock = next(iter(log.channels.values())).time_s
    for key, value in channels.items():
        kept[key] = value if isinstance(value, Channel) else channel(key, clock, value)
    return replace(log, channels=kept)


def every(log, step, *names):
    """Log with only each `step`-th sample of the channels named, or of all."""
    return replace(
        log,
        channels={
            key: replace(c, time_s=c.time_s[::step].copy(), values=c.values[::step].copy())
            if key in names or not names
            else c
            for key, c in log.channels.items()
        },
    )


# Signals of simulated vertical flights, straight from the simulator of the models.


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
