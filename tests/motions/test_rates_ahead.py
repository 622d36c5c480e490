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
    **{f"{name}_effectiveness": item for name, item in zip(AXES, VEHICLE.effectiveness, strict=True)},
    **{f"{name}_damping": item for name, item in zip(AXES, VEHICLE.damping, strict=True)},
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
    prediction = Rates().multi_step_prediction((flight,), models(), frozenset())
    assert [item[0].quantity for item in prediction.by_quantity] == ["roll rate", "pitch rate", "yaw rate"]
    assert [item.model for item in prediction.by_quantity[0]] == ["fit", "least_squares", "unchanged"]
    for entry, without, unchanged in prediction.by_quantity:
        assert entry.rms[-1] < 0.03 * unchanged.rms[-1]
        assert entry.rms[0] < 0.1 * without.rms[0]
        assert np.array_equal(unchanged.series[:, 0], entry.series[:, 0])
    assert prediction.predicts
    assert not prediction.omitted


def test_axes_that_are_not_told_are_left_out_and_it_is_said(flight):
    prediction = Rates().multi_step_prediction((flight,), models(), frozenset({"pitch_effectiveness"}))
    assert [item[0].quantity for item in prediction.by_quantity] == ["roll rate", "yaw rate"]
    assert prediction.omitted == ("The pitch rate is not predicted: its effectiveness is refused.",)
    blind = Rates().multi_step_prediction((flight,), models(), frozenset({"effective_lag"}))
    assert not blind.errors
    assert len(blind.omitted) == 3
    channels = {
        name: channel for name, channel in flight.signals.channels.items() if name != "torque_setpoint_z"
    }
    two = replace(flight, signals=replace(flight.signals, channels=channels))
    result = Rates().multi_step_prediction((two,), models(), frozenset())
    assert [item[0].quantity for item in result.by_quantity] == ["roll rate", "pitch rate"]
    assert "not logged" in result.omitted[0]
    no_yaw = {name: item for name, item in TRUTH.items() if not name.startswith("yaw")}
    lesser = {"fit": SimpleModel("the fit", no_yaw)}
    assert "the fit knows none" in Rates().multi_step_prediction((flight,), lesser, frozenset()).omitted[0]
