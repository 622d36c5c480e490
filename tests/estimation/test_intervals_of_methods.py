"""Default intervals of every method cover where the method is consistent, in autocorrelated errors too.

Each problem is one that its method is made for: errors in the regressors where it knows of them, none for
least squares. Bounds are binomial around a coverage of 92 to 98 %: default intervals are right to first
order, and some of these methods are nonlinear.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy import stats
from scipy.signal import lfilter
from threadpoolctl import threadpool_limits

import eivor as ev
import shape_checks
from eivor.estimation.linear import LinearMethod

RUNS, COUNT = 250, 600
TRUTH = np.array([0.8, -0.5])
NOISE = 0.4
CHANCE = 1e-4

least_squares, total = ev.methods.least_squares(), ev.methods.total_least_squares()
compensated = ev.methods.bias_compensated_least_squares()
METHODS: dict[str, tuple[LinearMethod, str]] = {
    "least squares": (least_squares, "exact"),
    "total least squares": (total, "errors in all"),
    "bias-compensated least squares": (compensated, "errors in regressors"),
    "extended IV": (ev.methods.extended_iv(), "errors in regressors"),
    "extended IV, TLS": (ev.methods.extended_iv_tls(), "errors in regressors"),
    "two-stage": (ev.methods.extended_iv(ev.methods.TwoStage()), "errors in regressors"),
    "two-step GMM": (ev.methods.extended_iv(ev.methods.TwoStepRobust()), "errors in regressors"),
    "generalized IV": (ev.methods.generalized_iv(), "shared"),
    "generalized IV, TLS": (ev.methods.generalized_iv_tls(), "shared"),
    "generalized IV, two-stage": (ev.methods.generalized_iv(ev.methods.TwoStage()), "shared"),
}


def autocorrelated(rng: np.random.Generator, memory: float, std: float, columns: int) -> np.ndarray:
    shocks = rng.standard_normal((COUNT + 50, columns))
    series = lfilter([np.sqrt(1.0 - memory**2)], [1.0, -memory], shocks, axis=0)
    return np.asarray(std * series[50:])


def problem(rng: np.random.Generator, kind: str) -> ev.Regression:
    """Two slow regressors, an autocorrelated disturbance, and white errors where the kind has them."""
    x = autocorrelated(rng, 0.7, 1.0, 2)
    # Total least squares is told white errors of known covariance; the others allow for any disturbance.
    memory = 0.0 if kind == "errors in all" else 0.6
    y = x @ TRUTH + autocorrelated(rng, memory, NOISE, 1)[:, 0]
    errors = np.zeros((COUNT, 2)) if kind == "exact" else NOISE * rng.standard_normal((COUNT, 2))
    noisy = x + errors
    current = np.diag([NOISE**2, NOISE**2, NOISE**2 if kind == "errors in all" else 0.0])
    other = x + autocorrelated(rng, 0.3, 0.5, 2)
    instruments, shared = [other, other**3], np.zeros((4, 3))
    if kind == "shared":
        # The noisy regressors are instruments themselves: their noise is known, and taken out.
        instruments.append(noisy)
        shared = np.vstack([shared, current[:2]])
    return ev.regression(
        response=y,
        regressors=noisy,
        instruments=np.column_stack(instruments),
        names=["a", "b"],
        noise_covariance=current,
        instrument_noise_covariance=shared,
    )


def coverage(draw: Callable[[np.random.Generator], ev.Estimate], seed: int) -> np.ndarray:
    with shape_checks.unchecked():
        hits = np.zeros(2, dtype=int)
        with threadpool_limits(limits=1):  # the matrices are small: threads would wait for each other
            for run in range(RUNS):
                fit = draw(np.random.default_rng([seed, run]))
                ends = [fit.interval(name) for name in fit.names]
                hits += [low <= true <= high for (low, high), true in zip(ends, TRUTH, strict=True)]
    return hits


@pytest.mark.calibration
@pytest.mark.parametrize("name", METHODS)
def test_default_intervals_cover(name):
    method, kind = METHODS[name]
    hits = coverage(lambda rng: ev.identify(problem(rng, kind), method), seed=list(METHODS).index(name))
    low, high = stats.binom.ppf(CHANCE, RUNS, 0.92), stats.binom.ppf(1.0 - CHANCE, RUNS, 0.98)
    assert np.all((low <= hits) & (hits <= high)), hits / RUNS


@pytest.mark.calibration
def test_a_method_that_is_told_nothing_of_the_errors_does_not_cover():
    hits = coverage(lambda rng: ev.identify(problem(rng, "errors in regressors"), least_squares), seed=99)
    assert np.all(hits < stats.binom.ppf(CHANCE, RUNS, 0.5))
