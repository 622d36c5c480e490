"""The lag by another motion of the same flight: what tells it, how it is used, and when it is not."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from flight_logs import LAG_S, changed, flown, prepare_vertical

import eivor as ev
from eivor.flights.estimate import SENSORS_APART_S, estimated, lags_from_rates
from eivor.flights.lag_prior import LagMeasurement
from eivor.flights.options import FlightOptions
from eivor.flights.quantity import QuantityEstimate
from eivor.lab.disturbances import OrnsteinUhlenbeck
from eivor.motions.rates.motion import Rates
from eivor.motions.vertical.motion import Vertical
from eivor.report.flight import checks
from eivor.signals.noise import WhiteNoise
from eivor.signals.recording import Recording
from eivor.simulation.controller import FlightController, Sensor
from eivor.simulation.excitation import DrydenGust, RandomSteps
from eivor.simulation.rigid_body import simulate_rigid_body_flights
from eivor.simulation.rigid_body_spec import (
    AxisExcitations,
    Logged,
    RigidBodyFlightSpec,
    Sensors,
    TorqueDisturbance,
    Wind,
)
from motions.turning_logs import STEP_S, Vehicle, turned
from simulation.rigid_body.test_rigid_flight import VEHICLE

pytestmark = [pytest.mark.thorough, pytest.mark.usefixtures("unchecked_shapes", "coarse_search")]

ROTORS = Vehicle(lag_s=LAG_S - 2 * STEP_S)


@pytest.fixture(scope="module")
def turning() -> Recording:
    """What a flight that turns logs of that."""
    return turned(3, vehicle=ROTORS, seconds=26.0)


@pytest.fixture(scope="module")
def slow() -> Recording:
    """A flight whose climbs hardly tell the lag."""
    return flown(seconds=15.0, gust=3.0, amplitude=0.4, seed=5)[0]


def told(value: float = LAG_S, half_width: float = 0.004, source: str = "other") -> LagMeasurement:
    interval = (value - half_width, value + half_width)
    lag = QuantityEstimate(value, "s", 0.5 * half_width, interval)
    return LagMeasurement(source, f"{source} motion", lag, SENSORS_APART_S, "delays")


def estimate(log: Recording, *lag_measurement: LagMeasurement, options: FlightOptions | None = None):
    chosen = options or FlightOptions()
    return estimated(
        Vertical(), (prepare_vertical(log, chosen),), chosen, lag_measurements=lambda: lag_measurement
    )


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


def test_what_a_user_knows_comes_first_and_nothing_else_is_asked(slow):
    def asked() -> tuple[LagMeasurement, ...]:
        raise AssertionError("asked")

    for lag in (ev.Prior(LAG_S, 0.01), ev.Bounds(0.0, 0.0)):
        options = FlightOptions(lag=lag)
        flights = (prepare_vertical(slow, options),)
        given = estimated(Vertical(), flights, options, lag_measurements=asked).fit.lag_prior
        assert given.by is None
        assert given.known == lag


def test_a_lag_that_contradicts_the_flight_is_told_and_not_used():
    log = flown(seconds=15.0)[0]
    alone, late = estimate(log), estimate(log, told(LAG_S + 0.1))
    assert late.fit.lag_prior is None
    assert late.quantities["viscous_friction"] == alone.quantities["viscous_friction"]
    (finding,) = [item for item in late.findings if item.name == "other_contradicts"]
    assert "is not used" in finding.message


def test_the_closest_that_agrees_serves():
    log = flown(seconds=15.0)[0]
    both = estimate(log, told(half_width=0.02, source="rough"), told(source="close"))
    assert both.fit.lag_prior.by.source == "close"
    wrong = estimate(log, told(half_width=0.02, source="rough"), told(LAG_S + 0.1, source="wrong"))
    assert wrong.fit.lag_prior.by.source == "rough"
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


def test_turning_that_hardly_moves_the_lag_is_not_estimated_closely(monkeypatch):
    unmade(monkeypatch)
    assert lags_from_rates((Rates(),), turned(4, vehicle=ROTORS, seconds=26.0, size=0.02), None) == ()


def unmade(monkeypatch: pytest.MonkeyPatch) -> None:
    def not_to_be_made(*_: object, **__: object) -> None:
        raise AssertionError("estimated")

    monkeypatch.setattr("eivor.flights.estimate.estimated", not_to_be_made)


@pytest.mark.thorough
def test_turning_that_is_not_trusted_says_nothing(turning):
    assert lags_from_rates((Rates(),), turning, (5.0, 18.0)) == ()  # too short to be identified


@pytest.mark.thorough
def test_flights_of_a_pool_tell_their_lag_together(monkeypatch):
    monkeypatch.setattr("eivor.flights.identify.lags_from_rates", lambda *_: (told(),))
    logs = [flown(seconds=10.0, seed=seed)[0] for seed in (1, 2)]
    assert ev.identify_flight(logs[0]).fit.lag_prior.by.source == "other"
    assert ev.identify_flight(logs).fit.lag_prior is None


@pytest.mark.long
def test_a_whole_vehicle_that_turns_and_climbs_tells_more_of_its_climbs():
    """Attitude steps of .2 rad, height excited, gusts of .5 m/s, setpoints at 50 Hz of a 400 Hz loop."""
    gust, turning = DrydenGust(0.5, 3.0, 2.0), OrnsteinUhlenbeck(0.04, 0.3)
    spec = RigidBodyFlightSpec(
        VEHICLE,
        rate_hz=400.0,
        duration=30.0,
        attitude=AxisExcitations(RandomSteps(0.2, 0.7), RandomSteps(0.2, 0.9)),
        controller=FlightController(rate_hz=400.0, attitude_hz=200.0, derivative_share=0.3, hold=0.3),
        wind=Wind(x=gust, y=gust, z=gust),
        torque_disturbance=TorqueDisturbance(turning, turning),
        sensors=Sensors(angular_rate=Sensor(WhiteNoise(0.02), rate_hz=200.0, cutoff_hz=80.0)),
        logged=Logged(rotor_command_hz=50.0, setpoint_hz=50.0, reference_hz=50.0),
        seed=1,
    )
    (flight,) = simulate_rigid_body_flights([spec])
    alone, known = estimate(flight.recording), ev.identify_flight(flight.recording)
    low, high = known.fit.lag_prior.by.measured.interval
    assert low < flight.truth.parameters.lag_up + flight.truth.parameters.delay < high
    for name in ("viscous_friction", "effective_lag"):
        assert known.quantities[name].half_width < alone.quantities[name].half_width
