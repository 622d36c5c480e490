"""Means of estimates that differ: against other people's programs, by hand, and by draws."""

import numpy as np
import pytest
from scipy import special
from statsmodels.stats.meta_analysis import combine_effects

from eivor.inference.random_effects import (
    Groups,
    between_distribution,
    moment_between,
    one_group,
    paule_mandel,
    q_profile,
    random_effects_means,
)

Y = np.array([0.1, 0.3, 0.8, 0.2])
V = np.array([0.01, 0.02, 0.01, 0.04])


def drawn(seed: int, sizes: list[int], between: float) -> tuple[Groups, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    rows = sum(sizes)
    errors = rng.uniform(0.01, 0.05, rows)
    return (
        Groups(np.array(sizes)),
        0.3 + np.hypot(between, errors) * rng.standard_normal(rows),
        errors**2,
    )


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


def test_pymare_gives_the_same_interval_of_the_variance_between():
    """PyMARE 0.0.13: ``q_profile(Y[:, None], V[:, None], np.ones((4, 1)))``, and DerSimonianLaird's tau2."""
    low, high = q_profile(one_group(4), Y, V)
    assert low[0] == pytest.approx(0.019482394633919074, abs=1e-6)
    assert high[0] == pytest.approx(1.3314842698242637, abs=1e-6)
    moments = moment_between(one_group(4), Y, V)
    assert moments[0] == pytest.approx(0.12309523809523817, abs=1e-9)
    means = random_effects_means(one_group(4), Y, V, moments)
    assert means.value[0] == pytest.approx(0.3582979087615189, abs=1e-9)


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


def test_groups_at_once_are_as_one_by_one():
    groups, y, v = drawn(5, [3, 1, 7], 0.03)
    means = random_effects_means(groups, y, v, paule_mandel(groups, y, v))
    next_half_widths = between_distribution(groups, y, v).next_half_widths(means.value)
    for number, (start, size) in enumerate(zip(groups.starts, groups.sizes, strict=True)):
        group, rows = one_group(int(size)), slice(start, start + size)
        alone = random_effects_means(group, y[rows], v[rows], paule_mandel(group, y[rows], v[rows]))
        assert alone.value[0] == pytest.approx(means.value[number], rel=1e-12)
        assert alone.half_widths()[0] == pytest.approx(means.half_widths()[number], rel=1e-9)
        assert between_distribution(group, y[rows], v[rows]).next_half_widths(alone.value)[
            0
        ] == pytest.approx(next_half_widths[number], rel=1e-6)
    assert means.half_widths()[1] == np.inf
    assert next_half_widths[1] == np.inf
    assert [end[1] for end in q_profile(groups, y, v)] == [0.0, np.inf]


def test_the_mean_of_estimates_that_differ_counts_the_differences():
    """By hand: equal variances v give equal weights, and the variance of the estimates over n."""
    y, v = np.array([0.1, 0.3, 0.8]), np.full(3, 1e-4)
    for between in (moment_between, paule_mandel):
        means = random_effects_means(one_group(3), y, v, between(one_group(3), y, v))
        assert means.value[0] == pytest.approx(0.4)
        assert means.between[0] == pytest.approx(np.var(y, ddof=1) - 1e-4)
        assert means.variance[0] == pytest.approx(np.var(y, ddof=1) / 3.0)
    # estimates closer to each other than their errors: never below what these say
    same = np.full(3, 0.4)
    close = random_effects_means(one_group(3), same, v, paule_mandel(one_group(3), same, v))
    assert close.variance[0] == pytest.approx(1e-4 / 3.0)


def test_groups_that_go_together_have_one_variance_between():
    """By hand: with equal v it is the pooled variance of the rows about the means of their groups, less v."""
    groups, y = Groups(np.array([2, 3, 1])), np.array([0.0, 0.2, 1.0, 1.3, 1.6, 5.0])
    v = np.full(6, 1e-3)
    mandel = paule_mandel(groups, y, v, together=one_group(3))
    assert mandel == pytest.approx(np.full(3, (0.02 + 0.18) / 3.0 - 1e-3))


@pytest.mark.parametrize("between", [0.0, 0.02, 0.05])
def test_the_prediction_is_that_of_draws_from_the_confidence_distribution(between):
    """Second route: Q at the truth is chi-square, so solve Q(t) = draw, then draw the mean and the next."""
    groups, y, v = drawn(8, [5], between)
    centre = random_effects_means(groups, y, v, paule_mandel(groups, y, v)).value
    half = between_distribution(groups, y, v).next_half_widths(centre)[0]
    rng = np.random.default_rng(0)
    draws = 4000
    t = np.geomspace(1e-9, 1e3, 4000)
    weights = 1.0 / (v + t[:, None])
    means = weights @ y / weights.sum(axis=1)
    q = (weights * (y - means[:, None]) ** 2).sum(axis=1)
    index = np.clip(np.searchsorted(-q, -rng.chisquare(4, draws)), 0, t.size - 1)
    following = means[index] + np.sqrt(1.0 / weights.sum(axis=1) + t)[index] * rng.standard_normal(draws)
    inside = np.mean(np.abs(following - centre) <= half)
    assert inside == pytest.approx(0.95, abs=4 * np.sqrt(0.95 * 0.05 / draws))


@pytest.mark.parametrize("between", [0.0, 0.05, 0.5])
def test_the_mean_of_estimates_with_equal_errors_is_no_longer_than_students(between):
    """Truth: with equal v and a clear variance between, mixture and Hartung-Knapp are Student's t both."""
    groups, y, _ = drawn(4, [6], between)
    v = np.full(6, 1e-4)
    means = random_effects_means(groups, y, v, paule_mandel(groups, y, v))
    half = between_distribution(groups, y, v).mean_half_widths(means)[0]
    assert half >= means.half_widths()[0]
    if between == 0.5:
        assert half == pytest.approx(special.stdtrit(5, 0.975) * np.std(y, ddof=1) / np.sqrt(6), rel=0.01)


def test_the_prediction_of_many_that_agree_is_what_their_mean_says():
    """A thousand estimates of one value: the next is within little more of it than chance says."""
    groups, y, v = drawn(2, [1000], 0.0)
    half = between_distribution(groups, y, v).next_half_widths(np.array([np.average(y, weights=1.0 / v)]))[0]
    assert 0.0 < half < 0.012
    wide = drawn(2, [1000], 0.3)
    known = between_distribution(*wide).next_half_widths(np.array([wide[1].mean()]))[0]
    assert known == pytest.approx(special.ndtri(0.975) * 0.3, rel=0.05)
