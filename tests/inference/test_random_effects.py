"""Means of estimates that differ: against other people's programs, by hand, and by draws."""

from __future__ import annotations

import numpy as np
import pytest
import statsmodels.api as sm
from scipy import stats
from statsmodels.stats.meta_analysis import combine_effects
from statsmodels.stats.outliers_influence import OLSInfluence

from eivor.fleet.change_points import Ordered, deviation_p_values, drifts, outlier_test, steps
from eivor.inference.random_effects import (
    Groups,
    moment_between,
    one_group,
    paule_mandel,
    q_profile,
    random_effects_means,
)


def drawn(seed, sizes, between):
    rng = np.random.default_rng(seed)
    rows = sum(sizes)
    errors = rng.uniform(0.01, 0.05, rows)
    return (Groups(np.array(sizes)), 0.3 + np.hypot(between, errors) * rng.standard_normal(rows), errors**2)


@pytest.mark.parametrize("between", [0.1, 0.2, 0.4])
def test_statsmodels_gives_the_same_variances_between_and_means(between):
    groups, y, v = drawn(3, [4, 9, 20], between)  # of two estimates its iteration does not converge
    means = random_effects_means(groups, y, v, paule_mandel(groups, y, v))
    moments = moment_between(groups, y, v)
    for number, start in enumerate(groups.starts):
        rows = slice(start, start + groups.sizes[number])
        iterated = combine_effects(y[rows], v[rows], method_re="iterated", use_t=True, atol=1e-12)
        assert means.between[number] == pytest.approx(max(iterated.tau2, 0.0), abs=1e-6)
        assert means.value[number] == pytest.approx(iterated.mean_effect_re, abs=1e-6)
        plain = iterated.sd_eff_w_re_hksj if iterated.scale_hksj_re >= 1.0 else iterated.sd_eff_w_re
        assert np.sqrt(means.variance[number]) == pytest.approx(plain, abs=1e-6)
        assert moments[number] == pytest.approx(
            max(combine_effects(y[rows], v[rows], method_re="dl").tau2, 0.0), abs=1e-9
        )


def test_pymare_gives_the_same_of_flights_as_they_are():
    """The same of nine logarithms of a gain whose errors are unlike."""
    y = np.array([3.61, 3.64, 3.58, 3.70, 3.55, 3.66, 3.49, 3.63, 3.60])
    v = np.array([0.02, 0.03, 0.01, 0.05, 0.02, 0.04, 0.03, 0.015, 0.025]) ** 2
    low, high = q_profile(one_group(9), y, v, near=np.array([1.0]))
    assert (low[0], high[0]) == pytest.approx((0.0006566118607090315, 0.012827818979102555), abs=1e-6)
    moments = moment_between(one_group(9), y, v)
    assert moments[0] == pytest.approx(0.00144084, abs=1e-8)
    means = random_effects_means(one_group(9), y, v, moments)
    assert means.value[0] == pytest.approx(3.59964825, abs=1e-6)


def ordered(y, sizes, *, errors=1e-12, nuisances=None, weights=None):
    """Rows whose own variances are next to nothing unless said otherwise."""
    y = np.asarray(y, dtype=float)
    weights = np.ones(y.size) if weights is None else weights
    nuisances = (
        np.concatenate([np.arange(size, dtype=float) for size in sizes]) if nuisances is None else nuisances
    )
    none = np.zeros((0, y.size)), np.zeros((len(sizes), 0, 0))
    return Ordered(Groups(np.array(sizes)), y, np.full(y.size, errors), weights, weights, nuisances, *none)


def drawn_courses(seed, rows):
    rng = np.random.default_rng(seed)
    return rng.standard_normal(rows), rng.uniform(0.5, 2.0, rows)


def test_a_step_is_the_best_of_all_pairs_of_means():
    y, weights = drawn_courses(2, 25)
    y[6:15] += 5.0  # the first group, of 15, after its sixth
    result = steps(ordered(y, [15, 10], weights=weights))
    for number, rows in enumerate((slice(0, 15), slice(15, 25))):
        current, w = y[rows], weights[rows]
        after = [np.arange(current.size) >= item for item in range(3, current.size - 2)]
        fits = [sm.WLS(current, sm.add_constant(item.astype(float)), weights=w).fit() for item in after]
        best = max(fits, key=lambda fit: abs(fit.tvalues[1]))
        assert result.index[number] == 3 + fits.index(best)
        assert result.size[number] == pytest.approx(best.params[1])
        assert result.half_width[number] == pytest.approx(np.diff(best.conf_int()[1])[0] / 2)
        assert result.squares[number] == pytest.approx(best.ssr)
        line = ordered(current, [current.size], weights=w)
        assert steps(line).after == pytest.approx(after[fits.index(best)])
        # between what one test and all of them would say
        assert best.pvalues[1] <= result.p_values[number] <= min(1.0, len(fits) * best.pvalues[1])
        assert result.first[number] <= result.index[number] <= result.last[number]
    assert result.index[0] == 6
    assert result.p_values[0] < 0.01 < result.p_values[1]


def test_deviations_are_externally_studentized_residuals():
    y, _ = drawn_courses(4, 12)
    y[5] += 6.0
    made = ordered(y, [12])
    result = drifts(made)
    p_values = deviation_p_values(made, result.line, result.leverage, np.array([2.0]))
    truth = OLSInfluence(sm.OLS(y, sm.add_constant(np.arange(12.0))).fit())
    far = np.abs(truth.resid_studentized_external) > 2.0
    assert far[5]
    expected = 2 * stats.t.sf(np.abs(truth.resid_studentized_external), 9)
    assert p_values[far] == pytest.approx(expected[far])
    assert (p_values[~far] == 1.0).all()


def added(y, sizes, sets=None):
    """What is added to variances of 1e-4, the groups a set unless said otherwise."""
    v = np.full(y.size, 1e-4)
    return outlier_test(Groups(np.array(sizes)), sets or one_group(len(sizes)), v)(y)


def noise(seed, rows):
    return 0.004 * np.random.default_rng(seed).standard_normal(rows)


@pytest.mark.parametrize("place", [3, 4, 10, 16, 17])
@pytest.mark.parametrize("size", [0.05, 0.5, -5.0])
def test_steps_and_drifts_are_courses(place, size):
    y = noise(2, 20)
    y[place:] += size
    assert not added(y, [20]).any()
    assert not added(noise(2, 20) + np.linspace(0.0, size, 20), [20]).any()


def test_few_of_normal_estimates_are_isolated():
    sizes = [40] * 250
    assert 0.0 < np.mean(added(2.5 * noise(8, 10_000), sizes) > 0.0) < 0.006
