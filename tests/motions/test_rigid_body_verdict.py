"""What a log that holds every fourth command leaves open of gains and lag."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

import eivor as ev
from eivor.estimation.methods import by_name, identify
from eivor.flights.options import FlightOptions
from eivor.flights.prepare import prepare
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import Counts, QuantityEstimate, SimpleModel
from eivor.flights.timestamps import Clock
from eivor.flights.verdict import Instruments, VerdictInputs, systematic_uncertainties
from eivor.inference.verdict import Status
from eivor.lab.disturbances import OrnsteinUhlenbeck
from eivor.models.separable import LaggedReferences, NoInstruments
from eivor.motions.identify import identify_flight
from eivor.motions.rigid_body import regression, verdict
from eivor.motions.rigid_body.motion import FULL_BAND_HZ, RigidBody, in_full_band
from eivor.motions.rigid_body.vehicle import KnownNumber, vehicle_from_record
from eivor.report.saved_fit import SavedFit, load_fit
from eivor.report.terminal import on_terminal
from eivor.report.validation import quantity_comparisons, validation_document
from eivor.signals.noise import WhiteNoise
from eivor.signals.recording import Recording
from eivor.simulation.controller import Sensor
from eivor.simulation.rigid_body import Logged, RigidBodyFlight, Sensors, TorqueDisturbance
from motions.turning_logs import BODY, CRAZYFLIE, DELAY_KNOWN, body_flown, combinations

ROTORS = CRAZYFLIE.vehicle.rotors
DIRECT = "whitened_least_squares"
RESULTS = {
    "roll_gain": QuantityEstimate(200.0, "rad/s^2/m", 1.0, (198.0, 202.0)),
    "pitch_damping": QuantityEstimate(1.0, "1/s", 0.1, (0.8, 1.2)),
    "drag_z": QuantityEstimate(0.3, "1/s", 0.01, (0.28, 0.32)),
    "effective_lag": QuantityEstimate(0.05, "s", 1e-4, (0.0498, 0.0502)),
    "rotor_reaction": QuantityEstimate(0.002, "", 1e-5, (0.00198, 0.00202)),
    "yaw_gain": QuantityEstimate(1e-6, "", 1e-8, (0.98e-6, 1.02e-6)),
}


def prepared(log, **options):
    return prepare(log, BODY, FlightOptions(**options))


def problem_of(log, motion=BODY):
    """The equations of a flight."""
    return motion.problem((prepare(log, motion, FlightOptions()).shortened,), NoInstruments())


def logged_at(command_hz):
    return prepared(body_flown(duration=8.0, seed=4, logged=Logged(rotor_command_hz=command_hz)).recording)


def open_parts(flight, cutoff_hz=None, results=RESULTS, names=()):
    """Systematic parts of a flight with the filter of a gyroscope."""
    early_s = verdict.filter_early_s(cutoff_hz, flight.rates_hz["roll"])
    checks = verdict.RigidBodyChecks(filter_early_s=early_s)
    chosen = Instruments(LaggedReferences(("reference_roll",)), names=names)
    of_flight = VerdictInputs((flight,), 100.0, 100.0, chosen, checks=checks, quantities=results)
    return systematic_uncertainties(verdict.PARTS, of_flight)


def test_even_stamps_may_be_in_step_with_a_slower_loop():
    """A loop at 100 Hz in step with a log at 100 Hz made gains 3.1 % small and the lag 4 ms long."""
    flight = logged_at(125.0)
    allowances = open_parts(flight)
    assert flight.locked_s == pytest.approx(0.5 * (0.008 - 0.001))  # of issued ones at most 2 ms apart
    share = 0.45 * 2.5e-3 / 0.055  # of the attitude's loop, behind rotors and 5 ms of sensors
    at_once = 0.002 / (1e-6 * 2.0 * regression.usual_state((flight,))) / 0.055  # reaction, of squared speeds
    for name, value in (("roll_gain", 200.0), ("rotor_reaction", 0.002 * at_once)):
        unseen, gain = allowances[name]
        assert unseen.above == pytest.approx(0.45 * flight.command_slack_s / 0.055 * value)
        assert (gain.counts, gain.below) == (Counts.INDEPENDENT, pytest.approx(value * share))
        assert "2 % larger or smaller" in gain.sentence
    (damping,) = allowances["pitch_damping"]
    assert (damping.counts, damping.above) == (Counts.INDEPENDENT, pytest.approx(6.5 * share))
    by_stamps, by_loops = allowances["effective_lag"]
    assert (by_stamps.counts, by_stamps.above) == (Counts.INDEPENDENT, flight.command_slack_s)
    assert (by_loops.counts, by_loops.above) == (Counts.INDEPENDENT, pytest.approx(3.5e-3))
    assert "drag_z" not in allowances
    _, by_position = open_parts(flight, names=("reference_position_left",))["roll_gain"]
    assert by_position.below == pytest.approx(200.0 * 0.45 * 3.5e-3 / 0.055)
    assert Clock(0.050, 0.010, is_known=False, is_even=True).locked_s == pytest.approx(0.5 * 0.019)
    delayed = {**RESULTS, "delay": QuantityEstimate(flight.command_slack_s, "s", 1e-4, (0.0, 0.001))}
    assert len(open_parts(flight, results=delayed)["roll_gain"]) == 1  # the delay takes it up


def test_references_that_disagree_lengthen_the_intervals_of_all_that_they_determine():
    assert {"roll_coupling", "product_xy", "roll_by_drag_y", "drag_x"} <= {*verdict.PARTS[0].quantities}


def test_a_part_that_changes_no_interval_is_not_reported():
    flight = replace(logged_at(0.0), locked_s=1e-9)
    assert not open_parts(flight)


def test_a_log_of_every_command_leaves_nothing_open():
    assert not open_parts(logged_at(0.0))


PARTS = [f"attitude_{part}" for part in "wxyz"]


@pytest.fixture(scope="module")
def log() -> Recording:
    return body_flown(duration=6.0, seed=8).recording


def with_values(log: Recording, **values: np.ndarray) -> Recording:
    changed = {name: replace(log.channel(name), values=value) for name, value in values.items()}
    return replace(log, channels={**log.channels, **changed})


def attitude(log: Recording) -> np.ndarray:
    return np.stack([log.channel(name).values for name in PARTS])


def test_opposite_quaternions_are_the_same_attitude(log):
    signs = np.where(np.arange(attitude(log).shape[1]) % 7 < 3, 1.0, -1.0)
    flipped = with_values(log, **dict(zip(PARTS, signs * attitude(log), strict=True)))
    result, expected = (regression.body_velocity(prepared(item).signals) for item in (flipped, log))
    np.testing.assert_allclose(result, expected, atol=1e-9)


AT = {"actuator_lag": ROTORS.lag_up, "delay": ROTORS.delay}
WIND = (2.0, -1.0, 0.0)


def test_a_reference_of_height_alone_is_done_without(log):
    """It cannot move all that turns: such a log was refused, and is identified without the reference."""
    references = [name for name in log.channels if "reference" in name and name != "reference_position_z"]
    result = ev.identify_flight(without(log, *references), model=DELAY_KNOWN)
    assert (result.verdict.status, result.fit.estimate.method) == (Status.PROVISIONAL, DIRECT)
    assert "reference_position_z alone cannot move all" in result.verdict.sentences[0]


@pytest.fixture(scope="module")
def log_wind():
    """Of a flight in a steady wind."""
    return body_flown(duration=8.0, seed=0, wind=replace(CRAZYFLIE.wind, steady=WIND)).recording


def wind_of(log):
    flight = prepared(log)
    problem = BODY.problem((flight,), NoInstruments())
    problem = verdict.with_air_at_rest(problem, AT, partial(BODY.problem, rule=NoInstruments()))
    return verdict.steady_wind(problem, (flight,))


def test_a_steady_wind_is_told_and_calm_air_is_not_called_windy(log_wind):
    speeds = dict(zip((f"velocity_{axis}" for axis in "xyz"), WIND, strict=True))
    through_the_air = {name: log_wind.channel(name).values - speed for name, speed in speeds.items()}
    assert wind_of(with_values(log_wind, **through_the_air)) is None
    assert wind_of(without(log_wind, *speeds, "position_x")) is None
    assert list(wind_of(log_wind).numbers.values()) == pytest.approx(WIND[:2], abs=0.5)


@pytest.mark.thorough
def test_drags_across_in_a_wind_are_weak_at_most_and_gains_stay(log_wind):
    quantities = identify_flight(log_wind, model=DELAY_KNOWN).quantities
    said = {name: " ".join(reason.sentence for reason in item.reasons) for name, item in quantities.items()}
    assert all("A steady wind of about 2." in said[name] for name in ("drag_x", "drag_y"))
    assert Status.IDENTIFIED not in (quantities["drag_x"].verdict, quantities["drag_y"].verdict)
    assert "wind of about" not in said["roll_gain"]


SPEED_STD = 0.005 * CRAZYFLIE.vehicle.hover_speed
NOISE = {"rotor_speed": SPEED_STD}
for axis in "xyz":
    NOISE |= {f"velocity_{axis}": 0.05, f"angular_rate_{axis}": 0.02, f"specific_force_body_{axis}": 0.5}
MEASURED_SPEEDS = replace(CRAZYFLIE.sensors, rotor_speed=Sensor(WhiteNoise(SPEED_STD)))


@pytest.mark.thorough
def test_noise_of_speeds_goes_through_the_map_of_thrust():
    log = body_flown(duration=5.0, seed=3, sensors=MEASURED_SPEEDS).recording
    flight = prepared(log, input="rotor_speed", noise=NOISE).shortened
    problem = BODY.problem((flight,), NoInstruments())
    names = [parameter.name for parameter in problem.parameters]
    rows = problem.rows({"actuator_lag": 0.0, "delay": 0.0})
    noise = rows.regressor_noise_covariance()
    thrust = names.index("thrust_gain")
    speeds = flight.signals.family("rotor_speed")[flight.used]
    std = flight.signals.noise["rotor_speed_1"].std
    # one row of six is of the force along z; n^2 has 2 n times the noise of n
    expected = 4.0 * std**2 * float(np.mean((speeds**2).sum(axis=1))) / 6.0
    assert noise[thrust, thrust] == pytest.approx(expected, rel=0.1)
    arms = names.index("roll_gain"), names.index("roll_offset")
    assert abs(noise[arms]) < 0.2 * np.sqrt(noise[arms[0], arms[0]] * noise[arms[1], arms[1]])
    again = problem.rows({"actuator_lag": 0.0, "delay": 0.0}).regressor_noise_covariance()
    np.testing.assert_array_equal(noise, again)
    undeclared = prepared(log, input="rotor_speed").shortened
    assert BODY.problem((undeclared,), NoInstruments()).noisier is None


@pytest.mark.thorough
def test_total_least_squares_is_not_attenuated_by_noise_of_speeds():
    flight = body_flown(duration=10.0, seed=7, sensors=MEASURED_SPEEDS)
    gains = tuple(zip(("roll_gain", "pitch_gain"), flight.truth.parameters.torque_gains, strict=False))

    def errors(method: str, **options):
        result = identify_flight(flight.recording, model=BODY, method=method, input="rotor_speed", **options)
        return [result.quantities[name].value / true - 1.0 for name, true in gains]

    plain = errors("whitened_least_squares")
    known = errors("total_least_squares", noise=NOISE)
    assert all(error < -0.03 for error in plain)
    assert all(abs(error) < 0.5 * abs(other) for error, other in zip(known, plain, strict=True))


@pytest.mark.usefixtures("unchecked_shapes")
def test_weak_instruments_move_an_interval_away_from_least_squares_where_they_have_power():
    """Below an F of 2 by all of a bias: half of a torque gain had an interval that looked narrow enough."""
    parts = {"assembler": SimpleNamespace(needs_instruments=True), "equation": SimpleNamespace(variance=1.0)}
    numbers = {"jacobian": np.eye(2), "residuals": np.array([1.0, 2.0]), "first_stage": np.array([0.4, 11.0])}
    names = {"names": ("thrust_gain", "drag_z"), "unrefined": None, "prior_rows": lambda: np.empty((0, 2))}
    numbers["instrument_power"] = np.array([0.2, 0.6])
    largest = np.hypot(0.2, 1.2) / 0.2
    by_references = SimpleNamespace(**parts, **numbers, **names, method="reference_iv")
    shifts = verdict.possible_shifts(by_references, None)
    assert (*shifts["thrust_gain"], *shifts["drag_z"]) == pytest.approx((largest, largest, 0.2, 0.0))
    by_references.unrefined = np.array([-0.3, 0.1])
    shifts = verdict.possible_shifts(by_references, None)
    assert (*shifts["thrust_gain"], *shifts["drag_z"]) == pytest.approx((0.3, 0.0, 0.0, 0.1))


def test_a_drag_below_zero_is_no_drag():
    wrong = QuantityEstimate(-0.3, "1/s", 0.1, (-0.5, -0.1))
    chosen = Instruments(LaggedReferences(("reference_roll",)))
    inputs = VerdictInputs((), 100.0, 100.0, chosen, quantities={"drag_y": wrong})
    rules = [item for item in verdict.all_rules(regression.QUANTITIES) if item.quantities == ("drag_y",)]
    said = [item.reason(inputs) for item in rules if item.when(inputs)]
    assert [item.status for item in said if "below zero" in item.sentence] == [Status.WEAK]


STEP_S, ONBOARD_CUTOFF_HZ = 0.002, 30.0
OWN_S = np.sqrt(2.0) / (2.0 * np.pi * ONBOARD_CUTOFF_HZ)
TIME = STEP_S * np.arange(2000)
INNER = slice(200, -200)


def sine(frequency_hz: float, late_s: float = 0.0) -> np.ndarray:
    return np.sin(2.0 * np.pi * frequency_hz * (TIME - late_s))


@pytest.mark.parametrize(
    ("taken_s", "left_s"), [(0.0, OWN_S), (OWN_S, 0.0), (OWN_S + 0.02, 0.0), (0.002, OWN_S - 0.002)]
)
def test_a_delay_that_was_taken_off_the_stamps_is_not_applied_again(taken_s, left_s):
    onboard_filter = regression.filtered(sine(1.0), STEP_S, ONBOARD_CUTOFF_HZ, taken_s)
    np.testing.assert_allclose(onboard_filter[INNER], sine(1.0, left_s)[INNER], atol=2e-4)


def test_what_is_more_than_a_delay_is_left():
    result = regression.filtered(sine(20.0), STEP_S, ONBOARD_CUTOFF_HZ, OWN_S)[INNER]
    amplitude = np.sqrt(2.0 * np.mean(result**2))
    assert amplitude == pytest.approx(1.0 / np.sqrt(1.0 + (20.0 / ONBOARD_CUTOFF_HZ) ** 4), rel=0.01)


def test_columns_of_filtered_rates_do_not_pass_the_filter_twice():
    flight, at = prepared(body_flown(duration=5.0, seed=2).recording), {"actuator_lag": 0.05, "delay": 0.0}
    cutoffs = dict.fromkeys(("gyro_cutoff_hz", "accelerometer_cutoff_hz"), ONBOARD_CUTOFF_HZ)
    vehicles = BODY.vehicle, replace(BODY.vehicle, **cutoffs)
    plain, slow = (RigidBody(item).problem((flight,), NoInstruments()).columns for item in vehicles)
    for axis in (regression.PITCH_EQUATION, regression.FORCE_Z_EQUATION):
        terms = [term for term in regression.body_equation(plain[axis]).terms if term.behind]
        columns, others = plain[axis].moving(at).T, slow[axis].moving(at).T
        for term, column, other in zip(terms, columns, others, strict=True):
            passes = axis == regression.FORCE_Z_EQUATION or regression.drives(term.of)
            late = regression.filtered(column, flight.signals.step_s, ONBOARD_CUTOFF_HZ, 0.0)
            np.testing.assert_allclose(other, late if passes else column)


def test_rows_of_turning_reach_up_and_those_of_forces_stay():
    problem = problem_of(body_flown(duration=5.0, seed=2).recording)
    whole = in_full_band(problem)
    assert {column.band_hz for column in whole.columns[:3]} == {(regression.TURNING_BAND_HZ[0], FULL_BAND_HZ)}
    assert {column.band_hz for column in whole.columns[3:]} == {regression.FORCE_BAND_HZ}
    assert in_full_band(whole) is whole
    index = {"actuator_lag": ROTORS.lag_up, "delay": 0.0}
    assert len(whole.bins(index).responses) > 1.5 * len(problem.bins(index).responses)
    # commands that the log does not hold end it
    slow = problem_of(body_flown(duration=5.0, seed=2, logged=Logged(rotor_command_hz=125.0)).recording)
    assert in_full_band(slow) is slow


@pytest.mark.thorough
def test_what_comes_back_through_the_controller_cancels_in_it():
    """Torques of the air make the lag of the lower band too short, and that of the whole one hardly."""
    air = TorqueDisturbance(*[OrnsteinUhlenbeck(4.0, 0.3)] * 3)
    lower, whole = [], []
    for seed in (10, 11):
        log = body_flown(torque_disturbance=air, duration=30.0, seed=seed).recording
        alone = identify(problem_of(log, DELAY_KNOWN), by_name(DIRECT))  # the bias is one of the lag
        assert verdict.lag_consistency_test(alone) is not None
        lower.append(alone.parameters["actuator_lag"] - ROTORS.lag_up)
        result = identify_flight(log, model=DELAY_KNOWN, method=DIRECT)
        assert result.fit.problem.band_hz(0)[1] == FULL_BAND_HZ
        assert "The axes disagree about the lag" in " ".join(result.verdict.sentences)
        whole.append(result.quantities["effective_lag"].value - ROTORS.lag_up)
    assert np.mean(lower) < -0.001
    assert abs(np.mean(whole)) < 0.3 * abs(np.mean(lower))


@pytest.mark.thorough
def test_axes_agree_in_calm_air(monkeypatch):
    calm = identify_flight(body_flown(duration=15.0, seed=2).recording, model=BODY, method=DIRECT)
    assert verdict.lag_consistency_test(calm.fit.estimate) is None
    assert calm.fit.motion_checks.lags is None
    monkeypatch.setattr(verdict, "BEYOND_DOUBT", 2.0)  # tell whatever there is
    result = verdict.lag_consistency_test(calm.fit.estimate)
    p_value, lag_s, *changes = result.numbers.values()
    assert p_value > 0.01
    lag = calm.quantities["effective_lag"]
    assert lag_s == pytest.approx(lag.value)
    assert len(changes) == 4
    assert abs(result.numbers["roll_lag_change_s"]) < 4.0 * lag.std_error


@pytest.mark.thorough
@pytest.mark.usefixtures("coarse_search")
def test_a_delay_that_was_given_wrong_is_said():
    vehicle = replace(CRAZYFLIE.vehicle, rotors=replace(ROTORS, delay=0.01))
    late = body_flown(vehicle=vehicle, duration=15.0, seed=2).recording
    flight = identify_flight(late, model=DELAY_KNOWN, method=DIRECT)
    numbers = flight.fit.motion_checks.lags
    assert numbers.numbers["lag_agreement_p"] < 1e-3
    assert numbers.sentence in " ".join(flight.verdict.sentences)
    assert flight.verdict.status is Status.PROVISIONAL
    flight = identify_flight(late, model=BODY, method=DIRECT)
    assert flight.fit.motion_checks.lags is None


def test_numbers_and_sentences():
    reported = verdict.disagreeing_lags(0.05, {"roll": 0.002, "yaw": -0.2, "thrust": 0.03}, 1e-12)
    assert reported.sentence == (
        "The axes disagree about the lag (p-value 1e-12). For all of them it is 50 ms; by itself "
        "roll asks for 52 ms, yaw for a much shorter one, thrust for a much longer one."
    )


# Flights under torques from outside: what exogenous signals predict, and what instruments of it tell.

QUANTITIES = ["roll rate", "pitch rate", "yaw rate", "attitude", "velocity", "position"]


@pytest.fixture(scope="module")
def flown_ahead() -> RigidBodyFlight:
    return body_flown(duration=9.0, seed=3, sensors=Sensors(*[Sensor()] * 5))


@pytest.fixture(scope="module")
def flight(flown_ahead: RigidBodyFlight) -> PreparedFlight:
    return prepared(flown_ahead.recording).shortened


@pytest.fixture(scope="module")
def truth(flown_ahead: RigidBodyFlight) -> dict[str, float]:
    parameters = flown_ahead.truth.parameters
    return combinations(parameters) | {"actuator_lag": parameters.lag_up, "delay": parameters.delay}


def models(values: dict[str, float]) -> dict[str, SimpleModel]:
    without = {**values, "actuator_lag": 0.0}
    return {"fit": SimpleModel("the fit", values), "least_squares": SimpleModel("without lag", without)}


def without(log: Recording, *excluded: str) -> Recording:
    kept = {name: channel for name, channel in log.channels.items() if name not in excluded}
    return replace(log, channels=kept)


def ahead(flight: PreparedFlight, values: dict[str, float], *refused: str):
    return BODY.abilities.prediction.multi_step((flight,), models(values), frozenset(refused))


def quantities(prediction) -> list[str]:
    return [item[0].quantity for item in prediction.by_quantity]


@pytest.mark.thorough
def test_true_numbers_predict_every_quantity(flight, truth):
    prediction = ahead(flight, truth)
    assert quantities(prediction) == QUANTITIES
    # of a flight without noise next to nothing is left half a second ahead
    allowed = dict(zip(QUANTITIES, (5e-3, 5e-3, 5e-3, 2e-3, 0.02, 5e-3), strict=True))
    for entry, lagless, unchanged in prediction.by_quantity:
        assert entry.rms[-1] < allowed[entry.quantity]
        assert entry.rms[-1] < 0.03 * unchanged.rms[-1]
        assert entry.rms[-1] < 0.08 * lagless.rms[-1]
    assert prediction.predicts


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("refused", "left"),
    [
        (("roll_gain",), ["pitch rate", "yaw rate"]),
        (("yaw_gain",), ["roll rate", "pitch rate", "velocity", "position"]),
        (("thrust_gain",), QUANTITIES[:4]),
        (("effective_lag",), []),
        (("drag_x", "roll_coupling"), QUANTITIES),
    ],
)
def test_what_rests_on_a_refused_gain_is_left_out(flight, truth, refused, left):
    prediction = ahead(flight, truth, *refused)
    assert quantities(prediction) == left
    text = " ".join(prediction.omitted)
    as_zero = "Counted as zero, since the fit does not identify it: roll coupling, drag x."
    assert ("Not predicted" in text) == (left != QUANTITIES)
    assert (as_zero in text) == ("drag_x" in refused)


def test_a_refused_drag_counts_as_zero(flight, truth):
    wild = {**truth, "drag_x": 1e3, "quadratic_drag_x": 1e3}
    errors = ahead(flight, wild, "drag_x").errors
    velocity = {error.model: error for error in errors if error.quantity == "velocity"}
    assert velocity["fit"].rms[-1] < 0.3
    assert velocity["least_squares"].rms[-1] > 1.0


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("lacking", "left"),
    [
        (("position_x", "position_y", "position_z"), QUANTITIES[:5]),
        (("position_x", "position_y"), [*QUANTITIES[:5], "height"]),
        (("velocity_y",), QUANTITIES[:4]),
        (("attitude_w",), QUANTITIES[:3]),
        (tuple(f"specific_force_body_{axis}" for axis in "xyz"), QUANTITIES),
    ],
)
def test_what_the_log_lacks_is_left_out(flown_ahead, truth, lacking, left):
    flight = prepared(without(flown_ahead.recording, *lacking)).shortened
    assert quantities(ahead(flight, truth)) == left


def saved(values: dict[str, float], tmp_path, **changed: object) -> SavedFit:
    """A result of such numbers, as `eivor identify --json` writes it; what matters here of it."""
    nuisances = {name: values[name] for name in ("actuator_lag", "delay")}
    quantity = {"unit": "", "std_error": 0.1, "interval": [0.0, 1.0], "verdict": "identified"}
    part = {"name": "given", "matrix": np.eye(len(values)).tolist(), "degrees": None, "share": 1.0}
    best = {"at": nuisances, "best": True, "values": list(values.values()), "parts": [part]}
    simple = {"words": "without lag", "values": {**values, "actuator_lag": 0.0}}
    prediction = {"input": "rotor_command", "input_map": "square", "at": nuisances, "input_level": 1700.0}
    prediction |= {"limits": {"max_tilt_deg": 25.8}, "beside": {"least_squares": simple}}
    document = {
        "schema": "eivor.identify/1",
        "model": {"name": "rigid_body"},
        "verdict": "identified",
        "reasons": [],
        "parameters": {name: {"value": value, **quantity} for name, value in values.items()},
        "derived": {},
        "covariance": {"names": list(values), "candidates": [best]},
        "prediction": {**prediction, "vehicle": asdict(BODY.vehicle), **changed},
        "provenance": {"logs": [{"name": "first.csv", "sha256": None}], "options": {}},
    }
    path = tmp_path / "fit.json"
    path.write_text(json.dumps(document))
    return load_fit(path)


@pytest.mark.thorough
def test_another_flight_is_validated(flown_ahead, truth, tmp_path):
    validate = ev.validate(saved(truth, tmp_path), flown_ahead.recording, window=(0.0, 7.0))
    assert validate.predicts
    assert "in the mean" in validate.sentence
    document = json.loads(validate.to_json())
    assert (document["predictions"], document["ahead"]["horizons"]) == ([], [0.1, 0.2, 0.3, 0.4, 0.5])
    assert document["ahead"]["starts"] == validate.multi_step_prediction.start_s.size > 100
    first = document["ahead"]["errors"][0]
    assert (first["model"], first["quantity"], first["unit"]) == ("fit", "roll rate", "rad/s")
    assert "position" in validate._repr_html_()
    assert on_terminal(validation_document(validate)).renderables
    figure = validate.plot()
    assert len(figure.axes) == 12
    assert [axes.get_ylabel() for axes in figure.axes[:2]] == ["roll rate [deg/s]", "RMS error [deg/s]"]


@pytest.mark.usefixtures("unchecked_shapes")
def test_friction_at_the_speeds_of_a_flight_is_not_compared():
    first, second = (SimpleNamespace(value=x, half_width=0.01, verdict=Status.IDENTIFIED) for x in (0.4, 0.9))
    fit, flight = (dict.fromkeys(("viscous_friction", "drag_z"), item) for item in (first, second))
    rows = quantity_comparisons(regression.QUANTITIES, fit, flight)
    assert [row.fit.name for row in rows] == ["drag_z"]


def test_a_vehicle_comes_back_from_a_result():
    numbers = {"mass": KnownNumber(0.03, 0.001), "arm_scale": KnownNumber(1.0)}
    vehicle = replace(BODY.vehicle, thrust_map="linear", **numbers)
    assert vehicle_from_record(json.loads(json.dumps(asdict(vehicle)))) == vehicle
