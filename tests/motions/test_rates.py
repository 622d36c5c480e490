"""Turning about the body axes: what flights tell of effectiveness and lag, and what they do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from turning_logs import Vehicle, turned

import eivor as ev
from eivor.errors import InputError, MissingChannelError
from eivor.flights.prepare import prepare
from eivor.flights.quantity import SimpleModel
from eivor.motions.rates.motion import Rates
from eivor.motions.table import motion_names
from motions.turning_logs import AXES
from motions.turning_logs import Vehicle as Vehicle_ahead
from motions.turning_logs import turned as turned_ahead

TRUTH = Vehicle()
HEADLINE = {"roll_effectiveness": 100.0, "pitch_effectiveness": 80.0, "effective_lag": TRUTH.effective_lag_s}


def changed(log, **channels):
    """The log with other channels; None takes one away."""
    merged = {**log.channels, **channels}
    return replace(log, channels={name: channel for name, channel in merged.items() if channel is not None})


@pytest.fixture(scope="module")
def short():
    """Steps of 14 degrees for 40 s."""
    return turned(1)


@pytest.fixture(scope="module")
def log():
    """Larger steps for longer, as the remedy of the short flight says."""
    return turned(1, seconds=80.0, size=0.5)


@pytest.fixture(scope="module")
def fit(log):
    return ev.identify_flight(log, model="rates")


def test_it_is_a_motion_of_its_own():
    assert motion_names()[:2] == ("vertical", "rates")


@pytest.mark.thorough
def test_setpoints_at_50_hz_tell_effectiveness_and_lag(fit):
    assert fit.verdict.status is ev.Status.IDENTIFIED
    for name, truth in HEADLINE.items():
        low, high = fit.quantities[name].interval
        assert low <= truth <= high
    assert fit.quantities["roll_effectiveness"].value == pytest.approx(100.0, rel=0.08)
    assert fit.quantities["effective_lag"].value == pytest.approx(TRUTH.effective_lag_s, abs=0.006)


@pytest.mark.thorough
def test_an_interval_wider_than_a_tenth_is_weak(short):
    flight = ev.identify_flight(short, model="rates")
    assert flight.verdict.status is ev.Status.WEAK
    for axis in ("roll", "pitch"):
        effect = flight.quantities[f"{axis}_effectiveness"]
        assert effect.interval[0] <= HEADLINE[f"{axis}_effectiveness"] <= effect.interval[1]
        assert 0.1 * effect.value < effect.half_width <= 0.25 * effect.value
        (reason,) = effect.reasons
        assert f"{axis} effectiveness is" in reason.sentence
        assert "identified needs ±10%" in reason.sentence
        assert reason.remedy == "Fly larger and quicker steps, or longer."
    assert flight.quantities["effective_lag"].verdict is ev.Status.IDENTIFIED
    assert flight.quantities["effective_lag"].value == pytest.approx(TRUTH.effective_lag_s, abs=0.006)


@pytest.mark.thorough
def test_without_noise_the_numbers_are_those_of_the_vehicle():
    log = turned(0, command_hz=400.0, rate_hz=400.0, disturbance=0.0, noise=0.0, seconds=20.0)
    exact = ev.identify_flight(log, model="rates", controller_rate_hz=400.0)
    results = {name: quantity.value for name, quantity in exact.quantities.items()}
    for axis, effect, damping in zip(
        ("roll", "pitch", "yaw"), TRUTH.effectiveness, TRUTH.damping, strict=True
    ):
        assert results[f"{axis}_effectiveness"] == pytest.approx(effect, rel=1e-3)
        assert results[f"{axis}_damping"] == pytest.approx(damping, abs=0.03)
    assert results["yaw_reaction"] == pytest.approx(0.0, abs=0.02)
    assert results["effective_lag"] == pytest.approx(TRUTH.effective_lag_s, abs=2e-4)
    unknown = ev.identify_flight(log, model="rates").quantities["effective_lag"]
    (slack,) = [item for item in unknown.systematic_uncertainties if "how often" in item.sentence]
    assert slack.above == pytest.approx(0.25 / 400.0)
    assert abs(unknown.value - TRUTH.effective_lag_s) <= slack.above


@pytest.mark.thorough
def test_references_that_hardly_move_tell_nothing():
    for size in (0.0, 0.01):
        flight = ev.identify_flight(turned(2, size=size, seconds=20.0), model="rates")
        assert flight.verdict.status is ev.Status.REFUSED
        assert flight.quantities["roll_effectiveness"].verdict is ev.Status.REFUSED


@pytest.mark.thorough
def test_a_setpoint_of_the_other_sign_is_named(log):
    torque = log.channels["torque_setpoint_y"]
    turned_over = changed(log, torque_setpoint_y=replace(torque, values=-torque.values))
    flight = ev.identify_flight(turned_over, model="rates")
    assert flight.verdict.status is ev.Status.REFUSED
    assert any(
        "opposite signs" in reason.sentence and "torque_setpoint_y" in reason.remedy
        for reason in flight.quantities["pitch_effectiveness"].reasons
    )
    assert flight.quantities["roll_effectiveness"].verdict is ev.Status.IDENTIFIED


@pytest.mark.thorough
def test_yaw_may_be_missing(log):
    flight = ev.identify_flight(changed(log, torque_setpoint_z=None), model="rates")
    assert "yaw_effectiveness" not in flight.quantities
    assert flight.quantities["roll_effectiveness"].verdict is ev.Status.IDENTIFIED
    assert any(finding.name == "no_yaw" for finding in flight.findings)


@pytest.mark.parametrize("missing", ["torque_setpoint_x", "angular_rate_y"])
def test_roll_and_pitch_are_needed(log, missing):
    with pytest.raises(MissingChannelError, match=missing):
        ev.identify_flight(changed(log, **{missing: None}), model="rates")


def test_rates_in_degrees_are_refused(log):
    degrees = {
        name: replace(channel, values=np.rad2deg(channel.values) * 10.0)
        for name, channel in log.channels.items()
        if name.startswith("angular_rate")
    }
    with pytest.raises(InputError, match="deg/s"):
        ev.identify_flight(changed(log, **degrees), model="rates")


@pytest.mark.thorough
def test_an_attitude_that_a_loop_computes_is_weak_at_most(log):
    answering = {
        f"feedback_{name}": replace(log.channels[name], name=f"feedback_{name}")
        for name in ("reference_roll", "reference_pitch", "reference_yaw")
    }
    gone = dict.fromkeys(("reference_roll", "reference_pitch", "reference_yaw"))
    flight = ev.identify_flight(changed(log, **answering, **gone), model="rates")
    assert flight.verdict.status is ev.Status.WEAK
    assert any("answer" in reason.sentence for reason in flight.verdict.reasons)


@pytest.mark.thorough
def test_an_axis_that_nothing_moves_leaves_the_others_their_sets(log, fit):
    still = replace(log.channels["reference_yaw"], values=np.zeros(log.channels["reference_yaw"].values.size))
    quiet = ev.identify_flight(changed(log, reference_yaw=still), model="rates")
    for name in ("roll_effectiveness", "pitch_effectiveness"):
        assert quiet.quantities[name].verdict is ev.Status.IDENTIFIED
        assert quiet.fit.sets[name].robust.is_bounded
        assert quiet.quantities[name].interval == pytest.approx(fit.quantities[name].interval, rel=0.1)
    assert quiet.quantities["yaw_effectiveness"].verdict is ev.Status.REFUSED


@pytest.mark.thorough
def test_what_an_unknown_clock_leaves_open_is_in_the_lag(fit):
    part, rotors = fit.quantities["effective_lag"].systematic_uncertainties
    assert part.above == pytest.approx(0.25 * 0.005)  # once a rate of 200 Hz at least
    assert "how often" in part.sentence
    assert (rotors.below, rotors.above) == (0.001, 0.001)


@pytest.mark.thorough
def test_a_real_log_of_the_default_profile_is_too_wide(recordings):
    flight = ev.identify_flight(ev.read_log(recordings / "px4" / "battery_brownout.ulg"), model="rates")
    assert flight.verdict.status is ev.Status.REFUSED
    refusals = [item.sentence for item in flight.verdict.reasons if item.status is ev.Status.REFUSED]
    assert all("effectiveness is ±" in item and "it needs ±25%" in item for item in refusals)
    low, high = flight.quantities["pitch_effectiveness"].interval
    assert 100.0 < low < high < 220.0
    assert 0.03 < flight.quantities["effective_lag"].value < 0.06


@pytest.mark.thorough
def test_a_real_log_without_excitation_is_refused(recordings):
    flight = ev.identify_flight(ev.read_log(recordings / "px4" / "ekf_failure.ulg"), model="rates")
    assert flight.verdict.status is ev.Status.REFUSED


VEHICLE = Vehicle_ahead()
AHEAD_TRUTH = {
    **{f"{name}_effectiveness": item for name, item in zip(AXES, VEHICLE.effectiveness, strict=True)},
    **{f"{name}_damping": item for name, item in zip(AXES, VEHICLE.damping, strict=True)},
    "yaw_reaction": 0.0,
    "actuator_lag": VEHICLE.lag_s,
    "delay": VEHICLE.delayed * 0.0025,
}
WITHOUT_LAG = {**AHEAD_TRUTH, "actuator_lag": 0.0, "delay": 0.0}


@pytest.fixture(scope="module")
def flight():
    """Without disturbance or noise, every setpoint logged."""
    log = turned_ahead(0, seconds=12.0, command_hz=400.0, rate_hz=400.0, disturbance=0.0, noise=0.0)
    return prepare(log, Rates(), ev.FlightOptions()).shortened


def models(fit=AHEAD_TRUTH):
    return {"fit": SimpleModel("the fit", fit), "least_squares": SimpleModel("without lag", WITHOUT_LAG)}


def test_the_truth_predicts_and_numbers_without_a_lag_do_not(flight):
    prediction = Rates().abilities.prediction.multi_step((flight,), models(), frozenset())
    assert [item[0].quantity for item in prediction.by_quantity] == ["roll rate", "pitch rate", "yaw rate"]
    assert [item.model for item in prediction.by_quantity[0]] == ["fit", "least_squares", "unchanged"]
    for entry, without, unchanged in prediction.by_quantity:
        assert entry.rms[-1] < 0.03 * unchanged.rms[-1]
        assert entry.rms[0] < 0.1 * without.rms[0]
        assert np.array_equal(unchanged.series[:, 0], entry.series[:, 0])
    assert prediction.predicts
    assert not prediction.omitted


def test_axes_that_are_not_told_are_left_out_and_it_is_said(flight):
    prediction = Rates().abilities.prediction.multi_step(
        (flight,), models(), frozenset({"pitch_effectiveness"})
    )
    assert [item[0].quantity for item in prediction.by_quantity] == ["roll rate", "yaw rate"]
    assert prediction.omitted == ("The pitch rate is not predicted: the pitch effectiveness is refused.",)
    blind = Rates().abilities.prediction.multi_step((flight,), models(), frozenset({"effective_lag"}))
    assert not blind.errors
    assert len(blind.omitted) == 3
    channels = {
        name: channel for name, channel in flight.signals.channels.items() if name != "torque_setpoint_z"
    }
    two = replace(flight, signals=replace(flight.signals, channels=channels))
    result = Rates().abilities.prediction.multi_step((two,), models(), frozenset())
    assert [item[0].quantity for item in result.by_quantity] == ["roll rate", "pitch rate"]
    assert "not logged" in result.omitted[0]
    no_yaw = {name: item for name, item in AHEAD_TRUTH.items() if not name.startswith("yaw")}
    lesser = {"fit": SimpleModel("the fit", no_yaw)}
    assert (
        "the fit has no yaw effectiveness"
        in Rates().abilities.prediction.multi_step((flight,), lesser, frozenset()).omitted[0]
    )
