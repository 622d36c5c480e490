"""Predictions of vertical motion: the truth predicts a noise-free flight, other numbers do not."""

from __future__ import annotations

import numpy as np
import pytest
from flight_logs import FRICTION, GAIN, HOVER, LAG_S, flown, prepare_vertical

from eivor.estimation.methods import by_name, identify
from eivor.flights.options import FlightOptions
from eivor.models.separable import NoInstruments
from eivor.motions.vertical.motion import Vertical

TRUTH = {"viscous_friction": FRICTION, "input_gain": GAIN, "actuator_lag": LAG_S, "delay": 0.0}
pytestmark = pytest.mark.usefixtures("unchecked_shapes")


@pytest.fixture(scope="module")
def problem():
    (log,) = flown(noise=0.0)
    return Vertical().problem((prepare_vertical(log, FlightOptions()),), NoInstruments())


def left(problem, values):
    return [
        float(np.std(prediction.measured - prediction.predicted) / np.std(prediction.measured))
        for prediction in Vertical().predictions(problem, values)
    ]


@pytest.mark.thorough
def test_the_truth_predicts(problem):
    one_step, open_loop = Vertical().predictions(problem, TRUTH)
    assert (one_step.horizon.words, open_loop.horizon.words) == ("one step ahead", "in open loop")
    assert one_step.measured.shape == one_step.predicted.shape == open_loop.measured.shape
    # the rotors' state before the log is not known: they start at their first command
    one_step, open_loop = left(problem, TRUTH)
    assert one_step < 0.02
    assert open_loop < 0.005


@pytest.mark.parametrize(
    ("name", "value"), [("viscous_friction", 0.2), ("input_gain", 36.0), ("actuator_lag", 0.0)]
)
def test_other_numbers_do_not(problem, name, value):
    assert min(left(problem, {**TRUTH, name: value})) > 0.035


def test_the_simpler_models_come_from_the_same_flight(problem):
    simple_models = Vertical().simple_models(problem, identify(problem, by_name("least_squares")))
    assert set(simple_models) == {"least_squares", "hover"}
    hover = simple_models["hover"].values
    assert hover["viscous_friction"] == hover["actuator_lag"] == hover["delay"] == 0.0
    assert hover["input_gain"] == pytest.approx(9.80665 / HOVER**2, rel=0.01)
    assert simple_models["least_squares"].values["actuator_lag"] == 0.0
    assert left(problem, simple_models["least_squares"].values)[0] < left(problem, hover)[0]
