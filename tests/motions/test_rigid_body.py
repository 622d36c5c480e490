"""The rigid body: what a flight with rotor commands tells of every axis."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from coarse_search import coarse
from eivor.flights.lag_prior import NO_LAG
from eivor.flights.motion import of_vehicle
from eivor.flights.quantity import QuantityEstimate
from eivor.flights.result import FlightEstimate, LogEstimate
from eivor.inference.covariance import CovariancePart, JointCovariance, JointEstimate
from eivor.inference.verdict import Status
from eivor.lab.scenario_files import shipped_rigid_body_flight
from eivor.logs import read_log
from eivor.motions.identify import identify_flight
from eivor.motions.rigid_body import dynamics
from eivor.motions.rigid_body.motion import RigidBody
from eivor.motions.rigid_body.physical_parameters import OF_THE_AIR, Combinations, physical_parameters
from eivor.motions.rigid_body.vehicle import BodyDrag, KnownNumber, KnownVehicle, Rotors, Vehicle
from eivor.motions.table import motion_by_name
from eivor.report.flight import log_documents
from eivor.report.json_document import json_document
from eivor.simulation.controller import Sensor
from eivor.simulation.rigid_body import RigidBodyFlight, Sensors
from flights.flight_logs import changed
from motions.turning_logs import BODY, CRAZYFLIE, DELAY_KNOWN, body_flown, combinations, known


def truth_of(flight: RigidBodyFlight) -> dict[str, float]:
    parameters = flight.truth.parameters
    told = {name: value for name, value in combinations(parameters).items() if not name.endswith("damping")}
    return told | {"effective_lag": parameters.lag_up + parameters.delay}


@pytest.fixture(scope="module")
def flight() -> RigidBodyFlight:
    return body_flown(duration=16.0, seed=3)


@pytest.fixture(scope="module")
def fit(flight) -> FlightEstimate:
    with coarse():
        return identify_flight(flight.recording, model=BODY)


@pytest.mark.thorough
def test_commands_and_noisy_sensors_tell_every_axis(flight, fit):
    assert fit.verdict.status is Status.IDENTIFIED
    truth = truth_of(flight)
    for name in ("roll_gain", "pitch_gain", "yaw_gain", "effective_lag"):
        assert fit.quantities[name].value == pytest.approx(truth[name], rel=5e-3)
    for name in ("roll_gain", "pitch_gain", "thrust_gain", "effective_lag", "drag_z", "pitch_coupling"):
        low, high = fit.quantities[name].interval
        margin = 0.3 * (high - low)  # an interval of 95 % is not asked to hold every time
        assert low - margin <= truth[name] <= high + margin


@pytest.mark.thorough
def test_without_noise_the_numbers_are_those_of_the_vehicle():
    flight = body_flown(sensors=Sensors(*[Sensor()] * 5), duration=15.0, seed=3)
    result = identify_flight(flight.recording, model=DELAY_KNOWN, method="whitened_least_squares")
    for name, truth in truth_of(flight).items():
        near = {"abs": 1e-3} if name == "yaw_coupling" else {"rel": 1e-3}
        assert result.quantities[name].value == pytest.approx(truth, **near), name


@pytest.mark.thorough
@pytest.mark.usefixtures("coarse_search")
def test_a_delay_is_told_from_the_lag():
    vehicle = replace(CRAZYFLIE.vehicle, rotors=replace(CRAZYFLIE.vehicle.rotors, delay=0.004))
    flight = body_flown(vehicle=vehicle, duration=30.0, seed=3)
    result = identify_flight(flight.recording, model=BODY)
    assert result.quantities["delay"].value == pytest.approx(0.004, abs=3e-4)
    assert result.quantities["roll_gain"].value == pytest.approx(truth_of(flight)["roll_gain"], rel=5e-3)


@pytest.mark.thorough
@pytest.mark.usefixtures("coarse_search")
def test_two_lags_and_a_product_of_inertia_are_identified_or_bounds(flight, fit):
    """One lag made couplings twice as large, and they were called identified."""
    truth = {name: truth_of(flight)[name] for name in ("roll_gain", "roll_coupling", "pitch_coupling")}
    truth |= {"lag_up": 0.05, "lag_down": 0.08, "product_xz": 0.04}
    body = CRAZYFLIE.vehicle
    rotors = replace(body.rotors, lag_up=truth["lag_up"], lag_down=truth["lag_down"])
    inertia = (*body.inertia[:3], 0.0, truth["product_xz"] * body.inertia[0], 0.0)
    vehicle = replace(body, inertia=inertia, rotors=rotors)
    result = identify_flight(body_flown(vehicle=vehicle, duration=20.0, seed=3).recording, model=BODY)
    for name, true in truth.items():
        low, high = result.quantities[name].interval
        assert low <= true <= high
        assert result.quantities[name].verdict is Status.IDENTIFIED
    ahead = {(item.model, item.quantity): item.rms[-1] for item in result.multi_step_prediction.errors}
    assert ahead["fit", "roll rate"] < 0.1 * ahead["unchanged", "roll rate"]
    for name in ("lag_asymmetry", "product_xy", "product_xz", "product_yz"):
        low, high = fit.quantities[name].interval
        assert -0.03 < low <= 0.0 <= high < 0.03


@pytest.mark.thorough
def test_without_a_lag_and_with_a_known_delay_nothing_is_searched_for(flight):
    result = identify_flight(flight.recording, model=DELAY_KNOWN, lag=NO_LAG)
    assert result.quantities["actuator_lag"].value == 0.0


@pytest.mark.thorough
def test_spins_that_contradict_the_data_are_named(flight):
    turned = replace(DELAY_KNOWN.vehicle, spins=tuple(-spin for spin in CRAZYFLIE.vehicle.rotors.spins))
    result = identify_flight(flight.recording, model=RigidBody(turned))
    (reason,) = [r for r in result.quantities["yaw_gain"].reasons if "spin" in r.sentence]
    assert reason.status is Status.REFUSED
    assert result.quantities["roll_gain"].verdict is Status.IDENTIFIED


@pytest.mark.thorough
def test_an_order_that_contradicts_the_data_is_named(flight):
    mirrored = replace(DELAY_KNOWN.vehicle, positions=tuple((x, -y) for x, y in BODY.vehicle.positions))
    result = identify_flight(flight.recording, model=RigidBody(mirrored))
    assert result.verdict.status is Status.REFUSED
    assert any("order about roll" in reason.sentence for reason in result.quantities["roll_gain"].reasons)


@pytest.mark.thorough
def test_without_velocity_only_drag_along_z_is_told_and_it_is_said(flight):
    blind = changed(flight.recording, *(f"{of}_{axis}" for of in ("velocity", "position") for axis in "xyz"))
    result = identify_flight(blind, model=DELAY_KNOWN)
    assert [name for name in result.quantities if name.startswith("drag")] == ["drag_z"]
    (findings_kept,) = [finding for finding in result.findings if finding.name == "no_body_velocity"]
    assert "drag along x and y" in findings_kept.message
    assert result.quantities["roll_gain"].value == pytest.approx(truth_of(flight)["roll_gain"], rel=0.02)
    assert result.quantities["thrust_gain"].value == pytest.approx(truth_of(flight)["thrust_gain"], rel=0.05)


@pytest.mark.thorough
def test_what_is_supplied_makes_physical_parameters_and_what_is_not_is_said(flight, fit):
    mass = CRAZYFLIE.vehicle.mass
    motion = RigidBody(known(mass=KnownNumber(mass, 0.01 * mass), arm_scale=KnownNumber(1.0)))
    follows = {
        number.name: number
        for number in motion.abilities.implications(fit.fit.estimate, fit.quantities).numbers
    }
    for axes, truth in zip(("xx", "yy", "zz"), CRAZYFLIE.vehicle.inertia, strict=True):
        low, high = follows[f"inertia_{axes}"].interval
        assert low - 0.01 * truth <= truth <= high + 0.01 * truth
        assert high - low >= 0.03 * truth  # the mass is known to two per cent and two of them make four
    for name in ("drag_x", "drag_z"):  # in hover, as the combinations are
        assert follows[name].value == pytest.approx(mass * fit.quantities[name].value, rel=5e-3)
    # nobody said what a command is in rad/s, and of the first vehicle neither mass nor arms are known
    assert follows["rotor_inertia"].value is None
    inertias = [item.value for item in fit.implications.numbers if item.name.startswith("inertia")]
    assert {*inertias} == {None}
    assert any("mass" in number.sentence for number in fit.implications.numbers)
    made = log_documents(LogEstimate({"": replace(fit, motion=motion)}))[0]
    headings = [section.heading for section in made.sections]
    assert "What follows for the vehicle" in headings
    assert json_document(replace(fit, motion=motion))["implied"]


@pytest.mark.thorough
def test_the_friction_of_climbs_is_told_better_than_either_of_its_parts(flight, fit):
    friction, linear = fit.quantities["viscous_friction"], fit.quantities["drag_z"]
    low, high = friction.interval
    margin = 0.3 * (high - low)
    assert low - margin <= flight.truth.parameters.drag[2] <= high + margin  # its body drags nothing
    assert friction.half_width < 0.8 * linear.half_width
    assert friction.verdict is Status.IDENTIFIED


def test_a_vehicle_is_known_by_its_name():
    named = of_vehicle(motion_by_name("rigid-body"), "crazyflie-2x")
    assert named.vehicle is not None
    assert len(named.vehicle.spins) == 4


#: Arm [m] and mass [kg] of that vehicle.
ARM, MASS = 0.028, 0.027
VEHICLE = KnownVehicle("Crazyflie", ((ARM, -ARM), (-ARM, -ARM), (-ARM, ARM), (ARM, ARM)), (-1, 1, -1, 1))


@pytest.mark.thorough
def test_roll_and_pitch_manoeuvres_tell_inertias_and_nothing_is_called_identified(recordings):
    log = read_log(recordings / "arpl-crazyflie" / "log15")
    flight = identify_flight(log, model=RigidBody(VEHICLE), window=(15.8, 50.8))
    assert flight.verdict.status is Status.PROVISIONAL  # no setpoint is logged
    thrust = MASS * flight.quantities["thrust_gain"].value
    about_x, about_y = (thrust / flight.quantities[f"{axis}_gain"].value for axis in ("roll", "pitch"))
    assert 1.1e-5 < about_x < 1.4e-5
    assert 1.02 < about_y / about_x < 1.09
    assert 0.045 < flight.quantities["effective_lag"].value < 0.09
    assert not {"drag_x", "drag_y"} & set(flight.quantities)  # no velocity is logged
    assert 0.15 < flight.quantities["drag_z"].value < 0.65
    (yaw,) = [number for number in flight.implications.numbers if number.name == "inertia_zz"]
    assert yaw.value is None
    assert "do not identify Izz" in yaw.sentence


# Physical parameters: back to a vehicle's own numbers, honest intervals, and what is said without them.

AXES = "xyz"


def combinations_of(vehicle, offset=(0.0, 0.0), command=1.0, arm=1.0):
    """What a flight shows: commands in units of so many rad/s, positions in units of so many metres."""
    parameters = dynamics.effective_parameters(vehicle)
    alpha_p, alpha_q, alpha_r = (gain * command**2 for gain in parameters.torque_gains)
    return combinations(parameters) | {
        "roll_gain": alpha_p * arm,
        "pitch_gain": alpha_q * arm,
        "yaw_gain": alpha_r,
        # p' has alpha_p sum (y - y_c) phi, and q' has -alpha_q sum (x - x_c) phi
        "roll_offset": -alpha_p * offset[1],
        "pitch_offset": alpha_q * offset[0],
        "thrust_gain": parameters.thrust_gain * command**2,
        "rotor_reaction": parameters.rotor_reaction * command,
        "translational_lift": parameters.translational_lift,
        **{
            f"quadratic_drag_{name}": item for name, item in zip(AXES, parameters.quadratic_drag, strict=True)
        },
    }


def of_values(values, covariance):
    joint = JointCovariance((CovariancePart("given", covariance),))
    return Combinations(tuple(values), JointEstimate(np.array(list(values.values()), dtype=float), joint))


def exact(values):
    return of_values(values, np.zeros((len(values), len(values))))


def with_errors(values, relative=0.01, **specific):
    errors = np.array([specific.get(name, relative * abs(value)) for name, value in values.items()])
    return of_values(values, np.diag(errors**2))


def known_of(vehicle, **given):
    one = KnownNumber(1.0)
    usual = {"arm_scale": one, "mass": KnownNumber(vehicle.mass), "speed_scale": one}
    return known(vehicle, **(usual | given))


VEHICLES = {name: shipped_rigid_body_flight(name).vehicle for name in ("crazyflie", "quadrotor")}
QUADROTOR = VEHICLES["quadrotor"]


@pytest.mark.parametrize("vehicle", VEHICLES.values(), ids=VEHICLES)
@pytest.mark.parametrize(("command", "arm"), [(1.0, 1.0), (1000.0, 1.0), (0.05, 0.8)])
def test_back_to_the_vehicles_own_numbers(vehicle, command, arm):
    """Whatever the unit of the commands, and for positions in metres or in arms of a known length."""
    offset = (0.004, -0.002)
    result = exact(combinations_of(vehicle, offset, command, arm))
    known = known_of(vehicle, arm_scale=KnownNumber(arm), speed_scale=KnownNumber(command))
    parameters = physical_parameters(result, known)
    rotors, hover = vehicle.rotors, vehicle.hover_speed
    ixx, iyy, izz = vehicle.inertia
    forward, left = (sum(position[axis] ** 2 for position in rotors.positions) for axis in (0, 1))
    truth = {
        "inertia_xx": ixx,
        "inertia_yy": iyy,
        "inertia_zz": izz,
        "thrust_quadratic": rotors.thrust_quadratic,
        "torque_ratio": rotors.torque_ratio,
        "centre_of_mass_forward": offset[0],
        "centre_of_mass_left": offset[1],
        "drag_x": 4.0 * rotors.drag * hover + vehicle.drag.linear[0],
        "drag_y": 4.0 * rotors.drag * hover + vehicle.drag.linear[1],
        "drag_z": 4.0 * rotors.inflow * hover + vehicle.drag.linear[2],
        **{f"quadratic_drag_{name}": item for name, item in zip(AXES, vehicle.drag.quadratic, strict=True)},
        "translational_lift": 4.0 * rotors.translational_lift,
        "roll_drag": rotors.inflow * hover * left,
        "pitch_drag": rotors.inflow * hover * forward,
        "yaw_drag": rotors.drag * hover * (forward + left),
        "rotor_inertia": rotors.inertia,
    }
    assert set(parameters.numbers) == set(truth)
    for row in parameters.numbers.values():
        assert row.value is not None, row.sentence
        assert row.value == pytest.approx(truth[row.name], rel=1e-9, abs=1e-30)
        if row.name in OF_THE_AIR and row.interval[0] <= 0.0 <= row.interval[1]:
            assert row.verdict is Status.IDENTIFIED  # a bound
    assert parameters.contradictions == ()


SHORT = {"roll_coupling": 0.4, "pitch_coupling": 0.4}
RATIO = QUADROTOR.rotors.torque_ratio


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("left_out", "name", "symbol", "remedy"),
    [  # a row of the table of what is supplied and what is identified for each
        (("mass",), "inertia_xx", "Ixx/m", "Supply the mass."),
        (("arm_scale",), "inertia_yy", "Iyy/(m l)", "Supply the arm length."),
        (("mass", "arm_scale"), "inertia_xx", "Ixx/(m l)", "Supply the mass and the arm length."),
        (("mass",), "inertia_zz", "Izz/m", "Supply the mass."),
        (("mass", "arm_scale"), "inertia_zz", "Izz/Ixx", "Supply the mass and the arm length."),
        (("mass",), "thrust_quadratic", "k/m", "Supply the mass."),
        (("speed_scale",), "thrust_quadratic", "k", "Supply the rotor speed per unit of command."),
        (("arm_scale",), "torque_ratio", "kappa/l", "Supply the arm length."),
        (("arm_scale",), "centre_of_mass_left", "y_c/l", "Supply the arm length."),
        (("mass",), "drag_z", "D_z/m", "Supply the mass."),
        (("mass",), "quadratic_drag_x", "C_x/m", "Supply the mass."),
        (("mass",), "translational_lift", "H/m", "Supply the mass."),
        (("mass",), "pitch_drag", "B_y/m", "Supply the mass."),
        (("arm_scale",), "roll_drag", "B_x/Ixx", "Supply the arm length."),
        (("speed_scale",), "rotor_inertia", "J/Izz", "Supply the rotor speed per unit of command."),
    ],
)
def test_what_is_missing_is_said_with_what_is_left(left_out, name, symbol, remedy):
    known = known_of(QUADROTOR, **dict.fromkeys(left_out))
    row = physical_parameters(exact(combinations_of(QUADROTOR)), known).numbers[name]
    assert row.value is None
    assert row.sentence.startswith(f"{symbol} = ")
    assert row.sentence.endswith(f"is all that the flight gives without {remedy[len('Supply ') :]} {remedy}")


def test_what_is_left_is_right():
    ixx, _, izz = QUADROTOR.inertia
    result = exact(combinations_of(QUADROTOR))
    known = known_of(QUADROTOR, mass=None, arm_scale=None, speed_scale=None)
    log_only = physical_parameters(result, known).numbers
    assert all(row.value is None for row in log_only.values())
    assert f" = {ixx / QUADROTOR.mass:.4g} (" in log_only["inertia_xx"].sentence
    assert f" = {izz / ixx:.4g} (" in log_only["inertia_zz"].sentence
    assert f" = {RATIO:.4g} (" in log_only["torque_ratio"].sentence
    assert f" = {combinations_of(QUADROTOR)['drag_x']:.4g} (" in log_only["drag_x"].sentence


def test_izz_by_the_torque_ratio():
    errors = with_errors(combinations_of(QUADROTOR), **SHORT)
    known = known_of(QUADROTOR, torque_ratio=KnownNumber(RATIO, 0.1 * RATIO))
    parameters = physical_parameters(errors, known)
    izz = parameters.numbers["inertia_zz"]
    assert izz.value == pytest.approx(QUADROTOR.inertia[2])
    assert izz.std_error == pytest.approx(0.1 * izz.value, rel=0.05)
    assert "It rests on the torque ratio that was supplied." in parameters.numbers["inertia_zz"].sentence
    assert parameters.numbers["torque_ratio"].value is None, "what was supplied is not found again"
    assert parameters.numbers["yaw_drag"].value is not None
    assert parameters.numbers["rotor_inertia"].value == pytest.approx(QUADROTOR.rotors.inertia)


def test_izz_by_an_assumption_says_so():
    errors = with_errors(combinations_of(QUADROTOR), **SHORT)
    ixx, iyy, izz = QUADROTOR.inertia
    known = known_of(QUADROTOR, yaw_inertia_ratio=KnownNumber(izz / (0.5 * (ixx + iyy))))
    parameters = physical_parameters(errors, known)
    assert parameters.numbers["inertia_zz"].value == pytest.approx(izz)
    assert "that was supplied, not on the flight" in parameters.numbers["inertia_zz"].sentence
    assert parameters.numbers["torque_ratio"].value == pytest.approx(RATIO)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("change", "error", "name", "told"),
    [
        ("roll_gain", None, "inertia_xx", "The flight identifies no roll_gain."),
        ("drag_x", None, "drag_x", "The flight identifies no drag_x."),
        ("thrust_gain", None, "inertia_zz", "The flight identifies no thrust_gain."),
        ("roll_gain", 0.6, "inertia_xx", "The flight does not distinguish roll_gain from zero."),
        ("pitch_gain", 0.6, "centre_of_mass_forward", "The flight does not distinguish pitch_gain from ze"),
        ("roll_gain", -1.0, "inertia_xx", "roll_gain is below zero: positions, order or spins"),
    ],
)
def test_no_number_of_what_is_not_told(change, error, name, told):
    values = combinations_of(QUADROTOR)
    errors = {}
    if error is None:
        del values[change]
    elif error > 0.0:
        errors[change] = error * values[change]
    else:
        values[change] *= error
    row = physical_parameters(with_errors(values, **errors), known_of(QUADROTOR)).numbers[name]
    assert row.value is None
    assert row.sentence.startswith(told)


@pytest.mark.parametrize("error", [np.inf, np.nan])
def test_no_number_of_what_has_no_finite_variance(error):
    values = combinations_of(QUADROTOR)
    errors = with_errors(values, drag_x=error, roll_coupling=error, pitch_coupling=error)
    parameters = physical_parameters(errors, known_of(QUADROTOR))
    assert parameters.numbers["drag_x"].sentence == "The flight identifies no drag_x."
    assert parameters.numbers["inertia_zz"].value is None
    assert parameters.numbers["inertia_xx"].value is not None


def test_drag_below_zero_is_none():
    values = combinations_of(QUADROTOR)
    values["roll_damping"] = -2.5
    row = physical_parameters(exact(values), known_of(QUADROTOR)).numbers["roll_drag"]
    assert row.value < 0.0
    assert "not the air's drag" in row.sentence


def test_physical_parameters_reach_as_far_as_what_they_are_made_of():
    """A drag from 0.1 to 2.3 1/s made one of 0.14 to 1.20 N/(m/s)."""
    errors, known = with_errors(combinations_of(QUADROTOR), 0.01), known_of(QUADROTOR)
    value, (low, _) = errors.value("drag_z").value, errors.interval("drag_z")
    wide = errors.reaching({"drag_z": QuantityEstimate(value, "1/s", 0.0, (low, 4.0 * value))})
    plain, reaching = (physical_parameters(item, known).numbers["drag_z"].interval for item in (errors, wide))
    further = known.mass.value * (4.0 * value - errors.interval("drag_z")[1])
    assert reaching == pytest.approx((plain[0], plain[1] + further))


def _contradictions(change=(), yaw_error=0.001, **given):
    values = combinations_of(QUADROTOR) | dict(change)
    errors = with_errors(values, 0.001, yaw_coupling=yaw_error)
    return " ".join(physical_parameters(errors, known_of(QUADROTOR, **given)).contradictions)


@pytest.mark.thorough
def test_contradictions_are_said():
    assert "no body has one beyond -1 or 1" in _contradictions({"roll_coupling": -1.5, "pitch_coupling": 1.5})
    assert "in place of 0" in _contradictions({"yaw_coupling": 0.3})
    assert "in place of 0" not in _contradictions({"yaw_coupling": 0.3}, yaw_error=0.2)
    wrong = KnownNumber(10.0 * RATIO)
    without = {"roll_coupling": 0.0, "pitch_coupling": 0.0}
    errors = with_errors(combinations_of(QUADROTOR) | without, 0.001, roll_coupling=1.0, pitch_coupling=1.0)
    contradictions = physical_parameters(errors, known_of(QUADROTOR, torque_ratio=wrong)).contradictions
    assert any("Izz is more than Ixx and Iyy together" in contradiction for contradiction in contradictions)
    assert "% off that by" in _contradictions(torque_ratio=KnownNumber(1.2 * RATIO))


@pytest.mark.parametrize("times", [500.0, 0.001])
def test_a_mass_in_another_unit_is_noticed(times):
    mass = KnownNumber(times * QUADROTOR.mass)
    assert "the weight over the square of an arm would be" in _contradictions(mass=mass)


def test_lengths_in_another_unit_are_told():
    """Positions in millimetres, which a caller of Python can give."""
    known = known_of(QUADROTOR)
    positions = tuple((1e3 * x, 1e3 * y) for x, y in known.positions)
    wrong = KnownVehicle("it", positions, known.spins, KnownNumber(1.0), known.mass)
    values = combinations_of(QUADROTOR)
    values |= {name: 1e-3 * values[name] for name in ("roll_gain", "pitch_gain")}
    contradictions = physical_parameters(exact(values), wrong).contradictions
    assert any("Check their unit" in contradiction for contradiction in contradictions)


@pytest.mark.thorough
def test_thrust_maps_have_constants_of_their_own():
    values = exact(combinations_of(QUADROTOR, command=1000.0))
    scale, mass = KnownNumber(1000.0), QUADROTOR.mass
    gain = QUADROTOR.rotors.thrust_quadratic * 1e6 / mass
    mixed = {"thrust_quadratic": (0.25 * mass * gain / 1e6, "N/(rad/s)^2")}
    mixed["thrust_linear"] = (0.75 * mass * gain / 1e3, "N/(rad/s)")
    for thrust_map, constants in (
        ("linear", {"thrust_linear": (mass * gain / 1e3, "N/(rad/s)")}),
        ("power:1.5", {"thrust_constant": (mass * gain / 1e3**1.5, "N/(rad/s)^1.5")}),
        ("mixed:0.25", mixed),
    ):
        vehicle = known_of(QUADROTOR, speed_scale=scale, thrust_map=thrust_map)
        parameters = physical_parameters(values, vehicle)
        names = {name for name in parameters.numbers if name.startswith("thrust_")}
        assert names == set(constants)
        for name, (value, unit) in constants.items():
            assert parameters.numbers[name].value == pytest.approx(value)
            assert parameters.numbers[name].unit == unit


def _coverage(seeds, relative):
    """Share of intervals that hold the truth, by parameter: drawn combinations, drawn supplied numbers."""
    values = combinations_of(QUADROTOR, (0.004, -0.002)) | {"translational_lift": 1e-3}
    vector = np.array(list(values.values()))
    errors = relative * np.abs(vector)
    correlations = 0.5 * (np.eye(vector.size) + 1.0)
    root, covariance = np.linalg.cholesky(correlations), correlations * np.outer(errors, errors)
    truth = physical_parameters(exact(values), known_of(QUADROTOR))
    supplied = {"arm_scale": (1.0, 0.01), "mass": (QUADROTOR.mass, 0.02), "speed_scale": (1.0, 0.02)}
    held = {row.name: 0 for row in truth.numbers.values()}
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        drawn = dict(zip(values, vector + errors * (root @ rng.standard_normal(vector.size)), strict=True))
        given = {
            name: KnownNumber(value * (1.0 + share * rng.standard_normal()), value * share)
            for name, (value, share) in supplied.items()
        }
        parameters = physical_parameters(of_values(drawn, covariance), known_of(QUADROTOR, **given))
        for row in parameters.numbers.values():
            low, high = row.interval
            held[row.name] += low <= truth.numbers[row.name].value <= high
    return {name: count / seeds for name, count in held.items()}


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes")
def test_intervals_include_what_is_supplied():
    """Without the errors of mass, arm and scale most of them would hold the truth far less often."""
    coverage = _coverage(25, 0.004)
    assert all(share >= 0.8 for share in coverage.values()), coverage


ROTORS = Rotors(
    positions=((0.1, 0.12, 0.0), (0.1, -0.12, 0.0), (-0.1, -0.12, 0.0), (-0.1, 0.12, 0.0)),
    spins=(1, -1, 1, -1),
    highest_speed=1000.0,
    thrust_quadratic=1e-5,
    thrust_linear=1e-3,
    torque_ratio=0.02,
    lag_up=0.05,
    lag_down=0.06,
    inertia=1e-5,
    delay=0.004,
    drag=1e-4,
    inflow=2e-4,
)
DRAGGED_VEHICLE = Vehicle(
    1.0,
    (0.01, 0.012, 0.02),
    ROTORS,
    BodyDrag(linear=(0.1, 0.2, 0.3), quadratic=(0.01, 0.02, 0.03), rotational=(1e-3, 2e-3, 3e-3)),
)


@pytest.mark.parametrize(
    "thrust", [{}, {"thrust_linear": 0.0}, {"thrust_quadratic": 0.0, "thrust_linear": 0.01}]
)
def test_equations_hold_at_hover(thrust):
    """The equations of the module's docstring at hover speeds, term by term."""
    vehicle = replace(DRAGGED_VEHICLE, rotors=replace(ROTORS, **thrust))
    parameters, rotors = dynamics.effective_parameters(vehicle), vehicle.rotors
    hover = vehicle.hover_speed
    change = np.array([300.0, -200.0, 100.0, 50.0])
    p, q, r, vx, vy, vz = 0.3, -0.2, 0.4, 1.0, -2.0, 0.5
    coefficients, still = dynamics.coefficients_of(vehicle), (0.0, 0.0, 0.0)
    body = [0.0, 0.0, 0.0, vx, vy, vz, 1.0, 0.0, 0.0, 0.0, p, q, r]
    slope = dynamics.body_derivative(coefficients, body, [hover] * 4, change.tolist(), still, still)
    quadratic = rotors.thrust_quadratic
    phi = hover if quadratic == 0.0 else hover**2 + rotors.thrust_linear / quadratic * hover
    first, second, third = parameters.gyroscopic_ratios
    # Equal rotors: neither the shear of the flow nor their own momentum leaves a torque.
    assert slope[10] == pytest.approx(first * q * r - parameters.rate_damping[0] * p, rel=1e-9)
    assert slope[11] == pytest.approx(second * p * r - parameters.rate_damping[1] * q, rel=1e-9)
    reaction = parameters.rotor_reaction * (change @ rotors.spins)
    assert slope[12] == pytest.approx(third * p * q - parameters.rate_damping[2] * r + reaction, rel=1e-9)
    speed = np.sqrt(vx**2 + vy**2 + vz**2)
    force = dynamics.specific_force(coefficients, body, [hover] * 4, still)
    for axis, v in enumerate((vx, vy, vz)):
        thrust_part = parameters.thrust_gain * 4.0 * phi if axis == 2 else 0.0
        expected = thrust_part - parameters.drag[axis] * v - parameters.quadratic_drag[axis] * speed * v
        assert force[axis] == pytest.approx(expected, rel=1e-9)
