"""What is told of the supply: a fall of its voltage, and a long flight without one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eivor.flights.options import FlightOptions
from eivor.motions.vertical.motion import supply_findings
from flights.flight_logs import changed, channel, flown, prepare_vertical

pytestmark = [pytest.mark.thorough, pytest.mark.usefixtures("unchecked_shapes")]


@pytest.fixture(scope="module")
def prepared():
    return prepare_vertical(flown(seconds=150.0, noise=0.3)[0], FlightOptions())


def told(prepared, volts=None, **changes):
    log = prepared.recording
    if volts is not None:
        stamps = np.linspace(0.0, 150.0, 700)
        log = changed(log, battery_voltage=channel("battery_voltage", stamps, volts(stamps)))
    flight = replace(prepared, recording=log, **changes)
    return [(finding.name, finding.message) for finding in supply_findings((flight,))]


def test_a_long_flight_without_a_voltage_may_have_sagged(prepared):
    ((name, message),) = told(prepared)
    assert name == "voltage_not_logged"
    assert "2.5 minutes" in message
    assert told(prepared, volts=lambda t: np.full(t.size, np.nan)) == told(prepared)
    assert told(prepared, runs=(slice(0, 3000),)) == []


def test_a_fall_of_the_voltage_is_told(prepared):
    ((name, message),) = told(prepared, volts=lambda t: 16.5 - 0.01 * t)
    assert name == "voltage_sag"
    assert "fell by 8.2%, from 16.4 to 15.1 V" in message
    assert told(prepared, volts=lambda t: 16.5 - 0.002 * t) == []


def test_measured_rotors_do_not_answer_the_voltage(prepared):
    assert told(prepared, input=replace(prepared.input, measured=True)) == []


def test_flights_of_a_pool_are_named(prepared):
    first, second = supply_findings((prepared, prepared))
    assert first.message.startswith("flight 0: No battery voltage")
    assert second.name == "voltage_not_logged"
