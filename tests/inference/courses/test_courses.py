"""Drifts, steps, slopes on covariates, deviations: against least squares of others, by hand, and by draws."""

from dataclasses import replace

import numpy as np
import pytest
import statsmodels.api as sm
from scipy import stats
from statsmodels.stats.outliers_influence import OLSInfluence

from eivor.fleet.change_points import Ordered, deviation_p_values, drifts, shared_slopes, steps
from eivor.inference.random_effects import Groups


def ordered(y, sizes, *, errors=1e-12, nuisances=None, weights=None) -> Ordered:
    """Rows whose own variances are next to nothing unless said otherwise."""
    y = np.asarray(y, dtype=float)
    weights = np.ones(y.size) if weights is None else weights
    nuisances = (
        np.concatenate([np.arange(size, dtype=float) for size in sizes]) if nuisances is None else nuisances
    )
    none = np.zeros((0, y.size)), np.zeros((len(sizes), 0, 0))
    return Ordered(Groups(np.array(sizes)), y, np.full(y.size, errors), weights, weights, nuisances, *none)


def drawn(seed: int, rows: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.standard_normal(rows), rng.uniform(0.5, 2.0, rows)


def test_drifts_are_those_of_weighted_least_squares():
    y, weights = drawn(1, 19)
    result = drifts(ordered(y, [7, 12], weights=weights))
    for number, rows in enumerate((slice(0, 7), slice(7, 19))):
        position = np.arange(y[rows].size, dtype=float)
        truth = sm.WLS(y[rows], sm.add_constant(position), weights=weights[rows]).fit()
        assert result.slope[number] == pytest.approx(truth.params[1])
        assert result.std_error[number] == pytest.approx(truth.bse[1])
        assert result.p_values[number] == pytest.approx(truth.pvalues[1])
        assert result.half_widths()[number] == pytest.approx(np.diff(truth.conf_int()[1])[0] / 2)
        assert result.line[rows] == pytest.approx(truth.fittedvalues)


def test_a_drift_of_flights_at_one_time_is_not_told():
    result = drifts(ordered([1.0, 2.0, 4.0], [3], nuisances=np.zeros(3)))
    assert result.p_values[0] == 1.0
    assert result.half_widths()[0] == np.inf


def test_what_errors_say_is_a_floor():
    exact = ordered(np.arange(6.0), [6], errors=1.0)
    assert drifts(exact).std_error[0] == pytest.approx(1.0 / np.sqrt(17.5))


def test_a_step_is_the_best_of_all_pairs_of_means():
    y, weights = drawn(2, 25)
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


def test_too_few_estimates_have_no_step():
    result = steps(ordered([0.0, 0.0, 0.0, 9.0, 9.0], [5]))
    assert (result.p_values[0], result.size[0], result.half_width[0]) == (1.0, 0.0, np.inf)
    assert not result.after.any()


@pytest.mark.parametrize("size", [8, 40])
def test_the_search_for_a_place_is_counted(size):
    """Draws without a step: no more are told than the level says, and not many fewer."""
    groups = 2000
    y = np.random.default_rng(size).standard_normal(groups * size)
    share = np.mean(steps(ordered(y, [size] * groups)).p_values < 0.019)
    assert share <= 0.019 + 3 * np.sqrt(0.019 / groups)
    assert share >= 0.008


def test_slopes_are_those_of_least_squares_with_means_and_lines_of_their_own():
    rng = np.random.default_rng(3)
    sizes, position = [9, 12], np.concatenate([np.arange(9.0), np.arange(12.0)])
    x = rng.standard_normal((2, 21))
    y = (
        0.7 * x[0]
        - 0.2 * x[1]
        + np.repeat([1.0, 5.0], sizes)
        + 0.1 * position
        + 3.0 * rng.standard_normal(21)
    )
    weights = rng.uniform(0.5, 2.0, 21)
    nothing = np.zeros(2), np.full(2, np.inf)
    slopes = shared_slopes(
        Groups(np.array(sizes)), Groups(np.array([2])), y, weights, position[None, :], x, *nothing
    )
    current = np.repeat(np.eye(2), sizes, axis=0)
    truth = sm.WLS(y, np.column_stack([x.T, current, current * position[:, None]]), weights=weights).fit()
    assert truth.scale > 1.0
    assert slopes.values[0] == pytest.approx(truth.params[:2])
    assert slopes.covariance[0] == pytest.approx(truth.cov_params()[:2, :2])


def test_what_is_expected_of_a_slope_is_one_more_measurement():
    """By hand: alone where there are too few rows; a covariate that never varies has no other slope."""
    few = Groups(np.array([3])), Groups(np.array([1])), np.arange(3.0), np.ones(3), np.arange(3.0)[None, :]
    slopes = shared_slopes(*few, np.ones((1, 3)), np.array([1.0]), np.array([0.3]))
    assert slopes.values[0] == pytest.approx([1.0])
    assert slopes.covariance[0, 0] == pytest.approx([0.09])
    many = (
        Groups(np.array([20])),
        Groups(np.array([1])),
        np.arange(20.0),
        np.ones(20),
        np.arange(20.0)[None, :],
    )
    unknown = shared_slopes(*many, np.ones((1, 20)), np.zeros(1), np.full(1, np.inf))
    assert unknown.values[0, 0] == 0.0


def test_deviations_are_externally_studentized_residuals():
    y, _ = drawn(4, 12)
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


def test_a_row_that_counts_little_is_judged_by_its_own_variance_and_hides_no_other():
    """Truth: the residual of each of two far rows over the scatter of the rows that count."""
    y = np.concatenate([drawn(3, 20)[0], [40.0, 40.0]])
    weights = np.concatenate([np.ones(20), np.full(2, 1e-12)])
    rows = replace(ordered(y, [22], weights=weights), own_weights=np.ones(22))
    mean = y[:20].mean()
    p_values = deviation_p_values(rows, np.full(22, mean), weights / 20.0, np.ones(1))
    degrees = 20  # of 22 rows, one mean, and the row itself
    score = (40.0 - mean) / np.sqrt(np.sum((y[:20] - mean) ** 2) / degrees)
    assert p_values[20:] == pytest.approx(2.0 * stats.t.sf(score, degrees), rel=1e-6)
    assert (p_values[:20] > 1e-3).all()
