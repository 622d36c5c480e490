"""Rates some tenths of a second ahead, of the torque setpoints alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eivor.flights.options import FlightOptions
from eivor.flights.prepare import prepare
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import SimpleModel
from eivor.motions.rates.motion import Rates
from motions.turning_logs import AXES, Vehicle, turned

VEHICLE = Vehicle()
TRUTH = {
    **{f"{name}_effectiveness": one for name, one in zip(AXES, VEHICLE.effectiveness, strict=True)},
    **{f"{name}_damping": one for name, one in zip(AXES, VEHICLE.damping, strict=True)},
    "yaw_reaction": 0.0,
    "actuator_lag": VEHICLE.lag_s,
    "delay": VEHICLE.delayed * 0.0025,
}
WITHOUT_LAG = {**TRUTH, "actuator_lag": 0.0, "delay": 0.0}


@pytest.fixture(scope="module")
def flight() -> PreparedFlight:
    """Without disturbance or noise, every setpoint logged."""
    log = turned(0, seconds=12.0, command_hz=400.0, rate_hz=400.0, disturbance=0.0, noise=0.0)
    return prepare(log, Rates(), FlightOptions()).shortened


def models(fit: dict[str, float] = TRUTH) -> dict[str, SimpleModel]:
    return {"fit": SimpleModel("the fit", fit), "least_squares": SimpleModel("without lag", WITHOUT_LAG)}


def test_the_truth_predicts_and_numbers_without_a_lag_do_not(flight):
    ahead = Rates().ahead((flight,), models(), frozenset())
    assert [one[0].quantity for one in ahead.by_quantity] == ["roll rate", "pitch rate", "yaw rate"]
    assert [one.model for one in ahead.by_quantity[0]] == ["fit", "least_squares", "unchanged"]
    for own, without, unchanged in ahead.by_quantity:
        assert own.rms[-1] < 0.03 * unchanged.rms[-1]
        assert own.rms[0] < 0.1 * without.rms[0]
        assert np.array_equal(unchanged.series[:, 0], own.series[:, 0])
    assert ahead.predicts
    assert not ahead.left_out


def test_axes_that_are_not_told_are_left_out_and_it_is_said(flight):
    ahead = Rates().ahead((flight,), models(), frozenset({"pitch_effectiveness"}))
    assert [one[0].quantity for one in ahead.by_quantity] == ["roll rate", "yaw rate"]
    assert ahead.left_out == ("The pitch rate is not predicted: its effectiveness is refused.",)
    blind = Rates().ahead((flight,), models(), frozenset({"effective_lag"}))
    assert not blind.errors
    assert len(blind.left_out) == 3
    channels = {name: one for name, one in flight.signals.channels.items() if name != "torque_setpoint_z"}
    two = replace(flight, signals=replace(flight.signals, channels=channels))
    found = Rates().ahead((two,), models(), frozenset())
    assert [one[0].quantity for one in found.by_quantity] == ["roll rate", "pitch rate"]
    assert "not logged" in found.left_out[0]
    no_yaw = {name: one for name, one in TRUTH.items() if not name.startswith("yaw")}
    lesser = {"fit": SimpleModel("the fit", no_yaw)}
    assert "the fit knows none" in Rates().ahead((flight,), lesser, frozenset()).left_out[0]
