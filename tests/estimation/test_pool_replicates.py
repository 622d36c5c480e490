"""Replicates of pools with any nuisances: against the estimate, and against the method on what was drawn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from nuisance_runs import LAG_S, PARAMETERS, SHARE, columns, lag, share

import eivor as ev
from eivor.errors import UsageError
from eivor.estimation.bootstrap import Replicate, left_over, pool_flights
from eivor.estimation.estimate import Estimate
from eivor.estimation.methods import least_squares, reference_iv
from eivor.estimation.variable_projection import MOST_NODES, nodes_of
from eivor.estimation.weighting import whitened_by_residuals
from eivor.models.lagged_runs import LaggedRuns
from eivor.models.separable import Nuisance, Prior

pytestmark = pytest.mark.usefixtures("unchecked_shapes")
KNOWN_LAG, KNOWN_SHARE = lag(grid=np.array([LAG_S])), share(grid=np.array([SHARE]))
SHARES = share(grid=np.array([0.38, 0.4, 0.42]), discrete=True)


def pool(numbers: list[int], *nuisances: Nuisance, noise: float = 0.02) -> LaggedRuns:
    """Flights of one vehicle, by the seed of each."""
    made = (replace(columns(seed, noise=noise), flight=k) for k, seed in enumerate(numbers))
    return LaggedRuns(tuple(made), PARAMETERS, nuisances)


def joint(estimate: Estimate, replicate: Replicate) -> np.ndarray:
    """The joint vector of a replicate."""
    return np.array(
        [*replicate.theta, *(replicate.nuisances[name] for name in estimate.names[replicate.theta.size :])]
    )


def errors(estimate: Estimate) -> np.ndarray:
    return np.array([estimate.std_error(name) for name in estimate.names])


# -- between the nodes ---------------------------------------------------------------------------------------


def test_nodes_are_the_grid_made_finer_or_thinned():
    (axis,) = nodes_of((lag(grid=np.geomspace(0.01, 0.4, 40)),)).axes
    np.testing.assert_array_equal(axis.values, np.geomspace(0.01, 0.4, 40))
    (axis,) = nodes_of((lag(grid=np.array([0.01, 0.1, 0.4])),)).axes
    assert axis.values.size == 17
    assert {0.01, 0.1, 0.4} <= set(axis.values.round(12))
    many = nodes_of((lag(grid=np.geomspace(0.01, 0.4, 60)), share(grid=np.linspace(0.0, 1.0, 60)), SHARES))
    assert 500 < len(many.points) <= MOST_NODES
    assert nodes_of((KNOWN_LAG, SHARES)).points == [{}]


def test_a_cubic_between_nodes_is_itself():
    nodes = nodes_of((lag(), share()))
    index = [np.log([0.0123, 0.2]), np.array([0.01, 0.5, 0.99])]

    def cubic(lag_s, bend):
        return np.log(lag_s) ** 3 * bend - bend**3 + 2.0

    values = np.array([[cubic(*point.values()), 1.0] for point in nodes.points])
    expected = [[cubic(np.exp(item), bend), 1.0] for item in index[0] for bend in index[1]]
    np.testing.assert_allclose(nodes.over(values, index), expected, rtol=1e-9)
    position = np.array([index[0][1], index[1][0]])
    np.testing.assert_allclose(nodes.weights(position) @ values, expected[3], rtol=1e-9)
    assert nodes.values_at(position) == pytest.approx({"actuator_lag": 0.2, "curve_share": 0.01})


def test_what_least_squares_leaves():
    systems = np.random.default_rng(3).standard_normal((6, 7, 4))
    systems[2, :, 1] = 0.0
    expected = [np.linalg.lstsq(system[:, :-1], system[:, -1], rcond=None)[0] for system in systems]
    residuals = [
        system[:, -1] - system[:, :-1] @ theta for system, theta in zip(systems, expected, strict=True)
    ]
    np.testing.assert_allclose(
        left_over(systems), [residual @ residual for residual in residuals], rtol=1e-12
    )


# -- replicates ----------------------------------------------------------------------------------------------


@pytest.mark.thorough
@pytest.mark.parametrize(
    "nuisances",
    [
        (lag(), KNOWN_SHARE),
        (lag(), share()),
        (lag(), SHARES),
        (SHARES, lag()),
        (KNOWN_LAG, KNOWN_SHARE),
        (KNOWN_LAG, share(prior=Prior(0.41, 0.002))),
    ],
    ids=["one", "two", "one and a discrete one", "in another order", "none", "one known beforehand"],
)
def test_all_flights_once_give_the_estimate_again(nuisances):
    problem = pool([0, 1, 2, 3], *nuisances)
    estimate = ev.identify(problem, reference_iv())
    whole = pool_flights(problem, estimate).whole
    assert (np.abs(joint(estimate, whole) - estimate.best.values) < 0.01 * errors(estimate)).all()
    assert whole.nuisances == pytest.approx(estimate.best.nuisances, rel=1e-3)
    assert whole.criterion < 1e-2


def test_a_replicate_written_out():
    """Two-stage equations of the drawn rows, without the pool's own misfit, and their J."""
    problem = pool([0, 1, 2, 3], KNOWN_LAG, KNOWN_SHARE)
    estimate = ev.identify(problem, reference_iv())
    result, times = pool_flights(problem, estimate).replicate(np.random.default_rng(7))
    best = estimate.best
    rows = whitened_by_residuals(problem, best.theta, best.nuisances).rows(best.nuisances)
    misfit = rows.instruments.T @ (rows.response - rows.regressors @ best.theta)
    drawn = np.repeat(np.arange(rows.response.size), times[rows.layout.flight_of_row].astype(int))
    Q, Phi, y = rows.instruments[drawn], rows.regressors[drawn], rows.response[drawn]
    A, b = Q.T @ Phi, Q.T @ y - misfit
    W = np.linalg.inv(Q.T @ Q)
    theta = np.linalg.solve(A.T @ W @ A, A.T @ W @ b)
    variance = ((y - Phi @ theta) ** 2).sum() / (y.size - theta.size)
    left = b - A @ theta
    np.testing.assert_allclose(result.theta, theta, rtol=1e-9)
    assert result.criterion == pytest.approx(left @ W @ left / variance, rel=1e-6)


@pytest.mark.thorough
@pytest.mark.parametrize("nuisances", [(lag(), share()), (lag(), SHARES)], ids=["two", "one and a discrete"])
def test_replicates_are_what_the_method_makes_of_the_drawn_flights(nuisances):
    """The method renews its whitening in each: a tenth or two of a standard error, no more."""
    problem = pool([0, 1, 2, 3, 4, 5], *nuisances)
    estimate = ev.identify(problem, reference_iv())
    again, random = pool_flights(problem, estimate), np.random.default_rng(1)
    moved = []
    for _ in range(4):
        result, times = again.replicate(random)
        drawn = [seed for seed, count in enumerate(times) for _ in range(int(count))]
        full = ev.identify(pool(drawn, *nuisances), reference_iv())
        away = joint(estimate, result) - full.best.values
        assert (np.abs(away) < 0.25 * errors(estimate)).all()
        moved.append(np.abs(joint(estimate, result) - estimate.best.values) / errors(estimate))
    assert (np.max(moved, axis=0) > 0.3).all()


@pytest.mark.thorough
def test_what_is_known_beforehand_is_measured_again():
    """The flights say nothing of the share: it varies as what is known does, about the pool's own value."""
    nuisances = (KNOWN_LAG, share(prior=Prior(0.5, 0.05)))
    problem = pool([0, 1, 2, 3], *nuisances, noise=30.0)
    estimate = ev.identify(problem, reference_iv())
    again, random = pool_flights(problem, estimate), np.random.default_rng(2)
    result = np.array([again.replicate(random)[0].nuisances["curve_share"] for _ in range(200)])
    assert abs(again.whole.nuisances["curve_share"] - estimate.parameters["curve_share"]) < 1e-3
    assert result.std() == pytest.approx(0.05, rel=0.15)
    assert result.mean() == pytest.approx(estimate.parameters["curve_share"], abs=0.012)


@pytest.mark.thorough
def test_what_is_known_of_a_sum_is_measured_again_at_each_other_part():
    together = replace(lag(prior=Prior(0.48, 0.002)), known_with=("curve_share",))
    nuisances = (together, share(grid=np.array([0.35, 0.4]), discrete=True))
    problem = pool([0, 1, 2, 3], *nuisances, noise=30.0)
    estimate = ev.identify(problem, reference_iv())
    again, random = pool_flights(problem, estimate), np.random.default_rng(2)
    ats = [again.replicate(random)[0].nuisances for _ in range(100)]
    sums = np.array([item["actuator_lag"] + item["curve_share"] for item in ats])
    wanted = estimate.parameters["actuator_lag"] + estimate.best.nuisances["curve_share"]
    assert sums.std() == pytest.approx(0.002, rel=0.25)
    assert sums.mean() == pytest.approx(wanted, abs=0.001)


def test_values_of_a_discrete_nuisance_known_beforehand_are_told_apart_by_it():
    """Again of noise: without what is known each of the three would be drawn as often as the others."""
    wide = np.array([0.2, 0.4, 0.6])
    made = []
    for std in (0.02, 2.0):
        problem = pool(
            [0, 1, 2, 3], KNOWN_LAG, share(grid=wide, discrete=True, prior=Prior(0.4, std)), noise=30.0
        )
        estimate = ev.identify(problem, reference_iv())
        again, random = pool_flights(problem, estimate), np.random.default_rng(2)
        made.append({again.replicate(random)[0].nuisances["curve_share"] for _ in range(60)})
    assert made[0] == {0.4}
    assert len(made[1]) > 1


def test_the_order_of_axes_and_flights_does_not_matter():
    """Rows of one flight need not follow each other."""
    parts = [replace(columns(10 * k + axis, axis=axis), flight=k) for k in range(3) for axis in range(2)]
    results = []
    for ordered in (parts, sorted(parts, key=lambda part: part.axis)):
        problem = LaggedRuns(tuple(ordered), PARAMETERS, (lag(), KNOWN_SHARE))
        estimate = ev.identify(problem, reference_iv())
        again, random = pool_flights(problem, estimate), np.random.default_rng(4)
        assert again.flights == (0, 1, 2)
        results.append([joint(estimate, again.replicate(random)[0]) / errors(estimate) for _ in range(5)])
    np.testing.assert_allclose(results[0], results[1], atol=0.01)


def test_what_cannot_be_drawn_again_is_refused():
    problem = pool([0, 1], lag(), KNOWN_SHARE)
    with pytest.raises(UsageError, match="one by least_squares"):
        pool_flights(problem, ev.identify(problem, least_squares()))
    alone = pool([0], lag(), KNOWN_SHARE)
    with pytest.raises(UsageError, match="two flights or more with usable runs; received 1"):
        pool_flights(alone, ev.identify(alone, reference_iv()))
