"""Pools: lag, delay and gain once for all flights, and a friction for each."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from flight_logs import FRICTION, GAIN, LAG_S, flown

import eivor
import eivor as ev
from eivor.errors import UsageError
from eivor.estimation.methods import identify, reference_iv
from eivor.flights.pooling import agreement, bootstrap_flights
from eivor.flights.prepare import prepare
from eivor.flights.quantity import QuantityTable
from eivor.inference.bootstrap import IntervalKind
from eivor.inference.diagnostics.instruments import OverIdentification
from eivor.inference.verdict import Status, Verdict
from eivor.models.lagged_runs import lag_and_delay
from eivor.motions.identify import identify_flight
from eivor.motions.vertical.motion import Vertical, vertical_flight
from eivor.motions.vertical.regression import VerticalFlights, vertical_problem
from eivor.report.flight import summary
from eivor.simulation.vertical import VerticalFlightSpec, simulate_vertical_flights

K = "viscous_friction"


def named(logs):
    return [replace(log, name=f"flight {n}", sha256=f"flight {n}") for n, log in enumerate(logs)]


@pytest.fixture(scope="module")
def alike():
    """Two flights of one friction."""
    return ev.identify_flight(named(flown(2, seconds=15.0, seed=5)))


MORE = (-0.25, 0.1, 0.6)


@pytest.fixture(scope="module")
def one_sine():
    """Flights along one sine, in air that drags them differently."""
    logs = [
        flown(1, seconds=20.0, seed=20 + n, hertz=(0.35,), friction=FRICTION + more)[0]
        for n, more in enumerate(MORE)
    ]
    return ev.identify_flight(named(logs))


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_flights_that_agree_have_one_friction_and_one_for_each(alike):
    assert [row.label for row in alike.by_flight] == ["flight 0", "flight 1"]
    truth = {K: FRICTION, "input_gain": GAIN, "effective_lag": LAG_S}
    for name, value in truth.items():
        low, high = alike.quantities[name].interval
        assert low < value < high
        for row in alike.by_flight:
            low, high = row.quantities[name].interval
            assert low < value < high
            assert row.quantities[name].verdict is Status.IDENTIFIED
    values = {row.quantities[K].value for row in alike.by_flight}
    assert len(values) == 2
    assert len({row.quantities["input_gain"].value for row in alike.by_flight}) == 1
    assert min(values) < alike.quantities[K].value < max(values)
    assert alike.diagnostics["pool_own_p_value"] > 0.05
    # flight by flight the pool tells the lag better than the flight does, and the friction no worse
    for row, flight in zip(alike.by_flight, alike.flights, strict=True):
        assert row.quantities["effective_lag"].half_width < flight.quantities["effective_lag"].half_width
        assert row.quantities[K].half_width < 1.1 * flight.quantities[K].half_width


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_common_and_separate_are_what_they_say(alike):
    logs = [flight.recording for flight in alike.prepared]
    common = ev.identify_flight(logs, pool_friction="common")
    assert common.by_flight == ()
    assert common.quantities[K].value == pytest.approx(
        alike.quantities[K].value, abs=0.5 * common.quantities[K].std_error
    )
    separate = ev.identify_flight(logs, pool_friction="separate")
    assert separate.fit.estimate.joint_covariance.part("between_flights").degrees == 1.0
    assert [finding.name for finding in separate.findings].count("flights_differ") == 1
    with pytest.raises(ev.errors.UsageError, match="pool_friction out of auto, common, separate"):
        ev.FlightOptions(pool_friction="seperate")


class Laden(Vertical):
    """The same motion of a vehicle whose load is another one in each flight, in air that is not."""

    quantities = QuantityTable(
        {name: replace(spec, of_flight=name == "input_gain") for name, spec in Vertical.quantities.items()}
    )


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_a_motion_says_what_belongs_to_the_flight(alike):
    identify_flight = ev.identify_flight([flight.recording for flight in alike.prepared], model=Laden())
    rows = [row.quantities for row in identify_flight.by_flight]
    assert len({row["input_gain"].value for row in rows}) == 2
    assert len({row[K].value for row in rows}) == 1
    for name, value in {K: FRICTION, "input_gain": GAIN}.items():
        low, high = identify_flight.quantities[name].interval
        assert low < value < high
    ends = identify_flight.fit.sets[K].profile.hull
    assert ends[0] < identify_flight.quantities[K].value < ends[1]


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_a_pool_is_told_and_read_back(one_sine, tmp_path):
    document = json.loads(one_sine.to_json())
    assert [row["log"] for row in document["by_flight"]] == [row.label for row in one_sine.by_flight]
    file = tmp_path / "fit.json"
    file.write_text(one_sine.to_json())
    read = ev.load_fit(file)
    for row in one_sine.by_flight:
        current = read.by_flight[row.label][K]
        assert (current.value, current.interval) == (row.quantities[K].value, row.quantities[K].interval)
    for level in (0.8, 0.95):
        assert read.interval(K, level) == pytest.approx(one_sine.interval(K, level))
    assert read.interval("actuator_lag") == one_sine.interval("actuator_lag")
    with pytest.raises(ev.errors.UsageError, match="a set for weak instruments or a pool"):
        read.interval("actuator_lag", 0.8)


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_instruments_of_a_pool_agree_when_those_of_half_its_flights_do(alike):
    def checks(p_value):
        return replace(alike.fit.checks, agreement=OverIdentification(9.0, 3, p_value, None))

    assert agreement([checks(p) for p in (1e-9, 0.4, 0.6, 0.8)]).p_value == pytest.approx(0.8)
    assert agreement([checks(p) for p in (1e-9, 1e-8, 0.6)]).p_value == pytest.approx(1.5e-8)
    assert agreement([checks(0.5)] * 3).J == 27.0
    assert agreement([]) is None


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_a_pool_has_the_verdict_of_its_own_quantities(alike, one_sine):
    """Each flight of `one_sine` has its friction identified, and their mean is not."""
    order = list(Status)
    for pool in (alike, one_sine):
        headline = [pool.quantities[name] for name in pool.motion.quantities.headline]
        assert pool.verdict.status is max((item.verdict for item in headline), key=order.index)
        assert bool(pool.verdict.reasons) == (pool.verdict.status is not Status.IDENTIFIED)
    assert {row.verdict for row in one_sine.by_flight} == {Status.IDENTIFIED}
    assert one_sine.quantities[K].verdict is not Status.IDENTIFIED
    assert "viscous friction" in summary(one_sine)


def logs(pool, count, gusts=0.3):
    """Logs of simulated flights of one vehicle, each with a trajectory, wind and noise of its own."""
    specs = [VerticalFlightSpec(gust_rms=gusts, seed=1000 * pool + number) for number in range(count)]
    return [
        replace(f.recording, sha256=str(s.seed))
        for s, f in zip(specs, simulate_vertical_flights(specs), strict=True)
    ]


@pytest.fixture(scope="module")
def pair():
    return identify_flight(logs(1, 2))


def pooled(pair, recordings):
    """Return what `identify_flight` makes of a pool, without each flight's own result."""
    prepared = tuple(prepare(log, pair.motion, pair.options) for log in recordings)
    made = problem_of(pair)
    problem = vertical_problem(
        tuple(vertical_flight(flight) for flight in prepared), made.motion, made.rule, made.nuisances
    )
    estimate = identify(problem, reference_iv())
    quantities = {
        name: quantity.judged(Verdict(Status.IDENTIFIED), pair.motion.quantities[name])
        for name, quantity in pair.motion.derive(problem, estimate).items()
    }
    assert pair.fit is not None
    return replace(
        pair,
        prepared=prepared,
        fit=replace(pair.fit, problem=problem, estimate=estimate),
        quantities=quantities,
    )


def problem_of(result):
    """What was estimated."""
    assert result.fit is not None
    assert isinstance(result.fit.problem, VerticalFlights)
    return result.fit.problem


@pytest.fixture(scope="module")
def pool(pair):
    return pooled(pair, logs(1, 10))


@pytest.fixture(scope="module")
def found(pool):
    return eivor.bootstrap_flights(pool, runs=40, seed=4)


@pytest.mark.thorough
def test_the_seed_decides(pool, found):
    np.testing.assert_array_equal(bootstrap_flights(pool, runs=5, seed=4).replicates, found.replicates[:5])
    assert not np.array_equal(bootstrap_flights(pool, runs=5, seed=5).replicates, found.replicates[:5])


@pytest.mark.thorough
def test_replicates_are_what_the_recipe_makes_of_the_drawn_flights(pool):
    """The recipe renews its whitening in each replicate: a tenth of a standard error, no more."""
    alone = replace(problem_of(pool), nuisances=lag_and_delay(delays_s=[0.0]))
    assert pool.fit is not None
    single = replace(pool, fit=replace(pool.fit, problem=alone, estimate=identify(alone, reference_iv())))
    random = np.random.default_rng(6)
    fast = bootstrap_flights(single, runs=4, seed=6)
    for replicate in fast.replicates:
        drawn = random.integers(0, 10, 10)
        flights = tuple(problem_of(pool).flights[number] for number in drawn)
        full = identify(vertical_problem(flights, alone.motion, alone.rule, alone.nuisances), reference_iv())
        for name in ("viscous_friction", "input_gain", "actuator_lag"):
            away = replicate[fast.names.index(name)] - full.parameters[name]
            assert abs(away) < 0.25 * pool.quantities[name].std_error


@pytest.mark.thorough
def test_percentiles_of_few_flights_are_too_narrow_by_the_factor_that_is_told(found):
    narrow = found.interval("viscous_friction", kind=IntervalKind.PERCENTILE)
    wide = found.interval("viscous_friction")
    wanted = np.sqrt(10 / 9) * 2.26216 / 1.95996
    assert (wide[1] - wide[0]) / (narrow[1] - narrow[0]) == pytest.approx(wanted, rel=1e-4)


@pytest.mark.thorough
def test_what_cannot_be_resampled_is_refused(pool):
    assert pool.fit is not None
    item = replace(problem_of(pool), columns=problem_of(pool).columns[:1])
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
