"""The lag as information: what it changes, what it is compared with, and when it cannot be had."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from flight_logs import LAG_S, changed, flown

import eivor as ev
from eivor.errors import UsageError
from eivor.flights.given_lag import GivenLag
from eivor.flights.quantity import Unjudged
from eivor.inference.verdict import Status
from eivor.report.fit_checks import checks
from eivor.signals.recording import Recording

pytestmark = pytest.mark.usefixtures("unchecked_shapes", "coarse_search")


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
    given = known.fit.given_lag
    assert given.alone.value == alone.value
    assert given.p_value > 0.05
    said = dict(checks(known))["lag"]
    assert said.startswith("given 50 ± 15 ms (one standard deviation); the flight alone says ")
    assert "they agree" in said
    document = json.loads(known.to_json())
    assert document["given_lag"]["alone"] == alone.value
    assert document["provenance"]["options"]["lag"] == {"mean": LAG_S, "std": 0.015}
    assert json.loads(ev.identify_flight(log).to_json())["given_lag"] is None


def test_what_is_known_the_instruments_need_not_tell(log):
    alone, known, sure = (
        ev.identify_flight(log, lag=prior) for prior in (None, ev.Prior(LAG_S, 0.002), ev.Prior(LAG_S, 1e-6))
    )
    strengths = [result.fit.checks.first_stage for result in (alone, known, sure)]
    assert strengths[0]["actuator_lag"] < strengths[1]["actuator_lag"] < strengths[2]["actuator_lag"]
    # with a lag that is known exactly the others are as strong as without one to find
    problem = alone.fit.problem
    at = problem.with_nuisances((problem.lag.known_at(sure.estimate.best.at["actuator_lag"]), problem.delay))
    fixed = ev.identify(at, ev.methods.reference_iv()).best.inference.first_stage[0]
    assert strengths[2]["viscous_friction"] == pytest.approx(fixed, rel=0.05)


def test_a_contradiction_is_said_and_makes_the_numbers_weak():
    good = flown(seconds=15.0)[0]
    wrong = ev.identify_flight(good, lag=ev.Prior(0.15, 0.01))
    assert wrong.fit.given_lag.contradicted
    for name in ("viscous_friction", "input_gain", "effective_lag"):
        assert wrong.quantities[name].verdict is Status.WEAK
        assert any("contradicts the flight" in reason.sentence for reason in wrong.quantities[name].reasons)
    # J, which counts what was given as data, does not say it again
    assert not any("references disagree" in sentence for sentence in wrong.verdict.sentences)
    assert wrong.quantities["hover_input"].verdict is Status.IDENTIFIED


@pytest.mark.parametrize(
    ("value", "error", "p_value"), [(0.07, 0.004, 1.0), (0.08, 0.0, 0.0455), (0.083, 0.012, 0.4053)]
)
def test_the_test_is_that_of_two_independent_numbers(value, error, p_value):
    alone = Unjudged(value, "s", error, (value - 2.0 * error, value + 2.0 * error))
    given = GivenLag(ev.Prior(0.07, 0.005 if error < 0.01 else 0.01), alone)
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
    with pytest.raises(UsageError, match=r"ev\.Prior\(0\.070, 0\.015\)"):
        ev.identify_flight(log, lag=lag)


def test_a_lag_below_zero_is_refused():
    with pytest.raises(UsageError, match="a lag above zero"):
        ev.FlightOptions(lag=ev.Prior(-0.02, 0.01))
