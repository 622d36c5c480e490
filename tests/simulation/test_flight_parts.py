"""What both simulators share: trajectories, wind, sensor errors."""

from __future__ import annotations

import numpy as np
import pytest

from eivor.simulation.environment import (
    OWN_HEIGHT,
    NoiseKind,
    SensorNoise,
    TrajectoryKind,
    altitude_reference,
    gusts,
    sensor_errors,
)

STEP_S = 0.01


def reference(kind: TrajectoryKind, *, seed: int = 1, count: int = 6000, vigour: float = 1.0):
    rng = np.random.default_rng(seed)
    return altitude_reference(kind, count=count, step_s=STEP_S, rng=rng, vigour=vigour)


@pytest.mark.parametrize("kind", list(TrajectoryKind))
def test_reference_and_its_derivatives_belong_together(kind):
    flight = reference(kind)
    np.testing.assert_allclose(
        np.gradient(flight.position, STEP_S)[1:-1], flight.velocity[1:-1], rtol=0.0, atol=5e-3
    )
    np.testing.assert_allclose(
        np.gradient(flight.velocity, STEP_S)[1:-1], flight.acceleration[1:-1], rtol=0.0, atol=5e-2
    )


@pytest.mark.parametrize("kind", [TrajectoryKind.STEPS, TrajectoryKind.MULTISINE, TrajectoryKind.CHIRP])
@pytest.mark.parametrize("seed", range(5))
def test_excitation_reaches_a_limit_and_passes_none(kind, seed):
    flight = reference(kind, seed=seed)
    speed, acceleration = np.abs(flight.velocity).max(), np.abs(flight.acceleration).max()
    assert speed <= 2.2 + 1e-9
    assert acceleration <= 4.0 + 1e-9
    assert speed >= 1.6 - 1e-9 or acceleration >= 3.0 - 1e-9


def test_vigour_is_a_share_of_the_limits():
    full, half = (reference(TrajectoryKind.CHIRP, vigour=vigour) for vigour in (1.0, 0.5))
    np.testing.assert_allclose(half.position, 0.5 * full.position, rtol=1e-12)


@pytest.mark.parametrize("kind", sorted(OWN_HEIGHT))
def test_own_height_is_never_scaled_up(kind):
    heights = [np.ptp(reference(kind, seed=seed).position) for seed in range(5)]
    assert max(heights) <= {TrajectoryKind.CLIMBS: 4.0, TrajectoryKind.HOVER_STEPS: 0.1}[kind] + 1e-9
    assert min(heights) >= {TrajectoryKind.CLIMBS: 1.5, TrajectoryKind.HOVER_STEPS: 0.04}[kind]


def test_wind_is_stationary_and_forgets():
    wind = gusts(count=200_000, axes=2, step_s=0.01, rms=0.7, correlation_s=0.2, rng=np.random.default_rng(3))
    # 200,000 samples of correlation .2 s are about 5,000 independent ones.
    np.testing.assert_allclose(wind.std(axis=0), 0.7, rtol=0.05)
    for column in wind.T:
        assert np.corrcoef(column[20:], column[:-20])[0, 1] == pytest.approx(np.exp(-1.0), abs=0.06)
    assert abs(np.corrcoef(wind.T)[0, 1]) < 0.06


def test_wind_is_the_recursion_it_is_said_to_be():
    wind = gusts(count=50, axes=1, step_s=0.01, rms=0.5, correlation_s=0.3, rng=np.random.default_rng(4))
    shocks = np.random.default_rng(4).standard_normal(50)
    decay = np.exp(-0.01 / 0.3)
    state = shocks[0]
    for k in range(50):
        state = state if k == 0 else decay * state + np.sqrt(1.0 - decay**2) * shocks[k]
        assert wind[k, 0] == pytest.approx(0.5 * state, rel=1e-12)


@pytest.mark.parametrize("kind", list(NoiseKind))
def test_errors_have_their_levels_over_the_record(kind):
    noise = SensorNoise(kind, acceleration=0.4, velocity=0.03, position=0.01, attitude=0.002)
    errors = sensor_errors(noise, count=4000, axes=40, rng=np.random.default_rng(5))
    for name in ("acceleration", "velocity", "position", "attitude", "angular_rate"):
        rms = np.sqrt(np.mean(getattr(errors, name) ** 2))
        assert rms == pytest.approx(getattr(noise, name), rel=0.05)
