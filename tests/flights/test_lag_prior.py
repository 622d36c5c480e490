"""The lag as information: what it changes, what it is compared with, and when it cannot be had."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from flight_logs import LAG_S, changed, flown, prepare_vertical

import eivor as ev
from eivor.errors import ParameterError, UsageError
from eivor.flights.estimate import SENSORS_APART_S, FlightState, estimated, lags_from_rates
from eivor.flights.lag_prior import LagPrior
from eivor.flights.options import FlightOptions
from eivor.flights.quantity import QuantityEstimate
from eivor.inference.verdict import Status
from eivor.models.separable import LaggedReferences
from eivor.motions.rates.motion import Rates
from eivor.motions.vertical.motion import Vertical
from eivor.report.flight import checks
from eivor.signals.recording import Recording
from motions.turning_logs import STEP_S, Vehicle, turned

pytestmark = pytest.mark.usefixtures("unchecked_shapes", "coarse_search")


@pytest.fixture(scope="module")
def log() -> Recording:
    """A flight that hardly tells its lag."""
    return flown(seconds=15.0, gust=3.0, amplitude=0.4, seed=5)[0]


@pytest.mark.thorough
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
def test_bounds_intersect_what_the_flight_says():
    """Finding 20a: bounds around the truth made 8 identified flights weak or refused."""
    good = flown(seconds=30.0)[0]
    alone = ev.identify_flight(good)
    around = ev.identify_flight(good, lag=ev.Bounds(LAG_S - 0.02, LAG_S + 0.02))
    assert around.verdict.status is Status.IDENTIFIED
    for name in ("viscous_friction", "input_gain", "hover_input"):
        assert around.quantities[name].interval == alone.quantities[name].interval
    middle = alone.quantities["effective_lag"].value
    cut = ev.identify_flight(good, lag=ev.Bounds(middle, middle + 0.02))
    low, high = cut.quantities["effective_lag"].interval
    assert middle - 0.005 <= low <= high <= alone.quantities["effective_lag"].interval[1] + 0.005
    width = alone.quantities["viscous_friction"].half_width
    assert cut.quantities["viscous_friction"].half_width < 2.0 * width


@pytest.mark.thorough
def test_a_given_lag_is_one_unknown_less(monkeypatch):
    """Finding 3: two instruments were too few for friction, gain and a lag that was given."""
    every = LaggedReferences.columns
    monkeypatch.setattr(LaggedReferences, "columns", lambda rule, driven: every(rule, driven)[:, :2])
    log = flown(seconds=30.0)[0]
    alone = ev.identify_flight(log)
    assert alone.fit is None
    assert "at least 3 independent instruments" in alone.verdict.sentences[0]
    flight = ev.identify_flight(log, lag=ev.Prior(LAG_S, 0.005))
    assert "the flight alone has too few instruments for a lag" in dict(checks(flight))["lag"]
    assert flight.quantities["viscous_friction"].value == pytest.approx(0.4, rel=0.2)
    low, high = flight.quantities["effective_lag"].interval
    assert LAG_S - 0.0115 <= low <= high <= LAG_S + 0.0115  # never wider than what was given


@pytest.mark.thorough
def test_neither_lag_nor_delay_is_searched():
    good = flown(seconds=15.0)[0]
    none = ev.identify_flight(good, lag=ev.Bounds(0.0, 0.0))
    assert dict(none.estimate.nuisances) == {"actuator_lag": 0.0, "delay": 0.0}
    assert none.quantities["effective_lag"].interval == (0.0, 0.0)
    assert "given neither lag nor delay" in dict(checks(none))["lag"]
    assert none.fit.lag_prior.contradicted


def test_a_delay_that_the_references_do_not_move_leaves_its_degree_to_them():
    """The delay ends at zero in some flights without one: J was too large there for its degrees."""
    estimates = [ev.identify_flight(log).fit.estimate for log in flown(4, seed=900, gust=0.5)]
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
        assert wrong.quantities[name].verdict is Status.WEAK
        assert any("contradicts the flight" in reason.sentence for reason in wrong.quantities[name].reasons)
    assert not any("references disagree" in sentence for sentence in wrong.verdict.sentences)
    assert wrong.quantities["hover_input"].verdict is Status.IDENTIFIED


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("value", "error", "p_value"), [(0.07, 0.004, 1.0), (0.08, 0.0, 0.0455), (0.083, 0.012, 0.4053)]
)
def test_the_test_is_that_of_two_independent_numbers(value, error, p_value):
    alone = QuantityEstimate(value, "s", error, (value - 2.0 * error, value + 2.0 * error))
    given = LagPrior(ev.Prior(0.07, 0.005 if error < 0.01 else 0.01), alone)
    assert given.p_value == pytest.approx(p_value, abs=1e-3)


@pytest.mark.thorough
def test_a_measured_state_has_no_lag_to_know(log):
    command = log.channels["rotor_command_1"]
    measured = changed(
        log, "rotor_command_1", rotor_speed_1=replace(command, name="rotor_speed_1", held=False)
    )
    with pytest.raises(UsageError, match="whose actuators' lag is searched for"):
        ev.identify_flight(measured, lag=ev.Prior(0.05, 0.01))


@pytest.mark.thorough
@pytest.mark.parametrize("lag", [70, "70:15", (0.07, 0.015)])
def test_a_lag_of_another_type_is_refused(log, lag):
    with pytest.raises(UsageError, match=r"ev\.Prior\(0\.070, 0\.015\) or ev\.Bounds"):
        ev.identify_flight(log, lag=lag)


@pytest.mark.thorough
def test_a_lag_below_zero_is_refused():
    with pytest.raises(UsageError, match="a lag above zero"):
        ev.FlightOptions(lag=ev.Prior(-0.02, 0.01))


@pytest.mark.thorough
@pytest.mark.parametrize("ends", [(50.0, 90.0), (-0.01, 0.05)])
def test_bounds_in_another_unit_or_below_zero_are_refused(ends):
    with pytest.raises(UsageError, match="between 0 and 1 s"):
        ev.FlightOptions(lag=ev.Bounds(*ends))


@pytest.mark.thorough
def test_bounds_in_the_wrong_order_are_refused():
    with pytest.raises(ParameterError, match="the lower one first"):
        ev.Bounds(0.09, 0.05)


ROTORS = Vehicle(lag_s=LAG_S - 2 * STEP_S)


@pytest.fixture(scope="module")
def turning() -> Recording:
    """What a flight that turns logs of that."""
    return turned(3, vehicle=ROTORS, seconds=26.0)


@pytest.fixture(scope="module")
def slow() -> Recording:
    """A flight whose climbs hardly tell the lag."""
    return flown(seconds=15.0, gust=3.0, amplitude=0.4, seed=5)[0]


def told(value: float = LAG_S, half_width: float = 0.004, source: str = "other") -> LagPrior:
    interval = (value - half_width, value + half_width)
    lag = QuantityEstimate(value, "s", 0.5 * half_width, interval)
    return LagPrior.by_measurement(source, f"{source} motion", lag, SENSORS_APART_S, "delays")


def estimate(log: Recording, *lag_measurement: LagPrior, options: FlightOptions | None = None):
    chosen = options or FlightOptions()
    return estimated(
        FlightState(Vertical(), (prepare_vertical(log, chosen),), chosen, lambda: lag_measurement)
    )


@pytest.mark.thorough
@pytest.mark.thorough
def test_the_lag_by_turning_is_used_and_said(slow, turning):
    log = changed(slow, **turning.channels)
    alone, known = estimate(log), ev.identify_flight(log)
    for name in ("effective_lag", "viscous_friction"):
        assert known.quantities[name].half_width < alone.quantities[name].half_width
    sentence = dict(checks(known))["lag"]
    assert sentence.startswith("turning about the body axes (--model rates) says ")
    given = json.loads(known.to_json())["given_lag"]
    low, high = given["told_interval"]
    assert low < LAG_S < high
    assert given["told_by"] == "rates"
    assert given["telemetry_interval"] is None
    assert given["alone"] == alone.quantities["effective_lag"].value
    assert given["std"] == pytest.approx(np.hypot(0.25 * (high - low), SENSORS_APART_S), rel=0.05)


@pytest.mark.thorough
def test_what_a_user_knows_comes_first_and_nothing_else_is_asked(slow):
    def asked() -> tuple[LagPrior, ...]:
        raise AssertionError("asked")

    for lag in (ev.Prior(LAG_S, 0.01), ev.Bounds(0.0, 0.0)):
        options = FlightOptions(lag=lag)
        flights = (prepare_vertical(slow, options),)
        given = estimated(FlightState(Vertical(), flights, options, asked)).fit.lag_prior
        assert given.measured is None
        assert given.known == lag


@pytest.mark.thorough
def test_a_lag_that_contradicts_the_flight_is_told_and_not_used():
    log = flown(seconds=15.0)[0]
    alone, late = estimate(log), estimate(log, told(LAG_S + 0.1))
    assert late.fit.lag_prior is None
    assert late.quantities["viscous_friction"] == alone.quantities["viscous_friction"]
    (finding,) = [item for item in late.findings if item.name == "other_contradicts"]
    assert "is not used" in finding.message


@pytest.mark.thorough
def test_the_closest_that_agrees_serves():
    log = flown(seconds=15.0)[0]
    both = estimate(log, told(half_width=0.02, source="rough"), told(source="close"))
    assert both.fit.lag_prior.source == "close"
    wrong = estimate(log, told(half_width=0.02, source="rough"), told(LAG_S + 0.1, source="wrong"))
    assert wrong.fit.lag_prior.source == "rough"
    assert any(finding.name == "wrong_contradicts" for finding in wrong.findings)


def every(log: Recording, family: str, nth: int) -> Recording:
    slower = {
        name: replace(channel, time_s=channel.time_s[::nth], values=channel.values[::nth])
        for name, channel in log.channels.items()
        if name.startswith(family)
    }
    return changed(log, **slower)


def answering(log: Recording) -> Recording:
    names = [name for name in log.channels if name.startswith("reference_")]
    loops = {f"feedback_{name}": replace(log.channels[name], name=f"feedback_{name}") for name in names}
    return changed(log, *names, **loops)


@pytest.mark.thorough
@pytest.mark.parametrize(
    "spoilt",
    [
        lambda log: every(log, "angular_rate", 3),
        lambda log: every(log, "torque_setpoint", 2),
        lambda log: changed(log, "torque_setpoint_x"),
        answering,
    ],
)
def test_turning_that_cannot_tell_is_not_estimated(turning, spoilt, monkeypatch):
    unmade(monkeypatch)
    assert lags_from_rates((Rates(),), spoilt(turning), None) == ()
    with pytest.raises(AssertionError, match="estimated"):
        lags_from_rates((Rates(),), turning, None)


@pytest.mark.thorough
def test_turning_that_hardly_moves_the_lag_is_not_estimated_closely(monkeypatch):
    unmade(monkeypatch)
    assert lags_from_rates((Rates(),), turned(4, vehicle=ROTORS, seconds=26.0, size=0.02), None) == ()


def unmade(monkeypatch: pytest.MonkeyPatch) -> None:
    def not_to_be_made(*_: object, **__: object) -> None:
        raise AssertionError("estimated")

    monkeypatch.setattr("eivor.flights.estimate.estimated", not_to_be_made)


@pytest.mark.thorough
@pytest.mark.thorough
def test_turning_that_is_not_trusted_says_nothing(turning):
    assert lags_from_rates((Rates(),), turning, (5.0, 18.0)) == ()  # too short to be identified
