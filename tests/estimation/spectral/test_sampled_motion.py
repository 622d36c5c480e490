"""What the motion does between samples, in frequency, against records and finite differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import eivor as ev
from eivor.estimation.sampled_motion import (
    NoiseModel,
    SampledMotion,
    SampledRecord,
    _Fit,
    prior_of,
    unitary_bins,
)
from eivor.lab.records import Intersample
from eivor.lab.scenario_files import shipped_scenario
from eivor.tools import Float


def motion_of(intersample: Intersample, blend: float, samples: int = 801) -> SampledMotion:
    """Motion at the truth of a record without any noise."""
    scenario = replace(
        shipped_scenario("rich"),
        samples=samples,
        noise={},
        noise_to_signal={},
        disturbance=None,
        disturbance_to_signal=None,
        intersample=intersample,
    )
    signals = ev.simulate(scenario, np.random.default_rng(3)).signals
    names = ("acceleration_z", "velocity_z", "input")
    bins = (unitary_bins(signals.channel(name)) for name in names)
    record = SampledRecord(signals.step_s, samples, *bins)
    return SampledMotion(record, scenario.viscous_friction, scenario.input_gain, blend)


def test_without_noise_only_the_transient_is_left() -> None:
    motion = motion_of(Intersample.HOLD, 0.0)
    first, second = motion.residuals()
    assert np.abs(first).max() < 1e-12
    shape = motion.memory
    t = (shape.conj() * second).real.sum() / (np.abs(shape) ** 2).sum()
    assert np.abs(second - t * shape).max() < 1e-10 * np.abs(second).max()
    assert abs(t) > 1e-6
    left = motion.whole(np.array([t]), motion.nuisance_shapes(ramps=False))
    assert np.abs(left[1]).max() < 1e-10 * np.abs(second).max()


def test_a_linear_input_is_near_rho_one_half() -> None:
    held, linear = (motion_of(Intersample.LINEAR, blend) for blend in (0.0, 0.5))

    def left(motion: SampledMotion) -> float:
        """Power of the second residual beside the transient."""
        shape, second = motion.memory, motion.residuals()[1]
        t = (shape.conj() * second).real.sum() / (np.abs(shape) ** 2).sum()
        return float(np.sum(np.abs(second - t * shape) ** 2))

    assert left(linear) < 1e-2 * left(held)


@pytest.mark.parametrize("place", [0, 1, 2])
def test_directions_are_derivatives_over_the_input(place: int) -> None:
    motion = replace(motion_of(Intersample.HOLD, 0.0), blend=0.2)
    names, step = ("friction", "gain", "blend"), 1e-5
    name = names[place]
    prediction, behind = (
        replace(motion, **{name: getattr(motion, name) + sign * step}).residuals() for sign in (1, -1)
    )
    slope = (prediction - behind) / (2.0 * step)
    direction = motion.directions[place] * motion.record.input
    if name == "friction":  # of what is measured V is, of the true motion g U
        slope[0] += motion.response * motion.record.input - motion.record.velocity
    np.testing.assert_allclose(slope, direction, rtol=1e-6, atol=1e-9 * np.abs(direction).max())


def test_no_friction_is_a_limit() -> None:
    motion = motion_of(Intersample.HOLD, 0.0)
    small, none = replace(motion, friction=1e-6), replace(motion, friction=0.0)
    np.testing.assert_allclose(none.response, small.response, rtol=1e-4)
    np.testing.assert_allclose(none.response_by_friction, small.response_by_friction, rtol=1e-3)


def test_the_noise_fit_knows_its_gradient() -> None:
    motion = motion_of(Intersample.HOLD, 0.0)
    rng = np.random.default_rng(5)
    residual = rng.standard_normal((2, 400)) + 1j * rng.standard_normal((2, 400))
    start = prior_of(motion, residual, 1e-2).centre
    fit = _Fit(motion, residual, start)
    index = fit.vector(start) + 0.1
    slopes: list[float] = []
    for unit in np.eye(6):
        prediction, behind = (fit.value_and_gradient(index + sign * 1e-5 * unit)[0] for sign in (1, -1))
        slopes.append((prediction - behind) / 2e-5)
    np.testing.assert_allclose(fit.value_and_gradient(index)[1], slopes, rtol=1e-6)


def test_the_noise_model_is_the_covariance_of_what_noises_leave() -> None:
    """Residuals of simulated noises have the spectrum of the model, within chance."""
    motion, count = motion_of(Intersample.HOLD, 0.0, 4001), 4001
    noise = NoiseModel(0.3, 0.2, 0.4, 0.5, 0.0, 0.0)
    C = noise.spectrum(motion)
    rng = np.random.default_rng(7)

    def series(variance: float) -> Float[np.ndarray, " bins"]:
        return unitary_bins(np.sqrt(variance) * rng.standard_normal(count))

    ratios: list[float] = []
    for _ in range(10):
        u, v, a, e = (series(item) for item in (0.3, 0.2, 0.4, 0.5))
        first = a + motion.friction * v - motion.gain * u + e
        second = v - motion.response * u + motion.pushed * e
        pair = np.stack([first, second])
        ratios.append(float((pair.conj() * C.solved(pair)).real.sum() / (2 * pair.shape[1])))
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.02)
