"""Covariances: their scale on white noise, their coverage on autocorrelated noise, and explicit formulas."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from scipy.signal import lfilter

from eivor.errors import UsageError
from eivor.inference.covariance import (
    COSINE_AVERAGES,
    FLIGHT_DEFAULT,
    CovariancePart,
    JointCovariance,
    cosine_covariance,
    long_run_mean_variance,
    sandwich,
)
from eivor.inference.distributions import chi_square_quantile, chi_square_tail, normal_quantile, t_quantile
from eivor.inference.estimating_equation import EquationRows, EstimatingEquation
from eivor.inference.kernel import bartlett_covariance, newey_west_bandwidth

ONE_FLIGHT = np.zeros(400, dtype=np.int64)


def least_squares_equation(G, e, flight_of_row):
    rows = EquationRows(G, e, G * e[:, None], flight_of_row)
    return EstimatingEquation(np.eye(G.shape[1]), G.T @ G, e.size, lambda: [rows])


def test_cosine_averages_are_their_formula():
    scores = np.random.default_rng(0).standard_normal((50, 2))
    L = [
        np.sqrt(2.0 / 50) * sum(scores[t - 1] * np.cos(np.pi * j * (t - 0.5) / 50) for t in range(1, 51))
        for j in range(1, 9)
    ]
    wanted = 50.0 / 8.0 * sum(np.outer(l, l) for l in L)  # noqa: E741 - the equation's letter
    np.testing.assert_allclose(cosine_covariance([scores], scores.shape[0]), wanted, rtol=1e-10)
    # A constant is not in them: scores need not be centred.
    np.testing.assert_allclose(cosine_covariance([scores + 7.0], scores.shape[0]), wanted, rtol=1e-9)


def test_cosine_averages_of_white_noise_agree_with_its_variance():
    """B V / (N s^2) is chi-square on B degrees of freedom: its mean, and its whole distribution."""
    runs, count, std = 2000, 300, 1.7
    rng = np.random.default_rng(1)
    result = np.array(
        [cosine_covariance([std * rng.standard_normal((count, 1))], count)[0, 0] for _ in range(runs)]
    )
    ratio = result / (count * std**2)
    error = np.sqrt(2.0 / COSINE_AVERAGES / runs)
    assert abs(ratio.mean() - 1.0) < 4.0 * error
    assert stats.kstest(COSINE_AVERAGES * ratio, stats.chi2(COSINE_AVERAGES).cdf).pvalue > 1e-4


def test_robust_covariance_agrees_with_the_white_one_on_white_noise():
    runs, rng = 600, np.random.default_rng(2)
    ratios = []
    for _ in range(runs):
        G = rng.standard_normal((400, 2))
        e = rng.standard_normal(400)
        made = FLIGHT_DEFAULT.joint(least_squares_equation(G, e, ONE_FLIGHT))
        assert [part.name for part in made.parts] == ["equal_weighted_cosines", "classical"]
        robust, classical = (part.matrix for part in made.parts)
        np.testing.assert_allclose(classical, np.linalg.inv(G.T @ G) * (e @ e) / 398, rtol=1e-9)
        ratios.append(np.diag(robust) / np.diag(np.linalg.inv(G.T @ G)))
    error = np.sqrt(2.0 / COSINE_AVERAGES / runs)
    assert np.all(np.abs(np.mean(ratios, axis=0) - 1.0) < 4.5 * error)


@pytest.mark.calibration
@pytest.mark.parametrize("memory", [0.0, 0.6, 0.9])
def test_intervals_of_a_mean_cover_in_autocorrelated_noise(memory):
    runs, count, level = 2000, 2000, 0.95
    noise = lfilter(
        [1.0], [1.0, -memory], np.random.default_rng(3).standard_normal((count + 200, runs)), axis=0
    )
    noise = noise[200:]
    half = t_quantile(level, COSINE_AVERAGES) * np.sqrt(
        [long_run_mean_variance(noise[:, run].copy()) for run in range(runs)]
    )
    covered = int((np.abs(noise.mean(axis=0)) <= half).sum())
    low, high = stats.binom.ppf([5e-5, 1.0 - 5e-5], runs, level)
    assert low <= covered <= high
    # The white formula, which intervals must not rest on here, fails by far when there is memory.
    white = normal_quantile(level) * noise.std(axis=0) / np.sqrt(count)
    naive = int((np.abs(noise.mean(axis=0)) <= white).sum())
    assert (naive < low) == (memory > 0.0)


@given(seed=st.integers(0, 999), scale=st.sampled_from([1e-9, 1.0, 1e9]))
def test_sandwich_is_its_formula_in_any_units(seed, scale):
    rng = np.random.default_rng(seed)
    M = rng.standard_normal((3, 3)) + 3.0 * np.eye(3)
    root = rng.standard_normal((3, 5))
    inverse = np.linalg.inv(M)
    wanted = inverse @ (root @ root.T) @ inverse.T
    units = np.diag([1.0, scale, 1.0])
    result = sandwich(units @ M @ units, units @ root @ root.T @ units)
    np.testing.assert_allclose(units @ result @ units, wanted, rtol=1e-7, atol=1e-9 * np.abs(wanted).max())
    np.testing.assert_array_equal(result, result.T)


@pytest.mark.parametrize("flights", [3, 9, 10, 15])
def test_clusters_count_from_ten_flights_on(flights):
    rng = np.random.default_rng(4)
    rows = 20 * flights
    G, flight_of_row = rng.standard_normal((rows, 2)), np.repeat(np.arange(flights), 20)
    # The whole of a flight shares its error: only the clustered covariance knows.
    e = np.repeat(rng.standard_normal(flights), 20) * G[:, 0] + 0.1 * rng.standard_normal(rows)
    made = FLIGHT_DEFAULT.joint(least_squares_equation(G, e, flight_of_row))
    if flights < 10:
        assert [part.name for part in made.parts] == ["equal_weighted_cosines", "classical"]
        return
    clustered = made.part("clustered")
    assert clustered.degrees == flights - 1
    sums = np.array([(G * e[:, None])[flight_of_row == f].sum(axis=0) for f in range(flights)])
    inverse = np.linalg.inv(G.T @ G)
    wanted = flights * inverse @ np.cov(sums.T) @ inverse
    np.testing.assert_allclose(clustered.matrix, wanted, rtol=1e-9)
    direction = np.array([1.0, 0.0])
    assert made.half_width(direction) >= stats.t(flights - 1).ppf(0.975) * np.sqrt(wanted[0, 0]) * (1 - 1e-12)


def test_widest_assumption_makes_the_interval():
    white, robust, clustered = np.diag([4.0, 1.0]), np.diag([1.0, 9.0]), np.diag([0.5, 0.1])
    parts = (
        CovariancePart("robust", robust, 8.0),
        CovariancePart("white", white),
        CovariancePart("clustered", clustered, 11.0),
    )
    made = JointCovariance(parts)
    first, second = np.eye(2)
    assert made.std_error(first) == 2.0
    assert made.std_error(second) == 3.0
    assert made.half_width(first) == pytest.approx(stats.norm.ppf(0.975) * 2.0)
    assert made.half_width(second) == pytest.approx(stats.t(8).ppf(0.975) * 3.0)
    assert made.half_width(second, 0.5) == pytest.approx(stats.t(8).ppf(0.75) * 3.0)
    assert made.half_width(first, extra_variance=5.0) == pytest.approx(
        max(stats.norm.ppf(0.975) * 3.0, stats.t(8).ppf(0.975) * np.sqrt(6.0))
    )
    np.testing.assert_allclose(np.diag(made.matrix), [4.0, 9.0])
    tilted = JointCovariance((CovariancePart("robust", np.array([[1.0, 0.6], [0.6, 9.0]])), parts[1]))
    with pytest.raises(UsageError, match="out of robust, white; received 'grey'"):
        tilted.part("grey")
    np.testing.assert_allclose(tilted.matrix[0, 1] / np.sqrt(4.0 * 9.0), 0.6 / 3.0)


# -- kernels and quantiles --------------------------------------------------------------------------------


@pytest.mark.thorough
@given(count=st.integers(1, 30), bandwidth=st.integers(0, 40), seed=st.integers(0, 99))
def test_bartlett_covariance_is_its_double_sum(count, bandwidth, seed):
    scores = np.random.default_rng(seed).standard_normal((count, 2))
    wanted = np.zeros((2, 2))
    for t in range(count):
        for s in range(count):
            weight = max(0.0, 1.0 - abs(t - s) / (bandwidth + 1.0))
            wanted += weight * np.outer(scores[t], scores[s]) / count
    covariance = bartlett_covariance(scores, bandwidth)
    np.testing.assert_allclose(covariance, wanted, atol=1e-12)
    assert np.linalg.eigvalsh(covariance)[0] > -1e-12


def test_rule_of_thumb_and_quantiles_are_the_published_ones():
    assert [newey_west_bandwidth(n) for n in (100, 1000, 100_000)] == [4, 6, 18]
    assert normal_quantile(0.95) == pytest.approx(1.959963984540054)
    assert t_quantile(0.95, 8) == pytest.approx(2.306004135204166)
    assert t_quantile(0.95, 0) == float("inf")
    assert chi_square_quantile(0.95) == pytest.approx(3.841458820694124)
    # Tails are not one minus a distribution: this one is far below the rounding of one.
    assert chi_square_tail(400.0, 3) == pytest.approx(stats.chi2(3).sf(400.0), rel=1e-10)
    assert 0.0 < chi_square_tail(400.0, 3) < 1e-80
