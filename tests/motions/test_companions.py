"""Quantities that another motion of the same flight tells: the thrust gain beside turning."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from turning_logs import turned

from eivor.flights import identify
from eivor.flights.identify import with_coupled_axes
from eivor.flights.quantity import Quantity
from eivor.flights.result import FlightEstimate
from eivor.inference.verdict import Reason, Status
from eivor.motions.identify import identify_flight
from eivor.motions.vertical.motion import Vertical
from eivor.signals.recording import Channel, Recording

LOG = turned(3, seconds=16.0)
MOTIONS = {"vertical": Vertical()}


@pytest.fixture(scope="module")
def turning() -> FlightEstimate:
    return identify_flight(LOG, model="rates")


def logging(*names: str) -> Recording:
    """The log with further channels, whose values do not matter."""
    time = np.arange(0.0, 16.0, 0.02)
    added = {name: Channel(name, time, np.full(time.size, 0.5), "", held=True) for name in names}
    return replace(LOG, channels={**LOG.channels, **added})


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("logged", "missing"),
    [
        ((), "no thrust setpoint is logged"),
        (("input",), "no accelerometer is logged"),
        (("input", "specific_force_body_z"), "velocity_z"),
    ],
)
def test_what_is_not_logged_refuses_the_thrust_gain(turning, logged, missing):
    bare = replace(turning, findings=())
    companions = with_coupled_axes(bare, MOTIONS, [logging(*logged)], [None])
    (finding,) = companions.findings
    assert finding.name == "no_thrust_gain"
    assert missing in finding.message
    assert "thrust_gain" not in companions.quantities
    assert companions.verdict == turning.verdict


@pytest.mark.thorough
def test_the_other_motion_is_given_the_lag_and_has_its_own_verdict(turning, monkeypatch):
    requested = {}
    why = Reason(Status.WEAK, "The input gain's interval is wide.", "Fly steps.")
    gain = Quantity(30.0, "m/s^2", 1.0, (28.0, 32.0), Status.WEAK, reasons=(why,))

    def identified(_logs, _motion, options, _windows, *, lag_measurements):
        requested.update(options=options, lag_measurements=lag_measurements)
        return SimpleNamespace(quantities={"input_gain": gain})

    monkeypatch.setattr(identify, "identified", identified)
    companions = with_coupled_axes(turning, MOTIONS, [logging("input", "acceleration_z")], [None])
    assert companions.quantities["thrust_gain"].value == 30.0
    assert companions.quantities["thrust_gain"].reasons[0].sentence == "The thrust gain's interval is wide."
    assert companions.quantities["roll_effectiveness"] == turning.quantities["roll_effectiveness"]
    assert (requested["options"].input, requested["options"].input_map) == ("input", "linear")
    (reported,) = requested["lag_measurements"]
    assert reported.prior.mean == turning.quantities["effective_lag"].value


@pytest.mark.thorough
def test_a_lag_that_is_not_identified_is_not_passed_on(turning, monkeypatch):
    passed = []

    def identified(_logs, _motion, _options, _windows, *, lag_measurements):
        passed.append(lag_measurements)
        return SimpleNamespace(quantities={"input_gain": turning.quantities["roll_effectiveness"]})

    monkeypatch.setattr(identify, "identified", identified)
    rough = replace(turning.quantities["effective_lag"], verdict=Status.WEAK)
    weak = replace(turning, quantities={**turning.quantities, "effective_lag": rough})
    with_coupled_axes(weak, MOTIONS, [logging("input", "acceleration_z")], [None])
    assert passed == [()]
