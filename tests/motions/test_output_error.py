"""Output error, and what kinematics says of sensors: on simulated flights and on real ones."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import eivor as ev
from eivor.estimation.methods import by_name
from eivor.flights.estimate import beyond_errors
from eivor.flights.grid import upward
from eivor.flights.motion import FIT, UNCHANGED
from eivor.flights.prepare import prepare
from eivor.flights.quantity import Implied, SimpleModel
from eivor.inference.verdict import Status
from eivor.motions.rigid_body.compatibility import (
    comparisons,
    in_still_air,
    wind_table,
    with_one_clock,
    with_velocity,
)
from eivor.motions.rigid_body.dynamics import ATTITUDE
from eivor.motions.rigid_body.output_error import weights_of
from eivor.motions.rigid_body.verdict import gyroscope_late_s, hover_over_usual
from eivor.report.document import bounded_numbers
from eivor.signals.recording import Frame
from eivor.simulation.controller import Sensor
from eivor.simulation.rigid_body import Sensors
from flights.flight_logs import channel
from motions.turning_logs import BODY, body_flown


@pytest.fixture(scope="module")
def flight():
    return body_flown(duration=26.0, seed=5)


@pytest.mark.thorough
def test_gains_lie_within_their_intervals_and_predictions_are_as_good_as_any(flight):
    method = ev.methods.output_error(ev.methods.whitened_least_squares())
    result = ev.identify_flight(flight.recording, model=BODY, method=method)
    assert result.method == "whitened_least_squares+output_error"
    truth = flight.truth.parameters
    true = dict(zip(("roll_gain", "pitch_gain", "yaw_gain"), truth.torque_gains, strict=True))
    true |= {"thrust_gain": truth.thrust_gain, "effective_lag": truth.lag_up + truth.delay}
    for name, value in true.items():
        quantity = result.quantities[name]
        assert abs(quantity.value - value) < 4.0 * quantity.std_error
        assert quantity.std_error < 0.03 * value
    assert result.estimate is not None
    assert 0.0 in result.estimate.theta  # terms that do not earn their place
    ahead = result.multi_step_prediction
    assert ahead is not None
    by_fit = {item.quantity: item for item in ahead.errors if item.model == FIT}
    # after half a second what is left is noise of the sensors, .02 rad/s and .05 m/s
    assert by_fit["roll rate"].rms[-1] < 1.5 * np.sqrt(2.0) * 0.02
    assert by_fit["velocity"].rms[-1] < 1.5 * np.sqrt(6.0) * 0.05
    assert by_fit["roll rate"].theil < 0.1


@pytest.mark.thorough
def test_refined_numbers_differ_from_those_of_instruments_only_beyond_the_errors_of_both(flight):
    """Instruments sharper than windows had contradicted numbers within their intervals: J p 7e-10."""
    result = ev.identify_flight(flight.recording, model=BODY, method="output_error")
    assert result.verdict.status is Status.IDENTIFIED
    assert result.diagnostics["over_identification_p_value"] > 0.01
    by_references = ev.identify_flight(flight.recording, model=BODY)
    problem, first = by_references.fit.problem, by_references.estimate
    moved = replace(first, solution=replace(first.solution, theta=1.1 * first.theta))
    gain, value = first.names.index("roll_gain"), first.parameters["roll_gain"]
    assert beyond_errors(first, moved)[gain] == pytest.approx(-0.1 * value, rel=0.2)
    assert abs(result.estimate.unrefined[gain]) < 0.02 * value
    # damping and drag are for rotors at hover, which has the error of the thrust gain
    (ratio, by_joint), step = hover_over_usual(problem, first), 1e-4 * first.theta
    moved = replace(first, solution=replace(first.solution, theta=first.theta + step))
    change = by_joint[: step.size] @ step
    assert hover_over_usual(problem, moved)[0] - ratio == pytest.approx(change, rel=1e-3)
    assert change == pytest.approx(-0.5e-4 * ratio, rel=1e-3)


def test_the_setpoints_of_a_path_identify_the_drag_of_a_real_flight(recordings):
    """The log has no setpoint of attitude: without those of position nothing was identified."""
    log = ev.read_log(recordings / "nanobench-repeats" / "B9_trefoil_medium_rep4.csv")
    fit = ev.identify_flight(log, model="rigid-body", vehicle="crazyflie-2x")
    assert fit.instruments == "reference_position_left, reference_position_forward, reference_position_z"
    for axis in "xy":
        drag = fit.quantities[f"drag_{axis}"]
        assert drag.verdict in (Status.IDENTIFIED, Status.WEAK)
        assert 0.1 < drag.interval[0] < 0.4 < drag.interval[1] < 0.7


@pytest.mark.thorough
def test_a_real_flight_predicts_another_better_than_staying_and_than_least_squares(recordings):
    """Velocity after half a second: less than .6 of what stays as it is, and than .75 of least squares."""
    vehicle, folder = "crazyflie-2x", recordings / "nanobench"
    first = ev.read_log(folder / "B2_circle_fast_rep1.csv")
    other = ev.read_log(recordings / "nanobench-repeats" / "B3_figure8_medium_rep2.csv")
    errors = {}
    for method in ("whitened_least_squares", "output_error"):
        fit = ev.identify_flight(first, model="rigid-body", vehicle=vehicle, method=method)
        flying = prepare(other, fit.motion, fit.options).shortened
        models = {FIT: SimpleModel("the fit", {**fit.estimate.nuisances, **fit.estimate.parameters})}
        ahead = fit.motion.abilities.prediction.multi_step((flying,), models, frozenset())
        errors[method] = {(e.model, e.quantity): e.rms[-1] for e in ahead.errors}
    best = errors["output_error"]
    assert best[FIT, "velocity"] < 0.6 * best[UNCHANGED, "velocity"]
    for quantity in ("velocity", "attitude", "roll rate", "pitch rate"):
        assert best[FIT, quantity] < 0.75 * errors["whitened_least_squares"][FIT, quantity]


@pytest.mark.thorough
@pytest.mark.usefixtures("coarse_search")
def test_references_that_are_too_few_leave_least_squares_and_it_is_said(recordings):
    log = ev.read_log(recordings / "nanobench" / "B3_figure8_medium_rep1.csv")
    kept = {name: item for name, item in log.channels.items() if name != "reference_position_x"}
    log = replace(log, channels=kept)
    result = ev.identify_flight(log, model="rigid-body", vehicle="crazyflie-2x")
    assert result.method == "whitened_least_squares"
    assert result.quantities["thrust_gain"].verdict is Status.PROVISIONAL
    assert any("reference_position_z alone cannot move" in text for text in result.verdict.sentences)


def test_short_flights_have_no_output_error(flight):
    assert by_name("total_least_squares+output_error").of_flights.name == "total_least_squares"
    short = ev.identify_flight(flight.recording, model=BODY, method="output_error", window=(3.0, 7.0))
    assert "30 windows of 0.5 s or more" in short.verdict.sentences[0]


@pytest.mark.usefixtures("unchecked_shapes")
def test_kinematics_finds_clock_scale_and_bias_and_clocks_are_put_together(flight):
    """A gyroscope that is 12 ms late, 4 % too large about x and has a bias of .03 rad/s."""
    log = flight.recording
    rate = log.channel("angular_rate_x")
    wrong = {
        name: replace(channel, time_s=channel.time_s + 0.012)
        for name, channel in log.channels.items()
        if name.startswith("angular_rate")
    }
    wrong["angular_rate_x"] = replace(wrong["angular_rate_x"], values=1.04 * rate.values + 0.03)
    late = replace(log, channels={**log.channels, **wrong})
    spans = [(1.0, 26.0)]
    rows = {row.what: row for item in comparisons(late, spans) for row in item.table()}
    for what, true, near in (
        ("gyroscope behind the attitude", 12.0, 0.5),
        ("gyroscope, scale along x", 1.04, 0.005),
        ("gyroscope, scale along y", 1.0, 0.005),
        ("gyroscope, bias along x", 0.03, 0.004),
    ):
        low, high = rows[what].interval
        assert abs(rows[what].value - true) < near
        assert low - near < true < high + near
    together, sentences = with_one_clock(late, spans)
    assert "ms ahead of the gyroscope" in sentences[0]
    moved = together.channel("attitude_w").time_s - log.channel("attitude_w").time_s
    np.testing.assert_allclose(moved, 0.012, atol=5e-4)
    assert with_one_clock(log, spans) == (log, ())
    assert gyroscope_late_s(SimpleNamespace(flights=(SimpleNamespace(recording=together),))) == pytest.approx(
        0.012, abs=5e-4
    )
    assert with_one_clock(late, spans, cutoff_hz=18.757) == (late, ())  # a known low-pass is as late
    # the end of the search is no measurement
    stamps = {name: channel.time_s + 0.103 * (name in wrong) for name, channel in late.channels.items()}
    later = replace(late, channels={n: replace(late.channel(n), time_s=t) for n, t in stamps.items()})
    untouched, (sentence,) = with_one_clock(later, spans)
    assert (untouched, "At no offset" in sentence) == (later, True)


def test_a_velocity_of_another_sensor_keeps_its_clock():
    log = body_flown(duration=20.0, seed=5, sensors=Sensors(*[Sensor()] * 5)).recording
    late = {name: replace(log.channel(name), time_s=log.channel(name).time_s + 0.012) for name in ATTITUDE}
    alone, (sentence,) = with_one_clock(replace(log, channels={**log.channels, **late}), [(1.0, 20.0)])
    assert "it, without the velocity, is put on its clock" in sentence
    assert alone.channel("velocity_x") is log.channel("velocity_x")


def test_a_position_gives_the_velocity_that_is_not_logged(flight):
    log, logged = flight.recording, flight.recording.channel("velocity_y")
    kept = {name: item for name, item in log.channels.items() if not name.startswith("velocity")}
    made = with_velocity(replace(log, channels=kept)).channel("velocity_y")
    assert np.std(made.values - np.interp(made.time_s, logged.time_s, logged.values)) < 0.065  # .06 is noise
    x = log.channel("position_x")
    slow = replace(log, channels={**kept, "position_x": replace(x, time_s=30.0 * x.time_s)})
    assert with_velocity(slow) is slow


@pytest.mark.parametrize("turning", [1.0, 0.0])
def test_the_airspeed_determines_the_wind_where_the_vehicle_turns(turning):
    """3 m/s to the north and -2 m/s to the east, by a sensor that reads 4 % too much."""
    time, rng = np.arange(0.0, 90.0, 0.1), np.random.default_rng(1)
    heading, speed = turning * (3.0 * np.sin(0.13 * time) + 0.5 * time), 9.0 + np.sin(0.4 * time)
    series = dict.fromkeys(("velocity_z", "attitude_x", "attitude_y"), 0.0 * time)
    series["velocity_x"], series["velocity_y"] = speed * [np.cos(heading), np.sin(heading)] + [[3.0], [-2.0]]
    series |= {"attitude_w": np.cos(heading / 2), "attitude_z": np.sin(heading / 2), "airspeed": 1.04 * speed}
    noise = {name: 0.01 * rng.standard_normal(time.size) for name in series}
    noisy = {name: channel(name, time, values + noise[name]) for name, values in series.items()}
    log = ev.Recording("air.csv", "csv", noisy, frame=Frame.NED)
    east, north, scale = (row.value for row in wind_table(log, [log.span_s]))
    moved, (said,) = in_still_air(upward(log), [log.span_s])
    speeds = np.hypot(*(moved.channel(name).values for name in ("velocity_x", "velocity_y")))
    if turning:
        assert [north, east, scale] == pytest.approx([3.0, -2.0, 1.04], abs=0.02)
        assert "A wind of 3.6 m/s" in said
        assert speeds == pytest.approx(speed, abs=0.1)
    else:
        assert np.isnan([north, east, scale]).all()
        assert "hardly turned" in said


@pytest.mark.usefixtures("coarse_search")
def test_windows_without_noise_have_weights():
    by_state = np.random.default_rng(1).normal(size=(12, 6, 40))
    roots, noise = weights_of(np.zeros((12, 40)), by_state, np.full(6, 0.05))
    assert np.isfinite(roots).all()
    assert (noise > 0.0).all()


def test_flights_that_disagree_about_a_vehicle_are_said_so(flight):
    """The second flight turns less about x at the same commands."""
    log, name, windows = flight.recording, "angular_rate_x", [(1.0, 12.0), (14.0, 25.0)]
    rate = log.channel(name)
    slower = replace(
        log, name="slower", channels={**log.channels, name: replace(rate, values=0.7 * rate.values)}
    )
    options = {"model": "rates", "windows": windows, "method": "whitened_least_squares"}
    pool = ev.identify_flight([log, slower], **options)
    (said,) = [finding.message for finding in pool.findings if finding.name == "flights_differ"]
    assert "differ in the roll effectiveness by more than chance says" in said


def test_what_follows_is_no_better_than_what_it_rests_on_and_zero_is_a_bound():
    assert bounded_numbers(0.01, (-0.02, 0.04)) == ("0.010", "size below 0.040")
    assert bounded_numbers(0.03, (0.02, 0.04)) == ("0.030", "[0.020, 0.040]")
    number = Implied("inertia_xx", "", "Ixx", "kg m^2", 1.0, 0.01, (0.98, 1.02), "", Status.IDENTIFIED)
    for status in Status:
        fit = SimpleNamespace(quantities={"roll_gain": SimpleNamespace(verdict=status)})
        assert ev.FlightEstimate._judged(fit, replace(number, needs=("roll_gain",))).verdict is status
