"""The lag as information: what it changes, what it is compared with, and when it cannot be had."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from flight_logs import FRICTION, GAIN, LAG_S, changed, flown

import eivor as ev
from eivor.flights.lag_prior import LagPrior, lag_quantities, limited_by_sum
from eivor.flights.quantity import QuantityEstimate
from eivor.motions.rates.motion import Rates
from logs.dataflash_writer import commands

pytestmark = pytest.mark.usefixtures("unchecked_shapes", "coarse_search")


@pytest.fixture(scope="module")
def log() -> ev.Recording:
    """A flight that hardly tells its lag."""
    return flown(seconds=15.0, gust=3.0, amplitude=0.4, seed=5)[0]


@pytest.mark.thorough
def test_the_report_says_what_the_flight_alone_says(log):
    alone = ev.identify_flight(log).quantities["effective_lag"]
    known = ev.identify_flight(log, lag=ev.Prior(LAG_S, 0.015))
    given = known.fit.lag_prior
    assert given.flight_lag.value == alone.value
    assert given.p_value > 0.05
    sentence = given.sentence
    assert sentence.startswith("given 50 ± 15 ms (one standard deviation); the flight alone says ")
    assert "they agree" in sentence
    document = json.loads(known.to_json())
    assert document["given_lag"]["alone"] == alone.value
    assert document["provenance"]["options"]["lag"] == {"mean": LAG_S, "std": 0.015}
    assert json.loads(ev.identify_flight(log).to_json())["given_lag"] is None


@pytest.mark.thorough
def test_bounds_intersect_what_the_flight_says():
    """Finding 20a: bounds around the truth made 8 identified flights weak or refused."""
    good = flown(seconds=30.0)[0]
    alone = ev.identify_flight(good)
    around = ev.identify_flight(good, lag=ev.Bounds(LAG_S - 0.02, LAG_S + 0.02))
    assert around.verdict.status is ev.Status.IDENTIFIED
    for name in ("viscous_friction", "input_gain", "hover_input"):
        assert around.quantities[name].interval == pytest.approx(alone.quantities[name].interval, rel=1e-6)
    middle = alone.quantities["effective_lag"].value
    cut = ev.identify_flight(good, lag=ev.Bounds(middle, middle + 0.02))
    low, high = cut.quantities["effective_lag"].interval
    assert middle - 0.005 <= low <= high <= alone.quantities["effective_lag"].interval[1] + 0.005
    width = alone.quantities["viscous_friction"].half_width
    assert cut.quantities["viscous_friction"].half_width < 2.0 * width


def test_what_was_given_ends_the_interval_only_where_the_flight_agrees():
    flight = QuantityEstimate(0.07, "s", 0.004, (0.062, 0.078))
    agreed, doubtful = (LagPrior(ev.Prior(mean, 0.005), flight, strong=True) for mean in (0.066, 0.054))
    assert agreed.limited((0.055, 0.085), 0.069) == pytest.approx((0.0562, 0.0758))
    # a lag that was given 20 ms short ended the interval at its value: none of 7 flights was covered
    assert doubtful.limited((0.053, 0.069), 0.061) == (0.053, 0.07)


@pytest.mark.thorough
def test_neither_lag_nor_delay_is_searched():
    good = flown(seconds=15.0)[0]
    none = ev.identify_flight(good, lag=ev.Bounds(0.0, 0.0))
    assert dict(none.estimate.nuisances) == {"actuator_lag": 0.0, "delay": 0.0}
    assert none.quantities["effective_lag"].interval == (0.0, 0.0)
    assert "given neither lag nor delay" in none.fit.lag_prior.sentence
    assert none.fit.lag_prior.contradicted


@pytest.mark.thorough
def test_no_lag_is_below_zero_and_its_parts_end_where_it_does():
    """A delay alone made a lag from -1 to 16 ms of parts that end at 5 and at 4.6 ms."""
    fit = ev.identify_flight(flown(seconds=15.0)[0], order=1)
    lags = lag_quantities(fit.fit.problem, fit.estimate)
    assert (lags["actuator_lag"].value, lags["effective_lag"].lowest) == (0.0, 0.0)
    longer = lags | {"actuator_lag": replace(lags["actuator_lag"], interval=(0.0, 9.0))}
    high = lags["effective_lag"].interval[1]
    assert limited_by_sum(longer)["actuator_lag"].interval == (0.0, high)
    assert limited_by_sum(longer, unsplit=True)["delay"].interval[0] == 0.0
    late = {name: replace(item, lowest=-np.inf) for name, item in longer.items()}
    assert limited_by_sum(late) == late  # telemetry may come before its command
    assert {"delay", "effective_lag"} <= {*Rates.parts[0].quantities}


def test_a_delay_that_the_references_do_not_move_leaves_its_degree_to_them():
    """The delay ends at zero in some flights without one: J was too large there for its degrees."""
    estimates = [ev.identify_flight(log).fit.estimate for log in flown(4, seconds=15.0, seed=900, gust=0.5)]
    at_end = [estimate.nuisances["delay"] < 1e-4 for estimate in estimates]
    assert any(at_end)
    for estimate, ends in zip(estimates, at_end, strict=True):
        left = estimate.degrees - (estimate.rank - estimate.unknowns)
        assert left == 1.0 if ends else 0.0 <= left < 1.0


@pytest.mark.thorough
def test_a_contradiction_is_said_and_makes_the_numbers_weak():
    good = flown(seconds=15.0)[0]
    wrong = ev.identify_flight(good, lag=ev.Prior(0.15, 0.01))
    assert wrong.fit.lag_prior.contradicted
    for name in ("viscous_friction", "input_gain", "effective_lag"):
        assert wrong.quantities[name].verdict is ev.Status.WEAK
        assert any("contradicts the flight" in reason.sentence for reason in wrong.quantities[name].reasons)
    assert not any("references disagree" in sentence for sentence in wrong.verdict.sentences)
    assert wrong.quantities["hover_input"].verdict is ev.Status.IDENTIFIED


# The thrust curve that is found out: its value, what it rests on, and what it does to everything else.


@pytest.fixture(scope="module")
def square_log():
    """A flight whose thrust goes with the square of its command."""
    return flown(seconds=20.0)[0]


def mixed(share):
    """Signals that give shares of thrust, of a curve of motors."""
    return lambda thrust: commands(thrust, share, 1.0)["signal"]


def power(exponent):
    """The same of a power."""
    return lambda thrust: thrust ** (1.0 / exponent)


def commanded(log, inverse, *, thrust, side="BEFORE"):
    """The same flight, its commands such that thrust goes with another map of them."""
    command = log.channels["rotor_command_1"]
    name = "input" if thrust else "rotor_command_1"
    side = type(command.curve_side)[side]
    reported = replace(command, name=name, values=inverse(command.values**2), curve_side=side)
    return replace(changed(log, "rotor_command_1", **{name: reported}), input_map="")


@pytest.mark.parametrize(
    ("true", "thrust", "value"),
    [
        pytest.param(power(1.5), False, 1.5, marks=pytest.mark.thorough),
        (mixed(0.5), True, 0.5),
        pytest.param(mixed(0.0), True, 0.0, marks=pytest.mark.thorough),
    ],
)
def test_the_curve_is_found_out(square_log, true, thrust, value):
    fit = ev.identify_flight(commanded(square_log, true, thrust=thrust), input_map="fit")
    curve = fit.quantities["thrust_curve"]
    low, high = curve.interval
    assert low < value < high
    assert curve.half_width < 0.3
    assert curve.value == pytest.approx(value, abs=0.05)
    friction = fit.quantities["viscous_friction"]
    assert friction.value == pytest.approx(FRICTION, abs=1.5 * friction.half_width)
    # the map's own error is part of the gain's interval, and the bias of the intercept's
    gain = fit.quantities["input_gain"]
    assert gain.interval[0] < GAIN < gain.interval[1]
    assert gain.half_width > 1.9 * gain.std_error
    assert fit.interval("input_gain") == gain.interval
    assert 0.7 < np.diff(fit.interval("input_gain", 0.9)) / np.diff(gain.interval) < 0.9
    assert fit.quantities["intercept"].half_width >= 1.9 * 0.1
    # no share is below zero: there an intercept is left that is none within its error
    left = fit.quantities["intercept"]
    assert abs(left.value) < (0.03 if curve.value > 0.0 else 0.5 * left.half_width)


@pytest.mark.thorough
def test_what_was_found_is_told_and_can_be_typed(square_log):
    flight = replace(commanded(square_log, mixed(0.5), thrust=True), parameters={"THR_MDL_FAC": 0.0})
    fit = ev.identify_flight(flight, input_map="fit")
    document = json.loads(fit.to_json())
    name = document["model"]["input_map"]
    assert name.startswith("mixed:0.")
    assert document["parameters"]["thrust_curve"]["value"] == pytest.approx(
        float(name.split(":")[1]), abs=1e-3
    )
    assert document["provenance"]["options"]["accelerometer_bias"] == 0.1
    (messages,) = [finding.message for finding in fit.findings if finding.name == "thrust_curve"]
    assert "THR_MDL_FAC (PX4) would be set to 0." in messages
    assert "The log has THR_MDL_FAC 0." in messages
    typed = ev.identify_flight(flight, input_map=name)
    assert typed.parameters["input_gain"] == pytest.approx(fit.parameters["input_gain"], rel=1e-3)
    assert "thrust_curve" not in typed.quantities
    assert "thrust_curve" not in json.loads(typed.to_json())["parameters"]


@pytest.mark.parametrize(
    ("side", "parameters", "said"),
    [
        ("BEHIND", {}, r"THR_MDL_FAC \(PX4\) would be set to 0\.5.* MOT_THST_EXPO \(ArduPilot\) would be"),
        pytest.param("BEFORE", {}, "no value of it that is in force is known", marks=pytest.mark.thorough),
        ("UNKNOWN", {"THR_MDL_FAC": 0.0}, "does not say whether input is before or behind"),
    ],
)
def test_what_the_report_says_without_a_value_in_force(square_log, side, parameters, said):
    flight = commanded(square_log, mixed(0.5), thrust=True, side=side)
    fit = ev.identify_flight(replace(flight, parameters=parameters), input_map="fit")
    (messages,) = [finding.message for finding in fit.findings if finding.name == "thrust_curve"]
    assert re.search(said, messages)
    document = json.loads(fit.to_json())["model"]["autopilot_curve"]
    assert document == {
        "side": {"UNKNOWN": None}.get(side, side.lower()),
        "in_force": parameters,
        "logged": parameters,
    }
