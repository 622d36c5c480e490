"""Sensors that disagree: what is told of them, what it harms, and what is taken out."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest

import eivor as ev
from eivor.cli.options import FlightWords
from eivor.cli.parsing import flight_options
from eivor.errors import InputError, UsageError
from eivor.estimation.methods import identify, least_squares, reference_iv
from eivor.flights.estimate import instruments
from eivor.flights.options import FlightOptions
from eivor.flights.prepare import prepare
from eivor.flights.prepared import Difference, SensorAgreement
from eivor.flights.quantity import Horizon
from eivor.inference.diagnostics.instruments import OverIdentification
from eivor.motions.identify import identify_flight
from eivor.motions.vertical.misspecification import (
    OmittedTerms,
    behind,
    either_sentence,
    omitted_variable_tests,
    sensitivities,
    sensor_agreement_sentence,
    sentence,
    turned,
)
from eivor.motions.vertical.motion import Vertical
from eivor.motions.vertical.predict import _response_of_run, dragged_run
from eivor.report.json_document import json_document, json_text
from eivor.report.outputs import saved_fit
from eivor.report.saved_fit import fit_of
from eivor.signals.recording import GRAVITY, Channel
from flights.flight_logs import FRICTION, GAIN, HOVER, LAG_S, STEP_S, changed, flown

pytestmark = pytest.mark.usefixtures("unchecked_shapes", "coarse_search")

VERTICAL = Vertical()


@pytest.fixture(scope="module")
def log():
    return flown(seconds=30.0, seed=3)[0]


def shifted(log, name, late_s):
    channel = log.channels[name]
    return with_channels(log, replace(channel, time_s=channel.time_s + late_s))


def with_channels(log, *channels):
    return replace(log, channels={**log.channels, **{channel.name: channel for channel in channels}})


def sideways(log, *, leaning, yaw=None, seed=0):
    """A flight that moves along the world's x, and whose up leans along it; with an attitude of that yaw."""
    rng = np.random.default_rng(seed)
    like = log.channels["velocity_z"]
    time = like.time_s
    v = 2.0 * np.sin(0.9 * time) + 1.5 * np.sin(2.3 * time + 1.0)
    a = np.gradient(v, STEP_S)
    force = log.channels["specific_force_z"]
    channels = [replace(force, values=force.values + leaning * a)]
    for name, values in (("velocity_x", v), ("velocity_y", np.zeros(v.size))):
        channels.append(replace(like, name=name, values=values + 0.03 * rng.standard_normal(v.size)))
    if yaw is not None:
        parts = zip("wxyz", (np.cos(0.5 * yaw), 0.0, 0.0, np.sin(0.5 * yaw)), strict=True)
        channels.extend(Channel(f"attitude_{axis}", time, np.full(v.size, part), "") for axis, part in parts)
    return with_channels(log, *channels)


def agreement(*logs):
    flights = tuple(prepare(log, VERTICAL, FlightOptions()) for log in logs)
    chosen = instruments(flights, FlightOptions(), reference_iv())
    return VERTICAL.abilities.sensors.agreement(VERTICAL.problem(flights, chosen.rule), flights)


@pytest.mark.thorough
def test_sensors_that_agree(log):
    result = agreement(log)
    assert result.significant == {}
    assert not result.otherwise
    assert list(result.differences) == ["offset", "scale"]
    assert sensor_agreement_sentence(result).startswith("velocity and accelerometer agree: offset ")


@pytest.mark.parametrize(("late", "other"), [("accelerometer", "velocity"), ("velocity", "accelerometer")])
def test_a_late_sensor_is_named(log, late, other):
    result = agreement(shifted(log, "velocity_z" if late == "velocity" else "specific_force_z", 0.015))
    ((name, item),) = result.significant.items()
    assert name == "offset"
    assert abs(abs(item.value) - 0.015) < 3.0 * item.std_error
    said = rf"The {late} is 1\d\.\d ± \d\.\d ms behind the {other}."
    assert re.fullmatch(said, sensor_agreement_sentence(result))


@pytest.mark.parametrize("channel", ["velocity_z", "specific_force_z"])
def test_what_a_late_sensor_moves_is_known_by_half(log, channel):
    """Finding 20b."""
    right, late = (identify_flight(item) for item in (log, shifted(log, channel, 0.02)))
    problem = VERTICAL.problem(
        late.prepared, instruments(late.prepared, FlightOptions(), reference_iv()).rule
    )
    known = sensitivities(problem, late.estimate, late.prepared)
    offset_s = 0.02 if channel == "specific_force_z" else -0.02
    for name in ("viscous_friction", "input_gain"):
        moved = late.estimate.parameters[name] - right.estimate.parameters[name]
        above, below = behind(offset_s, name, known)
        assert moved == pytest.approx(above if moved > 0.0 else -below, rel=0.6)


def test_what_was_measured_is_spread_as_slow_commands_are(log):
    def velocity(every):
        slower = {
            name: replace(channel, time_s=channel.time_s[::every], values=channel.values[::every])
            for name, channel in log.channels.items()
            if name.startswith("rotor_command")
        }
        return prepare(replace(log, channels=log.channels | slower), VERTICAL, FlightOptions()).signals

    as_logged, at_50, at_10 = (velocity(every).channel("velocity_z") for every in (1, 2, 10))
    np.testing.assert_allclose(at_50, as_logged[: at_50.size], atol=1e-12)
    expected = np.convolve(as_logged, (1.0 - np.abs(np.arange(-9, 10)) / 10.0) / 10.0, mode="same")
    np.testing.assert_allclose(at_10[50:-50], expected[50 : at_10.size - 50], atol=1e-9)


def sentences(quantity):
    return " ".join(reason.sentence for reason in quantity.reasons)


def pitched(log, *, attitude=0.0, accelerometer=0.0):
    """A flight that pitches to move along x, with an attitude or an accelerometer that is turned about y."""
    rng, like, force = np.random.default_rng(0), log.channels["velocity_z"], log.channels["specific_force_z"]
    v = np.sin(0.9 * like.time_s) + 0.75 * np.sin(2.3 * like.time_s + 1.0)
    pitch = np.arctan(np.gradient(v, STEP_S) / GRAVITY)
    thrust, turned = force.values / np.cos(pitch), 0.5 * (pitch + attitude)
    values = {
        "velocity_x": v + 0.03 * rng.standard_normal(v.size),
        "velocity_y": 0.03 * rng.standard_normal(v.size),
        "attitude_w": np.cos(turned),
        "attitude_y": np.sin(turned),
        "specific_force_body_x": -accelerometer * thrust,
        "specific_force_body_z": thrust,
    }
    values |= dict.fromkeys(("attitude_x", "attitude_z", "specific_force_body_y"), np.zeros(v.size))
    flown_so = commanded(log, lambda U: U / np.cos(pitch))
    bare = changed(flown_so, "specific_force_z", "cos_tilt")
    return with_channels(bare, *(replace(like, name=name, values=item) for name, item in values.items()))


def test_a_tilt_is_taken_out_of_an_attitude_unless_the_accelerometer_leans(log):
    two, right = np.deg2rad(2.0), prepare(pitched(log), VERTICAL, FlightOptions())
    result = identify_flight(pitched(log, attitude=-two))
    (finding,) = [item for item in result.findings if item.name == "attitude_corrected"]
    assert "degrees forward: the attitude is corrected by it." in finding.message
    for name in ("specific_force_z", "cos_tilt"):
        corrected = result.prepared[0].signals.channel(name)
        np.testing.assert_allclose(corrected, right.signals.channel(name), rtol=0.002)
    leaning = identify_flight(pitched(log, accelerometer=two))
    assert all(item.name != "attitude_corrected" for item in leaning.findings)
    parts = leaning.quantities["viscous_friction"].systematic_uncertainties
    assert any("Which is right is not known" in part.sentence for part in parts)


def test_kinds_that_a_flight_does_not_tell_apart_are_told_by_what_each_explains_alone(log):
    """Sideways as up and down: what leans looks like a scale."""
    like, rng = log.channels["velocity_z"], np.random.default_rng(1)
    v = 2.0 * log.channels["reference_velocity_z"].values
    force = log.channels["specific_force_z"]
    leaning = replace(force, values=force.values + np.deg2rad(3.0) * np.gradient(v, STEP_S))
    noisy = [
        replace(like, name=name, values=factor * v + 0.03 * rng.standard_normal(v.size))
        for name, factor in (("velocity_x", 1.0), ("velocity_y", 0.0))
    ]
    result = agreement(with_channels(log, leaning, *noisy))
    assert result.significant == {}
    assert list(result.either) == ["tilt_x"]  # a scale alone does not explain all of it
    tilt = result.either["tilt_x"]
    assert abs(tilt.value - np.deg2rad(3.0)) < 4.0 * tilt.std_error
    assert tilt.std_error < 0.2 * result.differences["tilt_x"].std_error
    assert sensor_agreement_sentence(result).startswith("Attitude and accelerometer differ by 3")
    both = replace(result, either={"tilt_x": tilt, "scale": Difference(-0.09, 0.01)})
    said = r"along x\. Or: The velocity reads 8\.6% \(± 1\.9%\) less than .* This flight does"
    assert re.search(said, either_sentence(both))


def test_a_difference_that_no_name_fits_is_told_all_the_same(log):
    """Up leans, and no horizontal velocity is logged."""
    leaning = sideways(log, leaning=np.deg2rad(8.0))
    height = log.channels["reference_position_z"].values
    force = log.channels["specific_force_z"]
    other = with_channels(log, replace(force, values=force.values + 0.4 * (height - height.mean())))
    result = agreement(other)
    assert result.otherwise
    assert "in another way than by offset" in sensor_agreement_sentence(result)
    assert list(agreement(changed(leaning, "velocity_x")).differences) == ["offset", "scale"]


@pytest.mark.parametrize(("channel", "sensor"), [("velocity_z", "velocity"), ("position_z", "height")])
def test_a_sensor_with_the_wrong_sign_is_named(log, channel, sensor):
    """Opposite signs leave no mean of both, whose share a scale would be."""
    wrong = with_channels(log, replace(log.channels[channel], values=-log.channels[channel].values))
    named, words = turned((prepare(wrong, VERTICAL, FlightOptions()),))
    assert named == sensor
    gain = identify_flight(wrong).quantities["input_gain"]
    assert (words in {reason.sentence for reason in gain.reasons}) is (channel == "velocity_z")


AGREE = OverIdentification(0.0, 1, 0.5)


@pytest.mark.thorough
def test_aligned_sensors_give_what_right_ones_give(log):
    right = identify_flight(log)
    late = shifted(log, "specific_force_z", 0.02)
    as_it_is, aligned = identify_flight(late), identify_flight(late, align=True)
    lag = as_it_is.quantities["effective_lag"]
    assert lag.half_width > aligned.quantities["effective_lag"].half_width
    assert lag.interval[0] <= LAG_S <= lag.interval[1]
    assert as_it_is.quantities["viscous_friction"].verdict.value == "identified"
    assert as_it_is.diagnostics["sensors_offset"] == pytest.approx(0.02, abs=0.004)
    moved = aligned.quantities["effective_lag"]
    assert abs(moved.value - right.quantities["effective_lag"].value) < 0.003
    assert abs(lag.value - right.quantities["effective_lag"].value) > 0.004
    assert moved.verdict.value == "identified"
    assert moved.half_width > right.quantities["effective_lag"].half_width


@pytest.mark.parametrize(("channel", "factor"), [("specific_force_z", 1.06), ("velocity_z", 1.06)])
def test_the_sensor_that_is_wrong_is_scaled(log, channel, factor):
    """An accelerometer whose scale is wrong shows another gravity."""
    scaled = with_channels(log, replace(log.channels[channel], values=factor * log.channels[channel].values))
    flight, right = (prepare(item, VERTICAL, FlightOptions()) for item in (scaled, log))
    scale = Difference(0.06 if channel == "velocity_z" else -0.06 / 1.06, 1e-3)
    sensors = SensorAgreement({"scale": scale}, AGREE)
    (aligned,) = VERTICAL.abilities.sensors.corrected((flight,), sensors, FlightOptions(align=True))
    for name in ("velocity_z", "specific_force_z"):
        np.testing.assert_allclose(aligned.signals.channel(name), right.signals.channel(name), rtol=1e-9)
    assert abs(right.signals.channel("specific_force_z").mean() - GRAVITY) < 0.1


def test_a_tilt_that_no_sensor_has_is_told_as_such():
    near, far = (sentence("tilt_left", Difference(np.deg2rad(-degrees), 0.01)) for degrees in (3.0, 52.0))
    assert near == "Attitude and accelerometer differ by 3.0 ± 1.2 degrees to the right."
    assert far.startswith("Attitude and accelerometer do not go together: it would take a tilt of 52 ± 1 deg")


@pytest.fixture(scope="module")
def log_left():
    return flown(seconds=30.0, seed=5)[0]


def test_a_velocity_that_is_not_logged_is_the_slope_of_the_height(log_left):
    alone = identify_flight(changed(log_left, "velocity_z", "specific_force_z"), model="vertical")
    assert "velocity_by_position" in {item.name for item in alone.findings}
    for name, true in {"viscous_friction": FRICTION, "input_gain": GAIN, "effective_lag": LAG_S}.items():
        assert alone.quantities[name].interval[0] < true < alone.quantities[name].interval[1], name


def test_thrust_that_falls_in_descent_widens_the_friction(log_left):
    speed = log_left.channels["velocity_z"].values
    fit = ev.identify_flight(commanded(log_left, lambda U: U + 2.0 / GAIN * np.maximum(-speed, 0.0)))
    assert -2.2 < fit.diagnostics["left_out_thrust_in_descent"] < -1.6
    assert fit.diagnostics["left_out_thrust_in_descent_p_value"] < 1e-6
    assert fit.quantities["viscous_friction"].interval[1] > FRICTION


def terms_of(log_left, method=None):
    chosen = method or reference_iv()
    flights = (prepare(log_left, VERTICAL, FlightOptions()),)
    problem = VERTICAL.problem(flights, instruments(flights, FlightOptions(), chosen).rule)
    return omitted_variable_tests(problem, identify(problem, chosen), flights)[0]


def commanded(log_left, change):
    """The log of a vehicle that needed another thrust: its mapped command is changed by what is given."""
    command = log_left.channels["rotor_command_1"]
    return with_channels(log_left, replace(command, values=np.sqrt(change(command.values**2))))


def with_channel(log, name, values, time_s=None):
    like = log.channels["velocity_z"]
    stamps = like.time_s if time_s is None else time_s
    return with_channels(log, replace(like, name=name, values=values, time_s=stamps))


@pytest.mark.thorough
def test_nothing_is_missed_where_the_model_holds(log_left):
    terms = terms_of(with_channel(log_left, "position_z", log_left.channels["reference_position_z"].values))
    names = "quadratic_drag ground_effect thrust_curvature thrust_in_descent supply clock_drift"
    assert " ".join(terms) == names
    assert min(term.p_value for term in terms.values()) > 0.005
    ((title, sentence),) = OmittedTerms(terms).report
    assert title == "left out"
    assert sentence.startswith("not missed: quadratic drag (p ")


def test_thrust_by_a_logged_voltage_is_told_as_that():
    """A vehicle whose thrust fell by 10 % with a voltage that fell by 10 % was said to have gained 100 %."""
    omitted = OmittedTerms({"supply": Difference(1.0, 0.1)}, 0.1)
    assert omitted.supply_sentence.startswith(
        "The thrust of one command went as the battery's voltage to the power 1 ± 0.21: the voltage changed "
        "by 10%, and the thrust by 10% (± 2%)."
    )
    assert "--term voltage" in omitted.supply_sentence
    assert omitted.supply_change == pytest.approx(0.1)
    assert not replace(omitted, voltage_change=0.01).missed("supply")


def test_a_thrust_curve_that_bends_is_missed(log_left):
    mean = float(np.mean(log_left.channels["rotor_command_1"].values ** 2))
    bent = commanded(log_left, lambda U: U + 0.3 * mean * (U / mean - 1.0) ** 2)
    result = terms_of(bent)["thrust_curvature"]
    assert abs(result.value + 0.3) < 3.0 * result.half_width < 0.3
    ((_, sentence),) = OmittedTerms({"thrust_curvature": result}).report
    assert sentence.startswith("thrust bends less than the input map: -0.3")
    quantities = identify_flight(bent, model="vertical").quantities
    friction, lag = (quantities[name] for name in ("viscous_friction", "effective_lag"))
    assert any("--input-map fit" in part.sentence for part in lag.systematic_uncertainties)
    assert friction.interval[0] < FRICTION < friction.interval[1]
    assert lag.interval[0] < LAG_S < lag.interval[1]


def test_clocks_that_drift_apart_are_measured(log_left):
    command = log_left.channels["rotor_command_1"]
    terms = terms_of(with_channels(log_left, replace(command, time_s=command.time_s * (1.0 - 0.001))))
    drift = terms["clock_drift"]
    assert abs(drift.value - 0.001) < drift.half_width < 0.0005
    omitted = OmittedTerms(terms, clock_reach_s=20.0)
    assert omitted.clocks_apart_s(several=True) == pytest.approx(
        (20.0 * drift.value, 20.0 * drift.half_width)
    )
    assert "clocks of command and motion drift apart by" in omitted.report[0][1]


def test_ground_effect_is_missed(log_left):
    height = log_left.channels["reference_position_z"].values
    over = height - height.min() + 0.5
    flown_at = with_channel(log_left, "position_z", height + 0.1)
    terms = terms_of(commanded(flown_at, lambda U: U / (1.0 + 0.05 / over**2)))
    assert terms["ground_effect"].p_value < 0.005
    assert "thrust grows towards the ground" in OmittedTerms(terms).report[0][1]


def test_without_instruments_nothing_is_tested(log_left):
    assert terms_of(log_left, least_squares()) == {}
    assert OmittedTerms().report == ()


def test_what_is_missed_has_a_name_and_a_size():
    sure, unsure = Difference(-0.1, 0.01), Difference(-0.1, 0.1)
    by_supply = OmittedTerms({"supply": sure, "ground_effect": unsure})
    by_ground = OmittedTerms({"supply": unsure, "ground_effect": sure})
    assert by_supply.missed("supply")
    assert by_supply.supply_sentence.startswith("The thrust of one command fell by 10.0% (± 2")
    assert not by_supply.missed("ground_effect")
    assert by_ground.missed("ground_effect")
    assert by_ground.supply_change == 0.0
    assert not OmittedTerms({"supply": Difference(0.01, 0.001)}).missed("supply")


# Optional terms of the vertical equation: found where they are, zero where they are not, else refused.

RADIUS = 0.2


def near(quantity, truth):
    """Whether the truth lies within four standard errors or so."""
    return abs(quantity.value - truth) < 2.0 * quantity.half_width


def test_thrust_that_falls_in_time_is_reported_and_moves_nothing_else(log_left):
    """Real flights lose 1 to 5 per cent of the thrust of one command in half a minute."""
    time = log_left.channels["rotor_command_1"].time_s
    falling = commanded(log_left, lambda mapped: mapped * (1.0 + 0.04 * (time - time[0]) / np.ptp(time)))
    still, fit = (ev.identify_flight(item) for item in (log_left, falling))
    for name in ("viscous_friction", "effective_lag"):
        moved = fit.quantities[name].value - still.quantities[name].value
        assert abs(moved) < 0.25 * still.quantities[name].half_width
    assert fit.quantities["hover_input"].value == pytest.approx(1.01 * HOVER, rel=2e-3)
    numbers = fit.diagnostics
    assert numbers["thrust_drift"] == pytest.approx(-0.04 * 9.81, abs=numbers["thrust_drift_half_width"])
    share = 0.02 * 60.0 / numbers["thrust_drift_duration_s"]
    assert numbers["hover_drift"] == pytest.approx(share, abs=numbers["hover_drift_half_width"])
    assert numbers["hover_drift_half_width"] < 0.4 * share
    assert "thrust of one command fell by 0.3" in dict(fit.fit.motion_checks.report)["drift"]
    short = ev.identify_flight(log_left, ev.FlightOptions(window=(5.0, 18.0)))
    assert "thrust_drift" not in short.diagnostics


def with_height(log, lowest):
    """Height over the ground, which the log begins on, and the log with it."""
    reference = log.channels["reference_position_z"].values
    over = reference - reference.min() + lowest
    time = log.channels["velocity_z"].time_s
    before = time[0] - 0.01 * np.arange(200, 0, -1)
    values = np.concatenate([np.zeros(200), over])
    return over, with_channel(log, "position_z", values, np.concatenate([before, time]))


def sagging(log):
    """Share of the voltage that is lost, about its mean."""
    lost = np.linspace(0.0, 0.1, log.channels["velocity_z"].values.size)
    return (1.0 - lost) / (1.0 - lost.mean())


@pytest.mark.thorough
def test_quadratic_drag_is_told_apart_from_friction(log_left):
    velocity = log_left.channels["reference_velocity_z"].values
    draggy = commanded(log_left, lambda U: U + 0.2 / GAIN * velocity * np.abs(velocity))
    biased = ev.identify_flight(draggy).quantities["viscous_friction"]
    assert biased.interval[0] > FRICTION
    quantities = ev.identify_flight(draggy, terms=("quadratic-drag",)).quantities
    assert near(quantities["viscous_friction"], FRICTION)
    assert near(quantities["quadratic_drag"], 0.2)
    assert quantities["quadratic_drag"].interval[0] > 0.0
    assert quantities["quadratic_drag"].unit == "1/m"


def test_climbs_with_drag_are_predicted_of_the_input_alone():
    """Against the equation itself, in steps a twenty-fifth as long; without drag as the linear answer is."""
    step, fine, K, K_2 = 0.02, 25, 0.3, 0.2
    times = step / fine * np.arange(12 * 50 * fine)
    force = 1.5 * np.sin(1.1 * times) + 0.8 * np.sin(2.3 * times + 1.0)
    force -= force[::fine].mean()
    v = np.empty(times.size)
    v[0] = 0.7
    for k in range(times.size - 1):
        v[k + 1] = v[k] + step / fine * (force[k] - K * v[k] - K_2 * v[k] * abs(v[k]) + 0.1)
    reported = dragged_run(force[::fine], v[::fine], slice(None), K, K_2, step)
    np.testing.assert_allclose(reported, v[::fine], atol=0.01)
    linear = dragged_run(force[::fine], v[::fine], slice(None), K, 0.0, step)
    np.testing.assert_allclose(
        linear, _response_of_run(force[::fine], v[::fine], slice(None), K, step), atol=1e-6
    )
    assert np.sqrt(np.mean((linear - v[::fine]) ** 2)) > 0.05


@pytest.mark.thorough
def test_thrust_near_the_ground_is_told_apart_from_the_gain(log_left):
    over, near_ground = with_height(log_left, 0.5)
    near_ground = commanded(near_ground, lambda U: U / (1.0 + 0.3 * (RADIUS / over) ** 2))
    plain = ev.identify_flight(near_ground, rotor_radius=RADIUS)
    for name in ("input_gain", "hover_input"):
        assert "rotor radii over the ground" in sentences(plain.quantities[name])
    fit = ev.identify_flight(near_ground, terms=("ground-effect",), rotor_radius=RADIUS)
    assert "rotor radii" not in sentences(fit.quantities["input_gain"])
    assert near(fit.quantities["ground_effect"], 0.3)
    assert fit.quantities["ground_effect"].interval[0] > 0.0
    assert near(fit.quantities["input_gain"], GAIN)
    assert not any(name.startswith("left_out_ground_effect") for name in fit.diagnostics)
    assert "left_out_quadratic_drag" in fit.diagnostics


@pytest.mark.thorough
def test_thrust_follows_the_voltage_and_the_gain_is_that_of_its_mean(log_left):
    voltage = sagging(log_left)
    sags = commanded(with_channel(log_left, "battery_voltage", 16.0 * voltage), lambda U: U / voltage**2)
    fit = ev.identify_flight(sags, terms=("voltage",))
    assert near(fit.quantities["voltage_exponent"], 2.0)
    assert fit.quantities["voltage_exponent"].interval[0] > 1.0
    # a slow column: its covariance is taken row by row as well
    assert fit.estimate.joint_covariance.part("by_row").matrix.shape == (5, 5)
    assert near(fit.quantities["input_gain"], GAIN)
    # at the mean voltage
    assert near(fit.quantities["hover_input"], HOVER)
    # another part of the flight is predicted with the voltage that the gain belongs to, not with its own
    result = ev.validate(fit, sags, window=(0.0, 12.0))
    assert result.motion.mean_voltage == fit.motion.mean_voltage
    assert result.predicts
    saved = saved_fit(fit)
    values = np.array(list((fit.estimate.parameters | {"voltage_exponent": 0.0}).values()))
    blind = replace(saved, estimated=replace(saved.joint, values=values))
    worse = ev.validate(blind, sags, window=(0.0, 12.0))
    reported, without = (
        next(p for p in each.predictions if p.model == "fit" and p.horizon is Horizon.OPEN_LOOP).rms
        for each in (result, worse)
    )
    assert reported < without


@pytest.mark.thorough
def test_terms_that_are_absent_cannot_be_told_from_zero_and_several_go_together(log_left):
    _, high_up = with_height(with_channel(log_left, "battery_voltage", 16.0 * sagging(log_left)), 0.5)
    every = ("quadratic-drag", "ground-effect", "voltage")
    fit = ev.identify_flight(high_up, terms=every, rotor_radius=RADIUS)
    assert near(fit.quantities["voltage_exponent"], 0.0)
    for name in ("quadratic_drag", "ground_effect"):
        low, high = fit.quantities[name].interval
        assert low < 0.0 < high
        assert "cannot be distinguished from zero" in sentences(fit.quantities[name])
    assert near(fit.quantities["viscous_friction"], FRICTION)
    assert "voltage_exponent" in fit.summary()
    assert fit.motion.view(fit.prepared[0]).symbols.endswith("; V the battery's voltage, V_0 its mean")
    model = json_document(fit)["model"]
    equation = (
        "z'' + g = K_u U - K z' + b - K_2 z'|z'| + k g (U/mean U) (R/h)² + n g (U/mean U) (V/V_0 - 1); "
    )
    assert model["equation"].startswith(equation)
    with pytest.raises(InputError, match="begins or ends on the ground"):
        ev.validate(fit, log_left)
    reported = json.loads(json_text(json_document(fit)))
    known = {"rotor_radius": RADIUS, "mean_voltage": fit.motion.mean_voltage}
    assert reported["prediction"]["vehicle"] == known
    reported["prediction"]["vehicle"] = None  # as it was written before terms were predicted with
    with pytest.raises(UsageError, match="radius of a rotor"):
        ev.validate(fit_of(reported), high_up)
    reported["prediction"]["vehicle"] = {"rotor_radius": "wide"}
    with pytest.raises(InputError, match="with rotor_radius and mean_voltage of its terms"):
        ev.validate(fit_of(reported), high_up)


def test_without_instruments_terms_are_biased(log_left):
    fit = ev.identify_flight(log_left, terms=("quadratic-drag",), method="least_squares")
    assert "direct method is biased" in sentences(fit.quantities["quadratic_drag"])


def test_the_command_line_takes_terms_before_a_log_is_read():
    options = flight_options(
        (Vertical(),), FlightWords(terms=["ground-effect", "voltage"], rotor_radius=RADIUS)
    )
    assert (options.terms, options.rotor_radius) == (("ground-effect", "voltage"), RADIUS)
