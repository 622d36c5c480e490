"""Whiteness, memory and excitation: formulas written out, sizes, and known orders."""

from __future__ import annotations

import instrument_data as data
import numpy as np
import pytest
from scipy import stats

from eivor.inference.diagnostics.excitation import (
    Periodicity,
    band_power,
    block_sums,
    blocks_of,
    strongest_swings,
)
from eivor.inference.diagnostics.record import Subject
from eivor.inference.diagnostics.residuals import (
    GROUPS,
    LONGEST,
    QUANTILES,
    TAILS,
    constancy,
    influences,
    p_value,
    residual_memory,
    residual_whiteness,
    segment_leverage,
    wald_path,
)
from eivor.inference.verdict import Status
from eivor.signals.noise import fractional_difference


def test_whiteness_is_its_formulas():
    e = data.autoregression(np.random.default_rng(0), (70_000,), 0.3)  # longer than a block
    whiteness = residual_whiteness(e, 12)
    r = np.array([e[lag:] @ e[:-lag] for lag in range(1, 13)]) / (e @ e)
    np.testing.assert_allclose(whiteness.autocorrelation, r, rtol=1e-9)
    Q = e.size * (e.size + 2) * sum(r[lag - 1] ** 2 / (e.size - lag) for lag in range(1, 13))
    assert whiteness.ljung_box == pytest.approx(Q, rel=1e-9)
    assert whiteness.durbin_watson == pytest.approx(np.sum(np.diff(e) ** 2) / np.sum(e**2), rel=1e-9)
    assert whiteness.band == pytest.approx(stats.norm.ppf(0.975) / np.sqrt(e.size), rel=1e-9)
    assert whiteness.outside == int((np.abs(r) > whiteness.band).sum())


@pytest.mark.thorough
def test_statsmodels_ljung_box():
    diagnostic = pytest.importorskip("statsmodels.stats.diagnostic")
    e = data.autoregression(np.random.default_rng(1), (500,), 0.1)
    e -= e.mean()
    peer = diagnostic.acorr_ljungbox(e, lags=[20])
    whiteness = residual_whiteness(e)
    assert whiteness.ljung_box == pytest.approx(float(peer["lb_stat"].iloc[0]), rel=1e-6)
    assert whiteness.p_value == pytest.approx(float(peer["lb_pvalue"].iloc[0]), rel=1e-6)


def test_a_residual_of_zeros_or_of_few_samples_is_white():
    assert residual_whiteness(np.zeros(100)).p_value == 1.0
    assert residual_whiteness(np.zeros(100)).durbin_watson == 2.0
    assert residual_whiteness(np.array([1.0, -1.0, 1.0])).autocorrelation.size == 1


@pytest.mark.parametrize("memory", [0.0, 0.3, 0.45])
def test_memory_of_a_long_record_is_found_from_its_means(memory):
    """Fractional noises of 40,000 samples, averaged five to one: the error is the one that is told."""
    runs, z = 60, []
    for seed in range(runs):
        white = np.random.default_rng(seed).standard_normal(5 * LONGEST)
        result = residual_memory(np.asarray(fractional_difference(white, -memory)))
        z.append((result.memory - memory) / result.order_error)
    assert abs(np.mean(z)) < 4.0 / np.sqrt(runs) + 0.3  # the noise starts with its record, hence the .3
    assert 0.6 < np.std(z) < 1.4


def test_memory_needs_a_record():
    assert residual_memory(np.zeros(1000)) is None
    assert residual_memory(np.ones(1000) * 3.3) is None
    assert residual_memory(np.arange(16.0)) is None


def test_where_the_input_is_below_the_residual():
    """A sine lifts its own band above the residual and no other."""
    count, rate = 8192, 10.0
    t = np.arange(count) / rate
    power = band_power(
        [np.sin(2.0 * np.pi * 0.5 * t)], [1.0], np.random.default_rng(4).standard_normal(count), rate_hz=rate
    )
    inside = (power.low_hz <= 0.5) & (power.high_hz >= 0.5)
    assert power.excited[inside, 0].all()
    assert not power.excited[~inside, 0].any()
    assert power.share_above[0] > 0.99


def tenths(count):
    """Stretches of ten rows each."""
    return tuple((10 * k, 10 * k + 10) for k in range(count))


def scores_of(seed, count=2560, memory=0.0, change=0.0, nuisances=0.6):
    """Least squares of y on two columns, the first one's parameter changing; scores, M, and the rows."""
    rng = np.random.default_rng(seed)
    X = data.autoregression(rng, (count, 2), memory)
    slope = np.where(np.arange(count) < nuisances * count, 1.0, 1.0 + change)
    y = slope * X[:, 0] - 0.5 * X[:, 1] + data.autoregression(rng, (count,), memory)
    theta = np.linalg.lstsq(X, y, rcond=None)[0]
    return X * (y - X @ theta)[:, None], X.T @ X, X, y


def constancy_of(seed, **circumstances):
    scores, M, *_ = scores_of(seed, **circumstances)
    return constancy(scores.reshape(128, -1, 2).sum(axis=1), M)


def test_wald_path_is_its_formula():
    groups = np.random.default_rng(0).standard_normal((GROUPS, 2)) @ np.array([[1.0, 0.3], [0.0, 2.0]])
    path = wald_path(groups)
    assert path.size == GROUPS - 20 + 1
    for k in (10, 31, 54):
        S = np.zeros((2, 2))
        for side in (groups[:k], groups[k:]):
            size = len(side)
            for j in range(1, 7):
                L = np.sqrt(2.0 / size) * sum(
                    side[t] * np.cos(np.pi * j * (t + 0.5) / size) for t in range(size)
                )
                S += np.outer(L, L) / 12.0
        difference = groups[:k].mean(axis=0) - groups[k:].mean(axis=0)
        W = difference @ np.linalg.solve(S * (1.0 / k + 1.0 / (GROUPS - k)), difference)
        assert path[k - 10] == pytest.approx(W * (12 - 2 + 1) / (12 * 2), rel=1e-6)


@pytest.mark.thorough
@pytest.mark.parametrize("unknowns", [1, 2, 3, 6])
def test_table_is_what_the_simulation_draws(unknowns):
    """Shares of a fresh simulation beyond each quantile, within their binomial error."""
    runs = 3000
    rng = np.random.default_rng(100 + unknowns)
    suprema = np.array([wald_path(rng.standard_normal((GROUPS, unknowns))).max() for _ in range(runs)])
    for tail, quantile in zip(TAILS[:6], QUANTILES[unknowns], strict=False):
        low, high = stats.binom.ppf([1e-4, 1.0 - 1e-4], runs, tail)
        assert low <= np.sum(suprema > quantile) <= high
        assert p_value(quantile, unknowns) == pytest.approx(tail)
    assert p_value(1e9, unknowns) == pytest.approx(0.001)
    assert p_value(0.0, unknowns) == pytest.approx(0.5)


@pytest.mark.calibration
@pytest.mark.parametrize("memory", [0.0, 0.8])
def test_size_with_constant_parameters(memory):
    runs = 600
    results = [constancy_of(seed, memory=memory) for seed in range(runs)]
    low, high = stats.binom.ppf([1e-4, 1.0 - 1e-4], runs, [0.04, 0.06])
    assert low <= sum(result.p_value < 0.05 for result in results) <= high
    for j in (0, 1):
        assert low <= sum(result.p_values[j] < 0.05 for result in results) <= high


def test_a_change_is_found_where_and_what_it_is():
    results = [constancy_of(seed, change=0.5, memory=0.5) for seed in range(60)]
    assert sum(result.p_value < 0.05 for result in results) > 50
    assert np.median([result.break_at for result in results]) == pytest.approx(0.6, abs=0.02)
    changes = np.array([result.change for result in results])
    error = changes.std(axis=0) / np.sqrt(len(results))
    np.testing.assert_array_less(np.abs(changes.mean(axis=0) - [0.5, 0.0]), 4.0 * error + 0.03)
    # power does not fall as the change grows: either side has a covariance of its own
    assert sum(constancy_of(seed, change=5.0, memory=0.5).p_value < 0.05 for seed in range(60)) == 60


def test_scores_of_zero_are_constant():
    assert constancy(np.zeros((64, 2)), np.eye(2)).p_value == pytest.approx(0.5)


def test_leverage_is_the_estimate_without_the_stretch():
    scores, _, X, y = scores_of(4)
    theta = np.linalg.lstsq(X, y, rcond=None)[0]
    sums = scores.reshape(10, -1, 2).sum(axis=1)
    current = np.einsum("kti,ktj->kij", X.reshape(10, -1, 2), X.reshape(10, -1, 2))
    leverage = segment_leverage(sums, current, np.array([0.1, 0.2]), tenths(len(sums)))
    for k in range(10):
        rest = np.ones(len(y), dtype=bool)
        rest[k * 256 : (k + 1) * 256] = False
        again = np.linalg.lstsq(X[rest], y[rest], rcond=None)[0]
        np.testing.assert_allclose(leverage.shift[k], again - theta, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(leverage.in_std_errors, leverage.shift / [0.1, 0.2])
    most = np.argmax(np.abs(leverage.in_std_errors), axis=0)
    np.testing.assert_array_equal(leverage.most, most)
    np.testing.assert_allclose(leverage.largest, leverage.in_std_errors[most, [0, 1]])


STEP = 0.05
BLOCKS = 128
SUBJECT = Subject(("slope", "other"), np.ones(2), str, 2560)


def found_of(seed, *, slope=0.0, pushed=0.0, period=5.0, memory=0.5, count=2560, gap=False):
    """Least squares of y on two columns and a constant; the first one's parameter, or a push, swings."""
    rng = np.random.default_rng(seed)
    X = np.column_stack([data.autoregression(rng, (count, 2), 0.95), np.ones(count)])
    times = STEP * (np.arange(count) + (np.arange(count) > count // 3) * 333 * gap)
    swing = np.cos(2.0 * np.pi * times / period + 1.0)
    y = (1.0 + slope * swing) * X[:, 0] - 0.5 * X[:, 1] + pushed * swing
    y += data.autoregression(rng, (count,), memory)
    residual = y - X @ np.linalg.lstsq(X, y, rcond=None)[0]
    sums = (X[:, :2] * residual[:, None]).reshape(BLOCKS, -1, 2).sum(axis=1)
    made = influences(sums, X[:, :2].T @ X[:, :2])
    counts = np.full(BLOCKS, count / BLOCKS)
    of_parameters = block_sums(made, counts, times, STEP)
    return Periodicity(
        strongest_swings(of_parameters, (("slope", "N/m"), ("other", ""))),
        strongest_swings(blocks_of(residual, times, STEP, BLOCKS), (("push", "N"),), 1.0 / count),
        "s",
        1.0 / of_parameters.span,
    )


@pytest.mark.parametrize("gap", [False, True])
@pytest.mark.parametrize(("what", "of"), [("slope", "slope"), ("pushed", "push")])
def test_what_swings_is_named_with_period_and_amplitude(what, of, gap):
    for seed in range(5):
        result = found_of(seed, gap=gap, **{what: 0.8})
        assert result.speaks
        assert result.strongest.of == of
        assert result.strongest.period == pytest.approx(5.0, rel=0.03)
        assert result.strongest.amplitude == pytest.approx(0.8, rel=0.35)


def test_a_parameter_that_pushes_too_is_the_one_that_varies():
    result = found_of(1, slope=0.8, pushed=1.0)
    assert min(result.tested, key=lambda item: item.p_value).of == "push"
    assert result.strongest.of == "slope"


def test_sentences_have_number_unit_and_period():
    parameter, push = found_of(1, slope=0.8), found_of(1, pushed=0.8)
    (weak,), (reported,) = list(parameter.reasons(SUBJECT)), list(push.reasons(SUBJECT))
    assert weak.status is Status.WEAK
    assert weak.sentence.startswith(f"slope varies by {parameter.strongest.extent} with a period of ")
    assert parameter.strongest.extent.endswith(" N/m")
    assert reported.status is Status.IDENTIFIED
    assert f"swings by {push.strongest.extent} with a period of" in reported.sentence
    assert not list(found_of(1).reasons(SUBJECT))
    assert [row.of for row in push.rows(SUBJECT)] == ["", *2 * ["slope"], *2 * ["other"], *2 * ["push"]]
    assert "most likely push by" in next(iter(push.lines(SUBJECT)))


def test_few_blocks_and_no_power_say_nothing():
    few = blocks_of(np.ones(31), STEP * np.arange(31), STEP, 31)
    assert strongest_swings(few, (("a", ""),)) == ()
    still = blocks_of(np.ones(640), STEP * np.arange(640), STEP, 64)
    assert strongest_swings(still, (("a", ""),))[0].p_value == 1.0
