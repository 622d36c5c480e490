"""Logs of flights for tests: one simulated vehicle under altitude control, and ways to change its log."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

import eivor as ev
from eivor.flights.grid import Active, Grid
from eivor.flights.prepare import prepare
from eivor.flights.prepared import InputFamily, PreparedFlight
from eivor.models.lagged_runs import BAND_HZ, lag_and_delay
from eivor.models.separable import LaggedReferences
from eivor.motions.vertical.motion import Vertical
from eivor.signals.recording import CONTROLLER_RATE, Channel, Recording
from eivor.simulation.vertical import (
    AltitudeController,
    VerticalEnvironment,
    VerticalFlightSpec,
    VerticalVehicles,
    simulate_vertical,
    simulate_vertical_flights,
)


@cache
def simulated(**spec):
    """Log of a flight of the simulator."""
    (flight,) = simulate_vertical_flights([VerticalFlightSpec(**spec)])
    assert flight.flew
    return flight.recording


STEP_S = 0.01
FRICTION, GAIN, LAG_S = 0.4, 40.0, 0.05
HOVER = float(np.sqrt(9.80665 / GAIN))
HELD = (
    *("rotor_command_1", "input", "reference_position_z", "reference_velocity_z", "landed"),
    *("ground_contact"),
)


#: Frequencies of references [Hz].
HERTZ = (0.15, 0.4, 0.9, 1.7)


def moved(
    rng, errors, samples, count, *, hertz=HERTZ, amplitude=1.0, gust=0.0, friction=FRICTION, delay_s=0.0
):
    """References that are sums of sines of random phases, errors of sensors, and how vehicles move.

    `errors` draws those of position, velocity and acceleration, and the unit gust, after the phases.
    """
    time = STEP_S * np.arange(samples)
    reference = np.zeros((3, samples, count))
    for pulsation in 2.0 * np.pi * np.array(hertz):
        phase = pulsation * time[:, None] + rng.uniform(0.0, 2.0 * np.pi, count)
        reference += (amplitude / pulsation**1.5) * np.stack(
            [np.sin(phase), pulsation * np.cos(phase), -(pulsation**2) * np.sin(phase)]
        )
    position, velocity, acceleration, wind = errors()
    met = VerticalEnvironment(
        *reference,
        gust=gust * wind,
        cos_tilt=np.ones((samples, count)),
        position_noise=position,
        velocity_noise=velocity,
        acceleration_noise=acceleration,
    )
    every = np.ones(count)
    vehicles = VerticalVehicles(friction * every, GAIN * every, LAG_S * every, delay_s * every)
    motion = simulate_vertical(vehicles, met, step_s=STEP_S, controller=AltitudeController(1.2, 3.0, 0.5))
    return reference, motion, met


def flown(count=1, *, seconds=30.0, seed=0, noise=1.0, **how):
    """Flights along random sums of sines; `amplitude` 0 is a hover."""
    rng, samples = np.random.default_rng(seed), round(seconds / STEP_S)

    def errors():
        sizes = noise * np.array([0.003, 0.03, 0.3])[:, None, None]
        drawn = sizes * rng.standard_normal((3, samples, count))
        return *drawn, rng.standard_normal((samples, count))

    reference, motion, met = moved(rng, errors, samples, count, **how)
    return [
        recording(
            {
                "position_z": 5.0 + motion.position[:, i] + met.position_noise[:, i],
                "velocity_z": motion.velocity[:, i] + met.velocity_noise[:, i],
                "specific_force_z": motion.specific_force[:, i] + met.acceleration_noise[:, i],
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
    rng, shape = np.random.default_rng(seed), (round(seconds / STEP_S), count)

    def errors():
        sizes = (noise.velocity, noise.acceleration, 1.0, 0.003)
        velocity, acceleration, wind, position = (size * rng.standard_normal(shape) for size in sizes)
        return position, velocity, acceleration, wind

    reference, motion, met = moved(rng, errors, *shape, gust=noise.gust, delay_s=delay_s)
    declared = {"velocity_z": noise.velocity, "specific_force_z": noise.acceleration}
    made = []
    for number in range(count):
        channels = {
            "velocity_z": motion.velocity[:, number] + met.velocity_noise[:, number],
            "specific_force_z": motion.specific_force[:, number] + met.acceleration_noise[:, number],
            "rotor_command_1": motion.command[:, number].copy(),
            "cos_tilt": np.ones(shape[0]),
            "reference_position_z": reference[0, :, number].copy(),
            "reference_acceleration_z": reference[2, :, number].copy(),
        }
        whites = {name: ev.WhiteNoise(std) for name, std in declared.items()}
        signals = ev.Signals(1.0 / STEP_S, channels, noise=whites)
        # The start is left out: the rotor then was where the model cannot know.
        made.append(prepared_of(signals, slice(100, shape[0]), family="rotor_command", by="square"))
    return made


def prepared_of(signals, *runs, family="input", by="linear", measured=False):
    """A flight of signals, whose samples are all usable."""
    grid = Grid(0.0, signals.step_s, (range(signals.sample_count),))
    usable = np.ones(grid.count, dtype=bool)
    of = recording(dict(signals.channels)), signals, InputFamily(family, measured), by, runs, BAND_HZ
    return PreparedFlight(*of, (), Active(usable, ""), usable, {}, (), grid)


def problem(*which, lags=None, delays=(0.0,)):
    """The separable problem of flights, by default with a coarse grid of lags."""
    grid = np.geomspace(0.01, 0.2, 6) if lags is None else lags
    rule = LaggedReferences(("reference_position_z", "reference_acceleration_z"))
    return Vertical().problem(which, rule).with_nuisances(lag_and_delay(grid, delays))
