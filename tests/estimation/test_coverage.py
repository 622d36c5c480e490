"""Coverage: intervals of methods that no formula checks hold the truth as often as they say."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import eivor as ev

TRUTH = (0.3, 0.02)
MOTION = ev.VerticalMotion(intercept=False)
INSTRUMENTS = ev.lags("input", 0, 10)
SCENARIO = ev.Scenario(
    *TRUTH,
    samples=1500,
    noise={
        "input": ev.WhiteNoise(1.0),
        "velocity_z": ev.FractionalNoise(1.0, 0.3),
        "acceleration_z": ev.WhiteNoise(1.0),
    },
    noise_to_signal={"input": 0.3, "velocity_z": 0.1, "acceleration_z": 0.3},
)
RUNS, CHANCE = 200, 1e-3


def by_method(name):
    def estimate(signals):
        if "unknown" in name:
            signals = replace(signals, noise={})
        return ev.identify(MOTION.regression(signals, INSTRUMENTS), getattr(ev.methods, name)())

    return estimate


def by_recursion(signals):
    recursion = ev.RecursiveIdentification(MOTION, ev.methods.generalized_iv(), INSTRUMENTS, memory=400.0)
    return recursion.update(signals).estimate()


@pytest.mark.thorough
@pytest.mark.calibration
@pytest.mark.parametrize(
    "estimator",
    [
        pytest.param(by_method("spectral_giv"), id="spectral_giv"),
        pytest.param(by_method("whittle_ml"), id="whittle_ml"),
        pytest.param(by_method("generalized_iv_unknown_noise"), id="unknown noise"),
        pytest.param(by_recursion, id="recursion"),
    ],
)
def test_errors_are_as_large_as_their_standard_errors(estimator):
    errors, hits = [], []
    for seed in range(RUNS):
        signals = ev.simulate(SCENARIO, np.random.default_rng([seed, 7])).signals
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            estimate = estimator(signals)
        names = estimate.names[:2]
        errors.append(
            [(estimate.parameters[n] - t) / estimate.std_error(n) for n, t in zip(names, TRUTH, strict=True)]
        )
        hits.append(
            [low < t < high for (low, high), t in zip(map(estimate.interval, names), TRUTH, strict=True)]
        )
    least = stats.binom.ppf(CHANCE, RUNS, 0.95)
    assert np.all(np.sum(hits, axis=0) >= least)
    # the size of the errors over their standard errors, within four of its own
    assert np.all(np.abs(np.sqrt(np.mean(np.square(errors), axis=0)) - 1.0) < 4.0 / np.sqrt(2.0 * RUNS))
