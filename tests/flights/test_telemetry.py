"""Telemetry beside commands: the lag that it tells, how it is used, and when it is not."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from flight_logs import LAG_S, STEP_S, changed, channel, flown, prepare_vertical

import eivor as ev
from eivor.flights.lag_prior import OWN_DELAY_S, LagMeasurement, telemetry_lag
from eivor.flights.options import FlightOptions
from eivor.motions.vertical.select import selected
from eivor.report.flight import checks
from eivor.signals.filters import actuator_state
from eivor.signals.recording import Recording

pytestmark = [pytest.mark.thorough, pytest.mark.usefixtures("unchecked_shapes")]


@pytest.fixture(scope="module")
def log() -> Recording:
    """A flight that hardly tells its lag."""
    return flown(seconds=15.0, gust=3.0, amplitude=0.4, seed=5)[0]


def with_telemetry(
    log: Recording, *, rate_hz: float = 50.0, late_s: float = 0.0, power: float = 1.0, rotors: int = 1
) -> Recording:
    """The log with the speeds of its rotors in rpm, on a clock of their own."""
    command = log.channels["rotor_command_1"]
    state = actuator_state(command.values[:, None], step_s=STEP_S, lag_s=LAG_S, delay_s=0.0)[:, 0]
    results = {}
    for rotor in range(rotors):
        stamps = np.arange(0.003, command.time_s[-1] - 0.1, 1.0 / rate_hz)
        speeds = 1.8e4 * np.interp(stamps - late_s, command.time_s, state) ** power + 300.0
        noise = 30.0 * np.random.default_rng(rotor).standard_normal(stamps.size)
        name = f"rotor_speed_{rotor + 1}"
        results[name] = replace(channel(name, stamps, speeds + noise), held=False)
    return changed(log, **results)


def told(log: Recording) -> LagMeasurement | None:
    return telemetry_lag((prepare_vertical(log, FlightOptions()),), ("rotor_speed",))


@pytest.mark.parametrize(
    "how", [{}, {"rate_hz": 20.0}, {"rate_hz": 100.0, "late_s": 0.01}, {"power": 0.5}, {"rotors": 3}]
)
def test_telemetry_in_any_unit_tells_lag_and_its_own_delay(log, how):
    result = told(with_telemetry(log, **how))
    truth = LAG_S + how.get("late_s", 0.0)
    low, high = result.measured.interval
    assert low < truth < high
    assert high - low < 0.015
    assert result.prior.mean == result.measured.value
    assert OWN_DELAY_S < result.prior.std < 0.025


def test_slow_telemetry_and_what_does_not_follow_tell_nothing(log):
    assert told(log) is None
    assert told(with_telemetry(log, rate_hz=10.0)) is None
    noise = np.random.default_rng(1).standard_normal(log.channels["rotor_command_1"].values.size)
    assert told(changed(log, rotor_speed_1=noise)) is None


@pytest.mark.usefixtures("coarse_search")
def test_the_lag_by_telemetry_is_used_and_said(log):
    alone, known = ev.identify_flight(log), ev.identify_flight(with_telemetry(log))
    for name in ("effective_lag", "viscous_friction"):
        assert known.quantities[name].half_width < alone.quantities[name].half_width
    sentence = dict(checks(known))["lag"]
    assert sentence.startswith("telemetry of the actuators says ")
    assert "the flight alone says" in sentence
    given = json.loads(known.to_json())["given_lag"]
    low, high = given["telemetry_interval"]
    assert low < given["mean"] < high
    assert given["alone"] == alone.quantities["effective_lag"].value
    # what a user knows comes first
    typed = ev.identify_flight(with_telemetry(log), lag=ev.Prior(LAG_S, 0.01))
    assert typed.fit.lag_prior.by is None


@pytest.mark.usefixtures("coarse_search")
def test_telemetry_that_contradicts_the_flight_is_told_and_not_used():
    good = flown(seconds=15.0)[0]
    alone, late = ev.identify_flight(good), ev.identify_flight(with_telemetry(good, late_s=0.12))
    assert late.fit.lag_prior is None
    assert late.quantities["viscous_friction"] == alone.quantities["viscous_friction"]
    (finding,) = [item for item in late.findings if item.name == "telemetry_contradicts"]
    assert "is not used" in finding.message


def test_slow_telemetry_is_no_input_where_commands_are_logged(log):
    thrust = channel("input", log.channels["rotor_command_1"].time_s, log.channels["rotor_command_1"].values)
    for rate_hz, family in ((4.0, "input"), (50.0, "rotor_speed")):
        neighbours = changed(with_telemetry(log, rate_hz=rate_hz), "rotor_command_1", input=thrust)
        assert selected(neighbours, FlightOptions()).input.name == family
    alone = changed(with_telemetry(log, rate_hz=4.0), "rotor_command_1")
    assert selected(alone, FlightOptions()).input.name == "rotor_speed"
