"""Confidence sets of the friction: what they are, when they have bounds, what the verdict makes of them."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
import scipy.stats
from flight_logs import FRICTION, LAG_S, changed, flown

import eivor as ev
from eivor.errors import UsageError
from eivor.estimation.derived import ParameterSets, parameter_sets
from eivor.estimation.weighting import whitened_by_residuals
from eivor.flights.result import FlightEstimate
from eivor.inference.confidence_set import ConfidenceSet
from eivor.inference.diagnostics.instruments import STRONG_FIRST_STAGE
from eivor.inference.verdict import Status
from eivor.signals.recording import Recording

pytestmark = pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
K = "viscous_friction"


@pytest.fixture(scope="module")
def gusty() -> Recording:
    """A flight in gusts."""
    return flown(seconds=15.0, gust=2.0, amplitude=0.5, seed=3)[0]


@pytest.fixture(scope="module")
def one_frequency() -> Recording:
    """A flight whose reference tells friction and lag together only."""
    return flown(seconds=30.0, gust=2.0, seed=1, hertz=(0.32,))[0]


@pytest.fixture(scope="module")
def two_frequencies() -> Recording:
    """A flight whose reference hardly tells its lag."""
    return flown(seconds=30.0, gust=3.0, amplitude=0.7, seed=1501, hertz=(0.3, 0.35))[0]


def searched(result: FlightEstimate, values: np.ndarray) -> np.ndarray:
    """The criterion at some values of K, from rows at very many lags."""
    problem, estimate = result.fit.problem, result.fit.estimate
    grid = problem.lag.grid
    lags = np.geomspace(grid[0], grid[-1], 301)
    results = np.full(values.size, np.inf)
    for candidate in estimate.candidates:
        weights = whitened_by_residuals(problem, candidate.theta, candidate.nuisances)
        for lag_s in lags:
            index = {**candidate.nuisances, "actuator_lag": float(lag_s)}
            rows = weights.rows(index)
            columns = np.column_stack([rows.response, rows.regressors])
            seen = rows.instruments.T @ columns
            N, D = seen.T @ seen, columns.T @ columns / (len(columns) - candidate.unknowns)
            misfit = sum(nuisance.misfit(index) for nuisance in problem.nuisances)
            for item, value in enumerate(values):
                T = np.array([[1.0, 0.0], [-value, 0.0], [0.0, 1.0]])
                least = scipy.linalg.eigh(T.T @ N @ T, T.T @ D @ T, eigvals_only=True)[0]
                results[item] = min(results[item], least + misfit)
    return results


@pytest.mark.thorough
@pytest.mark.parametrize("lag", [None, ev.Prior(0.07, 0.01)])
def test_sets_are_those_of_a_search_over_everything(gusty, lag):
    result = ev.identify_flight(gusty, lag=lag)
    sets = result.fit.sets[K]
    near = np.array([end + step for end in sets.profile.hull for step in (-0.01, 0.01)])
    J = searched(result, np.concatenate([near, np.linspace(*sets.profile.hull, 9)]))
    # within one percent of the ends, and of the least criterion
    wide = sets.profile.length
    assert wide > 0.2
    assert (J[:4] <= J.min() + 2.306**2).tolist() == [False, True, True, False]
    degrees = result.fit.estimate.best.rank + (lag is not None) - 2
    bound = float(scipy.stats.chi2.ppf(0.95, degrees))
    low, high = sets.anderson_rubin.hull
    step = 0.02 * (high - low)
    J = searched(result, np.array([low - step, low + step, high - step, high + step]))
    assert (bound >= J).tolist() == [False, True, True, False]


@pytest.mark.thorough
def test_one_frequency_tells_no_friction_without_the_lag(one_frequency):
    alone = ev.identify_flight(one_frequency)
    sets = alone.fit.sets[K]
    assert not sets.anderson_rubin.is_bounded
    assert not sets.profile.is_bounded
    quantity = alone.quantities[K]
    assert quantity.interval == sets.robust.hull
    assert alone.verdict.status is Status.REFUSED
    (reason,) = [item for item in alone.quantities[K].reasons if item.status is Status.REFUSED]
    assert "one frequency (0.3" in reason.sentence
    assert "leave the viscous friction anywhere in [" in reason.sentence
    assert reason.remedy.endswith("--lag MS:STD or --lag LOW..HIGH.")
    assert json.loads(alone.to_json())["parameters"][K]["sets"]["anderson_rubin"][-1][1] is None
    known = ev.identify_flight(one_frequency, lag=ev.Prior(LAG_S, 0.015))
    sets = known.fit.sets[K]
    assert sets.anderson_rubin.is_bounded
    assert sets.anderson_rubin.hull[0] > 0.0
    assert sets.profile.contains(FRICTION)
    assert known.verdict.status in {Status.IDENTIFIED, Status.WEAK}


@pytest.mark.thorough
def test_strong_instruments_at_a_wrong_lag_tell_nothing():
    """At the best lag, which is far too long, every F is above ten, and the interval there misses."""
    result = ev.identify_flight(flown(seconds=15.0, gust=1.0, seed=2, hertz=(0.32,))[0])
    assert min(result.fit.checks.first_stage.values()) >= STRONG_FIRST_STAGE
    assert not result.fit.sets[K].wald.contains(FRICTION)
    low, high = result.quantities[K].interval
    assert low < FRICTION < high == np.inf
    assert result.verdict.status is Status.REFUSED
    assert any("how long the lag is at most" in sentence for sentence in result.verdict.sentences)


@pytest.mark.thorough
def test_weak_instruments_refuse_nothing_that_a_bounded_set_tells(two_frequencies):
    result = ev.identify_flight(two_frequencies)
    assert min(result.fit.checks.first_stage.values()) < 10.0
    sets, quantity = result.fit.sets[K], result.quantities[K]
    assert sets.wald.hull[0] < 0.0 < sets.anderson_rubin.hull[0]
    assert quantity.interval == sets.anderson_rubin.hull
    assert result.verdict.status is Status.WEAK
    assert any("holds however weak they are" in sentence for sentence in result.verdict.sentences)
    low, high = quantity.interval
    assert result.quantities["time_constant"].interval == (1.0 / high, 1.0 / low)
    narrow = result.interval(K, 0.9)
    assert result.interval(K) == quantity.interval
    assert low < narrow[0] < narrow[1] < high


@pytest.mark.thorough
def test_other_levels_of_a_set_are_not_read_back(two_frequencies, gusty, tmp_path):
    for log in (two_frequencies, gusty):
        result = ev.identify_flight(log)
        path = tmp_path / "fit.json"
        path.write_text(result.to_json())
        saved = ev.load_fit(path)
        assert saved.interval(K) == result.interval(K)
        if log is gusty:
            assert saved.interval(K, 0.9) == pytest.approx(result.interval(K, 0.9))
            continue
        with pytest.raises(UsageError, match="a set for weak instruments"):
            saved.interval(K, 0.9)


@pytest.mark.thorough
def test_strong_instruments_keep_the_interval_about_the_estimate(gusty):
    result = ev.identify_flight(gusty)
    assert result.quantities[K].interval == result.fit.sets[K].wald.hull == result.estimate.interval(K)
    fields = json.loads(result.to_json())["parameters"][K]
    assert fields["sets"]["wald"] == [fields["interval"]]
    assert list(fields["sets"]) == ["wald", "profile", "anderson_rubin"]


def test_a_measured_state_has_no_lag_to_go_over(gusty):
    command = gusty.channels["rotor_command_1"]
    measured = changed(
        gusty, "rotor_command_1", rotor_speed_1=replace(command, name="rotor_speed_1", held=False)
    )
    result = ev.identify_flight(measured)
    sets = result.fit.sets[K]
    assert sets.profile.is_bounded
    assert sets.profile.contains(result.quantities[K].value)
    assert sets.profile.length == pytest.approx(sets.wald.length, rel=0.5)


def test_the_wider_of_two_level_sets_is_the_robust_one():
    line = ConfidenceSet(((0.1, 0.5),))
    for other in (ConfidenceSet.empty(), ConfidenceSet(((0.2, 0.3),))):
        assert ParameterSets(line, line, other).robust == line
        assert ParameterSets(line, other, line).robust == line


@pytest.mark.thorough
def test_methods_whose_rows_are_not_white_have_no_sets(gusty):
    result = ev.identify_flight(gusty, method="extended_iv")
    assert result.fit.sets == {}
    assert json.loads(result.to_json())["parameters"][K]["sets"] is None
    whitened = ev.identify_flight(gusty)
    problem, estimate = whitened.fit.problem, whitened.fit.estimate
    with pytest.raises(UsageError, match="viscous_friction, input_gain"):
        parameter_sets(problem, estimate, "actuator_lag")


@pytest.mark.calibration
def test_sets_cover_and_tell_where_instruments_are_weak():
    logs = [
        log
        for first in range(2)
        for log in flown(10, seconds=30.0, gust=3.0, amplitude=0.7, seed=900 + first, hertz=(0.3, 0.35))
    ]
    results = [ev.identify_flight(log) for log in logs]
    weak = [result for result in results if min(result.fit.checks.first_stage.values()) < STRONG_FIRST_STAGE]
    assert len(weak) >= 10
    robust = [result.fit.sets[K].robust for result in weak]
    covered = sum(item.contains(FRICTION) for item in robust)
    assert covered >= scipy.stats.binom.ppf(1e-3, len(robust), 0.95)
    selected = [item.is_bounded and item.hull[0] > 0.0 for item in robust]
    assert np.mean(selected) >= 0.3
    assert np.mean([result.fit.sets[K].wald.hull[0] > 0.0 for result in weak]) < np.mean(selected)
