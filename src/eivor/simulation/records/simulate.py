"""Simulated records of vertical motion, exact at the samples.

The motion is z'' = -K z' + K_u u (+ e), the paper's (34) without gravity: inputs are deviations from
hover and the response is `acceleration_z`, so that the model has no intercept
(``VerticalMotion(intercept=False)``). The vehicle starts at rest. With a = exp(-K T), H = (1 - a)/K and
G = (1 - H/T)/K,

    v[k+1] = a v[k] + H (K_u u[k] + e[k])                            input held between samples
    v[k+1] = a v[k] + K_u ((H - G) u[k] + G u[k+1]) + H e[k]         input linear between samples

where e enters the velocity only when its route is the dynamics; it is held either way. In the equation
only, e shifts the response and nothing else. The altitude of a held acceleration is exact as well, see
`eivor.simulation.records.sampled_vehicle`. Under control (`eivor.simulation.records.control`) the input
answers what is measured, so that the noise of z', and of z under altitude control, moves the vehicle.

Ratios refer to the motion without measurement noise: a disturbance is scaled, by the standard deviation
of its own realisation, to a share of that of z'' in the undisturbed motion; the std of a noise is a
share of that of the channel in the disturbed motion, over the whole record. For fractional noise it is
the std of the white noise before the operator.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from eivor import checks
from eivor.errors import ParameterError
from eivor.shapes import Float
from eivor.signals.noise import MeasurementNoise, WhiteNoise
from eivor.signals.signals import Signals
from eivor.simulation.records.control import Feedback
from eivor.simulation.records.sampled_loop import driven_loop, from_rest, sampled_loop
from eivor.simulation.records.scenario import NOISY_CHANNELS, Intersample, Route, Scenario, SimulatedRecord

#: Sources of randomness, in the order in which they take their streams from the record's generator.
SOURCES = ("excitation", "disturbance", *NOISY_CHANNELS)

Series = Float[np.ndarray, " samples"]


@dataclass(frozen=True, slots=True)
class LinearMotion:
    """Input and motion at the samples; motions add, since the model is linear.

    Parameters
    ----------
    input : ndarray, shape (samples,)
        What the actuator got.
    velocity : ndarray, shape (samples,)
        z' [m/s].
    altitude : ndarray, shape (samples,), or None
        z [m], under altitude control.
    """

    input: Series
    velocity: Series
    altitude: Series | None = None

    def __add__(self, other: LinearMotion) -> LinearMotion:
        altitude = None
        if self.altitude is not None and other.altitude is not None:
            altitude = self.altitude + other.altitude
        return LinearMotion(self.input + other.input, self.velocity + other.velocity, altitude)


def simulate(scenario: Scenario, rng: np.random.Generator) -> SimulatedRecord:
    """Simulate one record.

    Parameters
    ----------
    scenario : Scenario
        What to simulate.
    rng : numpy.random.Generator
        Source of all randomness. Each source spawns its own stream from it, whether the scenario uses it
        or not: changing one leaves the others' realisations as they are. A second call with the same
        generator gives another record.

    Returns
    -------
    SimulatedRecord
        Measured and true channels; every channel's noise is declared, with std 0 where there is none.

    Raises
    ------
    ParameterError
        When a disturbance that is to be scaled does not vary.

    Notes
    -----
    Linear in samples, apart from the FFT of fractional noises.
    """
    checks.kind("scenario", scenario, Scenario, "a Scenario", "Make one: ev.Scenario(0.3, 0.02).")
    checks.kind("rng", rng, np.random.Generator, "a generator", "Give numpy.random.default_rng(0).")
    streams = dict(zip(SOURCES, rng.spawn(len(SOURCES)), strict=True))
    drive = scenario.excitation.sample(scenario.samples, scenario.step_s, streams["excitation"])
    motion = driven_motion(scenario, drive)
    disturbance = _disturbance(scenario, motion, streams["disturbance"])
    if scenario.route is Route.DYNAMICS and scenario.disturbance is not None:
        motion += pushed_motion(scenario, disturbance)
    noise = declared_noise(scenario, _channels(scenario, motion, disturbance))
    errors = {name: each.sample(scenario.samples, streams[name]) for name, each in noise.items()}
    feedback = scenario.control.feedback
    if feedback is not None:
        motion += misled_motion(scenario, feedback, errors)
    true = _channels(scenario, motion, disturbance)
    references = dict.fromkeys(scenario.references, drive)
    return SimulatedRecord(
        Signals(
            scenario.rate_hz,
            {name: true[name] + error for name, error in errors.items()} | references,
            noise=noise | {name: WhiteNoise(0.0) for name in references},
        ),
        Signals(scenario.rate_hz, true | references | {"disturbance": disturbance}),
        {"viscous_friction": scenario.viscous_friction, "input_gain": scenario.input_gain},
    )


def driven_motion(scenario: Scenario, drive: Series) -> LinearMotion:
    """Motion under the excitation alone: as the input, or under control as the reference."""
    feedback = scenario.control.feedback
    if feedback is not None:
        return _controlled(scenario, feedback, feedback.reference_gain * drive, np.zeros_like(drive))
    vehicle = scenario.vehicle
    if scenario.intersample is Intersample.LINEAR:
        pushed = (vehicle.held - vehicle.ramp) * drive[:-1] + vehicle.ramp * drive[1:]
    else:
        pushed = vehicle.held * drive[:-1]
    return LinearMotion(drive, _decaying(scenario, scenario.input_gain * pushed))


def pushed_motion(scenario: Scenario, disturbance: Series) -> LinearMotion:
    """Motion under a held acceleration [m/s^2] alone, with a controller when there is one."""
    rest = np.zeros_like(disturbance)
    feedback = scenario.control.feedback
    if feedback is not None:
        return _controlled(scenario, feedback, rest, disturbance)
    return LinearMotion(rest, _decaying(scenario, scenario.vehicle.held * disturbance[:-1]))


def misled_motion(scenario: Scenario, feedback: Feedback, errors: Mapping[str, Series]) -> LinearMotion:
    """Motion of a controlled vehicle under the errors of what its controller measures alone.

    Parameters
    ----------
    scenario : Scenario
        The vehicle.
    feedback : Feedback
        Its controller.
    errors : mapping of str to ndarray, shape (samples,)
        Of `velocity_z` [m/s], and of `position_z` [m] under altitude control.
    """
    error = errors["velocity_z"]
    if feedback.altitude_gain != 0.0:
        error = error + feedback.altitude_gain * errors["position_z"]
    return _controlled(scenario, feedback, -error, np.zeros_like(error))


def declared_noise(scenario: Scenario, channels: Mapping[str, Series]) -> dict[str, MeasurementNoise]:
    """Noise of each measured channel, with its std in the channel's unit."""
    noises: dict[str, MeasurementNoise] = {}
    for name in scenario.measured:
        noise = scenario.noise.get(name, WhiteNoise(0.0))
        if name in scenario.noise_to_signal:
            noise = noise.with_std(scenario.noise_to_signal[name] * float(channels[name].std()))
        noises[name] = noise
    return noises


def _channels(scenario: Scenario, motion: LinearMotion, disturbance: Series) -> dict[str, Series]:
    """Channels without measurement noise; the response is z''."""
    K, K_u = scenario.viscous_friction, scenario.input_gain
    channels = {
        "velocity_z": motion.velocity,
        "acceleration_z": K_u * motion.input - K * motion.velocity + disturbance,
        "input": motion.input,
    }
    return channels if motion.altitude is None else channels | {"position_z": motion.altitude}


def _disturbance(scenario: Scenario, undisturbed: LinearMotion, rng: np.random.Generator) -> Series:
    rest = np.zeros(scenario.samples)
    if scenario.disturbance is None:
        return rest
    series = scenario.disturbance.sample(scenario.samples, scenario.step_s, rng)
    if scenario.disturbance_to_signal is None:
        return series
    spread = float(series.std())
    if not (np.isfinite(spread) and spread > 0.0):
        raise ParameterError(
            "a disturbance that varies, since it is to be scaled to a share of z''",
            f"a standard deviation of {spread} over the record",
            "Give it a positive std, or leave disturbance_to_signal out.",
        )
    response = _channels(scenario, undisturbed, rest)["acceleration_z"]
    return scenario.disturbance_to_signal * float(response.std()) / spread * series


def _decaying(scenario: Scenario, steps: Float[np.ndarray, " steps"]) -> Series:
    """v[k+1] = decay v[k] + steps[k] from rest."""
    velocity: Series = from_rest(np.array([[scenario.vehicle.decay]]), steps[:, None])[:, 0]
    return velocity


def _controlled(scenario: Scenario, feedback: Feedback, additions: Series, pushes: Series) -> LinearMotion:
    """Motion of the loop under additions to its error [m/s] and held accelerations [m/s^2]."""
    commanded, states = driven_loop(sampled_loop(scenario.vehicle, feedback), additions, pushes)
    return LinearMotion(commanded, states[:, 0], states[:, 1] if feedback.altitude_gain != 0.0 else None)
