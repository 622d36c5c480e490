"""Flights under torques from outside: what exogenous signals predict, and what instruments of it tell."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import numpy as np
import pytest

import eivor as ev
from eivor.errors import InputError, MissingChannelError, UsageError
from eivor.flights.options import FlightOptions
from eivor.flights.prepare import prepare
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import SimpleModel
from eivor.lab.scenario_files import shipped_rigid_body_flight
from eivor.motions.rates.motion import AXES
from eivor.motions.rigid_body.motion import RigidBody
from eivor.motions.rigid_body.vehicle import KnownNumber, KnownVehicle, vehicle_from_record
from eivor.report.saved_fit import SavedFit, load_fit
from eivor.report.terminal import on_terminal
from eivor.report.validation import validation_document
from eivor.signals.recording import Recording
from eivor.simulation.controller import Sensor
from eivor.simulation.rigid_body import RigidBodyFlight, simulate_rigid_body_flights
from eivor.simulation.rigid_body_spec import Sensors

BASE = shipped_rigid_body_flight("crazyflie")
#: Onboard low-passes [Hz], the delay of the rotors [s], and torques from outside of 4 rad/s^2 for .3 s.
GYRO_HZ, FORCE_HZ, DELAY_S = 80.0, 30.0, 0.004


def motion(**known: float) -> RigidBody:
    rotors = BASE.vehicle.rotors
    positions = tuple((x, y) for x, y, _ in rotors.positions)
    return RigidBody(KnownVehicle("simulated", positions, rotors.spins, **known))


SPEC = replace(shipped_rigid_body_flight("crazyflie"), duration=9.0, seed=3, sensors=Sensors(*[Sensor()] * 5))
ROTORS = SPEC.vehicle.rotors
KNOWN = KnownVehicle("simulated", tuple((x, y) for x, y, _ in ROTORS.positions), ROTORS.spins)
MOTION = RigidBody(KNOWN)
QUANTITIES = ["roll rate", "pitch rate", "yaw rate", "attitude", "velocity", "position"]


@pytest.fixture(scope="module")
def flown_ahead() -> RigidBodyFlight:
    return next(iter(simulate_rigid_body_flights([SPEC])))


@pytest.fixture(scope="module")
def flight(flown_ahead: RigidBodyFlight) -> PreparedFlight:
    return prepare(flown_ahead.recording, MOTION, FlightOptions()).shortened


@pytest.fixture(scope="module")
def truth(flown_ahead: RigidBodyFlight) -> dict[str, float]:
    parameters = flown_ahead.truth.parameters
    return {
        **{
            f"{axis.name}_gain": torque_gain
            for axis, torque_gain in zip(AXES, parameters.torque_gains, strict=True)
        },
        **{
            f"{axis.name}_coupling": gyroscopic_ratio
            for axis, gyroscopic_ratio in zip(AXES, parameters.gyroscopic_ratios, strict=True)
        },
        **{f"{axis.name}_damping": item for axis, item in zip(AXES, parameters.rate_damping, strict=True)},
        **{f"drag_{axis}": item for axis, item in zip("xyz", parameters.drag, strict=True)},
        "thrust_gain": parameters.thrust_gain,
        "actuator_lag": parameters.lag_up,
        "delay": parameters.delay,
    }


def models(values: dict[str, float]) -> dict[str, SimpleModel]:
    without = {**values, "actuator_lag": 0.0}
    return {"fit": SimpleModel("the fit", values), "least_squares": SimpleModel("without lag", without)}


def without(log: Recording, *excluded: str) -> Recording:
    return replace(
        log, channels={name: channel for name, channel in log.channels.items() if name not in excluded}
    )


def quantities(motion: RigidBody, log: Recording, values: dict[str, float], *refused: str) -> list[str]:
    flight = prepare(log, motion, FlightOptions()).shortened
    prediction = motion.abilities.prediction.multi_step((flight,), models(values), frozenset(refused))
    return [item[0].quantity for item in prediction.by_quantity]


@pytest.mark.thorough
def test_true_numbers_predict_every_quantity(flight, truth):
    prediction = MOTION.abilities.prediction.multi_step((flight,), models(truth), frozenset())
    assert [item[0].quantity for item in prediction.by_quantity] == QUANTITIES
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
    prediction = MOTION.abilities.prediction.multi_step((flight,), models(truth), frozenset(refused))
    assert [item[0].quantity for item in prediction.by_quantity] == left
    text = " ".join(prediction.omitted)
    assert ("Not predicted" in text) == (left != QUANTITIES)
    assert ("Counted as zero, since the fit does not identify it: roll coupling, drag x." in text) == (
        "drag_x" in refused
    )


def test_a_refused_drag_counts_as_zero(flight, truth):
    wild = {**truth, "drag_x": 1e3, "quadratic_drag_x": 1e3}
    result = MOTION.abilities.prediction.multi_step((flight,), models(wild), frozenset({"drag_x"}))
    velocity = {error.model: error for error in result.errors if error.quantity == "velocity"}
    assert velocity["fit"].rms[-1] < 0.3
    assert velocity["least_squares"].rms[-1] > 1.0


@pytest.mark.thorough
def test_what_the_log_lacks_is_left_out(flown_ahead, truth):
    log = flown_ahead.recording
    assert quantities(MOTION, without(log, "position_x", "position_y", "position_z"), truth) == QUANTITIES[:5]
    assert quantities(MOTION, without(log, "position_x", "position_y"), truth)[-1] == "height"
    assert quantities(MOTION, without(log, "velocity_y"), truth) == QUANTITIES[:4]
    assert quantities(MOTION, without(log, "attitude_w"), truth) == QUANTITIES[:3]
    no_force = without(log, *(f"specific_force_body_{axis}" for axis in "xyz"))
    assert quantities(MOTION, no_force, truth) == QUANTITIES


def saved(values: dict[str, float], tmp_path, **changed: object) -> SavedFit:
    """A result of such numbers, as `eivor identify --json` writes it; what matters here of it."""
    nuisances = {name: values[name] for name in ("actuator_lag", "delay")}
    quantity = {"unit": "", "std_error": 0.1, "interval": [0.0, 1.0], "verdict": "identified"}
    best = {
        "at": nuisances,
        "best": True,
        "values": list(values.values()),
        "parts": [{"name": "given", "matrix": np.eye(len(values)).tolist(), "degrees": None, "share": 1.0}],
    }
    document = {
        "schema": "eivor.identify/1",
        "model": {"name": "rigid_body"},
        "verdict": "identified",
        "reasons": [],
        "parameters": {name: {"value": value, **quantity} for name, value in values.items()},
        "derived": {},
        "covariance": {"names": list(values), "candidates": [best]},
        "prediction": {
            "input": "rotor_command",
            "input_map": "square",
            "at": nuisances,
            "limits": {"max_tilt_deg": 25.8},
            "beside": {"least_squares": {"words": "without lag", "values": {**values, "actuator_lag": 0.0}}},
            "input_level": 1700.0,
            "vehicle": json.loads(json.dumps(asdict(KNOWN))),
            **changed,
        },
        "provenance": {"logs": [{"name": "first.csv", "sha256": None}], "options": {}},
    }
    path = tmp_path / "fit.json"
    path.write_text(json.dumps(document))
    return load_fit(path)


def test_another_flight_is_validated(flown_ahead, truth, tmp_path):
    validate = ev.validate(saved(truth, tmp_path), flown_ahead.recording, window=(0.0, 7.0))
    assert validate.predicts
    assert "in the mean" in validate.sentence
    document = json.loads(validate.to_json())
    assert document["predictions"] == []
    assert document["ahead"]["horizons"] == [0.1, 0.2, 0.3, 0.4, 0.5]
    assert document["ahead"]["starts"] == validate.multi_step_prediction.start_s.size > 100
    first = document["ahead"]["errors"][0]
    assert (first["model"], first["quantity"], first["unit"]) == ("fit", "roll rate", "rad/s")
    assert "position" in validate.summary()
    assert "position" in validate._repr_html_()
    assert on_terminal(validation_document(validate)).renderables
    figure = validate.plot()
    assert len(figure.axes) == 12
    assert [axes.get_ylabel() for axes in figure.axes[:2]] == ["roll rate [deg/s]", "RMS error [deg/s]"]


def test_what_cannot_be_validated_is_said(flown_ahead, truth, tmp_path):
    log = flown_ahead.recording
    with pytest.raises(InputError, match="says what flies"):
        ev.validate(saved(truth, tmp_path, vehicle=None), log)
    with pytest.raises(InputError, match="commands in the same unit"):
        ev.validate(saved(truth, tmp_path, input_level=0.6), log)
    with pytest.raises(InputError, match="4 rotors"):
        ev.validate(saved(truth, tmp_path), without(log, "rotor_command_4"))
    with pytest.raises(MissingChannelError, match="angular_rate_y"):
        ev.validate(saved(truth, tmp_path), without(log, "angular_rate_y"))
    nothing = {name: item for name, item in truth.items() if not name.endswith("gain")}
    with pytest.raises(UsageError, match="does not identify the roll gain"):
        ev.validate(saved(nothing, tmp_path), log)


def test_a_vehicle_comes_back_from_a_result():
    vehicle = replace(KNOWN, mass=KnownNumber(0.03, 0.001), arm_scale=KnownNumber(1.0), thrust_map="linear")
    assert vehicle_from_record(json.loads(json.dumps(asdict(vehicle)))) == vehicle
    for wrong in (
        {},
        {**asdict(vehicle), "mass": {"value": -1.0, "std": 0.0}},
        {**asdict(vehicle), "wings": 2},
    ):
        with pytest.raises(InputError, match="says what flies"):
            vehicle_from_record(wrong)
