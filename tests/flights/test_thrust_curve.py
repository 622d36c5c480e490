"""The thrust curve that is found out: its value, what it rests on, and what it does to everything else."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from flight_logs import FRICTION, changed, flown

import eivor as ev
from eivor.errors import UsageError
from eivor.inference.verdict import Status
from eivor.motions.vertical.model import (
    MOT_THST_EXPO,
    THR_MDL_FAC,
    CurveFamily,
    motor_signal,
    plant_share,
    proposed,
    share_of,
    thrust_of,
)
from eivor.signals.channels import CurveSide
from eivor.signals.thrust_map import Mixed, Power

pytestmark = pytest.mark.usefixtures("unchecked_shapes", "coarse_search")


@pytest.fixture(scope="module")
def log():
    """A flight whose thrust goes with the square of its command."""
    return flown(seconds=20.0)[0]


def commanded(log, true, *, thrust, side=CurveSide.BEFORE):
    """The same flight, its commands such that thrust goes with another map of them."""
    command = log.channels["rotor_command_1"]
    values = np.array([true.inverse(item) for item in command.values**2])
    name = "input" if thrust else "rotor_command_1"
    reported = replace(command, name=name, values=values, curve_side=side)
    return replace(changed(log, "rotor_command_1", **{name: reported}), input_map="")


@pytest.mark.parametrize(
    ("true", "thrust", "value"),
    [
        (Power(1.5), False, 1.5),
        (Mixed(0.5), True, 0.5),
        pytest.param(Mixed(0.0), True, 0.0, marks=pytest.mark.thorough),
    ],
)
def test_the_curve_is_found_out(log, true, thrust, value):
    identify_flight = ev.identify_flight(commanded(log, true, thrust=thrust), input_map="fit")
    curve = identify_flight.quantities["thrust_curve"]
    low, high = curve.interval
    assert low < value < high
    assert curve.half_width < 0.3
    assert curve.value == pytest.approx(value, abs=0.05)
    friction = identify_flight.quantities["viscous_friction"]
    assert friction.value == pytest.approx(FRICTION, abs=1.5 * friction.half_width)
    # the map's own error is part of the gain's interval, and the bias of the intercept's
    conditional = identify_flight.estimate.interval("input_gain")
    assert identify_flight.quantities["input_gain"].interval != pytest.approx(conditional, rel=1e-3)
    assert identify_flight.quantities["intercept"].half_width >= 1.9 * 0.1
    # no share is below zero: there an intercept is left that is none within its error
    left = identify_flight.quantities["intercept"]
    assert abs(left.value) < (0.03 if curve.value > 0.0 else 0.5 * left.half_width)


@pytest.mark.thorough
def test_what_was_found_is_told_and_can_be_typed(log):
    flight = replace(commanded(log, Mixed(0.5), thrust=True), parameters={"THR_MDL_FAC": 0.0})
    identify_flight = ev.identify_flight(flight, input_map="fit")
    document = json.loads(identify_flight.to_json())
    name = document["model"]["input_map"]
    assert name.startswith("mixed:0.")
    assert document["parameters"]["thrust_curve"]["value"] == pytest.approx(
        float(name.split(":")[1]), abs=1e-3
    )
    assert document["provenance"]["options"]["accelerometer_bias"] == 0.1
    (messages,) = [finding.message for finding in identify_flight.findings if finding.name == "thrust_curve"]
    assert "THR_MDL_FAC (PX4) would be set to 0." in messages
    assert "The log has THR_MDL_FAC 0." in messages
    typed = ev.identify_flight(flight, input_map=name)
    assert typed.parameters["input_gain"] == pytest.approx(identify_flight.parameters["input_gain"], rel=1e-3)
    assert "thrust_curve" not in typed.quantities
    assert "thrust_curve" not in json.loads(typed.to_json())["parameters"]


@pytest.mark.thorough
def test_curvature_alone_is_refused_when_it_cannot_tell(log):
    identify_flight = ev.identify_flight(
        commanded(log, Power(1.5), thrust=False), input_map="fit", accelerometer_bias=math.inf
    )
    curve = identify_flight.quantities["thrust_curve"]
    assert curve.verdict is Status.REFUSED
    assert any("Curvature alone" in reason.sentence for reason in curve.reasons)


@pytest.mark.parametrize("bias", [0.0, -0.1, math.nan])
def test_a_bias_that_is_none_is_refused(bias):
    with pytest.raises(UsageError, match="accelerometer's bias above zero"):
        ev.FlightOptions(accelerometer_bias=bias)


@pytest.mark.parametrize(("share", "hover"), [(0.3, 0.4), (0.7, 0.6), (-0.2, 0.5)])
def test_the_share_of_a_signal_behind_the_curve_is_the_parameter(share, hover):
    assert plant_share(CurveFamily(True), share, hover, None) == share
    assert plant_share(CurveFamily(True), share, hover, 0.0) == pytest.approx(share)
    exponent = CurveFamily(True).exponent(share, hover)
    assert plant_share(CurveFamily(False), exponent, hover, None) == pytest.approx(share)


@pytest.mark.parametrize("in_force", [-0.4, 0.0, 0.3, 1.0])
@pytest.mark.parametrize("true", [-0.3, 0.0, 0.65, 1.0])
def test_before_the_curve_both_curves_together_are_the_vehicle_s(in_force, true):
    """Commands went through the inverse of one curve, and thrust is another of the signal."""
    signal, step = 0.45, 1e-6

    def setpoint(nuisances):
        return thrust_of(in_force, nuisances)

    hover = setpoint(signal)
    assert motor_signal(hover, in_force) == pytest.approx(signal)
    ends = [
        (math.log(thrust_of(true, item)), math.log(setpoint(item))) for item in (signal - step, signal + step)
    ]
    seen = (ends[1][0] - ends[0][0]) / (ends[1][1] - ends[0][1])
    assert plant_share(CurveFamily(False), seen, hover, in_force) == pytest.approx(true, abs=1e-6)
    of_commands = share_of(seen, hover)
    if math.isfinite(of_commands):
        assert plant_share(CurveFamily(True), of_commands, hover, in_force) == pytest.approx(true, abs=1e-6)
    # thrust that is proportional to the setpoint leaves the curve as it is
    assert plant_share(CurveFamily(True), 0.0, hover, in_force) == pytest.approx(in_force)


@pytest.mark.parametrize("in_force", [None, 0.3])
def test_intervals_hold_every_pair_and_are_cut_to_the_range(in_force):
    curve, hover = (0.6, (0.5, 0.7)), (0.4, (0.38, 0.42))
    share, thrust = proposed(THR_MDL_FAC, CurveFamily(True), curve, hover, in_force)
    for value in np.linspace(0.5, 0.7, 9):
        for command in np.linspace(0.38, 0.42, 9):
            item = plant_share(CurveFamily(True), value, command, in_force)
            assert share[1][0] - 1e-12 <= item <= share[1][1] + 1e-12
            reported = thrust_of(item, motor_signal(command, in_force))
            assert thrust[1][0] - 1e-12 <= reported <= thrust[1][1] + 1e-12
    wide = (0.6, (-math.inf, math.inf))
    assert proposed(THR_MDL_FAC, CurveFamily(True), wide, hover, in_force)[0][1] == (0.0, 1.0)
    exponents = (1.4, (0.2, 40.0))
    at_rest = (0.4, (-0.1, 1.2))
    share, _ = proposed(MOT_THST_EXPO, CurveFamily(False), exponents, at_rest, in_force)
    assert share[1] == (-1.0, 1.0)


@pytest.mark.parametrize(
    ("side", "parameters", "said"),
    [
        (
            CurveSide.BEHIND,
            {},
            r"THR_MDL_FAC \(PX4\) would be set to 0\.5.* MOT_THST_EXPO \(ArduPilot\) would be",
        ),
        (CurveSide.BEFORE, {}, "no value of it that is in force is known"),
        (CurveSide.UNKNOWN, {"THR_MDL_FAC": 0.0}, "does not say whether input is before or behind"),
    ],
)
def test_what_the_report_says_without_a_value_in_force(log, side, parameters, said):
    flight = commanded(log, Mixed(0.5), thrust=True, side=side)
    identify_flight = ev.identify_flight(replace(flight, parameters=parameters), input_map="fit")
    (messages,) = [finding.message for finding in identify_flight.findings if finding.name == "thrust_curve"]
    assert re.search(said, messages)
    document = json.loads(identify_flight.to_json())["model"]["autopilot_curve"]
    assert document == {"side": side.value or None, "in_force": parameters}
