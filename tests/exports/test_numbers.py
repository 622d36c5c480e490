"""Every number of every target, recomputed by hand, in the grammar of those who read it."""

from __future__ import annotations

import json
import re
import runpy

import numpy as np
import pytest

import eivor as ev
from eivor.exports.fitted import Supplied
from eivor.motions.rigid_body.vehicle import KnownNumber
from exports import documents
from exports.documents import GRAVITY, OFFSET
from exports.test_autopilots import qgc
from exports.test_simulators import MOTOR, sitl_frame, xml_tree

#: Mass, thrust constant, torque ratio, moments of inertia, lag and fastest rotor of the vehicle.
MASS, THRUST, RATIO, INERTIA, LAG, FASTEST = 0.03, 2.3e-8, 0.034, (1.43e-5, 1.45e-5, 2.7e-5), 0.068, 2500.0
CENTRE, HEIGHT = (6.4e-6 * 1.45e-5 / THRUST, -3.2e-6 * 1.43e-5 / THRUST), 0.002
DRAG, QUADRATIC = MASS * np.array([0.25, 0.27, 0.18]), MASS * np.array([0.065, 0.069, 0.13])
TURNING = np.array([0.35, 0.35, 0.5]) * INERTIA
ROTOR_INERTIA = 1e-3 * INERTIA[2]
HOVER = (MASS * GRAVITY / 4 / THRUST) ** 0.5
ACROSS, ALONG = 0.5 * (DRAG[0] + DRAG[1]) / 4 / HOVER, DRAG[2] / 4 / HOVER
SPINS = np.array([-1, 1, -1, 1])
AT = np.array([[OFFSET, -OFFSET], [-OFFSET, -OFFSET], [-OFFSET, OFFSET], [OFFSET, OFFSET]])
PLACES = np.column_stack([AT - CENTRE, np.full(4, HEIGHT)])
#: Thrusts that hold the vehicle still, and where the rotors' drag then acts, from their middle.
TRIM = np.linalg.solve([np.ones(4), PLACES[:, 1], PLACES[:, 0], SPINS], [MASS * GRAVITY, 0, 0, 0])
DRAGGED = np.sqrt(TRIM) @ AT / np.sqrt(TRIM).sum()
PER_MINUTE = 2.0 * np.pi / 60.0


GIVEN = {"priors": {"largest_command": (FASTEST, 0.0)}}


@pytest.fixture(name="file")
def of_lopsided(tmp_path):
    """The text for a target."""
    fit = ev.load_fit(documents.written(documents.of_lopsided(translational_lift=(0.003, 1e-4)), tmp_path))
    return lambda to, **others: fit.export(to, **GIVEN, **others)


def numbers(read):
    """Every number of what was read, under its path."""
    if isinstance(read, dict):
        return {f"{name}.{path}": x for name, item in read.items() for path, x in numbers(item).items()}
    values = np.asarray(read)
    return {"": values.astype(float)} if values.dtype.kind in "iufb" else {}


def of_xml(element):
    """Numbers in attributes and text of an element's children, by name; those of a name in their order."""
    rows: dict[str, list[list[float]]] = {}
    for child in element.children:
        for name, text in {**child.attributes, "": child.text}.items():
            if re.fullmatch(r"[-+\d.e ]*\d[-+\d.e ]*", text):
                row = [float(word) for word in text.split()]
                rows.setdefault(f"{child.name}.{name}".rstrip("."), []).append(row)
        for name, inner in of_xml(child).items():
            rows.setdefault(f"{child.name}.{name}", []).extend(inner)
    return rows


def agree(got, expected):
    """The same numbers under the same names."""
    got, expected = numbers(got), numbers(expected)
    assert got.keys() == expected.keys()
    for name, value in expected.items():
        np.testing.assert_allclose(got[name], value, rtol=2e-3, atol=1e-12, err_msg=name)


def test_rotorpy(file, tmp_path):
    (tmp_path / "v.py").write_text(file("rotorpy"), encoding="utf-8")
    thrust = THRUST * 9.81 / GRAVITY
    zeros = dict.fromkeys(("Ixy", "Ixz", "Iyz", "k_flap", "rotor_speed_min", "motor_noise_std"), 0.0)
    expected = {
        **dict(zip(("Ixx", "Iyy", "Izz"), INERTIA, strict=True)),
        **dict(zip(("c_Dx", "c_Dy", "c_Dz"), QUADRATIC, strict=True)),
        "mass": MASS, "k_eta": thrust, "k_m": RATIO * thrust, "k_d": ACROSS, "k_z": ALONG,
        "tau_m": LAG, "k_h": MASS * 0.003 / 4, "rotor_speed_max": FASTEST, "num_rotors": 4,
        "rotor_directions": SPINS, "rI": np.zeros(3),
        "rotor_pos": {f"r{number}": place for number, place in enumerate(PLACES, 1)},
    }  # fmt: skip
    agree(runpy.run_path(str(tmp_path / "v.py"))["quad_params"], zeros | expected)


def test_drone_models(file):
    arm, rate = 0.043, 1.0 / LAG
    expected = {
        "gravity_vec": [0.0, 0.0, -GRAVITY], "mass": MASS, "L": arm, "J": np.diag(INERTIA),
        "rpm2thrust": [0.0, 0.0, THRUST * PER_MINUTE**2],
        "rpm2torque": [0.0, 0.0, RATIO * THRUST * PER_MINUTE**2], "drag_matrix": -np.diag(DRAG),
        "rotor_dyn_coef": [rate, 0.0, rate, 0.0], "prop_inertia": ROTOR_INERTIA,
        "mixing_matrix": [PLACES[:, 1] / arm, -PLACES[:, 0] / arm, SPINS],
    }  # fmt: skip
    agree(documents.table(file("drone-models")), expected)


def test_mujoco(file):
    found = of_xml(xml_tree(file("mujoco")))
    (coefficient, *nothing), size = (
        found.pop("worldbody.body.geom.fluidcoef")[0],
        np.array(found.pop("worldbody.body.geom.size")[0]),
    )
    assert nothing == [0.0] * 4
    areas = np.pi * size.prod() / size
    np.testing.assert_allclose(1e-6 * coefficient * areas, QUADRATIC, rtol=2e-3)
    turning = TURNING - [DRAG[1] * HEIGHT**2, DRAG[0] * HEIGHT**2, 0.0]
    axes = np.eye(6)
    expected = {
        "option.timestep": [[0.002]], "option.gravity": [[0, 0, -GRAVITY]], "option.density": [[1e-6]],
        "worldbody.body.pos": [[0, 0, 1]],
        "worldbody.body.joint.axis": np.eye(3),
        "worldbody.body.inertial.pos": [[*CENTRE, 0.0]],
        "worldbody.body.inertial.mass": [[MASS]],
        "worldbody.body.inertial.diaginertia": [INERTIA],
        "worldbody.body.geom.pos": [[*CENTRE, 0.0]],
        **{f"worldbody.body.geom.{name}": [[0]] for name in ("contype", "conaffinity")},
        "worldbody.body.site.pos": [[*DRAGGED, HEIGHT], *np.pad(AT, ((0, 0), (0, 1)))],
        "actuator.general.dynprm": [[LAG]] * 4,
        "actuator.general.gainprm": [[MASS * GRAVITY / 4]] * 4 + [[0]] * 6,
        "actuator.general.gear": [[0, 0, 1, 0, 0, spin * RATIO] for spin in SPINS] + axes.tolist(),
        "actuator.general.ctrlrange": [[0, (FASTEST / HOVER) ** 2]] * 4,
        "actuator.general.biasprm": [[0, 0, -drag] for drag in (*DRAG, *turning)],
        "keyframe.key.qpos": [[0, 0, 0, 1, 0, 0, 0]], "keyframe.key.act": [[1] * 4],
        "keyframe.key.ctrl": [[1] * 4 + [0] * 6],
    }  # fmt: skip
    agree(found, expected)


def test_pybullet(file, tmp_path):
    """Of the whole vehicle at hover speeds: its drag, its torques, and its rotors' reactions."""
    (tmp_path / "v.py").write_text(file("pybullet"), encoding="utf-8")
    forces, still, speeds = runpy.run_path(str(tmp_path / "v.py"))["forces"], np.zeros(3), np.full(4, HOVER)

    def change(air=still, rates=still, spin_up=0.0):
        at_rest = forces(still, still, speeds, np.zeros(4))
        return np.array(forces(np.array(air), np.array(rates), speeds, spin_up)) - at_rest

    lift = MASS * 9.8 * np.array([PLACES[:, 1].mean(), -PLACES[:, 0].mean()])
    np.testing.assert_allclose(forces(still, still, speeds, 0.0), [[0, 0, MASS * 9.8], [*lift, 0]], rtol=2e-3)
    for axis, speed in enumerate(2.0 * np.eye(3)):
        drag = -2.0 * (DRAG[axis] + 2.0 * QUADRATIC[axis])
        lifted = 0.003 * MASS * 4.0 if axis < 2 else 0.0
        np.testing.assert_allclose(change(air=speed)[0], drag * np.eye(3)[axis] + [0, 0, lifted], rtol=2e-3)
        assert change(rates=speed)[1, axis] == pytest.approx(-2.0 * TURNING[axis], rel=2e-3)
    assert change(spin_up=np.eye(4)[0])[1, 2] == pytest.approx(SPINS[0] * ROTOR_INERTIA, rel=2e-3)
    momentum = forces(still, np.array([0.0, 1.0, 0.0]), np.eye(4)[0], np.zeros(4))[1][0]
    assert momentum == pytest.approx(SPINS[0] * ROTOR_INERTIA, rel=0.06)  # with a little drag


def test_urdf(file):
    root = xml_tree(file("urdf"))
    thrust = THRUST * 9.8 / GRAVITY
    values = {
        "arm": 0.043, "kf": thrust * PER_MINUTE**2, "km": RATIO * thrust * PER_MINUTE**2,
        "thrust2weight": 4 * thrust * FASTEST**2 / MASS / 9.8, "max_speed_kmh": 30, "gnd_eff_coeff": 0,
        "prop_radius": 0.0215, "drag_coeff_xy": ACROSS, "drag_coeff_z": ALONG,
        "dw_coeff_1": 0, "dw_coeff_2": 0, "dw_coeff_3": 1,
    }  # fmt: skip
    links = [*np.pad(AT, ((0, 0), (0, 1))), [*DRAGGED, HEIGHT]]
    (name, zero), base = ("link.inertial.inertia.i", [0.0]), [[*CENTRE, 0.0]]
    shape = {f"link.{part}.geometry.cylinder.radius": [[0.043]] for part in ("visual", "collision")}
    expected = {
        **{f"properties.{key}": [[value]] for key, value in values.items()},
        "link.inertial.origin.rpy": [[0, 0, 0]] * 6,
        "link.inertial.origin.xyz": base + [list(place) for place in links],
        "link.inertial.mass.value": [[MASS], *[zero] * 5],
        **{f"{name}{axis}": [[x], *[zero] * 5] for axis, x in zip(("xx", "yy", "zz"), INERTIA, strict=True)},
        **{f"{name}{axes}": [zero] * 6 for axes in ("xy", "xz", "yz")},
        **{
            f"link.{part}.origin.{at}": [[0] * 3] for part in ("visual", "collision") for at in ("rpy", "xyz")
        },
        **shape,
        **{key.replace("radius", "length"): [[0.0215]] for key in shape},
    }  # fmt: skip
    agree(of_xml(root), expected)


#: Of a motor in Gazebo; what is zero there is not identified.
OF_MOTOR = {
    "timeConstantUp": LAG, "timeConstantDown": LAG, "maxRotVelocity": FASTEST,
    "motorConstant": THRUST * 9.8 / GRAVITY, "momentConstant": RATIO, "rotorDragCoefficient": ACROSS,
}  # fmt: skip


def test_motors_of_gazebo(file):
    """A rotor turns a tenth as fast, with ten times its inertia, and stands above the centre of mass."""
    model = xml_tree(file("gazebo")).one("model")
    for number, motor in enumerate(model.all("plugin")):
        beside = {"rollingMomentCoefficient": 0, "rotorVelocitySlowdownSim": 10, "actuator_number": number}
        expected = {name: [[value]] for name, value in {**OF_MOTOR, **beside}.items()}
        agree(of_xml(motor), expected)
    rotors = model.all("link")[1:]
    np.testing.assert_allclose([link.numbers("pose") for link in rotors], np.pad(AT, ((0, 0), (0, 4))))
    axial = [link.numbers("inertial/inertia/izz")[0] for link in rotors]
    np.testing.assert_allclose(axial, 10 * ROTOR_INERTIA, rtol=2e-3)


def test_elements_of_px4(file):
    root = xml_tree(file("px4-gazebo"))
    assert "SIM_GZ_EC_MAX1, ... of 2500 rad/s" in file("px4-gazebo")
    assert {child.name for child in root.one("motor").children} <= MOTOR
    inertial = {"mass": MASS, **dict(zip(("ixx", "iyy", "izz"), INERTIA, strict=True))}
    rows = {f"motor.{name}": [[x]] for name, x in OF_MOTOR.items()}
    agree(of_xml(root), rows | {f"inertial.{name}": [[x]] for name, x in inertial.items()})


def test_sih(file):
    """Names and units of PX4's sih_params.yaml; all but products of inertia are from zero on."""
    largest = THRUST * FASTEST**2
    expected = {
        "SIH_MASS": MASS, "SIH_T_MAX": largest, "SIH_Q_MAX": RATIO * largest, "SIH_T_TAU": LAG,
        **{f"SIH_I{axes}": x for axes, x in zip(("XX", "YY", "ZZ"), INERTIA, strict=True)},
        **dict.fromkeys(("SIH_IXY", "SIH_IXZ", "SIH_IYZ", "THR_MDL_FAC"), 0.0),
        "SIH_L_ROLL": OFFSET, "SIH_L_PITCH": OFFSET, "SIH_KDV": DRAG[2], "SIH_KDW": TURNING[0],
        "MPC_THR_HOVER": MASS * GRAVITY / 4 / largest,
    }  # fmt: skip
    agree(qgc(file("sih")), expected)
    assert min(expected.values()) >= 0.0


def test_sitl(file, tmp_path):
    """Forces and torques of ArduPilot's SIM_Frame and SIM_Motor: forward, right and down."""
    frame, full = sitl_frame(file("sitl")), 4 * THRUST * FASTEST**2
    reversed_ = documents.of_lopsided(documents.KNOWN_VEHICLE | {"spins": (-SPINS).tolist()})
    other = ev.load_fit(documents.written(reversed_, tmp_path))
    outputs = {"MOT_SPIN_MIN": 0, "MOT_SPIN_MAX": 1, "MOT_PWM_MIN": 1000, "MOT_PWM_MAX": 2000}
    curve = {"MOT_THST_EXPO": 1, "MOT_THST_HOVER": HOVER**2 / FASTEST**2, "FRAME_CLASS": 1}
    of_drag = {"SIM_FRM_MDRAG": DRAG[0] / np.sqrt(1.225 * 4 * np.pi * 0.0215**2 * MASS * GRAVITY)}
    simulated = {"SIM_VIB_MOT_MAX": FASTEST / 2 / np.pi, "SIM_FRM_MASS": MASS} | of_drag
    for text, frame_type in ((file("sitl-parameters"), 1), (other.export("sitl-parameters", **GIVEN), 18)):
        found = dict(line.split(",") for line in text.splitlines() if not line.startswith("#"))
        expected = outputs | curve | simulated | {"FRAME_TYPE": frame_type}
        agree({name: float(value) for name, value in found.items()}, expected)
    # motors of FRAME_TYPE 18 are in the order rear right, front right, rear left, front left
    first = sitl_frame(other.export("sitl", **GIVEN))["motor1_position"]
    np.testing.assert_allclose(first[:2], [PLACES[1, 0], -PLACES[1, 1]], rtol=2e-3)
    diagonal = 0.086
    disc = 4 * np.pi * 0.0215**2
    # motors 1 to 4: front right, rear left, front left, rear right
    for number, rotor in enumerate((0, 2, 3, 1), 1):
        x, y, z = PLACES[rotor]
        np.testing.assert_allclose(frame.pop(f"motor{number}_position"), [x, -y, -z], rtol=2e-3)
        yaw = frame.pop(f"motor{number}_yaw") * 0.05 * diagonal * (TRIM[rotor] / THRUST) ** 0.5 / FASTEST
        # with the cube of the signal in place of its square
        assert 3 * yaw == pytest.approx(-SPINS[rotor] * 2 * RATIO, rel=2e-3)
    speed, tilt = frame.pop("refSpd"), np.radians(20.0)
    factor = frame["mdrag_coef"] * np.sqrt(1.225 * disc)
    dragged = np.cos(tilt) ** 2 * factor * speed * np.sqrt(MASS * GRAVITY / np.cos(tilt))
    area = (MASS * GRAVITY * np.tan(tilt) - dragged) / speed**2
    assert area == pytest.approx(QUADRATIC[0], rel=2e-3)
    assert factor * np.sqrt(MASS * GRAVITY) == pytest.approx(DRAG[0], rel=2e-3)
    damping = 0.35 - DRAG[0] / 4 * np.square(PLACES[:, 1:]).sum() / INERTIA[0]
    typical = {"refVoltage": 12.1, "refCurrent": 20, "maxVoltage": 12.6, "refTempC": 15, "refBatRes": 0.01}
    expected = {
        "mass": MASS, "diagonal_size": diagonal, "moment_inertia": INERTIA, "refAngle": 20, "refAlt": 0,
        "propExpo": 1, "refRotRate": np.radians(400) / damping if damping > 0.0 else 0.0,
        "slew_max": 0, "num_motors": 4,
        "hoverThrOut": MASS * GRAVITY / full, "pwmMin": 1000, "pwmMax": 2000, "spin_min": 0, "spin_max": 1,
        "disc_area": disc, "mdrag_coef": DRAG[0] / np.sqrt(1.225 * disc * MASS * GRAVITY),
    }  # fmt: skip
    agree(frame, typical | {"battCapacityAh": 0} | expected)


#: What Isaac Lab's ThrusterCfg requires beside dt and thruster_names_expr, and what it may have.
THRUSTER = {"thrust_range", "thrust_const_range", "tau_inc_range", "tau_dec_range", "torque_to_thrust_ratio"}


def test_isaac_lab(file, tmp_path):
    (tmp_path / "v.py").write_text(file("isaaclab", draws=400), encoding="utf-8")
    made = runpy.run_path(str(tmp_path / "v.py"))
    events, thruster = made["events"], made["thruster"]
    assert thruster.keys() - {"use_discrete_approximation"} == THRUSTER
    assert events["randomize_rigid_body_mass"].keys() == {
        "mass_distribution_params",
        "operation",
        "distribution",
    }
    assert events["randomize_rigid_body_com"]["com_range"].keys() == {"x", "y", "z"}
    constant = THRUST * (2 * np.pi) ** 2 * 9.81 / GRAVITY
    expected = {
        "mass": MASS, "inertia_xx": INERTIA[0], "inertia_yy": INERTIA[1], "inertia_zz": INERTIA[2],
        "thrust_const": constant, "thrust_max": constant * (FASTEST / 2 / np.pi) ** 2,
        "time_constant": LAG, "torque_to_thrust_ratio": RATIO, "linear_damping": DRAG[2] / MASS,
        "com_x": CENTRE[0], "com_y": CENTRE[1],
    }  # fmt: skip
    assert made["draws"].keys() == expected.keys()
    for name, value in expected.items():
        column = np.array(made["draws"][name])
        assert np.median(column) == pytest.approx(value, abs=0.2 * column.std() + 1e-9 * abs(value)), name
    assert "Isaac Lab begins with a thrust_const of at least 1e-6" in file("isaaclab", draws=400)


def test_a_torque_that_was_measured_as_none_is_none(tmp_path):
    """Rotors whose drag does not turn; where a target has it turn, the bound that this breaks is said."""
    none = {f"{axis}_damping": (0.0, 0.01) for axis in ("roll", "pitch", "yaw")}
    fit = ev.load_fit(documents.written(documents.of_lopsided(**none), tmp_path))
    given = Supplied(priors={"largest_command": KnownNumber(FASTEST)})
    made = {
        to: fit.exported(to, given, None, 0) for to in ("mujoco", "statespace", "rotorpy", "gazebo", "urdf")
    }
    drags = of_xml(xml_tree(made["mujoco"].text))["actuator.general.biasprm"][3:]
    np.testing.assert_allclose(np.array(drags)[:, 2], [DRAG[1] * HEIGHT**2, DRAG[0] * HEIGHT**2, 0.0])
    A = np.array(json.loads(made["statespace"].text)["A"])
    np.testing.assert_allclose(np.diag(A)[6:9], 0.0, atol=0.01)  # 0.35 and 0.5 1/s of the rotors' drag
    forced = 4 * ACROSS * HOVER * np.square(PLACES[:, :2]).sum() / 4
    for to in ("rotorpy", "gazebo"):
        (text,) = (line for line in made[to].lost if "against turning" in line)
        assert f"yaw_drag {forced:.3g}, above its bound 5.5" in text  # 2.04 times the error of 0.01 1/s
    assert not any("against turning" in line for to in ("mujoco", "urdf") for line in made[to].lost)
