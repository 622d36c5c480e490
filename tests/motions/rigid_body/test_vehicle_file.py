"""Vehicle files: what they hold, and what each mistake in one is answered with."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from eivor.errors import InputError, ParameterError, UsageError
from eivor.flights.options import FlightOptions
from eivor.flights.prepare import prepare
from eivor.flights.prepared import PreparedFlight
from eivor.inference.verdict import Status
from eivor.lab.scenario_files import shipped_rigid_body_flight
from eivor.motions.identify import identify_flight
from eivor.motions.rigid_body.dynamics import side_by_side
from eivor.motions.rigid_body.motion import RigidBody
from eivor.motions.rigid_body.vehicle import (
    LAYOUTS,
    BodyDrag,
    KnownNumber,
    KnownVehicle,
    Rotors,
    Vehicle,
    load_vehicle,
    vehicle_template,
)
from eivor.motions.rigid_body.verdict import Order, observed_order
from eivor.simulation.rigid_body import simulate_rigid_body_flights
from eivor.simulation.rigid_body_spec import RigidBodyFlightSpec

X = 'layout = "quad-x"\nnumbering = "px4"\n'
EACH = "positions = [[0.1, -0.1], [-0.1, 0.1], [0.1, 0.1], [-0.1, -0.1]]\n"


@pytest.fixture
def loaded(tmp_path):
    def load(top="", rotors=X):
        path = tmp_path / "mine.toml"
        path.write_text(f"{top}\n[rotors]\n{rotors}", encoding="utf-8")
        return load_vehicle(path)

    return load


def test_everything_is_read(loaded):
    vehicle = loaded(
        'name = "Mine"\nmass = { value = 1.2, std = 0.01 }\nyaw_inertia_ratio = 1.8\n'
        "delay_ms = { value = 4.0, std = 1 }\n"
        "gyro_cutoff_hz = 80\naccelerometer_cutoff_hz = 30.0",
        X + "arm = { value = 0.2, std = 0.002 }\nspeed_scale = 0.10472\ntorque_ratio.value = 0.016\n"
        'thrust_map = "mixed:0.3"',
    )
    assert vehicle.name == "Mine"
    assert vehicle.mass == KnownNumber(1.2, 0.01)
    assert vehicle.yaw_inertia_ratio == KnownNumber(1.8)
    assert vehicle.delay == KnownNumber(0.004, 0.001)
    assert (vehicle.gyro_cutoff_hz, vehicle.accelerometer_cutoff_hz) == (80.0, 30.0)
    assert vehicle.arm == pytest.approx(0.2)
    assert vehicle.arm_scale == KnownNumber(1.0, 0.01)
    assert vehicle.speed_scale == KnownNumber(0.10472)
    assert vehicle.torque_ratio == KnownNumber(0.016)
    assert vehicle.thrust_map == "mixed:0.3"


@pytest.mark.parametrize("spins", ['["ccw", "ccw", "cw", "cw"]', "[-1, -1, 1, 1]"])
def test_rotors_one_by_one(loaded, spins):
    vehicle = loaded(rotors=f"{EACH}spins = {spins}\npositions_std = 0.02")
    assert vehicle.positions == ((0.1, -0.1), (-0.1, 0.1), (0.1, 0.1), (-0.1, -0.1))
    assert vehicle.spins == (-1, -1, 1, 1)
    assert vehicle.arm_scale == KnownNumber(1.0, 0.02)


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
    rotors = LAYOUTS["quad-x"][numbering]
    assert [(np.sign(y), -np.sign(x), spin) for x, y, spin in rotors] == mixed


@pytest.mark.parametrize(
    ("top", "rotors", "told"),
    [
        ("mass = { value = 1, sdt = 0.1 }", X, "unknown key 'sdt'. Did you mean 'std'"),
        ("mass = { std = 0.1 }", X, "finite number at mass.value of mine.toml; received nothing"),
        ("mass = { value = 1, std = -0.1 }", X, "std of zero or more in mine.toml"),
        ("mass = { value = 1, std = 0.5 }", X, "standard deviation of the mass of at most 0.4"),
        ('mass = "1 kg"', X, "a finite number or a table at mass"),
        ("gyro_cutoff_hz = 0", X, "gyro_cutoff_hz between 1 and 10000 Hz"),
        ("", X + "arm = 225", "0.005 to 10 m at rotors.arm of mine.toml; received 225. Check its unit"),
        ("", X + 'thrust_map = "cubic"', "an input map linear, square"),
        ("", X + EACH, "received both"),
        ("", EACH + 'spins = ["cw", "cw", "ccw"]', "4 positions and 3 spins"),
        ("", EACH + 'spins = ["cw", "cw", "left", "ccw"]', "one of cw, ccw at rotors.spins[3]"),
        ("", EACH + "spins = [1, 1, 2, -1]", "spins of +1 or -1"),
        ("", EACH + "spins = [1, 1, 1, 1]", "of both spins"),
        ("", "positions = [[0.1, 0.1, 0.0]]\nspins = [1]", "two numbers at rotors.positions[1]"),
        ("", "positions = [[100, 100]]\nspins = [1]", "at most 10 m at rotors.positions[1]"),
    ],
)
def test_mistakes_are_told(loaded, top, rotors, told):
    with pytest.raises(InputError, match=re.escape(told)):
        loaded(top, rotors)


def test_what_is_no_vehicle(tmp_path):
    (tmp_path / "log.toml").write_bytes(b"\xff\xfe")
    for source, item in (
        (tmp_path / "missing.toml", "unreadable"),
        (tmp_path / "log.toml", "unreadable"),
        (tmp_path, "unreadable"),
        ("crazyflie-2", "Did you mean 'crazyflie-2x'"),
        ("hexacopter", "eivor vehicle new"),
        ("x" * 5000, "eivor vehicle new"),
    ):
        with pytest.raises(InputError, match=item):
            load_vehicle(source)


def test_the_crazyflie_is_as_published():
    vehicle = load_vehicle("crazyflie-2x")
    assert vehicle.mass is not None
    assert vehicle.mass.value == 0.027
    np.testing.assert_allclose(np.abs(vehicle.positions), 0.028, atol=1e-4)
    assert (vehicle.gyro_cutoff_hz, vehicle.accelerometer_cutoff_hz) == (80.0, 30.0)
    assert vehicle.rotor_radius == 0.0225
    assert load_vehicle("crazyflie-2.1-brushless").rotor_radius == 0.0275
    assert vehicle.torque_ratio is None, "Izz is not to rest on what the user has not said"


def test_template_is_a_vehicle_with_every_key(tmp_path):
    path = tmp_path / "new.toml"
    path.write_text(vehicle_template(), encoding="utf-8")
    assert load_vehicle(path).mass is None
    path.write_text(re.sub(r"(?m)^# (\w+ = )", r"\1", vehicle_template()), encoding="utf-8")
    full = load_vehicle(path)
    names = set(KnownVehicle.__dataclass_fields__)
    assert all(getattr(full, name) is not None for name in names)
    each = re.sub(r"(?m)^(layout|numbering) .*$", "", vehicle_template())
    path.write_text(re.sub(r"(?m)^#   (\w+ = )", r"\1", each), encoding="utf-8")
    assert load_vehicle(path).arm_scale == KnownNumber(1.0, 0.01)


def test_known_numbers_and_vehicles_are_checked_in_python():
    with pytest.raises(ParameterError, match="finite value"):
        KnownNumber(float("nan"))
    with pytest.raises(ParameterError, match="std of zero or more"):
        KnownNumber(1.0, -0.1)
    corners = ((1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (-1.0, -1.0))
    with pytest.raises(ParameterError, match="mass between"):
        KnownVehicle("x", corners, (-1, -1, 1, 1), mass=KnownNumber(-1.0))
    with pytest.raises(ParameterError, match="Leave its height out"):
        KnownVehicle("x", tuple((*corner, 0.0) for corner in corners), (-1, -1, 1, 1))
    with pytest.raises(UsageError, match="input map"):
        KnownVehicle("x", corners, (-1, -1, 1, 1), thrust_map="")


ROTORS = Rotors(
    positions=((0.1, 0.0, 0.0), (-0.1, 0.0, 0.0)),
    spins=(1, -1),
    highest_speed=1000.0,
    thrust_quadratic=1e-5,
    torque_ratio=0.02,
    lag_up=0.05,
    lag_down=0.05,
)
VEHICLE = Vehicle(1.0, (0.01, 0.02, 0.025), ROTORS)


@pytest.mark.parametrize(("linear", "quadratic"), [(0.0, 1e-5), (2e-3, 0.0), (2e-3, 1e-5)])
def test_speed_of_thrust_inverts_it(linear, quadratic):
    rotors = replace(ROTORS, thrust_linear=linear, thrust_quadratic=quadratic)
    assert rotors.speed_of_thrust(rotors.thrust(432.1)) == pytest.approx(432.1, rel=1e-12)
    assert rotors.speed_of_thrust(-1.0) == 0.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mass": 0.0}, "mass above zero"),
        ({"inertia": (1.0, 2.0)}, "three numbers .* or six"),
        ({"inertia": (1.0, 2.0, -3.0)}, "positive definite"),
        ({"inertia": (1.0, 1.0, 1.0, 2.0, 0.0, 0.0)}, "positive definite"),
        ({"inertia": (float("nan"), 1.0, 1.0)}, "positive definite"),
    ],
)
def test_vehicle_is_checked(change, message):
    with pytest.raises(ParameterError, match=message):
        replace(VEHICLE, **change)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"spins": (1,)}, "a spin for each"),
        ({"spins": (1, 2)}, r"spins of \+1 or -1"),
        ({"positions": ((0.1, 0.0), (0.1, 0.0, 0.0))}, "three numbers for position"),
        ({"inertia": -1.0}, "inertia of zero or more"),
        ({"thrust_quadratic": 0.0}, "rotors with thrust"),
        ({"lowest_speed": 1000.0}, "below the highest_speed"),
    ],
)
def test_rotors_are_checked(change, message):
    with pytest.raises(ParameterError, match=message):
        replace(ROTORS, **change)


@pytest.mark.parametrize(
    ("drag", "message"),
    [({"linear": (1.0,)}, "three numbers"), ({"quadratic": (0.0, 0.0, -1.0)}, "zero or more")],
)
def test_drag_is_checked(drag, message):
    with pytest.raises(ParameterError, match=message):
        BodyDrag(**drag)


def test_several_need_equally_many_rotors():
    three = replace(ROTORS, positions=(*ROTORS.positions, (0.0, 0.1, 0.0)), spins=(1, -1, 1))
    with pytest.raises(UsageError, match="equally many rotors"):
        side_by_side([VEHICLE, replace(VEHICLE, rotors=three)])


SPEC = replace(shipped_rigid_body_flight("crazyflie"), duration=8.0, seed=0)
ROTOR_ROTORS = SPEC.vehicle.rotors
TRUE = KnownVehicle("simulated", tuple((x, y) for x, y, _ in ROTOR_ROTORS.positions), ROTOR_ROTORS.spins)


def ordered(*acts_as: int) -> KnownVehicle:
    """A vehicle file in which the true rotors have these numbers, below zero with the other spin."""
    positions, spins = [(0.0, 0.0)] * 4, [0] * 4
    for true, number in enumerate(acts_as):
        positions[abs(number) - 1] = TRUE.positions[true]
        spins[abs(number) - 1] = TRUE.spins[true] * (1 if number > 0 else -1)
    return replace(TRUE, positions=tuple(positions), spins=tuple(spins))


def shown(flight: PreparedFlight, vehicle: KnownVehicle) -> Order | None:
    return observed_order([flight], vehicle)


def flown(specs: list[RigidBodyFlightSpec]) -> list[PreparedFlight]:
    logs = [flight.recording for flight in simulate_rigid_body_flights(specs)]
    return [prepare(log, RigidBody(TRUE), FlightOptions()) for log in logs]


@pytest.fixture(scope="module")
def flight() -> PreparedFlight:
    return flown([SPEC])[0]


@pytest.mark.thorough
def test_the_right_order_is_not_accused(flight):
    assert shown(flight, TRUE) is None


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
    result = shown(flight, ordered(*acts_as))
    assert result is not None
    assert result.acts_as == acts_as
    assert result.sentence.startswith(words)
    assert result.explained > 0.9


def test_signs_alone_are_left_to_the_gains(flight):
    assert shown(flight, replace(TRUE, spins=tuple(-spin for spin in TRUE.spins))) is None
    assert shown(flight, replace(TRUE, positions=tuple((x, -y) for x, y in TRUE.positions))) is None


@pytest.mark.thorough
def test_of_more_rotors_two_may_be_exchanged():
    angles = np.arange(6) * np.pi / 3.0 + 0.3
    positions = tuple((float(np.cos(angle)), float(np.sin(angle))) for angle in angles)
    rotors = replace(
        ROTOR_ROTORS,
        positions=tuple((0.043 * x, 0.043 * y, 0.0) for x, y in positions),
        spins=(1, -1, 1, -1, 1, -1),
    )
    spec = replace(SPEC, vehicle=replace(SPEC.vehicle, mass=0.045, rotors=rotors))
    six = KnownVehicle("six", positions, rotors.spins)
    log = next(iter(simulate_rigid_body_flights([spec]))).recording
    flight = prepare(log, RigidBody(six), FlightOptions())
    swapped = replace(
        six, positions=(*positions[:3], positions[4], positions[3], positions[5]), spins=(1, -1, 1, 1, -1, -1)
    )
    assert shown(flight, six) is None
    result = shown(flight, swapped)
    assert result is not None
    assert result.acts_as == (1, 2, 3, 5, 4, 6)


@pytest.mark.thorough
def test_a_result_refuses_and_says_which(flight):
    result = identify_flight(flight.recording, model=RigidBody(ordered(1, 3, 2, 4)))
    assert result.verdict.status is Status.REFUSED
    assert any(reason.sentence.startswith("Rotors 2 and 3 look") for reason in result.verdict.reasons)
    assert result.diagnostics["rotor_2_acts_as"] == 3.0
