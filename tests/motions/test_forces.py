"""What lift turns, against the torques of the simulated rotors."""

from __future__ import annotations

import itertools
import re
from dataclasses import replace

import numpy as np
import pytest

from eivor.estimation.methods import by_name, identify
from eivor.flights.options import FlightOptions
from eivor.flights.prepare import prepare
from eivor.flights.prepared import PreparedFlight
from eivor.inference.verdict import Status
from eivor.models.lagged_runs import LaggedRuns
from eivor.models.separable import NoInstruments
from eivor.motions.identify import identify_flight
from eivor.motions.rigid_body import vehicle as vehicles
from eivor.motions.rigid_body import verdict
from eivor.motions.rigid_body.dynamics import body_derivative, coefficients_of, effective_parameters
from eivor.motions.rigid_body.motion import SETTLED_S, RigidBody
from eivor.motions.rigid_body.regression import (
    COUPLING,
    DRAG_MOMENT,
    FORCE_Z_EQUATION,
    FROM_HZ,
    GYROSCOPIC_MOMENT,
    LIFT_MOMENT,
    PITCH_EQUATION,
    REACTION,
    ROLL_EQUATION,
    STATES,
    TERMS,
    YAW_EQUATION,
    body_equation,
    body_velocity,
    inferred_velocity,
)
from eivor.signals.recording import GRAVITY
from eivor.signals.signals import Signals
from eivor.simulation.controller import Sensor
from eivor.simulation.rigid_body import Sensors
from motions.turning_logs import BODY, CRAZYFLIE, body_flown, combinations, known

VEHICLE = CRAZYFLIE.vehicle
HOVER = VEHICLE.hover_speed
TRUE = known()


def prepared(flight):
    return prepare(flight.recording, BODY, FlightOptions())


def column_of(parameter, velocity, rates, speeds=(HOVER,) * 4):
    """Column of a parameter for rotors at some speeds."""
    *sums, spin = (TRUE.sums @ np.array(speeds)).tolist()
    states = zip(STATES, (*(item / HOVER for item in sums), spin), strict=True)
    moving = zip("uvwpqr", (*velocity, *rates), strict=True)
    of = {**TRUE.numbers, **dict(states), **dict(moving), "speed": np.linalg.norm(velocity)}
    return next(term for _, term in TERMS if term.parameter == parameter).expression.evaluate(of)


def test_the_equations_of_roll_and_pitch_have_what_lift_turns():
    flight = prepared(body_flown(duration=4.0, seed=5))
    problem = BODY.problem((flight,), NoInstruments())
    assert (problem.band_hz(ROLL_EQUATION)[1], problem.band_hz(FORCE_Z_EQUATION)[1]) == (20.0, 8.0)
    for axis, parameter in enumerate(LIFT_MOMENT):
        index = problem.parameters.index(parameter)
        moved = [bool(column.fixed[:, index].any()) for column in problem.columns]
        assert moved == [column.axis == (ROLL_EQUATION, PITCH_EQUATION)[axis] for column in problem.columns]
    # a log that begins in the air counts once rotors no longer know how they began
    begin = flight.signals.step_s * float(np.flatnonzero(flight.used)[0])
    assert begin == pytest.approx(SETTLED_S, abs=0.02)


STILL = (0.0, 0.0, 0.0)
INERTIA_OF_A_ROTOR, HEIGHT_M = 2e-8, 0.006


def spinning(inertia, **rotors):
    """The vehicle with rotors of an inertia."""
    return replace(VEHICLE, rotors=replace(VEHICLE.rotors, inertia=inertia, **rotors))


def test_rotors_that_spin_turn_as_in_the_simulator():
    rates, speeds = (0.4, -0.9, 0.0), [1500.0, 1600.0, 1700.0, 1550.0]
    body = [0.0] * 6 + [1.0, 0.0, 0.0, 0.0, *rates]
    turned = [
        np.array(body_derivative(coefficients_of(item), body, speeds, [0.0] * 4, STILL, STILL)[10:12])
        for item in (spinning(INERTIA_OF_A_ROTOR), VEHICLE)
    ]
    for axis in (0, 1):
        column = column_of(GYROSCOPIC_MOMENT[axis], STILL, rates, speeds)
        expected = INERTIA_OF_A_ROTOR / VEHICLE.inertia[axis] * column
        assert turned[0][axis] - turned[1][axis] == pytest.approx(expected, rel=1e-9)
        assert abs(expected) > 1e-3


def test_the_equations_hold_for_rotors_that_spin_above_and_beside_the_centre_of_mass():
    """At the true lag, by least squares in time; without these columns the residual is many times larger."""
    elsewhere = np.add(VEHICLE.rotors.positions, (0.004, -0.003, HEIGHT_M)).tolist()
    vehicle = spinning(INERTIA_OF_A_ROTOR, positions=tuple(map(tuple, elsewhere)))
    flight = body_flown(vehicle=vehicle, sensors=Sensors(*[Sensor()] * 6), duration=10.0, seed=5)
    problem = BODY.problem((prepared(flight),), NoInstruments())
    truth, drag = effective_parameters(vehicle), 4.0 * vehicle.rotors.drag * HOVER
    first, second, third = vehicle.inertia
    expected = (
        {"roll_by_spin": INERTIA_OF_A_ROTOR / first, "roll_by_drag_y": HEIGHT_M * drag / first},
        {"pitch_by_spin": INERTIA_OF_A_ROTOR / second, "pitch_by_drag_x": -HEIGHT_M * drag / second},
        {"yaw_by_drag_x": -0.003 * drag / third, "yaw_by_drag_y": -0.004 * drag / third},
    )
    neighbours = {item.name for item in (*GYROSCOPIC_MOMENT, *itertools.chain(*DRAG_MOMENT))}
    for axis, name in enumerate(("roll", "pitch", "yaw")):
        result, left = in_time(problem, axis, set())
        assert result[f"{name}_coupling"] == pytest.approx(truth.gyroscopic_ratios[axis], abs=0.015)
        assert result[f"{name}_gain"] == pytest.approx(truth.torque_gains[axis], rel=2e-3)
        for parameter, value in expected[axis].items():
            assert result[parameter] == pytest.approx(value, rel=0.1)
        assert in_time(problem, axis, neighbours)[1] > 8.0 * left


def in_time(problem: LaggedRuns, axis: int, without: set[str]) -> tuple[dict[str, float], float]:
    """Least squares of an equation at the true lag over what counts of a flight, and what it leaves."""
    item = problem.columns[axis]
    names = [parameter.name for parameter in problem.parameters]
    fixed = item.fixed.shape[1]
    columns = dict(zip(names[:fixed], item.fixed.T, strict=True))
    moving = item.moving(AT)
    columns |= zip((names[fixed + entry] for entry in item.moved), moving.T, strict=True)
    kept = {name: column for name, column in columns.items() if column.any() and name not in without}
    (run,) = item.runs
    rows = np.column_stack([*kept.values(), np.ones(len(moving))])[run]
    scale = np.abs(rows).max(axis=0)
    response = item.responses[run, 0]
    theta = np.linalg.lstsq(rows / scale, response, rcond=None)[0] / scale
    left = float(np.std(response - rows @ theta))
    return dict(zip(kept, theta[:-1].tolist(), strict=True)), left


STEP_S = 0.01
TIME_S = STEP_S * np.arange(4000)


@pytest.mark.parametrize(
    ("frequency_hz", "bias", "tilt", "logged"),
    [
        *((hertz, 0.3, 0.0, False) for hertz in (FROM_HZ, 0.5, 2.0)),
        (0.5, 0.0, 0.4, False),
        (0.5, 0.0, 0.4, True),
    ],
)
def test_what_is_quick_is_found_whatever_the_bias_and_a_tilt_is_no_fall(frequency_hz, bias, tilt, logged):
    roll = tilt * np.sin(2.0 * np.pi * 0.7 * TIME_S)
    moved = np.sin(2.0 * np.pi * frequency_hz * TIME_S)
    channels = {"angular_rate_x": np.gradient(roll, STEP_S), "angular_rate_y": 0.0 * roll}
    channels["specific_force_body_z"] = np.gradient(moved, STEP_S) + GRAVITY * np.cos(roll) + bias
    if logged:
        quaternion = {"w": np.cos(roll / 2.0), "x": np.sin(roll / 2.0), "y": 0.0 * roll, "z": 0.0 * roll}
        channels |= {f"attitude_{part}": values for part, values in quaternion.items()}
    result = inferred_velocity(Signals(1.0 / STEP_S, channels), [slice(0, TIME_S.size)])
    assert result is not None
    assert np.std((result - moved)[500:-500]) < 0.03


def test_without_a_force_or_an_attitude_none_is_known():
    still = {name: np.zeros(100) for name in ("angular_rate_x", "velocity_x", "velocity_y", "velocity_z")}
    blind = Signals(rate_hz=100.0, channels=still)
    assert inferred_velocity(blind, [slice(0, 100)]) is None
    assert body_velocity(blind) is None


ONE_INERTIA = 5e-8
SPINNING = spinning(ONE_INERTIA)
FIRST, SECOND, THIRD = VEHICLE.inertia[:3]
METHOD = by_name("whitened_least_squares")
AT = {"actuator_lag": VEHICLE.rotors.lag_up, "delay": 0.0}


@pytest.fixture(scope="module")
def spun():
    """A noisy flight of a vehicle whose rotors have inertia."""
    return body_flown(vehicle=SPINNING, duration=20.0, seed=3)


@pytest.fixture(scope="module")
def problem(spun) -> LaggedRuns:
    return BODY.problem((prepared(spun).shortened,), NoInstruments())


@pytest.fixture(scope="module")
def free(problem):
    """An estimate of every column by itself."""
    return identify(problem, METHOD)


def test_columns_are_sums_of_those_that_they_replace(problem):
    ratios = (1.7, 1.5)
    linked = verdict.with_common_rotor_inertia(problem, ratios)
    made = [body_equation(item.columns[0]).rotors.inertia_ratios for item in (problem, linked)]
    assert made == [None, ratios]
    assert not set(GYROSCOPIC_MOMENT) & set(linked.parameters)
    names = [parameter.name for parameter in problem.parameters]
    kept = [index for index, parameter in enumerate(problem.parameters) if parameter not in GYROSCOPIC_MOMENT]
    expected = problem.bins(AT).regressors.copy()
    replaced = [names.index(item.name) for item in GYROSCOPIC_MOMENT]
    expected[:, names.index(REACTION.name)] += expected[:, replaced] @ ratios
    np.testing.assert_allclose(linked.bins(AT).regressors, expected[:, kept], rtol=1e-9, atol=1e-12)
    axes = linked.rows(AT).layout.axis_of_row
    reaction = linked.rows(AT).regressors[:, linked.parameters.index(REACTION)]
    assert all(reaction[axes == axis].any() for axis in (ROLL_EQUATION, PITCH_EQUATION, YAW_EQUATION))


@pytest.mark.thorough
@pytest.mark.usefixtures("coarse_search")
def test_a_flight_that_couples_tells_one_inertia_within_its_interval(spun, free):
    flight = identify_flight(spun.recording, model=BODY, method=METHOD.name)
    assert body_equation(flight.fit.problem.columns[0]).rotors.inertia_ratios is not None
    for item, inertia in zip((*GYROSCOPIC_MOMENT, REACTION), (FIRST, SECOND, THIRD), strict=True):
        low, high = flight.quantities[item.name].interval
        assert low <= ONE_INERTIA / inertia <= high
        assert low > 0.0
    for item in GYROSCOPIC_MOMENT:  # each by itself is told far worse
        assert flight.quantities[item.name].std_error < 0.7 * free.std_error(item.name)
    low, high = flight.quantities["effective_lag"].interval
    assert low <= VEHICLE.rotors.lag_up <= high
    for name in ("yaw_damping", "drag_x"):  # draws are made of the estimate's
        assert flight.estimate.parameters[name] == pytest.approx(flight.quantities[name].value, rel=1e-3)


@pytest.mark.thorough
def test_couplings_that_are_not_told_leave_three_columns(problem, free):
    assert verdict.identified_ratios(free) is not None
    hardly = [1e-9 if item in COUPLING else 1.0 for item in problem.parameters[: problem.still]]
    columns = tuple(replace(item, fixed=item.fixed * hardly) for item in problem.columns)
    blind = replace(problem, columns=columns)
    assert verdict.identified_ratios(identify(blind, METHOD)) is None


def test_predictions_know_what_all_axes_have():
    values = combinations(effective_parameters(SPINNING)) | {REACTION.name: ONE_INERTIA / THIRD}
    fit, other = verdict.with_gyroscopic_moments([values, {REACTION.name: 2.0}])
    for item, inertia in zip(GYROSCOPIC_MOMENT, (FIRST, SECOND), strict=True):
        assert fit[item.name] == pytest.approx(ONE_INERTIA / inertia)
        assert other[item.name] == pytest.approx(2.0 * THIRD / inertia)
    of_its_own = dict(zip((item.name for item in GYROSCOPIC_MOMENT), (3.0, 4.0), strict=True))
    assert verdict.with_gyroscopic_moments([values | of_its_own]) == [values | of_its_own]


# Vehicle files: what they hold, and what each mistake in one is answered with.

X = 'layout = "quad-x"\nnumbering = "px4"\n'
EACH = "positions = [[0.1, -0.1], [-0.1, 0.1], [0.1, 0.1], [-0.1, -0.1]]\n"


@pytest.fixture
def loaded(tmp_path):
    def load(top="", rotors=X):
        path = tmp_path / "mine.toml"
        path.write_text(f"{top}\n[rotors]\n{rotors}", encoding="utf-8")
        return vehicles.load_vehicle(path)

    return load


def test_everything_is_read(loaded):
    vehicle = loaded(
        'name = "Mine"\nmass = { value = 1.2, std = 0.01 }\nyaw_inertia_ratio = 1.8\n'
        "delay_ms = { value = 4.0, std = 1 }\n"
        "gyro_cutoff_hz = 80\naccelerometer_cutoff_hz = 30.0",
        X + "arm = { value = 0.2, std = 0.002 }\nspeed_scale = 0.10472\ntorque_ratio.value = 0.016\n"
        'thrust_map = "mixed:0.3"',
    )
    assert (vehicle.name, vehicle.mass) == ("Mine", vehicles.KnownNumber(1.2, 0.01))
    assert vehicle.yaw_inertia_ratio == vehicles.KnownNumber(1.8)
    assert vehicle.delay == vehicles.KnownNumber(0.004, 0.001)
    assert (vehicle.gyro_cutoff_hz, vehicle.accelerometer_cutoff_hz) == (80.0, 30.0)
    assert (vehicle.arm, vehicle.arm_scale) == (pytest.approx(0.2), vehicles.KnownNumber(1.0, 0.01))
    assert vehicle.speed_scale == vehicles.KnownNumber(0.10472)
    assert (vehicle.torque_ratio, vehicle.thrust_map) == (vehicles.KnownNumber(0.016), "mixed:0.3")


@pytest.mark.parametrize("spins", ['["ccw", "ccw", "cw", "cw"]', "[-1, -1, 1, 1]"])
def test_rotors_one_by_one(loaded, spins):
    vehicle = loaded(rotors=f"{EACH}spins = {spins}\npositions_std = 0.02")
    assert vehicle.positions == ((0.1, -0.1), (-0.1, 0.1), (0.1, 0.1), (-0.1, -0.1))
    assert (vehicle.spins, vehicle.arm_scale) == ((-1, -1, 1, 1), vehicles.KnownNumber(1.0, 0.02))


@pytest.mark.parametrize(
    ("numbering", "mixed"),
    [  # signs of (roll right, pitch nose down, yaw left) of each motor in the autopilots' own tables
        ("crazyflie", [(-1, -1, -1), (-1, 1, 1), (1, 1, -1), (1, -1, 1)]),
        ("betaflight", [(-1, 1, 1), (-1, -1, -1), (1, 1, -1), (1, -1, 1)]),
        ("ardupilot", [(-1, -1, -1), (1, 1, -1), (1, -1, 1), (-1, 1, 1)]),
        ("px4", [(-1, -1, -1), (1, 1, -1), (1, -1, 1), (-1, 1, 1)]),
    ],
)
def test_numberings_of_the_autopilots(numbering, mixed):
    """Torques about forward, left, up: (y, -x, spin) of thrust."""
    rotors = vehicles.LAYOUTS["quad-x"][numbering]
    assert [(np.sign(y), -np.sign(x), spin) for x, y, spin in rotors] == mixed


def test_the_crazyflie_is_as_published():
    vehicle = vehicles.load_vehicle("crazyflie-2x")
    assert vehicle.mass is not None
    assert vehicle.mass.value == 0.027
    np.testing.assert_allclose(np.abs(vehicle.positions), 0.028, atol=1e-4)
    assert (vehicle.gyro_cutoff_hz, vehicle.accelerometer_cutoff_hz) == (80.0, 30.0)
    assert vehicle.rotor_radius == 0.0225
    assert vehicles.load_vehicle("crazyflie-2.1-brushless").rotor_radius == 0.0275
    assert vehicle.torque_ratio is None, "Izz is not to rest on what the user has not said"


def test_template_is_a_vehicle_with_every_key(tmp_path):
    path = tmp_path / "new.toml"
    path.write_text(vehicles.vehicle_template(), encoding="utf-8")
    assert vehicles.load_vehicle(path).mass is None
    path.write_text(re.sub(r"(?m)^# (\w+ = )", r"\1", vehicles.vehicle_template()), encoding="utf-8")
    full = vehicles.load_vehicle(path)
    names = set(vehicles.KnownVehicle.__dataclass_fields__)
    assert all(getattr(full, name) is not None for name in names)
    each = re.sub(r"(?m)^(layout|numbering) .*$", "", vehicles.vehicle_template())
    path.write_text(re.sub(r"(?m)^#   (\w+ = )", r"\1", each), encoding="utf-8")
    assert vehicles.load_vehicle(path).arm_scale == vehicles.KnownNumber(1.0, 0.01)


COEFFICIENTS = {"thrust_quadratic": 1e-5, "torque_ratio": 0.02, "lag_up": 0.05, "lag_down": 0.05}
TWO_ROTORS = vehicles.Rotors(((0.1, 0.0, 0.0), (-0.1, 0.0, 0.0)), (1, -1), 1000.0, **COEFFICIENTS)
TWO_ROTORED = vehicles.Vehicle(1.0, (0.01, 0.02, 0.025), TWO_ROTORS)


@pytest.mark.parametrize(("linear", "quadratic"), [(0.0, 1e-5), (2e-3, 0.0), (2e-3, 1e-5)])
def test_speed_of_thrust_inverts_it(linear, quadratic):
    rotors = replace(TWO_ROTORS, thrust_linear=linear, thrust_quadratic=quadratic)
    assert rotors.speed_of_thrust(rotors.thrust(432.1)) == pytest.approx(432.1, rel=1e-12)
    assert rotors.speed_of_thrust(-1.0) == 0.0


def ordered(*acts_as: int) -> vehicles.KnownVehicle:
    """A vehicle file in which the true rotors have these numbers, below zero with the other spin."""
    positions, spins = [(0.0, 0.0)] * 4, [0] * 4
    for true, number in enumerate(acts_as):
        positions[abs(number) - 1] = TRUE.positions[true]
        spins[abs(number) - 1] = TRUE.spins[true] * (1 if number > 0 else -1)
    return replace(TRUE, positions=tuple(positions), spins=tuple(spins))


@pytest.fixture(scope="module")
def flight() -> PreparedFlight:
    return prepared(body_flown(duration=8.0, seed=0))


@pytest.mark.parametrize(
    ("acts_as", "words"),
    [
        ((1, 3, 2, 4), "Rotors 2 and 3 look exchanged: so the rotors explain"),
        ((2, 1, 3, 4), "Rotors 1 and 2 look exchanged:"),
        ((3, 2, 1, 4), "Rotors 1 and 3 look exchanged:"),
        ((1, -2, 3, 4), "Rotor 2 looks to spin the other way than the vehicle file says:"),
        ((2, 3, 1, 4), "The commands 1, 2, 3, 4 look to act as the rotors 2, 3, 1, 4 of the vehicle file:"),
    ],
)
def test_another_order_is_named(flight, acts_as, words):
    result = verdict.observed_order([flight], ordered(*acts_as))
    assert result is not None
    assert tuple(result.numbers.values())[:4] == acts_as
    assert result.sentence.startswith(words)
    assert result.numbers["order_explained"] > 0.9


def test_the_right_order_is_not_accused_and_signs_alone_are_left_to_the_gains(flight):
    turned = replace(TRUE, spins=tuple(-spin for spin in TRUE.spins))
    mirrored = replace(TRUE, positions=tuple((x, -y) for x, y in TRUE.positions))
    assert [verdict.observed_order([flight], vehicle) for vehicle in (TRUE, turned, mirrored)] == [None] * 3


@pytest.mark.thorough
def test_of_more_rotors_two_may_be_exchanged():
    angles = np.arange(6) * np.pi / 3.0 + 0.3
    positions = tuple((float(np.cos(angle)), float(np.sin(angle))) for angle in angles)
    around = tuple((0.043 * x, 0.043 * y, 0.0) for x, y in positions)
    rotors = replace(VEHICLE.rotors, positions=around, spins=(1, -1, 1, -1, 1, -1))
    six = vehicles.KnownVehicle("six", positions, rotors.spins)
    made = body_flown(vehicle=replace(VEHICLE, mass=0.045, rotors=rotors), duration=8.0, seed=0)
    flight = prepare(made.recording, RigidBody(six), FlightOptions())
    exchanged = (*positions[:3], positions[4], positions[3], positions[5])
    swapped = replace(six, positions=exchanged, spins=(1, -1, 1, 1, -1, -1))
    assert verdict.observed_order([flight], six) is None
    result = verdict.observed_order([flight], swapped)
    assert result is not None
    assert tuple(result.numbers.values())[:6] == (1, 2, 3, 5, 4, 6)


@pytest.mark.thorough
@pytest.mark.usefixtures("coarse_search")
def test_a_result_refuses_and_says_which(flight):
    result = identify_flight(flight.recording, model=RigidBody(ordered(1, 3, 2, 4)))
    assert result.verdict.status is Status.REFUSED
    assert any(reason.sentence.startswith("Rotors 2 and 3 look") for reason in result.verdict.reasons)
    assert result.diagnostics["rotor_2_acts_as"] == 3.0
