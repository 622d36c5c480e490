"""Joint draws have the laws that the intervals are read from, and the covariance's correlations."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import stats

import eivor as ev
from eivor.errors import EstimationError, UsageError
from eivor.inference.covariances.covariance import CovariancePart, JointCovariance
from eivor.inference.joint_draws import joint_draws
from exports.documents import CORRELATIONS, JOINT, NUMBERS, document, written

COUNT = 100_000


@pytest.mark.parametrize("degrees", [5.0, 8.0, None])
def test_marginal_laws_and_correlations(degrees: float | None, tmp_path: Path) -> None:
    draws = ev.load_fit(written(document(degrees), tmp_path)).sample(COUNT, seed=3)
    assert list(draws) == list(JOINT)
    edge = stats.norm.ppf(0.975) if degrees is None else stats.t.ppf(0.975, degrees)
    scaled = [(draws[name] - NUMBERS[name][0]) / NUMBERS[name][1] for name in JOINT]
    for one in scaled:
        assert np.median(one) == pytest.approx(0.0, abs=0.002)
        assert np.quantile(one, [0.025, 0.975]) == pytest.approx([-edge, edge], abs=0.005)
    np.testing.assert_allclose(np.corrcoef(scaled), CORRELATIONS, atol=0.01)


@pytest.mark.thorough
def test_single_draws_are_correlated_too() -> None:
    """Each call has its own strata; the correlation must not come from the number of draws."""
    covariance = JointCovariance((CovariancePart("classical", np.array([[1.0, 0.95], [0.95, 1.0]])),))
    draws = [joint_draws(np.zeros(2), covariance, 1, np.random.default_rng(seed))[0] for seed in range(200)]
    assert np.corrcoef(np.array(draws).T)[0, 1] == pytest.approx(0.95, abs=0.03)


def test_the_same_seed_gives_the_same_draws(tmp_path: Path) -> None:
    fit = ev.load_fit(written(document(), tmp_path))
    first, again, other = (fit.sample(5, seed=seed)["input_gain"] for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_what_cannot_be_negative_is_cut_as_its_interval_is(tmp_path: Path) -> None:
    draws = ev.load_fit(written(document(actuator_lag=(0.001, 0.002)), tmp_path)).sample(1000)
    assert draws["actuator_lag"].min() == 0.0
    assert np.median(draws["actuator_lag"]) == pytest.approx(0.001, abs=3e-4)
    loose = ev.load_fit(written(document(viscous_friction=(0.0, 0.1)), tmp_path)).sample(1000)
    assert loose["viscous_friction"].min() < 0.0


def test_different_degrees_keep_their_correlation() -> None:
    matrix = np.array([[1.0, 0.8], [0.8, 1.0]])
    wide = CovariancePart("robust", matrix * [[1.0, 0.1], [0.1, 0.01]], 5.0)
    plain = CovariancePart("classical", matrix * [[0.01, 0.1], [0.1, 1.0]], share=0.81)
    draws = joint_draws(np.zeros(2), JointCovariance((wide, plain)), COUNT, np.random.default_rng(1))
    assert np.corrcoef(draws.T)[0, 1] == pytest.approx(0.8, abs=0.01)
    edges = [stats.t.ppf(0.975, 5.0), stats.norm.ppf(0.975) / 0.9]
    assert np.quantile(draws, 0.975, axis=0) == pytest.approx(edges, abs=0.005)


def test_all_delays_are_drawn_as_often_as_they_fit(tmp_path: Path) -> None:
    """A delay that fits worse by 2 in the criterion is e times less likely."""
    told = document()
    (best,) = told["covariance"]["candidates"]
    other = {**best, "best": False, "excess": 2.0, "at": {"actuator_lag": 0.04, "delay": 0.01}}
    other["values"] = [0.3, 23.9, 0.04]
    told["covariance"]["candidates"].append(other)
    fit = ev.load_fit(written(told, tmp_path))
    draws = fit.sample(20_000, seed=1, delays="all")
    assert list(draws) == [*JOINT, "delay"]
    late = draws["delay"] == 0.01
    assert late.mean() == pytest.approx(1.0 / (1.0 + np.e), abs=0.01)
    assert np.median(draws["actuator_lag"][late]) == pytest.approx(0.04, abs=1e-4)
    assert np.median(draws["actuator_lag"][~late]) == pytest.approx(0.05, abs=1e-4)
    assert not np.all(np.diff(late.astype(int)) >= 0)
    assert list(fit.sample(10)) == list(JOINT)


@pytest.mark.usefixtures("unchecked_shapes")
def test_other_delays_are_told(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="delays 'best' or 'all'"):
        ev.load_fit(written(document(), tmp_path)).sample(10, delays="some")


def test_what_cannot_be_drawn_is_told(tmp_path: Path) -> None:
    fit = ev.load_fit(written(document(degrees=2.0), tmp_path))
    with pytest.raises(EstimationError, match="degrees of freedom"):
        fit.sample(10)
    for n, seed in ((0, 1), (10**8, 1), (5, -1)):
        with pytest.raises(UsageError, match="10,000,000 draws"):
            fit.sample(n, seed)
    nothing = document()
    nothing["covariance"] = None
    with pytest.raises(EstimationError, match="with an estimate"):
        ev.load_fit(written(nothing, tmp_path)).sample(10)


def test_hover_of_joint_draws_is_as_narrow_as_the_gain(tmp_path: Path) -> None:
    """Mass and thrust drawn each by itself lose the ratio that a flight tells."""
    draws = ev.load_fit(written(document(), tmp_path)).sample(10_000)
    joint = 9.80665 / draws["input_gain"]
    rng = np.random.default_rng(1)
    boxes = rng.uniform(0.95, 1.05, 10_000) / rng.uniform(0.95, 1.05, 10_000)
    assert 8.0 * joint.std() / joint.mean() < boxes.std()
