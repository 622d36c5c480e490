"""Joint draws have the laws that the intervals are read from, and the covariance's correlations."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

import eivor as ev
from eivor.errors import EstimationError, UsageError
from eivor.inference.covariance import CovariancePart, JointCovariance, joint_draws
from eivor.inference.distributions import shares_in_order
from exports.documents import CORRELATIONS, JOINT, NUMBERS, document, written

COUNT = 100_000


@pytest.mark.parametrize("degrees", [5.0, 8.0, None])
def test_marginal_laws_and_correlations(degrees: float | None, tmp_path: Path) -> None:
    draws = ev.load_fit(written(document(degrees), tmp_path)).sample(COUNT, seed=3)
    assert list(draws) == list(JOINT)
    edge = stats.norm.ppf(0.975) if degrees is None else stats.t.ppf(0.975, degrees)
    scaled = [(draws[name] - NUMBERS[name][0]) / NUMBERS[name][1] for name in JOINT]
    for item in scaled:
        assert np.median(item) == pytest.approx(0.0, abs=0.002)
        assert np.quantile(item, [0.025, 0.975]) == pytest.approx([-edge, edge], abs=0.005)
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


def at_delays(*others: tuple[float, float, float]) -> dict[str, Any]:
    """A document whose best candidate has no delay, with others: delay, lag, and excess of the criterion."""
    reported = document()
    (best,) = reported["covariance"]["candidates"]
    for delay, lag, excess in others:
        other = {**best, "best": False, "excess": excess, "at": {"actuator_lag": lag, "delay": delay}}
        reported["covariance"]["candidates"].append({**other, "values": [0.3, 23.9, lag]})
    return reported


def test_delays_are_drawn_by_their_confidence_distribution(tmp_path: Path) -> None:
    """Halfway to one that fits worse by 4 is one standard error; candidates may stand in any order."""
    delays = at_delays((0.02, 0.03, 16.0), (0.01, 0.04, 4.0))
    fit = ev.load_fit(written(delays, tmp_path))
    draws = fit.sample(20_000, seed=1, delays="all")
    assert list(draws) == [*JOINT, "delay"]
    delay, lag = draws["delay"], draws["actuator_lag"]
    edges = stats.norm.cdf([1.0, 3.0])
    shares = np.diff(edges, prepend=0.0, append=1.0)
    for value, middle, share in zip((0.0, 0.01, 0.02), (0.05, 0.04, 0.03), shares, strict=True):
        assert np.mean(delay == value) == pytest.approx(share, abs=0.01)
        if share > 0.1:
            assert np.median(lag[delay == value]) == pytest.approx(middle, abs=1e-4)
    assert not np.all(np.diff(delay) >= 0)
    assert list(fit.sample(10)) == list(JOINT)


def test_a_delay_at_the_end_of_what_is_possible_is_in_the_band_when_it_fits() -> None:
    """No delay, told to be 1.6 standard errors off, has the 5 % that a one-sided bound leaves it."""
    excesses = np.array([1.64, 1.0, 0.5, 0.2, 0.0, 0.2, 0.5]) ** 2
    shares = shares_in_order(excesses)
    assert shares.sum() == pytest.approx(1.0)
    assert shares[0] == pytest.approx(stats.norm.cdf(-1.32))
    assert shares[-1] == pytest.approx(stats.norm.sf(0.35))
    bumpy = shares_in_order(np.array([1.0, 4.0, 0.0, 4.0, 1.0]))
    assert (bumpy >= 0.0).all()
    np.testing.assert_allclose(bumpy, bumpy[::-1])


def test_several_nuisances_are_drawn_by_their_likelihood(tmp_path: Path) -> None:
    delays = at_delays((0.01, 0.04, 2.0))
    for number, candidate in enumerate(delays["covariance"]["candidates"]):
        candidate["at"]["other"] = float(number)
    draws = ev.load_fit(written(delays, tmp_path)).sample(20_000, seed=1, delays="all")
    assert np.mean(draws["delay"] == 0.01) == pytest.approx(1.0 / (1.0 + np.e), abs=0.01)
    np.testing.assert_array_equal(draws["other"] == 1.0, draws["delay"] == 0.01)


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
