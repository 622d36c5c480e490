"""The lag as information: what it changes, what it is compared with, and when it cannot be had."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace

import numpy as np
import pytest
from flight_logs import LAG_S, changed, flown

import eivor as ev
from eivor.errors import ParameterError, UsageError
from eivor.flights.lag_prior import LagPrior, with_lag_prior
from eivor.flights.quantity import QuantityEstimate
from eivor.inference.verdict import Status
from eivor.models.separable import Nuisance, SeparableProblem, combinations
from eivor.motions.rigid_body.regression import searched_lag_and_delay
from eivor.report.flight import checks
from eivor.signals.recording import Recording

pytestmark = [pytest.mark.thorough, pytest.mark.usefixtures("unchecked_shapes", "coarse_search")]


@pytest.fixture(scope="module")
def log() -> Recording:
    """A flight that hardly tells its lag."""
    return flown(seconds=15.0, gust=3.0, amplitude=0.4, seed=5)[0]


def test_a_given_lag_narrows_what_it_moves(log):
    alone = ev.identify_flight(log)
    known = ev.identify_flight(log, lag=ev.Prior(LAG_S, 0.002))
    for name in ("effective_lag", "viscous_friction"):
        assert known.quantities[name].half_width < alone.quantities[name].half_width
    assert known.quantities["effective_lag"].value == pytest.approx(LAG_S, abs=0.003)
    vague = ev.identify_flight(log, lag=ev.Prior(LAG_S, 100.0))
    for name, quantity in alone.quantities.items():
        assert vague.quantities[name].value == pytest.approx(
            quantity.value, abs=1e-3 * quantity.std_error if np.isfinite(quantity.std_error) else 0.0
        )


def test_the_report_says_what_the_flight_alone_says(log):
    alone = ev.identify_flight(log).quantities["effective_lag"]
    known = ev.identify_flight(log, lag=ev.Prior(LAG_S, 0.015))
    given = known.fit.lag_prior
    assert given.alone.value == alone.value
    assert given.p_value > 0.05
    sentence = dict(checks(known))["lag"]
    assert sentence.startswith("given 50 ± 15 ms (one standard deviation); the flight alone says ")
    assert "they agree" in sentence
    document = json.loads(known.to_json())
    assert document["given_lag"]["alone"] == alone.value
    assert document["provenance"]["options"]["lag"] == {"mean": LAG_S, "std": 0.015}
    assert json.loads(ev.identify_flight(log).to_json())["given_lag"] is None


@pytest.mark.thorough
def test_with_bounds_the_numbers_hold_for_every_lag_between(log):
    bounds = ev.Bounds(0.03, 0.08)
    between = ev.identify_flight(log, lag=bounds)
    alone = ev.identify_flight(log)
    known = [ev.identify_flight(log, lag=ev.Bounds(lag_s, lag_s)) for lag_s in (0.03, 0.055, 0.08)]
    for name in ("viscous_friction", "input_gain", "intercept"):
        low, high = between.quantities[name].interval
        intervals = [at_one.quantities[name].interval for at_one in known]
        assert low <= min(low for low, _ in intervals)
        assert high >= max(high for _, high in intervals)
    lag = between.quantities["effective_lag"]
    assert lag.interval == (0.03, 0.08)
    assert lag.value == pytest.approx(min(max(alone.quantities["effective_lag"].value, 0.03), 0.08))
    assert "actuator_lag" not in between.estimate.names
    assert all(
        0.03 <= sum(candidate.nuisances.values()) <= 0.08 + 1e-9 for candidate in between.estimate.candidates
    )
    # the profile set is a union too, each lag having a least J of its own
    sets = between.fit.sets["viscous_friction"]
    ends = [at_one.fit.sets["viscous_friction"].profile.hull for at_one in known]
    assert sets.profile.hull[0] == pytest.approx(min(low for low, _ in ends), rel=0.02)
    assert sets.profile.hull[1] == pytest.approx(max(high for _, high in ends), rel=0.02)


def test_bounds_are_held_against_what_the_flight_says():
    good = flown(seconds=15.0)[0]
    around, beyond = (ev.identify_flight(good, lag=ev.Bounds(*ends)) for ends in ((0.02, 0.2), (0.12, 0.15)))
    message = dict(checks(around))["lag"]
    assert message.startswith("given 20 to 200 ms; the flight alone says ")
    assert "they agree, and the flight alone is closer" in message
    assert around.fit.lag_prior.p_value == 1.0
    assert beyond.fit.lag_prior.contradicted
    assert beyond.quantities["viscous_friction"].verdict is Status.WEAK
    assert any("given 120 to 150 ms" in sentence for sentence in beyond.verdict.sentences)


def test_neither_lag_nor_delay_is_searched():
    good = flown(seconds=15.0)[0]
    none = ev.identify_flight(good, lag=ev.Bounds(0.0, 0.0))
    assert dict(none.estimate.best.nuisances) == {"actuator_lag": 0.0, "delay": 0.0}
    assert len(none.estimate.candidates) == 1
    assert none.quantities["effective_lag"].interval == (0.0, 0.0)
    assert "given neither lag nor delay" in dict(checks(none))["lag"]
    assert none.fit.lag_prior.contradicted


def test_the_instruments_agree_or_not_whatever_was_given():
    good = flown(seconds=15.0)[0]
    alone, wrong = (ev.identify_flight(good, lag=lag) for lag in (None, ev.Prior(0.15, 0.01)))
    assert wrong.fit.checks.agreement == alone.fit.checks.agreement


def test_what_is_known_the_instruments_need_not_tell(log):
    alone, known, sure = (
        ev.identify_flight(log, lag=prior) for prior in (None, ev.Prior(LAG_S, 0.002), ev.Prior(LAG_S, 1e-6))
    )
    strengths = [result.fit.checks.first_stage for result in (alone, known, sure)]
    assert strengths[0]["actuator_lag"] < strengths[1]["actuator_lag"] < strengths[2]["actuator_lag"]
    # with a lag that is known exactly the others are as strong as without one to find
    problem = alone.fit.problem
    index = problem.with_nuisances(
        (problem.lag.known_at(sure.estimate.best.nuisances["actuator_lag"]), problem.delay)
    )
    fixed = ev.identify(index, ev.methods.reference_iv()).best.first_stage[0]
    assert strengths[2]["viscous_friction"] == pytest.approx(fixed, rel=0.05)


def test_a_contradiction_is_said_and_makes_the_numbers_weak():
    good = flown(seconds=15.0)[0]
    wrong = ev.identify_flight(good, lag=ev.Prior(0.15, 0.01))
    assert wrong.fit.lag_prior.contradicted
    for name in ("viscous_friction", "input_gain", "effective_lag"):
        assert wrong.quantities[name].verdict is Status.WEAK
        assert any("contradicts the flight" in reason.sentence for reason in wrong.quantities[name].reasons)
    assert not any("references disagree" in sentence for sentence in wrong.verdict.sentences)
    assert wrong.quantities["hover_input"].verdict is Status.IDENTIFIED


@pytest.mark.parametrize(
    ("value", "error", "p_value"), [(0.07, 0.004, 1.0), (0.08, 0.0, 0.0455), (0.083, 0.012, 0.4053)]
)
def test_the_test_is_that_of_two_independent_numbers(value, error, p_value):
    alone = QuantityEstimate(value, "s", error, (value - 2.0 * error, value + 2.0 * error))
    given = LagPrior(ev.Prior(0.07, 0.005 if error < 0.01 else 0.01), alone)
    assert given.p_value == pytest.approx(p_value, abs=1e-3)


def test_a_measured_state_has_no_lag_to_know(log):
    command = log.channels["rotor_command_1"]
    measured = changed(
        log, "rotor_command_1", rotor_speed_1=replace(command, name="rotor_speed_1", held=False)
    )
    with pytest.raises(UsageError, match="whose actuators' lag is searched for"):
        ev.identify_flight(measured, lag=ev.Prior(0.05, 0.01))


@pytest.mark.parametrize("lag", [70, "70:15", (0.07, 0.015)])
def test_a_lag_of_another_type_is_refused(log, lag):
    with pytest.raises(UsageError, match=r"ev\.Prior\(0\.070, 0\.015\) or ev\.Bounds"):
        ev.identify_flight(log, lag=lag)


def test_a_lag_below_zero_is_refused():
    with pytest.raises(UsageError, match="a lag above zero"):
        ev.FlightOptions(lag=ev.Prior(-0.02, 0.01))


@pytest.mark.parametrize("ends", [(50.0, 90.0), (-0.01, 0.05)])
def test_bounds_in_another_unit_or_below_zero_are_refused(ends):
    with pytest.raises(UsageError, match="between 0 and 1 s"):
        ev.FlightOptions(lag=ev.Bounds(*ends))


def test_bounds_in_the_wrong_order_are_refused():
    with pytest.raises(ParameterError, match="the lower one first"):
        ev.Bounds(0.09, 0.05)


@dataclass(frozen=True)
class Searched(SeparableProblem):
    """A problem of nuisances alone."""

    nuisances: tuple[Nuisance, ...]

    def rows(self, nuisance_values):
        raise NotImplementedError

    def bins(self, nuisance_values):
        raise NotImplementedError


def test_bounds_leave_a_delay_that_is_no_choice_of_a_few_as_the_flight_tells_it():
    lag, delay = searched_lag_and_delay()
    alone = {lag.name: 0.044, delay.name: 0.008}
    known = with_lag_prior(Searched((lag, delay)), ev.Bounds(0.05, 0.06), alone)
    tried = list(combinations(known.nuisances))
    assert {item[delay.name] for item in tried} == {0.008}
    sums = [item[lag.name] + item[delay.name] for item in tried]
    assert min(sums) == pytest.approx(0.05)
    assert max(sums) == pytest.approx(0.06)
    assert any(abs(item - 0.052) < 1e-9 for item in sums)  # the flight's own is among them
