"""Simulated records of vertical motion, exact at the samples.

The motion is z'' = -K z' + K_u u (+ e), the paper's (34) without gravity: inputs are deviations from
hover and `specific_force_z` is z'' itself, so that the model has no intercept
(``VerticalMotion(intercept=False)``). The vehicle starts at rest. With a = exp(-K T), H = (1 - a)/K and
G = (1 - H/T)/K,

    v[k+1] = a v[k] + H (K_u u[k] + e[k])                            input held between samples
    v[k+1] = a v[k] + K_u ((H - G) u[k] + G u[k+1]) + H e[k]         input linear between samples

where e enters the velocity only when its route is the dynamics; it is held either way. In the equation
only, e shifts the response and nothing else. Under control u = P d + I T sum(d), with d = reference less
*measured* velocity and the present error in the sum, so that the noise of z' moves the vehicle.

Ratios refer to the motion without measurement noise: a disturbance is scaled, by the standard deviation
of its own realisation, to a share of that of z'' in the undisturbed motion; the std of a noise is a
share of that of the channel in the disturbed motion, over the whole record. For fractional noise it is
the std of the white noise before the operator.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg.lapack import dtbtrs

from eivor.errors import ParameterError
from eivor.models.scenario import NOISY_CHANNELS, Intersample, Route, Scenario, SimulatedRecord
from eivor.signals.noise import MeasurementNoise, WhiteNoise
from eivor.signals.signals import Signals

#: Sources of randomness, in the order in which they take their streams from the record's generator.
SOURCES = ("excitation", "disturbance", *NOISY_CHANNELS)

Series = Float[np.ndarray, " samples"]


@dataclass(frozen=True, slots=True)
class Motion:
    """Input and velocity at the samples; motions add, since the model is linear.

    Parameters
    ----------
    input : ndarray, shape (samples,)
        What the actuator got.
    velocity : ndarray, shape (samples,)
        z' [m/s].
    """

    input: Series
    velocity: Series

    def __add__(self, other: Motion) -> Motion:
        return Motion(self.input + other.input, self.velocity + other.velocity)


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
    streams = dict(zip(SOURCES, rng.spawn(len(SOURCES)), strict=True))
    drive = scenario.excitation.sample(scenario.samples, scenario.step_s, streams["excitation"])
    motion = driven_motion(scenario, drive)
    disturbance = _disturbance(scenario, motion, streams["disturbance"])
    if scenario.route is Route.DYNAMICS and scenario.disturbance is not None:
        motion += pushed_motion(scenario, disturbance)
    noise = declared_noise(scenario, _channels(scenario, motion, disturbance))
    errors = {name: noise[name].sample(scenario.samples, streams[name]) for name in NOISY_CHANNELS}
    if scenario.controlled:
        motion += misled_motion(scenario, errors["velocity_z"])
    true = _channels(scenario, motion, disturbance)
    references = {"reference_velocity_z": drive} if scenario.controlled else {}
    return SimulatedRecord(
        Signals(
            scenario.rate_hz,
            {name: true[name] + errors[name] for name in NOISY_CHANNELS} | references,
            noise=noise | {name: WhiteNoise(0.0) for name in references},
        ),
        Signals(scenario.rate_hz, true | references | {"disturbance": disturbance}),
        {"viscous_friction": scenario.viscous_friction, "input_gain": scenario.input_gain},
    )


def driven_motion(scenario: Scenario, drive: Series) -> Motion:
    """Motion under the excitation alone: as the input, or under control as the reference."""
    if scenario.controlled:
        return _controlled(scenario, drive, np.zeros_like(drive))
    held, ramp = _gains(scenario)
    if scenario.intersample is Intersample.LINEAR:
        pushed = (held - ramp) * drive[:-1] + ramp * drive[1:]
    else:
        pushed = held * drive[:-1]
    return Motion(drive, _decaying(scenario, scenario.input_gain * pushed))


def pushed_motion(scenario: Scenario, disturbance: Series) -> Motion:
    """Motion under a held acceleration [m/s^2] alone, with a controller when there is one."""
    rest = np.zeros_like(disturbance)
    if scenario.controlled:
        return _controlled(scenario, rest, disturbance)
    return Motion(rest, _decaying(scenario, _gains(scenario)[0] * disturbance[:-1]))


def misled_motion(scenario: Scenario, velocity_error: Series) -> Motion:
    """Motion of a controlled vehicle under the error of its measured velocity [m/s] alone."""
    return _controlled(scenario, -velocity_error, np.zeros_like(velocity_error))


def declared_noise(scenario: Scenario, channels: Mapping[str, Series]) -> dict[str, MeasurementNoise]:
    """Noise of each measured channel, with its std in the channel's unit."""
    noises: dict[str, MeasurementNoise] = {}
    for name in NOISY_CHANNELS:
        noise = scenario.noise.get(name, WhiteNoise(0.0))
        if name in scenario.noise_to_signal:
            noise = noise.with_std(scenario.noise_to_signal[name] * float(channels[name].std()))
        noises[name] = noise
    return noises


def _channels(scenario: Scenario, motion: Motion, disturbance: Series) -> dict[str, Series]:
    """Channels without measurement noise; the response is z''."""
    K, K_u = scenario.viscous_friction, scenario.input_gain
    return {
        "velocity_z": motion.velocity,
        "specific_force_z": K_u * motion.input - K * motion.velocity + disturbance,
        "input": motion.input,
    }


def _disturbance(scenario: Scenario, undisturbed: Motion, rng: np.random.Generator) -> Series:
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
    response = _channels(scenario, undisturbed, rest)["specific_force_z"]
    return scenario.disturbance_to_signal * float(response.std()) / spread * series


def _gains(scenario: Scenario) -> tuple[float, float]:
    """H and G of the module: of an acceleration that is held, and of one that grows from 0 to 1 [s].

    T (1 - e^-x)/x and T (e^-x - 1 + x)/x^2 at x = K T, the second by its series where it would cancel.
    """
    T = scenario.step_s
    x = scenario.viscous_friction * T
    if x < 1e-2:
        held = 1.0 - x / 2.0 * (1.0 - x / 3.0 * (1.0 - x / 4.0 * (1.0 - x / 5.0 * (1.0 - x / 6.0))))
        ramp = 0.5 * (1.0 - x / 3.0 * (1.0 - x / 4.0 * (1.0 - x / 5.0 * (1.0 - x / 6.0))))
        return T * held, T * ramp
    return -T * float(np.expm1(-x)) / x, T * (float(np.expm1(-x)) + x) / x**2


def _decaying(scenario: Scenario, steps: Float[np.ndarray, " steps"]) -> Series:
    """v[k+1] = a v[k] + steps[k] from rest, as the bidiagonal triangular system that it is."""
    band = np.empty((2, steps.size + 1))
    band[0], band[1] = 1.0, -np.exp(-scenario.viscous_friction * scenario.step_s)
    driven = np.concatenate([[0.0], steps])[:, None]
    velocity: Series = dtbtrs(band, driven, uplo="L", diag="U")[0][:, 0]
    return velocity


def _controlled(scenario: Scenario, reference: Series, disturbance: Series) -> Motion:
    """Motion under PI control of the velocity.

    The unknowns v[0], s[0], v[1], s[1], ... (s the sum of the errors) make a triangular system with two
    subdiagonals: s[k] - s[k-1] + v[k] = r[k] and v[k+1] - (a - H K_u P) v[k] - H K_u I T s[k] = known.
    """
    held = _gains(scenario)[0]
    proportional = scenario.velocity_gain
    integral = scenario.velocity_integral_gain * scenario.step_s
    effect = held * scenario.input_gain
    band = np.zeros((3, 2 * reference.size))
    band[0] = 1.0
    band[1, 0::2], band[1, 1::2] = 1.0, -effect * integral
    band[2, 0::2] = effect * proportional - np.exp(-scenario.viscous_friction * scenario.step_s)
    band[2, 1::2] = -1.0
    known = np.zeros((2 * reference.size, 1))
    known[1::2, 0] = reference
    known[2::2, 0] = effect * proportional * reference[:-1] + held * disturbance[:-1]
    unknown = dtbtrs(band, known, uplo="L", diag="U")[0][:, 0]
    velocity, total = unknown[0::2], unknown[1::2]
    return Motion(proportional * (reference - velocity) + integral * total, velocity)
