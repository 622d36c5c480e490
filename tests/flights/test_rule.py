"""Every ground of every verdict, each reached alone."""

from __future__ import annotations

import re
from types import SimpleNamespace

import numpy as np
import pytest

from eivor.flights.result import Quantity
from eivor.flights.rule import (
    Circumstances,
    friction_reasons,
    gain_reasons,
    hover_reasons,
    lag_reasons,
)
from eivor.inference.verdict import Status, verdict

# What is judged is passed in pieces, not as whole estimates.
pytestmark = pytest.mark.usefixtures("unchecked_shapes")
NAMES = ("viscous_friction", "input_gain", "actuator_lag")


def quantity(value: float, half_width: float) -> Quantity:
    return Quantity(value, "", 0.5 * half_width, (value - half_width, value + half_width), Status.IDENTIFIED)


def estimate(strengths=(50.0, 50.0, 50.0), p_value: float = 0.5, lag_s: float = 0.05, names=NAMES):
    """As much of an estimate as the rule looks at."""
    inference = SimpleNamespace(first_stage=np.array(strengths), over_identification=(1.0, p_value))
    profile = SimpleNamespace(lag_s=lag_s, lags_s=np.array([0.002, 0.05, 0.3]))
    return SimpleNamespace(best=SimpleNamespace(inference=inference, profile=profile), names=names)


def quantities(**changed: Quantity) -> dict[str, Quantity]:
    good = {
        "viscous_friction": quantity(0.4, 0.1),
        "input_gain": quantity(40.0, 1.0),
        "actuator_lag": quantity(0.05, 0.005),
        "effective_lag": quantity(0.05, 0.005),
        "hover_input": quantity(0.5, 0.005),
    }
    return good | changed


def circumstances(**changed) -> Circumstances:
    good = {
        "flights": 1,
        "command_rate_hz": 100.0,
        "response_rate_hz": 100.0,
        "exogenous": True,
        "direct": False,
    }
    return Circumstances(**(good | changed))


def test_a_good_flight_has_no_ground_against_it():
    at = circumstances()
    assert friction_reasons(estimate(), quantities(), at) == []
    assert gain_reasons(estimate(), quantities()["input_gain"], at) == []
    assert hover_reasons(quantities()["hover_input"], at) == []
    assert lag_reasons(estimate(), quantities(), at) == []


@pytest.mark.parametrize(
    ("fit", "found", "at", "status", "said"),
    [
        (
            {},
            {"viscous_friction": quantity(0.0, 0.1)},
            {},
            Status.REFUSED,
            "came out at 0 1/s, which no vehicle has",
        ),
        ({}, {"viscous_friction": quantity(-0.2, 0.1)}, {}, Status.REFUSED, "came out at -0.2 1/s"),
        ({}, {"viscous_friction": quantity(0.4, 0.4)}, {}, Status.REFUSED, "cannot be told from zero"),
        ({}, {"viscous_friction": quantity(0.4, 0.201)}, {}, Status.WEAK, r"interval is \+-50\.2% wide"),
        (
            {"strengths": (9.9, 50.0, 50.0)},
            {},
            {},
            Status.REFUSED,
            "about the viscous friction: first-stage F is 9.9",
        ),
        (
            {"strengths": (50.0, 50.0, 3.0)},
            {},
            {},
            Status.REFUSED,
            "about the actuator lag: first-stage F is 3.0",
        ),
        ({"strengths": (50.0, np.nan, 50.0)}, {}, {}, Status.REFUSED, "about the input gain"),
        ({"p_value": 0.0009}, {}, {}, Status.WEAK, "references disagree"),
        ({"lag_s": 0.2999}, {}, {}, Status.WEAK, "ran into the top of its grid"),
        ({}, {"effective_lag": quantity(0.05, 0.101)}, {}, Status.WEAK, r"known to \+-101 ms only"),
        ({}, {}, {"command_rate_hz": 44.9}, Status.WEAK, "logged at 45 Hz; below 45 Hz"),
        ({}, {}, {"exogenous": False}, Status.WEAK, "answer the vehicle's own disturbances"),
        (
            {},
            {},
            {"constant_reference": True, "missing_reference": "a: constant"},
            Status.REFUSED,
            "never moved",
        ),
        (
            {},
            {},
            {"direct": True, "missing_reference": "the log has none"},
            Status.PROVISIONAL,
            "No reference can serve",
        ),
        ({}, {}, {"direct": True}, Status.PROVISIONAL, "biased by disturbances in closed loop"),
    ],
)
def test_each_ground_against_the_friction(fit, found, at, status, said):
    (reason,) = friction_reasons(estimate(**fit), quantities(**found), circumstances(**at))
    assert reason.status is status
    assert re.search(said, reason.sentence)
    assert reason.remedy


@pytest.mark.parametrize(
    ("fit", "found", "at"),
    [
        ({}, {"viscous_friction": quantity(0.5, 0.25)}, {}),
        ({}, {"effective_lag": quantity(0.125, 0.1)}, {}),
        ({"strengths": (10.0, 10.0, 10.0)}, {}, {}),
        ({"p_value": 0.001}, {}, {}),
        ({"p_value": 0.0}, {}, {"flights": 10}),
        ({}, {}, {"command_rate_hz": 45.0}),
        ({"names": NAMES[:2], "strengths": (50.0, 50.0), "lag_s": 0.3}, {}, {}),
    ],
)
def test_bounds_themselves_are_accepted(fit, found, at):
    assert friction_reasons(estimate(**fit), quantities(**found), circumstances(**at)) == []


@pytest.mark.parametrize(
    ("gain", "fit", "at", "status", "said"),
    [
        (quantity(-1.0, 0.1), {}, {}, Status.REFUSED, "not positive"),
        (quantity(40.0, 4.1), {}, {}, Status.WEAK, "+-10.3% wide"),
        (
            quantity(40.0, 1.0),
            {"strengths": (50.0, 9.0, 50.0)},
            {},
            Status.WEAK,
            "F of the input gain is 9.0",
        ),
        (quantity(40.0, 1.0), {}, {"response_rate_hz": 19.0}, Status.WEAK, "logged at 19 Hz at most"),
        (quantity(40.0, 1.0), {}, {"direct": True}, Status.PROVISIONAL, "direct method"),
    ],
)
def test_each_ground_against_the_gain(gain, fit, at, status, said):
    (reason,) = gain_reasons(estimate(**fit), gain, circumstances(**at))
    assert reason.status is status
    assert said in reason.sentence


@pytest.mark.parametrize(
    ("hover", "at", "status", "said"),
    [
        (quantity(0.0, 0.1), {}, Status.REFUSED, "not positive"),
        (quantity(float("nan"), 0.1), {}, Status.REFUSED, "not positive"),
        (quantity(0.5, 0.026), {}, Status.WEAK, "wide"),
        (quantity(0.5, float("nan")), {}, Status.WEAK, "wide"),
        (quantity(0.5, 0.001), {"direct": True}, Status.PROVISIONAL, "direct method"),
    ],
)
def test_each_ground_against_the_hover_input(hover, at, status, said):
    (reason,) = hover_reasons(hover, circumstances(**at))
    assert reason.status is status
    assert said in reason.sentence


@pytest.mark.parametrize(
    ("fit", "found", "at", "status", "said"),
    [
        ({"strengths": (50.0, 50.0, 9.0)}, {}, {}, Status.WEAK, "F of the lag is 9.0"),
        ({}, {"effective_lag": quantity(0.05, 0.03)}, {}, Status.WEAK, "+-30 ms wide"),
        ({"lag_s": 0.3}, {}, {}, Status.WEAK, "top of its grid"),
        ({}, {}, {"direct": True}, Status.PROVISIONAL, "direct method"),
    ],
)
def test_each_ground_against_the_lag(fit, found, at, status, said):
    (reason,) = lag_reasons(estimate(**fit), quantities(**found), circumstances(**at))
    assert reason.status is status
    assert said in reason.sentence


@pytest.mark.parametrize(
    ("fit", "found"),
    [
        (estimate((4.0, 50.0, 50.0)), {}),
        (estimate(), {"viscous_friction": quantity(-0.1, 0.05)}),
        (estimate(), {"viscous_friction": quantity(0.4, 0.5)}),
        (estimate(), {"viscous_friction": quantity(0.4, 0.3)}),
    ],
)
def test_grounds_against_the_friction_say_how_much_the_flight_moved(fit, found):
    at = circumstances(input_variation=0.0137, velocity_std=0.084)
    (reason,) = friction_reasons(fit, quantities(**found), at)
    assert reason.sentence.endswith(
        "The input varied by 1.4% and the vertical speed by 0.084 m/s (standard deviations)."
    )
    assert "input varied" not in friction_reasons(fit, quantities(**found), circumstances())[0].sentence


def test_every_ground_says_what_to_do():
    bad = {
        "viscous_friction": quantity(0.4, 0.3),
        "input_gain": quantity(40.0, 10.0),
        "effective_lag": quantity(0.1, 0.2),
        "hover_input": quantity(0.5, 0.1),
    }
    fit = estimate((2.0, 2.0, 2.0), p_value=1e-6, lag_s=0.3)
    for direct in (False, True):
        at = circumstances(
            direct=direct,
            exogenous=False,
            command_rate_hz=10.0,
            response_rate_hz=10.0,
            missing_reference="none",
        )
        found = quantities(**bad)
        reasons = [
            *friction_reasons(fit, found, at),
            *gain_reasons(fit, found["input_gain"], at),
            *gain_reasons(fit, quantity(-1.0, 0.1), at),
            *hover_reasons(found["hover_input"], at),
            *hover_reasons(quantity(-1.0, 0.1), at),
            *lag_reasons(fit, found, at),
        ]
        assert len(reasons) >= 10
        assert all(reason.remedy.endswith(".") and reason.sentence.endswith(".") for reason in reasons)


def test_signs_and_units_speak_against_the_flight():
    found = quantities(input_gain=quantity(-40.0, 1.0))
    assert verdict(friction_reasons(estimate(), found, circumstances())).status is Status.REFUSED
    for value, wanted in ((20.0, Status.WEAK), (4.0, Status.IDENTIFIED), (-9.5, Status.WEAK)):
        found = quantities(intercept=quantity(value, 0.5))
        assert verdict(friction_reasons(estimate(), found, circumstances())).status is wanted
