"""Bootstrap of flights: against the recipe itself, and against the intervals of pools."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import eivor
from eivor.errors import UsageError
from eivor.estimation.methods import identify, reference_iv
from eivor.flights.pooling import bootstrap_flights
from eivor.flights.prepare import prepare
from eivor.flights.result import FlightEstimate
from eivor.inference.bootstrap import Bootstrap, IntervalKind
from eivor.inference.verdict import Status, Verdict
from eivor.models.lagged_runs import lag_and_delay
from eivor.motions.identify import identify_flight
from eivor.motions.vertical.motion import vertical_flight
from eivor.motions.vertical.regression import VerticalFlights
from eivor.signals.recording import Recording
from eivor.simulation.vertical import VerticalFlightSpec, simulate_vertical_flights
from simulation.rotor_states import actual_state_recording

pytestmark = pytest.mark.thorough

QUANTITIES = ("viscous_friction", "input_gain", "effective_lag", "hover_input")


def logs(pool: int, count: int, gusts: float = 0.3) -> list[Recording]:
    """Logs of simulated flights of one vehicle, each with a trajectory, wind and noise of its own."""
    specs = [VerticalFlightSpec(gust_rms=gusts, seed=1000 * pool + number) for number in range(count)]
    return [
        replace(f.recording, sha256=str(s.seed))
        for s, f in zip(specs, simulate_vertical_flights(specs), strict=True)
    ]


@pytest.fixture(scope="module")
def pair() -> FlightEstimate:
    return identify_flight(logs(1, 2))


def pooled(pair: FlightEstimate, recordings: list[Recording]) -> FlightEstimate:
    """Return what `identify_flight` makes of a pool, without each flight's own result."""
    prepared = tuple(prepare(log, pair.motion, pair.options) for log in recordings)
    problem = replace(problem_of(pair), flights=tuple(vertical_flight(flight) for flight in prepared))
    estimate = identify(problem, reference_iv())
    quantities = {
        name: quantity.judged(Verdict(Status.IDENTIFIED), pair.motion.wording[name])
        for name, quantity in pair.motion.quantities(problem, estimate).items()
    }
    assert pair.fit is not None
    return replace(
        pair,
        prepared=prepared,
        fit=replace(pair.fit, problem=problem, estimate=estimate),
        quantities=quantities,
    )


def problem_of(result: FlightEstimate) -> VerticalFlights:
    """What was estimated."""
    assert result.fit is not None
    assert isinstance(result.fit.problem, VerticalFlights)
    return result.fit.problem


@pytest.fixture(scope="module")
def pool(pair: FlightEstimate) -> FlightEstimate:
    return pooled(pair, logs(1, 10))


@pytest.fixture(scope="module")
def found(pool: FlightEstimate) -> Bootstrap:
    return eivor.bootstrap_flights(pool, runs=40, seed=4)


@pytest.mark.long
def test_all_flights_once_give_the_pool_again(pool: FlightEstimate, found: Bootstrap) -> None:
    for name, value in zip(found.names, found.values, strict=True):
        assert abs(value - pool.quantities[name].value) < 0.05 * pool.quantities[name].std_error
    assert found.names[:3] == ("viscous_friction", "input_gain", "hover_input")
    assert (found.pieces, found.failed) == (10, 0)
    assert np.isnan(found.block_length)


def test_the_seed_decides(pool: FlightEstimate, found: Bootstrap) -> None:
    np.testing.assert_array_equal(bootstrap_flights(pool, runs=5, seed=4).replicates, found.replicates[:5])
    assert not np.array_equal(bootstrap_flights(pool, runs=5, seed=5).replicates, found.replicates[:5])


def test_replicates_are_what_the_recipe_makes_of_the_drawn_flights(pool: FlightEstimate) -> None:
    """The recipe renews its whitening in each replicate: a tenth of a standard error, no more."""
    alone = replace(problem_of(pool), nuisances=lag_and_delay(delays_s=[0.0]))
    assert pool.fit is not None
    single = replace(pool, fit=replace(pool.fit, problem=alone, estimate=identify(alone, reference_iv())))
    random = np.random.default_rng(6)
    fast = bootstrap_flights(single, runs=4, seed=6)
    for replicate in fast.replicates:
        drawn = random.integers(0, 10, 10)
        flights = tuple(problem_of(pool).flights[number] for number in drawn)
        full = identify(VerticalFlights(flights, alone.motion, alone.rule, alone.nuisances), reference_iv())
        for name in ("viscous_friction", "input_gain", "actuator_lag"):
            away = replicate[fast.names.index(name)] - full.parameters[name]
            assert abs(away) < 0.25 * pool.quantities[name].std_error


@pytest.mark.long
def test_intervals_agree_with_those_of_pools_of_ten(pool: FlightEstimate) -> None:
    """Within 20 % of their width, in the median over pools and quantities; single pools vary by more."""
    pools = [(pool, bootstrap_flights(pool, runs=200, seed=4))]
    for number, gusts in ((2, 1.0), (3, 0.3)):
        other = pooled(pool, logs(number, 10, gusts))
        pools.append((other, bootstrap_flights(other, runs=200)))
    ratios = np.array([[_ratio(item, replicates, name) for name in QUANTITIES] for item, replicates in pools])
    assert 0.8 < float(np.median(ratios)) < 1.2
    assert (np.abs(np.median(ratios, axis=0) - 1.0) < 0.3).all()


def _ratio(result: FlightEstimate, replicates: Bootstrap, name: str) -> float:
    low, high = replicates.interval(name)
    return 0.5 * (high - low) / result.quantities[name].half_width


def test_percentiles_of_few_flights_are_too_narrow_by_the_factor_that_is_told(found: Bootstrap) -> None:
    narrow = found.interval("viscous_friction", kind=IntervalKind.PERCENTILE)
    wide = found.interval("viscous_friction")
    wanted = np.sqrt(10 / 9) * 2.26216 / 1.95996
    assert (wide[1] - wide[0]) / (narrow[1] - narrow[0]) == pytest.approx(wanted, rel=1e-4)


def test_measured_states_have_a_delay_and_no_lag() -> None:
    specs = [VerticalFlightSpec(seed=seed) for seed in (1, 2, 3)]
    states = [actual_state_recording(flight) for flight in simulate_vertical_flights(specs)]
    fit = identify_flight([replace(log, sha256=str(n)) for n, log in enumerate(states)])
    replicates = bootstrap_flights(fit, runs=40)
    assert replicates.names == ("viscous_friction", "input_gain", "hover_input", "effective_lag")
    low, high = replicates.interval("input_gain")
    assert low < fit.quantities["input_gain"].value < high


def test_what_cannot_be_resampled_is_refused(pool: FlightEstimate) -> None:
    assert pool.fit is not None
    item = replace(problem_of(pool), flights=problem_of(pool).flights[:1])
    alone = replace(pool, fit=replace(pool.fit, problem=item))
    with pytest.raises(UsageError, match="two flights or more"):
        bootstrap_flights(alone)
    by_another = replace(pool.fit.estimate, method="least_squares")
    direct = replace(pool, fit=replace(pool.fit, estimate=by_another))
    with pytest.raises(UsageError, match="one by least_squares"):
        bootstrap_flights(direct)
    with pytest.raises(UsageError, match="one without"):
        bootstrap_flights(replace(alone, fit=None))
    with pytest.raises(UsageError, match="two runs"):
        bootstrap_flights(pool, runs=1)
