"""Every ground of every verdict, each reached alone."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from eivor.flights.lag_prior import LagPrior
from eivor.flights.motion import InstrumentStrength, Searched, VerdictInputs
from eivor.flights.prepared import Difference, SensorAgreement
from eivor.flights.quantity import Choice, Counts, QuantityEstimate, SystematicUncertainty
from eivor.inference.confidence_set import ConfidenceSet
from eivor.inference.verdict import Status, verdict
from eivor.models.separable import Prior
from eivor.motions.vertical.verdict import (
    all_reasons,
    friction_reasons,
    gain_reasons,
    hover_reasons,
    lag_reasons,
)

NAMES = ("viscous_friction", "input_gain", "actuator_lag")


def reserving(of: QuantityEstimate, part: float) -> QuantityEstimate:
    """A quantity with a systematic part that the verdict alone counts."""
    return replace(of, systematic_uncertainties=(SystematicUncertainty(Counts.RESERVED, part, part, ""),))


def quantity(value: float, half_width: float) -> QuantityEstimate:
    return QuantityEstimate(value, "", 0.5 * half_width, (value - half_width, value + half_width))


def numbers(
    strengths=(50.0, 50.0, 50.0), p_value: float = 0.5, lag_s: float = 0.05, names=NAMES, robust=()
) -> InstrumentStrength:
    """What the instruments tell; with the pieces of a set of the friction."""
    searched = {"actuator_lag": Searched(lag_s, highest=0.3)} if "actuator_lag" in names else {}
    sets = {"viscous_friction": ConfidenceSet(robust)} if robust else {}
    return InstrumentStrength(dict(zip(names, strengths, strict=True)), p_value, searched, sets)


def quantities(**changed: QuantityEstimate) -> dict[str, QuantityEstimate]:
    good = {
        "viscous_friction": quantity(0.4, 0.1),
        "input_gain": quantity(40.0, 1.0),
        "actuator_lag": quantity(0.05, 0.005),
        "effective_lag": quantity(0.05, 0.005),
        "hover_input": quantity(0.5, 0.005),
        "intercept": quantity(0.0, 0.1),
        "delay": QuantityEstimate(0.0, "s", np.nan, (0.0, 0.0), Choice((0.0,), (0.0, 0.01))),
    }
    return good | changed


def circumstances(**changed) -> VerdictInputs:
    good = {
        "flights": 1,
        "command_rate_hz": 100.0,
        "response_rate_hz": 100.0,
        "exogenous": True,
        "direct": False,
    }
    return VerdictInputs(**(good | changed))


def test_a_good_flight_has_no_ground_against_it():
    index = circumstances()
    assert not list(friction_reasons(quantities(), numbers(), index))
    kept = quantities(viscous_friction=reserving(quantity(0.4, 0.169), 0.03))
    assert not list(friction_reasons(kept, numbers(), index))
    assert not list(gain_reasons(quantities()["input_gain"], numbers(), index))
    assert not list(hover_reasons(quantities()["hover_input"], index))
    assert not list(lag_reasons(quantities(), numbers(), index))


@pytest.mark.parametrize(
    ("fit", "found", "at", "status", "said"),
    [
        ({}, {}, {"used_s": 15.4}, Status.WEAK, "Only 15.4 s could be used"),
        (
            {},
            {"viscous_friction": quantity(0.0, 0.1)},
            {},
            Status.REFUSED,
            "cannot be distinguished from zero",
        ),
        (
            {},
            {"viscous_friction": quantity(-0.2, 0.1)},
            {},
            Status.REFUSED,
            "came out at -0.2 1/s, which no vehicle has",
        ),
        (
            {},
            {"viscous_friction": quantity(-0.2, 0.3)},
            {},
            Status.REFUSED,
            r"zero: its interval is \[-0.5, 0.1\]",
        ),
        (
            {"strengths": (50.0, 50.0, 2.0)},
            {},
            {"single_frequency_hz": 0.318},
            Status.REFUSED,
            r"has one frequency \(0.32 Hz\), which identifies two of 3 numbers",
        ),
        (
            {},
            {"viscous_friction": quantity(0.4, 0.4)},
            {},
            Status.REFUSED,
            "cannot be distinguished from zero",
        ),
        ({}, {"viscous_friction": quantity(0.4, 0.201)}, {}, Status.WEAK, r"interval is \+-50\.2% wide;"),
        (
            {},
            {"viscous_friction": reserving(quantity(0.4, 0.171), 0.03)},
            {},
            Status.WEAK,
            r"\+-42\.8% wide, and the estimator behind velocity or acceleration may add 0\.03 1/s;",
        ),
        (
            {},
            {"viscous_friction": reserving(replace(quantity(0.1, 0.0), interval=(0.029, 0.065)), 0.03)},
            {},
            Status.WEAK,
            r"begins at 0\.029 1/s, and up to 0\.03 1/s cannot be distinguished from an estimator's own",
        ),
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
    (reason,) = friction_reasons(quantities(**found), numbers(**fit), circumstances(**at))
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
        ({}, {}, {"command_rate_hz": 45.0}),
        ({}, {}, {"used_s": 25.0}),
        ({"names": NAMES[:2], "strengths": (50.0, 50.0), "lag_s": 0.3}, {}, {}),
    ],
)
def test_bounds_themselves_are_accepted(fit, found, at):
    assert not list(friction_reasons(quantities(**found), numbers(**fit), circumstances(**at)))


@pytest.mark.parametrize(
    ("interval", "gaps", "status", "said"),
    [
        ((0.3, 0.5), 0, Status.WEAK, r"F is 3\.0.* holds however weak they are\.$"),
        ((0.3, 0.5), 1, Status.WEAK, r"they are, here from the first to the last of its 2 pieces\.$"),
        ((0.1, 0.9), 0, Status.WEAK, "holds however weak they are"),
        ((-0.1, 0.5), 0, Status.REFUSED, "cannot be distinguished from zero"),
        ((0.2, np.inf), 0, Status.REFUSED, r"leave the viscous friction anywhere in \[0\.2, inf\]\.$"),
        ((-np.inf, np.inf), 0, Status.REFUSED, r"anywhere in \[-inf, inf\]\.$"),
    ],
)
def test_weak_instruments_are_judged_by_the_set_that_holds_all_the_same(interval, gaps, status, said):
    friction = QuantityEstimate(0.4, "1/s", 0.1, interval)
    low, high = interval
    pieces = ((low, 0.39), (0.41, high)) if gaps else (interval,)
    fit = numbers((50.0, 50.0, 3.0), robust=pieces)
    reasons = list(friction_reasons(quantities(viscous_friction=friction), fit, circumstances()))
    worst = verdict(reasons)
    assert worst.status is status
    assert re.search(said, worst.reasons[0].sentence)
    assert len(reasons) == (1 if not np.isfinite(interval[1]) or interval == (0.3, 0.5) else 2)


def test_a_set_without_bounds_is_refused_however_strong_the_instruments_are():
    friction = QuantityEstimate(0.4, "1/s", 0.01, (0.2, np.inf))
    result = quantities(viscous_friction=friction)
    (reason,) = friction_reasons(result, numbers(robust=(friction.interval,)), circumstances())
    assert reason.status is Status.REFUSED
    assert reason.sentence.startswith(
        "The instruments do not identify how long the lag is at most. They leave "
    )
    assert "--lag MS:STD" in reason.remedy


def test_the_lag_is_asked_for_where_it_would_help():
    weak = (50.0, 50.0, 3.0)
    given = LagPrior(Prior(0.05, 0.01), quantity(0.05, 0.1))
    texts = [
        "--lag MS:STD" in next(friction_reasons(quantities(), fit, item)).remedy
        for fit, item in (
            (numbers(weak), circumstances()),
            (numbers(weak), circumstances(lag_prior=given)),
            (numbers(weak[1:], names=NAMES[:2]), circumstances()),
        )
    ]
    assert texts == [True, False, False]


def test_a_gain_that_is_known_is_not_weak_for_its_instruments():
    assert not list(gain_reasons(quantity(40.0, 1.0), numbers((50.0, 2.0, 50.0)), circumstances()))


@pytest.mark.parametrize(
    ("gain", "fit", "at", "status", "said"),
    [
        (quantity(-1.0, 0.1), {}, {}, Status.REFUSED, "not positive"),
        (quantity(40.0, 4.1), {}, {}, Status.WEAK, "+-10.3% wide"),
        (
            quantity(40.0, 4.1),
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
    (reason,) = gain_reasons(gain, numbers(**fit), circumstances(**at))
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
        ({}, {"effective_lag": quantity(0.09, 0.099)}, {}, Status.WEAK, "+-99 ms wide"),
        ({"lag_s": 0.3}, {}, {}, Status.WEAK, "top of its grid"),
        ({}, {}, {"direct": True}, Status.PROVISIONAL, "direct method"),
    ],
)
def test_each_ground_against_the_lag(fit, found, at, status, said):
    (reason,) = lag_reasons(quantities(**found), numbers(**fit), circumstances(**at))
    assert reason.status is status
    assert said in reason.sentence


def test_a_lag_wider_than_itself_and_than_the_friction_can_bear_is_not_told():
    result = quantities(effective_lag=quantity(0.11, 0.12))
    reasons = list(lag_reasons(result, numbers(), circumstances()))
    assert verdict(reasons).status is Status.REFUSED
    assert any("anything from 0 to 230 ms" in reason.sentence for reason in reasons)


def test_a_delay_of_which_every_value_fits_is_not_told():
    tried = (0.0, 0.01, 0.02)
    some = QuantityEstimate(0.0, "s", float("nan"), (0.0, 0.01), Choice(tried[:2], tried))
    every = QuantityEstimate(0.0, "s", float("nan"), (0.0, 0.02), Choice(tried, tried))
    measured = QuantityEstimate(0.0, "s", float("nan"), (0.0, 0.0), Choice((0.0,), (0.0,)))
    for delay, wanted in ((some, Status.IDENTIFIED), (every, Status.WEAK), (measured, Status.IDENTIFIED)):
        grounds = all_reasons(quantities(delay=delay), numbers(), circumstances())
        assert verdict(list(grounds["delay"])).status is wanted
        assert grounds["actuator_lag"] == grounds["effective_lag"] == ()


@pytest.mark.parametrize(
    ("fit", "found"),
    [
        (numbers((4.0, 50.0, 50.0)), {}),
        (numbers(), {"viscous_friction": quantity(-0.1, 0.05)}),
        (numbers(), {"viscous_friction": quantity(0.4, 0.5)}),
        (numbers(), {"viscous_friction": quantity(0.4, 0.3)}),
    ],
)
def test_grounds_against_the_friction_say_how_much_the_flight_moved(fit, found):
    moved = "The input varied by 1.4% and the vertical speed by 0.084 m/s (standard deviations)."
    index = circumstances(excitation=moved)
    (reason,) = friction_reasons(quantities(**found), fit, index)
    assert reason.sentence.endswith(f" {moved}")
    assert "input varied" not in next(friction_reasons(quantities(**found), fit, circumstances())).sentence


def test_every_ground_says_what_to_do():
    bad = {
        "viscous_friction": quantity(0.4, 0.3),
        "input_gain": quantity(40.0, 10.0),
        "effective_lag": quantity(0.1, 0.2),
        "hover_input": quantity(0.5, 0.1),
    }
    fit = numbers((2.0, 2.0, 2.0), p_value=1e-6, lag_s=0.3)
    for direct in (False, True):
        index = circumstances(
            direct=direct,
            exogenous=False,
            command_rate_hz=10.0,
            response_rate_hz=10.0,
            missing_reference="none",
        )
        result = quantities(**bad)
        reasons = [
            *friction_reasons(result, fit, index),
            *gain_reasons(result["input_gain"], fit, index),
            *gain_reasons(quantity(-1.0, 0.1), fit, index),
            *hover_reasons(result["hover_input"], index),
            *hover_reasons(quantity(-1.0, 0.1), index),
            *lag_reasons(result, fit, index),
        ]
        assert len(reasons) >= 10
        assert all(reason.remedy.endswith(".") and reason.sentence.endswith(".") for reason in reasons)


def test_signs_and_units_speak_against_the_flight():
    result = quantities(input_gain=quantity(-40.0, 1.0))
    assert verdict(list(friction_reasons(result, numbers(), circumstances()))).status is Status.REFUSED
    for value, wanted in ((20.0, Status.WEAK), (4.0, Status.IDENTIFIED), (-9.5, Status.WEAK)):
        result = quantities(intercept=quantity(value, 0.5))
        assert verdict(list(friction_reasons(result, numbers(), circumstances()))).status is wanted


def test_a_delay_of_measured_rotors_at_the_end_of_its_grid_is_weak():
    for value, status in ((0.06, Status.WEAK), (-0.06, Status.WEAK), (0.05, Status.IDENTIFIED)):
        names = ("viscous_friction", "input_gain", "delay")
        fit = InstrumentStrength(dict.fromkeys(names, 50.0), 0.5, {"delay": Searched(value, highest=0.06)})
        reasons = all_reasons(quantities(effective_lag=quantity(value, 0.005)), fit, circumstances())
        assert verdict(list(reasons["viscous_friction"])).status is status
        assert verdict(list(reasons["effective_lag"])).status is status


# -- the thrust curve -------------------------------------------------------------------------------------


def curve(
    exponent: float, of_map: float, *, thrust: bool = False, p_value: float = 0.01, **record: float
) -> VerdictInputs:
    known = {"thrust_exponent": exponent, "map_exponent": of_map, "thrust_command": float(thrust)}
    return circumstances(numbers={**known, "input_map_p_value": p_value, **record})


@pytest.mark.parametrize(
    ("exponent", "of_map", "thrust", "remedy"),
    [
        (1.99, 1.5, False, "--input-map square "),
        (1.0, 2.0, False, "--input-map linear "),
        (1.6, 2.0, False, "--input-map power:1.6 "),
        # (1 - s) u + s u^2 at u = .5 with s = .6: exponent (.4 + .6) / (.4 + .3)
        (1.0 / 0.7, 1.0, True, "--input-map mixed:0.6 "),
        (0.8, 1.0, True, "sags under load"),
    ],
)
def test_an_intercept_that_no_map_leaves_names_the_map(exponent, of_map, thrust, remedy):
    wrong = quantities(intercept=quantity(9.8 * (1.0 - exponent / of_map), 0.1))
    reasons = all_reasons(wrong, numbers(), curve(exponent, of_map, thrust=thrust))
    for name in ("input_gain", "hover_input", "intercept"):
        (reason,) = reasons[name]
        assert reason.status is Status.WEAK
        assert f"to the power {exponent:.2f}, and the map says {of_map:.2f}" in reason.sentence
        assert remedy in reason.remedy
    assert reasons["actuator_lag"] == ()
    assert not [reason for reason in reasons["viscous_friction"] if "power" in reason.sentence]


@pytest.mark.parametrize(("p_value", "told"), [(0.049, True), (0.051, False)])
def test_an_input_map_does_not_fit_where_its_test_says_so(p_value, told):
    wide = quantities(intercept=quantity(0.9, 0.6))
    reasons = all_reasons(wide, numbers(), curve(1.8, 2.0, p_value=p_value))
    assert bool(reasons["input_gain"]) is told
    assert not reasons["hover_input"]


@pytest.mark.parametrize(("least", "told"), [(0.41, True), (0.39, False)])
def test_the_hover_input_is_within_what_was_flown_and_a_bend_alone_says_nothing_of_it(least, told):
    index = curve(1.8, 2.0, least_intercept=least)
    reasons = all_reasons(quantities(intercept=quantity(0.9, 0.3)), numbers(), index)
    assert reasons["input_gain"]
    assert bool(reasons["hover_input"]) is told


@pytest.mark.parametrize(
    ("bend", "half", "p_value", "said"),
    [
        (-0.12, 0.02, 1e-6, "more than such a power does (-0.046): so does thrust that sags under load."),
        (-0.12, 0.09, 0.02, "The curve bends as well (-0.12 ± 0.09)."),
        (-0.12, 0.15, 0.11, "and the map says 2.00."),
        (0.12, 0.02, 1e-6, "and the map says 2.00."),
    ],
)
def test_what_the_bend_of_the_thrust_curve_says_beside_the_intercept(bend, half, p_value, said):
    of_bend = ("left_out_thrust_curvature", bend), ("_half_width", half), ("_p_value", p_value)
    selected = {
        name if name.startswith("left") else f"{of_bend[0][0]}{name}": value for name, value in of_bend
    }
    (reason,) = all_reasons(quantities(intercept=quantity(0.9, 0.2)), numbers(), curve(1.8, 2.0, **selected))[
        "input_gain"
    ]
    assert reason.sentence.endswith(said)


@pytest.mark.parametrize(("times", "refused"), [(100.0, True), (-1.01, True), (1.2, False)])
def test_a_velocity_in_another_unit_or_of_another_sign_refuses_everything(times, refused):
    scale = Difference(2.0 * (times - 1.0) / (times + 1.0), 1e-3)
    index = circumstances(sensors=SensorAgreement({"scale": scale}, 0.5))
    grounds = all_reasons(quantities(), numbers(), index)
    for name in ("viscous_friction", "input_gain", "hover_input", "effective_lag"):
        assert (verdict(list(grounds[name])).status is Status.REFUSED) is refused


def test_a_gain_that_cannot_be_told_from_zero_is_refused():
    (reason,) = gain_reasons(quantity(3.0, 15.0), numbers(), circumstances())
    assert reason.status is Status.REFUSED
    assert "cannot be distinguished from zero: its interval is [-12, 18] m/s^2." in reason.sentence


@pytest.mark.parametrize(
    ("felt", "said"),
    [
        (1.0, "feels a gravity of 1 m/s^2, where 9.81 is expected: its values look like g."),
        (998.0, "where 9.81 is expected: its values look like milli-g."),
        (-9.8, "feels a gravity of -9.8 m/s^2, where 9.81 is expected."),
        (9.5, ""),
        (np.nan, ""),
    ],
)
def test_an_accelerometer_in_another_unit_refuses_everything(felt, said):
    index = circumstances(numbers={"apparent_gravity": felt})
    grounds = all_reasons(quantities(), numbers(), index)
    for name in ("viscous_friction", "input_gain", "hover_input", "effective_lag"):
        assert verdict(list(grounds[name])).status is (Status.REFUSED if said else Status.IDENTIFIED)
        assert said in " ".join(reason.sentence for reason in grounds[name])
