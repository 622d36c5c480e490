"""Files of simulators: loaded and flown by their programs, and identified again."""

from __future__ import annotations

import json
import os
import re
import runpy
import subprocess
import sys
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

import eivor as ev
from eivor.cli.main import app
from eivor.errors import NotIdentifiedError
from eivor.exports.autopilots import thrust_linear
from eivor.exports.fitted import Supplied
from eivor.exports.simulators import SIMULATORS, URDF, WITH_LARGEST
from eivor.exports.vehicle import (
    EFFECTS,
    LACKS,
    REPLAY_SPEED,
    REPLAY_STEP_S,
    by_quarters,
    coefficients,
    delay_commands,
    describe,
    manoeuvre,
    replay,
    rotors_of,
)
from eivor.motions.rigid_body.dynamics import body_derivative, speed_derivative
from eivor.motions.rigid_body.vehicle import KnownNumber, load_vehicle
from eivor.motions.table import motion_by_name
from eivor.signals.thrust_map import Mixed, input_map
from exports import documents
from exports.documents import document
from exports.test_simulators import WORSE, sitl_frame

STEP, SECONDS = 1.02, 1.0
LARGEST = {"largest_command": KnownNumber(2500.0)}
SPEED_LAG = "lag of the rotors' speed in place of their thrust's"


def flown(parameters, command):
    """Climb rate after `SECONDS` of a command in RotorPy, and a rotor's speeds."""
    from rotorpy.vehicles.multirotor import Multirotor

    start, step_s = {name: np.zeros(3) for name in ("x", "v", "w", "wind")}, 0.01
    state = start | {"q": np.array([0.0, 0.0, 0.0, 1.0]), "rotor_speeds": np.full(4, documents.HOVER)}
    vehicle = Multirotor(
        parameters, state, "cmd_motor_speeds", integrator_kwargs={"rtol": 1e-8, "atol": 1e-10}
    )
    speeds = [documents.HOVER]
    for _ in range(round(SECONDS / step_s)):
        state = vehicle.step(state, {"cmd_motor_speeds": np.full(4, command)}, step_s)
        speeds.append(state["rotor_speeds"][0])
    return float(state["v"][2]), np.array(speeds)


@pytest.mark.thorough
def test_rotorpy_climbs_and_lags_as_the_flight_did(tmp_path):
    pytest.importorskip("rotorpy", reason="RotorPy is not installed")
    parameters = documents.quad_params(tmp_path)
    rate, speeds = flown(parameters, STEP * documents.HOVER)
    assert rate == pytest.approx(documents.climb(STEP, SECONDS), rel=0.01)
    left = (STEP - speeds / documents.HOVER) / (STEP - 1.0)
    assert 0.1 / -np.log(left[10]) == pytest.approx(documents.LAG, abs=0.002)
    assert flown(parameters, documents.HOVER)[0] == pytest.approx(0.0, abs=1e-4)


@pytest.mark.thorough  # of the extra `simulators`
def test_mujoco_climbs_as_the_flight_did(tmp_path):
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed")
    model = mujoco.MjModel.from_xml_path(documents.saved("mujoco", tmp_path))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, 500)
    np.testing.assert_allclose(data.qvel, 0.0, atol=1e-9)
    data.ctrl[:4] = STEP**2
    mujoco.mj_step(model, data, round(SECONDS / model.opt.timestep))
    assert data.qvel[2] == pytest.approx(documents.climb(STEP, SECONDS, lagged="thrust"), rel=0.002)
    assert data.qvel[2] == pytest.approx(documents.climb(STEP, SECONDS), rel=0.01)
    data.ctrl[:4] = [1.0, 1.0, 1.02, 1.02]  # the rotors on the left
    mujoco.mj_step(model, data, 50)
    assert data.qvel[3] > 0.1  # rolls to the right, about the axis that points forward
    np.testing.assert_allclose(data.qvel[[4, 5]], 0.0, atol=1e-3)
    np.testing.assert_allclose(model.body_inertia[1], [1.43e-5, 1.45e-5, 2.7e-5])
    assert model.actuator_ctrlrange[0, 1] == pytest.approx((2500.0 / documents.HOVER) ** 2)


#: In a process of its own: drone-models must be imported before SciPy.
ACCELERATION = """
import drone_models.first_principles, json, runpy, sys
import numpy as np
per_minute = float(sys.argv[2]) * 60.0 / (2.0 * np.pi)
rest = np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), np.array([0.0, 0.0, 1.0]), np.zeros(3)
speeds = per_minute * np.array([1.0, 1.0, 1.02, 1.02])
found = runpy.run_path(sys.argv[1])["dynamics"](*rest, 1.02 * speeds, speeds)
print(json.dumps([one.tolist() for one in found[2:]]))
"""


@pytest.mark.thorough
def test_drone_models_accelerate_as_the_flight_says(tmp_path):
    pytest.importorskip("casadi", reason="drone-models is not installed")
    run = subprocess.run(
        [
            sys.executable,
            "-c",
            ACCELERATION,
            documents.saved("drone-models", tmp_path),
            repr(documents.HOVER),
        ],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"SCIPY_ARRAY_API": "1"},
    )
    velocity, rates, speeds = json.loads(run.stdout)
    lift = 0.5 + 0.5 * 1.02**2
    assert velocity[2] == pytest.approx(documents.GRAVITY * (lift - 1.0) - 0.3 * 1.01, rel=1e-6)
    arm, thrust = 0.043 / 2**0.5, 0.03 * documents.GAIN / 4 * documents.HOVER**2
    assert rates[0] == pytest.approx(
        2 * arm * (thrust * (1.02**2 - 1.0) - 0.02 * 0.3 * 0.03 / 4) / 1.43e-5, rel=1e-6
    )
    assert speeds[0] / 60.0 * 2.0 * np.pi == pytest.approx(0.02 * documents.HOVER / documents.LAG, rel=1e-6)


@pytest.fixture(name="lopsided")
def of_lopsided(tmp_path, request):
    """Saved result of that vehicle or another, its description, and commands and states of a manoeuvre."""
    record = documents.VEHICLES[getattr(request, "param", "lopsided")]
    fit = ev.load_fit(documents.written(record(), tmp_path))
    made = describe(fit.fitted, Supplied(priors=LARGEST), "all", WITH_LARGEST)
    commands = manoeuvre(made, 30.0)
    states = replay(made, commands)
    assert np.degrees(np.arccos(1.0 - 2.0 * (states[:, 7:9] ** 2).sum(axis=1)).max()) > 30.0
    assert np.abs(states[:, 10:13]).max() > 3.0
    return fit, made, commands, states


def off(states, attitudes):
    """Root mean square error of attitudes w, x, y, z [deg]."""
    cosine = np.abs((states[:, 6:10] * attitudes).sum(axis=1)).clip(max=1.0)
    return np.degrees(np.sqrt(np.mean((2.0 * np.arccos(cosine)) ** 2)))


def absent(lost):
    """Words for what a simulator has not."""
    return [re.split("[,:]", text.partition(" has no ")[2], maxsplit=1)[0] for text in lost]


def test_what_a_target_cannot_hold_is_said_with_the_error_that_it_makes(lopsided):
    fit, made = lopsided[:2]
    lost = {
        to: fit.exported(to, Supplied(priors=LARGEST), None, 0).lost
        for to in ("mujoco", "rotorpy", "pybullet", "gazebo", "drone-models", "sih", "px4-gazebo")
    }
    assert absent(lost["pybullet"]) == absent(lost["drone-models"]) == ["delay of the commands"]
    assert absent(lost["mujoco"]) == ["rotor inertia", SPEED_LAG, "delay of the commands"]
    for target in ("sih", "px4-gazebo"):
        (centre,) = [text for text in lost[target] if "centre of mass beside" in text]
        degrees = float(centre.partition("errs by ")[2].split()[0])
        assert degrees > 50.0
    assert any("quadratic drag" in text for text in lost["gazebo"])
    assert not any("quadratic drag" in text for text in lost["rotorpy"])
    with_inertia = documents.table(fit.export("drone-models"))
    assert with_inertia["prop_inertia"] == pytest.approx(made.values["rotor_inertia"][0])
    centres = made.values["centre_of_mass_forward"][0], made.values["centre_of_mass_left"][0]
    np.testing.assert_allclose(centres, (6.4e-6 / (2.3e-8 / 1.45e-5), -3.2e-6 / (2.3e-8 / 1.43e-5)))


def by_mujoco(path, made, commands):
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed")
    model = mujoco.MjModel.from_xml_path(str(path))
    data, hover = mujoco.MjData(model), rotors_of(made)["hover_speed"][0]
    mujoco.mj_resetDataKeyframe(model, data, 0)
    model.opt.timestep = 0.001
    data.qvel[:2], data.act[:] = REPLAY_SPEED, (manoeuvre(made, 0.0)[0] / hover) ** 2
    assert model.actuator_ctrllimited[:4].all()
    assert model.actuator_ctrlrange[0, 0] == 0.0
    for command in commands:
        data.ctrl[:4] = (command / hover) ** 2
        mujoco.mj_step(model, data, 5)
        yield data.qpos[3:7].copy()


def by_rotorpy(path, made, commands):
    multirotor = pytest.importorskip("rotorpy.vehicles.multirotor", reason="RotorPy is not installed")
    parameters = runpy.run_path(path)["quad_params"]
    state = {name: np.zeros(3) for name in ("x", "w", "wind")}
    state |= {"v": np.array([REPLAY_SPEED, REPLAY_SPEED, 0.0]), "q": np.array([0.0, 0.0, 0.0, 1.0])}
    state["rotor_speeds"] = manoeuvre(made, 0.0)[0]
    vehicle = multirotor.Multirotor(parameters, state, "cmd_motor_speeds", integrator_kwargs={"rtol": 1e-8})
    for command in commands:
        state = vehicle.step(state, {"cmd_motor_speeds": command}, REPLAY_STEP_S)
        yield state["q"][[3, 0, 1, 2]]


def by_pybullet(path, made, commands):
    bullet = pytest.importorskip("pybullet", reason="PyBullet is not installed")
    client, step_s = bullet.connect(bullet.DIRECT), 0.0005
    try:
        bullet.setGravity(0.0, 0.0, -9.8)
        bullet.setTimeStep(step_s)
        vehicle = runpy.run_path(path)["Vehicle"](client)
        bullet.resetBaseVelocity(vehicle.body, [REPLAY_SPEED, REPLAY_SPEED, 0.0], [0.0] * 3)
        for command in commands:
            for _ in range(round(REPLAY_STEP_S / step_s)):
                vehicle.apply(command, step_s)
                bullet.stepSimulation()
            x, y, z, w = bullet.getBasePositionAndOrientation(vehicle.body)[1]
            yield w, x, y, z
    finally:
        bullet.disconnect(client)


#: In a process of its own, as above: attitudes w, x, y, z under commands, by steps of half a millisecond.
TURNED = """
import drone_models.first_principles, json, runpy, sys
import numpy as np
from scipy.spatial.transform import Rotation
dynamics = runpy.run_path(sys.argv[1])["dynamics"]
speed, step_s, commands, speeds = json.load(sys.stdin)
still, up = np.zeros(3), Rotation.identity()
def slope(turn, velocity, rate, speeds):
    return dynamics(still, turn.as_quat(), velocity, rate, command, speeds)[2:]
turn, state, h, attitudes = up, [np.array([speed, speed, 0.0]), still, np.array(speeds)], 0.0005, []
for command in np.array(commands):
    for _ in range(round(step_s / h)):
        middle = [x + 0.5 * h * d for x, d in zip(state, slope(turn, *state))]
        half = turn * Rotation.from_rotvec(0.5 * h * state[1])
        state = [x + h * d for x, d in zip(state, slope(half, *middle))]
        turn = turn * Rotation.from_rotvec(h * middle[1])
    attitudes.append(turn.as_quat()[[3, 0, 1, 2]].tolist())
print(json.dumps(attitudes))
"""


def by_drone_models(path, made, commands):
    pytest.importorskip("casadi", reason="drone-models is not installed")
    per_minute = 60.0 / (2.0 * np.pi)
    speeds = [(per_minute * item).tolist() for item in (commands, manoeuvre(made, 0.0)[0])]
    run = subprocess.run(
        [sys.executable, "-c", TURNED, str(path)],
        input=json.dumps([REPLAY_SPEED, REPLAY_STEP_S, *speeds]),
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"SCIPY_ARRAY_API": "1"},
    )
    return json.loads(run.stdout)


@pytest.mark.thorough  # of the extra `simulators`
@pytest.mark.parametrize("lopsided", documents.VEHICLES, indirect=True)
@pytest.mark.parametrize(
    ("to", "consumer", "most"),
    [
        ("mujoco", by_mujoco, 0.8),
        ("rotorpy", by_rotorpy, 0.4),
        ("pybullet", by_pybullet, 0.1),
        ("drone-models", by_drone_models, 0.02),
    ],
)
def test_a_simulator_turns_as_the_result_predicts(to, consumer, most, lopsided, tmp_path):
    """Off by so many degrees of the whole vehicle, with all that is identified."""
    fit, made, commands, states = lopsided
    path = tmp_path / "vehicle"
    path.write_text(fit.exported(to, Supplied(priors=LARGEST), None, 0).text, encoding="utf-8")
    assert off(states, np.array(list(consumer(path, made, commands)))) < most


def held(made, commands, lacking):
    """States of a vehicle without what a simulator cannot hold."""
    rows = [EFFECTS[effect] for effect in lacking]
    names = {name for row in rows if "alike" not in row for name in row["numbers"]}
    rest = {name: column for name, column in made.values.items() if name not in names}
    rest |= dict.fromkeys(names & set(EFFECTS["turning"]["numbers"]), np.zeros(1))
    return replay(replace(made, values=rest), commands)


@pytest.mark.thorough  # of the extra `simulators`
def test_a_urdf_turns_as_what_it_holds(lopsided, tmp_path):
    """Forces and torques are those that gym-pybullet-drones applies."""
    bullet = pytest.importorskip("pybullet", reason="PyBullet is not installed")
    fit, made, commands, _ = lopsided
    path = tmp_path / "v.urdf"
    path.write_text(fit.export("urdf", priors={"largest_command": (2500.0, 0.0)}), encoding="utf-8")
    yourdfpy = pytest.importorskip("yourdfpy", reason="yourdfpy is not installed")
    assert yourdfpy.URDF.load(str(path)).validate()
    properties = ElementTree.parse(path).getroot().find("properties").attrib  # noqa: S314 - made here
    kf, km, across, along = (
        float(properties[name]) for name in ("kf", "km", "drag_coeff_xy", "drag_coeff_z")
    )
    order, step_s = by_quarters(made.vehicle, "pybullet"), 0.0005
    client = bullet.connect(bullet.DIRECT)
    try:
        bullet.setGravity(0.0, 0.0, -9.8)
        bullet.setTimeStep(step_s)
        body = bullet.loadURDF(str(path), flags=bullet.URDF_USE_INERTIA_FROM_FILE)
        bullet.changeDynamics(body, -1, linearDamping=0.0, angularDamping=0.0)
        bullet.resetBaseVelocity(body, [REPLAY_SPEED, REPLAY_SPEED, 0.0], [0.0] * 3)
        attitudes = []
        for command in commands:
            per_minute = command[list(order)] * 60.0 / (2.0 * np.pi)
            for _ in range(round(REPLAY_STEP_S / step_s)):
                turned = np.array(
                    bullet.getMatrixFromQuaternion(bullet.getBasePositionAndOrientation(body)[1])
                )
                velocity = turned.reshape(3, 3).T @ bullet.getBaseVelocity(body)[0]
                drag = -np.array([across, across, along]) * command.sum() * velocity
                for link, force in enumerate(kf * per_minute**2):
                    bullet.applyExternalForce(body, link, [0.0, 0.0, force], [0.0] * 3, bullet.LINK_FRAME)
                torque = km * per_minute**2 @ [-1.0, 1.0, -1.0, 1.0]
                bullet.applyExternalTorque(body, 4, [0.0, 0.0, torque], bullet.LINK_FRAME)
                bullet.applyExternalForce(body, 4, drag.tolist(), [0.0] * 3, bullet.LINK_FRAME)
                bullet.stepSimulation()
            x, y, z, w = bullet.getBasePositionAndOrientation(body)[1]
            attitudes.append((w, x, y, z))
    finally:
        bullet.disconnect(client)
    assert off(held(made, commands, LACKS[URDF]), np.array(attitudes)) < 1.0


#: What a flight up and down may identify beside the rest, and a turning one.
UP_AND_DOWN = {"quadratic_drag": (0.05, 0.01), "ground_effect": (0.1, 0.01), "voltage_exponent": (1.1, 0.1)}


@pytest.mark.parametrize(
    ("to", "lost", "written"),
    [
        ("rotorpy", ["delay of the commands", "ground effect", "voltage exponent"], '"c_Dz": 0.0015'),
        (
            "mujoco",
            [SPEED_LAG, "delay of the commands", "quadratic drag", "ground effect", "voltage exponent"],
            "",
        ),
        (
            "sitl",
            [
                "yaw torque in step with thrust",
                "gyroscopic coupling of the rates",
                "lag of the rotors",
                "delay of the commands",
                "ground effect",
                "voltage exponent",
            ],
            '"propExpo": 0.4',
        ),
        ("casadi", ["ground effect", "voltage exponent"], "- 0.05 * ca.fabs(x[1]) * x[1]"),
        ("statespace", ["quadratic drag", "ground effect", "voltage exponent"], '"delay_s": 0.015'),
    ],
)
def test_a_flight_up_and_down_loses_nothing_in_silence(to, lost, written, tmp_path):
    reported = document(delay=(0.015, 0.001))
    reported["model"]["input_map"] = "mixed:0.4"
    for name, pair in UP_AND_DOWN.items():
        reported["parameters"][name] = documents.quantity(*pair)
    fit = ev.load_fit(documents.written(reported, tmp_path))
    given = {name: KnownNumber(*pair) for name, pair in documents.PRIORS.items() if "inertia" in name}
    known = Supplied(priors=given, vehicle=load_vehicle(documents.vehicle_file(tmp_path)))
    made = fit.exported(to, Supplied() if to in ("casadi", "statespace") else known, None, 0)
    assert absent(made.lost) == lost
    assert written in made.text
    assert all(text in made.text for text in made.lost)


def test_a_second_stage_and_a_lift_that_is_weak_are_said(lopsided, tmp_path):
    """An ellipsoid of MuJoCo drags along all axes or none; stages of 10 and 58 ms are late as one of 68."""
    reported = documents.of_lopsided(translational_lift=(0.003, 1e-4), quadratic_drag_z=(-0.01, 0.005))
    reported["parameters"]["translational_lift"]["verdict"] = "weak"
    reported["parameters"]["second_lag"] = documents.quantity(0.01, 0.001)
    made = ev.load_fit(documents.written(reported, tmp_path)).exported("mujoco", Supplied(), None, 0)
    assert "rotors [N/(m/s)^2]: left out. translational_lift is weak." in made.text
    assert any(
        "no quadratic drag, and quadratic_drag_x 0.00195, quadratic_drag_y 0.00207 not" in x
        for x in made.lost
    )
    assert any("second stage of the rotors' lag, and second_lag 0.01 not" in text for text in made.lost)
    vehicle, commands = lopsided[1:3]
    two = replace(
        vehicle, values={**vehicle.values, "second_lag": np.array([0.01]), "delay": np.array([0.007])}
    )
    fast, late = delay_commands(
        two, np.vstack([np.tile(manoeuvre(two, 0.0)[0], (20, 1)), np.tile(commands[3], (400, 1))])
    )
    assert fast.values["actuator_lag"][0] == pytest.approx(0.058)
    reached = (late[20:] - late[0]) / (commands[3] - late[0])
    # the area that is missed is delay and lag
    np.testing.assert_allclose(REPLAY_STEP_S * np.sum(1.0 - reached[:200], axis=0), 0.017, atol=0.003)


def sitl_flown(frame, commands):
    """Attitudes w, x, y, z by the equations of SIM_Frame and SIM_Motor: forces and torques of each motor."""
    weight, step_s, attitudes = frame["mass"] * documents.GRAVITY, 0.0005, []
    at = np.array([frame[f"motor{number}_position"] for number in range(1, 5)])
    yaw = 0.05 * frame["diagonal_size"] * np.array([frame[f"motor{number}_yaw"] for number in range(1, 5)])
    momentum = frame["mdrag_coef"] * np.sqrt(1.225 * frame["disc_area"] / 4)
    turn, velocity, rates = Rotation.identity(), np.array([REPLAY_SPEED, -REPLAY_SPEED, 0.0]), np.zeros(3)
    for signal in commands:
        mapped = (1.0 - frame["propExpo"]) * signal + frame["propExpo"] * signal**2
        thrust = weight / frame["hoverThrOut"] / 4 * mapped
        for _ in range(round(REPLAY_STEP_S / step_s)):
            air = turn.inv().apply(velocity) + np.cross(rates, at)
            forces = -momentum * air * np.sqrt(thrust)[:, None] - np.outer(thrust, [0.0, 0.0, 1.0])
            torque = np.cross(at, forces).sum(axis=0)
            torque[2] += yaw @ (signal * thrust)
            velocity += step_s * (turn.apply(forces.sum(axis=0)) / frame["mass"] + [0, 0, documents.GRAVITY])
            rates += step_s * torque / frame["moment_inertia"]
            turn *= Rotation.from_rotvec(step_s * rates)
        attitudes.append(turn.as_quat()[[3, 0, 1, 2]] * [1.0, 1.0, -1.0, -1.0])
    return np.array(attitudes)


def test_a_frame_of_sitl_turns_as_what_it_holds(tmp_path):
    fit = ev.load_fit(documents.written(documents.of_rigid_body(documents.KNOWN_VEHICLE), tmp_path))
    supplied = Supplied(priors=LARGEST)
    made = describe(fit.fitted, supplied, "SITL", WITH_LARGEST)
    frame = sitl_frame(fit.exported("sitl", supplied, None, 0).text)
    assert frame["refRotRate"] == 0.0
    commands = manoeuvre(made, 20.0)
    like_x = made.values | dict.fromkeys(("drag_y", "drag_z"), made.values["drag_x"])
    without = replace(made, values={name: x for name, x in like_x.items() if name != "actuator_lag"})
    commands[20:, 0] *= 1.02  # which yaws, too
    states = replay(without, commands, ("in_step", "coupling"))
    assert np.degrees(np.arccos(1.0 - 2.0 * (states[:, 7:9] ** 2).sum(axis=1)).max()) > 30.0
    # motors 1 to 4: front right, rear left, front left, rear right
    turned = sitl_flown(frame, commands[:, [0, 2, 3, 1]] / 2500.0)
    assert off(states, turned) < 0.5 * off(replay(without, commands), turned)


def test_a_lag_of_thrust_is_that_of_squared_speeds(tmp_path):
    fit = ev.load_fit(documents.written(documents.of_speeds(), tmp_path))
    given = {name: KnownNumber(*pair) for name, pair in documents.PRIORS.items()}
    known = Supplied(priors=given, vehicle=load_vehicle(documents.vehicle_file(tmp_path)))
    made = describe(fit.fitted, known, "all", WITH_LARGEST)
    commands = np.full((100, 4), 1.2 * rotors_of(made)["hover_speed"][0])
    ends = [replay(made, commands, lacking)[-1, 5] for lacking in ((), ("of_speed",))]
    expected = [documents.climb(1.2, 0.5, lagged=lagged) for lagged in ("speed", "thrust")]
    assert np.diff(ends) == pytest.approx(np.diff(expected), rel=0.05)


def test_accepted_verdicts_are_written_and_marked(tmp_path):
    reported = documents.of_rigid_body(documents.KNOWN_VEHICLE)
    for name in ("roll_gain", "pitch_gain", "drag_x"):
        reported["parameters"][name] |= {"verdict": "weak", "reasons": ["The interval is wide."]}
    fit = ev.load_fit(documents.written(reported, tmp_path))
    with pytest.raises(NotIdentifiedError) as refusal:
        fit.export("mujoco")
    assert str(refusal.value).count("The interval is wide.") == 1
    assert "roll_gain, pitch_gain are weak" in str(refusal.value)
    beside = {"priors": {"largest_command": (2500.0, 0.0)}, "accept": "weak"}
    for target in SIMULATORS:
        text = fit.export(target.name, **beside)
        marked = re.findall(r"(inertia in \w+|drag along \w) \[.* WEAK, not identified", text)
        assert marked == ["drag along x", "inertia in roll", "inertia in pitch", "inertia in yaw"], (
            target.name
        )
    for to in ("rotorpy", "mujoco", "isaaclab", "statespace"):
        assert fit.export(to, draws=3, **beside).count("WEAK, not identified") >= 4


def test_accepted_verdicts_are_marked_in_equations_and_parameters(tmp_path):
    """Hover and curve together, of signals behind the curve; draws of a table are marked on the terminal."""
    reported = document(thrust_curve=(0.6, 0.02))
    reported["parameters"]["thrust_curve"] = documents.quantity(0.6, 0.02)
    for quantity in (*reported["parameters"].values(), *reported["derived"].values()):
        quantity["verdict"] = "provisional"
    reported["model"] |= {"input_map": "mixed:0.6", "autopilot_curve": {"side": "behind"}}
    path = documents.written(reported, tmp_path)
    fit = ev.load_fit(path)
    assert "PROVISIONAL" not in fit.export("px4")
    text = fit.export("px4", accept="provisional")
    assert len(re.findall(r"# (?:MPC_THR_HOVER|THR_MDL_FAC): .*PROVISIONAL, not identified", text)) == 2
    assert fit.export("casadi", accept="provisional").count("PROVISIONAL, not identified") == 5
    numbers = json.loads(fit.export("statespace", accept="provisional"))["numbers"]
    assert {number["source"] for number in numbers.values()} == {"PROVISIONAL, not identified"}
    draws = str(tmp_path / "draws.parquet")
    run = CliRunner().invoke(
        app, ["export", str(path), "--draws", "5", "--accept", "provisional", "-o", draws]
    )
    assert (run.exit_code, run.stderr.count("provisional.")) == (0, 4)


@pytest.mark.parametrize(
    ("curve", "largest", "share", "hover"),
    [
        ("linear", 1.0, 0.0, 0.4),
        ("square", 2500.0, 1.0, 0.4),
        ("mixed:0.3", 1.0, 0.3, 0.4),
        ("mixed:0.3", 2.0, 0.6 / 1.3, 0.4),
        (
            "power:1.5",
            1.0,
            0.6481,
            0.3821,
        ),  # hovers at the same signal; full thrust is 1.05 times the flight's
    ],
)
def test_a_curve_of_sitl_is_the_map_over_its_largest_command(curve, largest, share, hover, tmp_path):
    reported = document()
    reported["model"]["input_map"] = curve
    gain = 2.5 * documents.GRAVITY / float(input_map(curve)(np.array([largest]))[0])
    reported["parameters"]["input_gain"] = documents.quantity(gain, 0.01 * gain)
    fit = ev.load_fit(documents.written(reported, tmp_path))
    priors = documents.PRIORS | {"largest_command": (largest, 0.0)}
    text = fit.export("sitl", vehicle=documents.vehicle_file(tmp_path), priors=priors)
    frame = sitl_frame(text)
    assert frame["propExpo"] == pytest.approx(share, abs=1e-4)
    assert frame["hoverThrOut"] == pytest.approx(hover, abs=1e-4)
    assert ("with 1.05 times the thrust at full command" in text) == (hover != 0.4)


def test_every_target_is_written_to_a_folder_with_a_page(tmp_path):
    reported = documents.of_lopsided(documents.KNOWN_VEHICLE | {"name": WORSE})
    reported["provenance"] |= {"version": WORSE, "logs": [{"name": WORSE, "sha256": WORSE}]}
    reported["parameters"]["drag_z"] |= {"verdict": "refused", "reasons": [WORSE]}
    path = documents.written(reported, tmp_path)
    (tmp_path / "all").mkdir()  # from before
    words = ["export", str(path), "--to", "all", str(tmp_path / "all"), "--prior", "largest_command=2500"]
    run = CliRunner().invoke(app, words)
    assert run.exit_code == 0, run.output
    names = {item.name for item in (tmp_path / "all").iterdir()}
    assert {"README.md", "fit_mujoco.xml", "fit_drone_models.py", "fit_isaaclab.py"} <= names
    page = (tmp_path / "all" / "README.md").read_text(encoding="utf-8")
    assert "## px4: not written" in page
    assert "errs by" in page
    # names stand in blocks of code of one line each, and have no control characters on the terminal
    assert {line.split(" ")[0] for line in page.splitlines()} == {"", "#", "##", "For"}
    assert not re.search(r"[\x00-\x08\x0b-\x1f\x7f]", run.stderr)
    for lost in re.findall(r"^    (.* errs by .*)$", page, re.MULTILINE):
        assert lost in run.stderr


def test_equations_of_casadi_are_those_of_the_result(lopsided, tmp_path):
    pytest.importorskip("casadi", reason="CasADi is not installed")
    fit, made, commands, states = lopsided
    (tmp_path / "f.py").write_text(fit.export("casadi"), encoding="utf-8")
    function = runpy.run_path(str(tmp_path / "f.py"))["f"]
    c, speeds, wind = coefficients(made), commands[3] + 20.0, (1.0, -2.0, 0.5)
    spin_up = speed_derivative(c, speeds.tolist(), commands[3].tolist())
    expected = [
        *body_derivative(c, states[30].tolist(), speeds.tolist(), spin_up, wind, (0.0,) * 3),
        *spin_up,
    ]
    got = np.array(function([*states[30], *speeds], commands[3], wind)).ravel()
    np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-9)


def test_a_state_space_of_six_axes_is_the_slope_of_the_equations(lopsided):
    fit = lopsided[0]
    space = fit.to_statespace()
    at = {name: number for number, name in enumerate(space.states)}
    assert space.A[at["velocity_x"], at["pitch"]] == pytest.approx(documents.GRAVITY, rel=1e-3)
    assert space.A[at["velocity_x"], at["velocity_x"]] == pytest.approx(-0.25, rel=0.01)
    assert space.A[at["angular_rate_x"], at["angular_rate_x"]] == pytest.approx(-0.35, rel=0.03)
    assert space.A[at["rotor_speed_1"], at["rotor_speed_1"]] == pytest.approx(-1.0 / 0.068)
    document = json.loads(fit.export("statespace"))
    forward = np.array(document["forward"]["A"])
    np.testing.assert_allclose(forward, fit.to_statespace(5.0).A)
    assert forward[at["velocity_x"], at["velocity_x"]] < space.A[at["velocity_x"], at["velocity_x"]] - 0.3
    draws = json.loads(fit.export("statespace", draws=40))["draws"]
    assert np.std(draws["delay_s"]) == pytest.approx(0.0005, rel=0.4)
    hover, fast = (
        np.std(np.array(item["A"])[:, at["velocity_x"], at["velocity_x"]])
        for item in (draws, draws["forward"])
    )
    assert hover == pytest.approx(0.01, rel=0.4)
    assert fast > hover  # the quadratic drag is uncertain, too
    # at 1 m/s to the left the rotors' drag, above the centre of mass, turns it as the flight says
    assert space.A[at["angular_rate_x"], at["velocity_y"]] == pytest.approx(0.002 * 0.0081 / 1.43e-5, rel=0.1)


def test_a_state_space_of_rates_has_each_axis(tmp_path):
    reported = document()
    reported["model"] |= {"name": motion_by_name("rates").words.model}
    numbers = {
        "roll_effectiveness": (150.0, 3.0),
        "roll_damping": (2.0, 0.2),
        "actuator_lag": (0.05, 0.001),
        "delay": (0.01, 0.0001),
    }
    reported["parameters"] = {name: documents.quantity(*pair) for name, pair in numbers.items()}
    values, errors = np.array(list(numbers.values())).T
    parts = [{"name": "given", "matrix": np.diag(errors**2).tolist(), "degrees": None, "share": 1.0}]
    fitted = {"names": list(numbers), "values": values.tolist(), "parts": parts}
    reported["covariance"] = {"choices": 1, **fitted}
    fit = ev.load_fit(documents.written(reported, tmp_path))
    space = fit.to_statespace()
    np.testing.assert_allclose(space.A, [[-20.0, 0.0], [150.0, -2.0]])
    np.testing.assert_allclose(space.B, [[20.0], [0.0]])
    assert (space.inputs, space.delay_s) == (("torque_setpoint_x",), 0.01)
    draws = np.array(json.loads(fit.export("statespace", draws=400))["draws"]["A"])
    np.testing.assert_allclose(draws.std(axis=0), [[0.4, 0.0], [3.0, 0.2]], rtol=0.15)
    beside = {"yaw_effectiveness": 20.0, "yaw_damping": 0.5, "yaw_reaction": 1.5, "second_lag": 0.01}
    for name, value in {**beside, "thrust_gain": 23.0}.items():
        reported["parameters"][name] = documents.quantity(value, 0.01)
    reported["parameters"]["pitch_effectiveness"] = documents.quantity(1.0, 1.0, verdict="refused")
    made = ev.load_fit(documents.written(reported, tmp_path)).exported("statespace", Supplied(), None, 0)
    assert "pitch_effectiveness is refused" in made.omitted[0]
    assert made.lost == ("A state space has no thrust gain, and thrust_gain 23 not in this file.",)
    # roll and yaw: two stages of 40 and 10 ms, then the rates; yaw reacts to what its rotors accelerate
    expected = np.zeros((6, 6))
    expected[0, 0] = expected[1, 1] = -25.0
    expected[2:4, :4] = [[100.0, 0.0, -100.0, 0.0], [0.0, 100.0, 0.0, -100.0]]
    expected[4:, 2:] = [[150.0, 0.0, -2.0, 0.0], [0.0, 20.0 - 150.0, 0.0, -0.5]]
    expected[5, 1] = 150.0
    np.testing.assert_allclose(json.loads(made.text)["A"], expected, atol=1e-9)
    for name in ("roll_damping", "yaw_damping"):
        reported["parameters"][name]["verdict"] = "refused"
    fit = ev.load_fit(documents.written(reported, tmp_path))
    with pytest.raises(NotIdentifiedError, match="Expected roll_damping, yaw_damping identified"):
        fit.export("statespace")
    priors = {"roll_damping": (2.0, 0.1), "yaw_damping": (0.5, 0.1)}
    np.testing.assert_allclose(json.loads(fit.export("statespace", priors=priors))["A"], expected, atol=1e-9)


def test_a_line_of_betaflight_is_all_that_is_set(tmp_path):
    reported = document()
    reported["parameters"]["thrust_curve"] = documents.quantity(0.3, 0.02)
    reported["model"] |= {"input_map": "mixed:0.3", "autopilot_curve": {"side": "behind"}}
    reported["logs"] = [{"name": WORSE, "format": "blackbox"}]
    reported["provenance"]["logs"][0]["name"] = WORSE
    *comments, line, end = (
        ev.load_fit(documents.written(reported, tmp_path)).export("betaflight").splitlines()
    )
    low, value, high = (thrust_linear(Mixed(share)) for share in (0.26, 0.3, 0.34))
    assert (line, end) == (f"set thrust_linear = {value}", "save")
    assert f"thrust_linear: {value}, 95 % interval [{low}, {high}]" in comments[-1]
    assert all(comment.startswith("#") for comment in comments)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.7])
def test_the_percentage_of_betaflight_makes_thrust_straight(share):
    output = np.linspace(0.05, 1.0, 500)

    def unlike(percent):
        motor = output * (1.0 + 0.01 * percent * (1.0 - output) ** 2)
        return np.sum(((1.0 - share) * motor + share * motor**2 - output) ** 2)

    chosen = thrust_linear(Mixed(share))
    assert chosen == pytest.approx(
        minimize_scalar(unlike, bounds=(-10.0, 150.0), method="bounded").x, abs=1.5
    )
