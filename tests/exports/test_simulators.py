"""Files of simulators: the algebra, what each cannot do without, and that no name breaks out of a comment."""

from __future__ import annotations

import ast
import io
import json
import re
from dataclasses import dataclass, field
from xml.parsers import expat

import numpy as np
import pytest
from scipy.io import loadmat

import eivor as ev
from eivor.errors import NotIdentifiedError, UsageError
from exports import documents
from exports.test_autopilots import HOSTILE, qgc


@dataclass
class Element:
    """An element; comments and blanks between elements are left out."""

    name: str
    attributes: dict[str, str] = field(default_factory=dict)
    children: list[Element] = field(default_factory=list)
    text: str = ""

    def __getitem__(self, position):
        return self.children[position]

    def all(self, name):
        """Its children of a name."""
        return [child for child in self.children if child.name == name]

    def one(self, path):
        """The only child of each name on the path."""
        result = self
        for name in path.split("/"):
            (result,) = result.all(name)
        return result

    def numbers(self, path):
        """Numbers in the text of the only child on the path."""
        return [float(word) for word in self.one(path).text.split()]


def xml_tree(text):
    """Root of a document without declarations of its own."""
    top = Element("")
    within = [top]
    parser = expat.ParserCreate()

    def start(name, attributes):
        within[-1].children.append(Element(name, attributes))
        within.append(within[-1].children[-1])

    def letters(data):
        within[-1].text += data.strip()

    def declaration(*_):
        raise AssertionError("a document type, which no file of ours has")

    parser.StartElementHandler, parser.EndElementHandler = start, lambda _: within.pop()
    parser.CharacterDataHandler, parser.StartDoctypeDeclHandler = letters, declaration
    parser.buffer_text = True
    parser.Parse(text, True)
    (root,) = top.children
    return root


TARGETS = ("rotorpy", "mujoco", "pybullet", "urdf", "gazebo", "drone-models", "sih")

#: Files whose parsers are those of another target, or which hold less.
OTHERS = ("px4-gazebo", "sitl", "sitl-parameters")
XML = ("mujoco", "urdf", "gazebo", "px4-gazebo")
NO_DRAG = ("gazebo", "px4-gazebo", "sitl-parameters")  # along the rotors' axes

#: Ends comments and strings in every format, and begins what a reader may look for.
WORSE = (
    f"{HOSTILE} ---> --> </sdf> ]]> */ \"\"\" ''' \\ # [other]\nmass = 9 <!-- -\x00{{{{ 7 * 7 }}}}"
    ' {"mass": 9, "exec": "import os"} #{x} ${x} &lt;'
)


def sitl_frame(text):
    """As ArduPilot's AP_JSON reads it: the object from the first brace on, without what is behind a hash."""
    frame, _ = json.JSONDecoder().raw_decode(re.sub("#[^\n\r]*", "", text[text.index("{") :]))
    return frame


def test_rotorpy_by_hand(tmp_path):
    params = documents.quad_params(tmp_path)
    assert params["k_eta"] == pytest.approx(0.03 * documents.GAIN / 4 * 9.81 / documents.GRAVITY)
    assert params["k_z"] == pytest.approx(documents.FRICTION * 0.03 / (4 * documents.HOVER))
    assert params["k_m"] == pytest.approx(0.034 * params["k_eta"])
    assert (params["tau_m"], params["mass"], params["Izz"], params["k_d"]) == (0.072, 0.03, 2.7e-5, 0.0)
    np.testing.assert_array_equal(params["rotor_directions"], [-1, 1, -1, 1])
    np.testing.assert_allclose(params["rotor_pos"]["r1"], [0.043 / 2**0.5, -0.043 / 2**0.5, 0.0])


def test_a_rigid_body_tells_inertia_and_torque(tmp_path):
    """Of a flight that turns about all axes only the largest command is asked for."""
    rigid_body = documents.of_rigid_body(documents.KNOWN_VEHICLE | {"name": WORSE})
    fit = ev.load_fit(documents.written(rigid_body, tmp_path))
    result = documents.table(fit.export("drone-models"))
    np.testing.assert_allclose(np.diag(result["J"]) * 1e5, [1.43, 1.45, 2.7], rtol=1e-3)
    assert result["rpm2torque"][2] / result["rpm2thrust"][2] == pytest.approx(0.034, rel=1e-3)
    assert result["rpm2thrust"][2] == pytest.approx(2.3e-8 * (2.0 * np.pi / 60.0) ** 2)
    np.testing.assert_allclose(np.diag(result["drag_matrix"]), [-0.0075, -0.0081, -0.0054])
    documents.refused(rigid_body, "roll_coupling")
    documents.refused(rigid_body, "pitch_coupling")
    fit = ev.load_fit(documents.written(rigid_body, tmp_path))
    with pytest.raises(NotIdentifiedError, match=r"inertia in yaw .* torque over thrust"):
        fit.export("drone-models")
    given = fit.export("drone-models", priors={"inertia_zz": (2.6e-5, 1e-6), "torque_ratio": (0.03, 0.0)})
    assert np.diag(documents.table(given)["J"])[2] == 2.6e-5


def test_shares_of_the_largest_command_need_no_largest_command(tmp_path):
    """Of a thrust setpoint SIH's largest thrust is mass times gain over the rotors."""
    result = qgc(documents.exported("sih", tmp_path, documents.document(), "px4", largest_command=None))
    assert result["SIH_T_MAX"] == pytest.approx(1 / 4 * 0.03 * 23.9, rel=1e-6)
    assert result["MPC_THR_HOVER"] == pytest.approx(documents.GRAVITY / 23.9, rel=1e-6)
    assert result["THR_MDL_FAC"] == 0.0
    assert (result["SIH_T_TAU"], result["SIH_KDV"]) == pytest.approx((0.05, 0.009))
    assert result["SIH_L_ROLL"] == pytest.approx(0.043 / 2**0.5, rel=1e-6)
    root = xml_tree(documents.exported("urdf", tmp_path, documents.document(), "px4", largest_command=None))
    assert float(root[0].attributes["thrust2weight"]) == pytest.approx(23.9 / documents.GRAVITY)


def test_gym_pybullet_drones_finds_its_numbers(tmp_path):
    """It reads mass, inertia and collision body by their places in the tree."""
    root = xml_tree(documents.exported("urdf", tmp_path, numbering="betaflight"))
    turn = 2.0 * np.pi / 60.0
    properties = {name: float(text) for name, text in root[0].attributes.items()}
    assert 4 * properties["kf"] * (documents.HOVER / turn) ** 2 == pytest.approx(0.03 * 9.8)
    assert properties["drag_coeff_z"] * 4 * documents.HOVER == pytest.approx(documents.FRICTION * 0.03)
    assert float(root[1][0][1].attributes["value"]) == 0.03
    assert float(root[1][0][2].attributes["izz"]) == 2.7e-5
    assert float(root[1][2][1][0].attributes["radius"]) == 0.043
    assert root[1][2][0].attributes["xyz"] == "0 0 0"
    # Betaflight's rotors turn the other way in each quarter.
    other = xml_tree(documents.exported("urdf", tmp_path))
    assert properties["km"] == pytest.approx(float(other[0].attributes["km"]))
    lag = "gym-pybullet-drones has no lag of the rotors, and actuator_lag 0.072 not in this file: a manoeuvre"
    assert lag in documents.exported("urdf", tmp_path)


@pytest.mark.parametrize("target", TARGETS)
def test_intervals_log_and_hash_stand_beside_the_numbers(target, tmp_path):
    text = documents.exported(target, tmp_path)
    assert text.isascii()
    assert "lag of the rotors [s]: 0.072, 95 % interval [0.07, 0.074], identified" in text
    assert "flight.ulg, SHA-256 abab" in text
    assert "mass [kg]: 0.03, 95 % interval [0.029412, 0.030588], given" in text
    assert "back by 0.015 s" in documents.exported(target, tmp_path, documents.of_speeds(delay=(0.015, 0.0)))


@pytest.mark.parametrize("target", [*TARGETS, *OTHERS])
def test_no_name_and_no_reason_breaks_out_of_a_comment(target, tmp_path):
    plain, speeds = documents.exported(target, tmp_path), documents.of_speeds()
    for item in speeds["logs"], speeds["provenance"]["logs"]:
        item[0]["name"] = WORSE
    speeds["provenance"]["version"] = WORSE
    hostile = documents.exported(target, tmp_path, documents.refused(speeds, "viscous_friction", WORSE))
    without = documents.exported(
        target, tmp_path, documents.refused(documents.of_speeds(), "viscous_friction")
    )
    assert hostile.isascii()
    assert content(target, hostile) == content(target, without)
    assert len(hostile.splitlines()) == len(without.splitlines())
    assert content(target, plain) != content(target, without) or target in NO_DRAG
    assert "drag_z is not written: viscous_friction is refused. a" in hostile


def test_fields_of_matlab_have_names_that_it_takes(tmp_path):
    reported = documents.refused(documents.document(), "viscous_friction")
    names = ("_hidden", "g\u00fc", WORSE, "t" * 70)
    for name in names:
        reported["parameters"][name] = documents.quantity(1.5, 0.1, unit=f"{WORSE}m/s\u00b2")
    reported["provenance"] |= {"version": WORSE, "logs": [{"name": WORSE, "sha256": "ab" * 32}]}
    content = ev.load_fit(documents.written(reported, tmp_path)).export("matlab")
    read = loadmat(io.BytesIO(content), simplify_cells=True)["fit"]["quantities"]
    assert len(read) == len(reported["parameters"]) + 1
    assert all(re.fullmatch("[A-Za-z][A-Za-z0-9_]{0,62}", name) for name in read)
    assert [row["value"] for row in read.values()].count(1.5) == len(names)
    unknown, numbers = read["viscous_friction"], read["input_gain"]
    assert unknown["verdict"] == "refused"
    assert np.isnan([unknown["value"], *unknown["interval"]]).all()
    assert [numbers["value"], numbers["std_error"], *numbers["interval"]] == pytest.approx(
        [23.9, 0.1, 23.7, 24.1]
    )


def test_a_state_space_about_hover_by_hand(tmp_path):
    space = ev.load_fit(documents.written(documents.document(delay=(0.015, 0.001)), tmp_path)).to_statespace()
    np.testing.assert_allclose(space.A, [[-1.0 / 0.05, 0.0], [23.9, -0.3]])
    np.testing.assert_allclose(space.B, [[1.0 / 0.05], [0.0]])
    np.testing.assert_array_equal(space.C, [[0.0, 1.0]])
    assert space.delay_s == 0.015


@pytest.mark.parametrize("target", ["casadi", "statespace"])
def test_no_name_breaks_out_of_a_model(target, tmp_path):
    texts = []
    for name in ("A small quadrotor", WORSE):
        reported = documents.of_rigid_body(documents.KNOWN_VEHICLE | {"name": name})
        reported["provenance"] |= {"version": name, "logs": [{"name": name, "sha256": "ab" * 32}]}
        texts.append(ev.load_fit(documents.written(reported, tmp_path)).export(target))
    plain, hostile = texts
    assert hostile.isascii()
    if target == "casadi":
        assert ast.dump(ast.parse(hostile)) == ast.dump(ast.parse(plain))
    else:
        assert json.loads(hostile)["A"] == json.loads(plain)["A"]


def content(target, text):
    """What a reader sees that skips comments."""
    if target in XML:
        return xml_tree(text)
    if target == "sih":
        return qgc(text)
    if target == "sitl":
        return sitl_frame(text)
    if target == "sitl-parameters":
        return [line for line in text.splitlines() if not line.startswith("#")]
    return ast.dump(ast.parse(text))


@pytest.mark.parametrize("target", TARGETS)
def test_a_refused_lag_must_be_given(target, tmp_path):
    reported = documents.refused(documents.of_speeds(), "actuator_lag", "Nothing moves.")
    if target == "urdf":  # has none
        assert "actuator_lag is not written" in documents.exported(target, tmp_path, reported)
        return
    with pytest.raises(NotIdentifiedError, match=r"refused. Nothing moves. .*--prior actuator_lag=VALUE:STD"):
        documents.exported(target, tmp_path, reported)
    text = documents.exported(target, tmp_path, reported, actuator_lag=(0.06, 0.01))
    assert "lag of the rotors [s]: 0.06, 95 % interval [0.0404004, 0.0795996], given" in text


def test_no_friction_is_written_as_none(tmp_path):
    reported = documents.refused(documents.of_speeds(), "viscous_friction")
    assert 'gear="0 0 1 0 0 0" gainprm="0" biastype="affine" biasprm="0 0 0.0"' in documents.exported(
        "mujoco", tmp_path, reported, viscous_friction=(0.0, 0.1)
    )


def test_moments_of_inertia_are_those_of_a_body(tmp_path):
    """RotorPy's own Crazyflie is beyond by 1 %, which simulators that check refuse."""
    near = documents.exported("mujoco", tmp_path, inertia_zz=(2.9e-5, 0.0))
    assert "are those of no body: the largest is put at the sum of the others" in near
    assert 'diaginertia="1.43e-05 1.45e-05 2.8799971' in near


def test_rotors_elsewhere_are_written_where_a_simulator_knows_any_order(tmp_path):
    fit = ev.load_fit(documents.written(documents.of_speeds(), tmp_path))
    plus = tmp_path / "plus.toml"
    plus.write_text(documents.PLUS, encoding="utf-8")
    assert "rotor4" in fit.export("mujoco", vehicle=plus, priors=documents.PRIORS)


def test_a_result_without_an_estimate_ends_in_a_sentence(tmp_path):
    file = tmp_path / "fit.json"
    file.write_text(ev.identify_flight(ev.example_flight(), window=(0.0, 2.0)).to_json())
    fit = ev.load_fit(file)
    assert fit.document.covariance is None
    assert "is not written" in fit.export("px4")
    for target in TARGETS:
        with pytest.raises((NotIdentifiedError, UsageError)):
            fit.export(target)


#: What each element holds, by the specification of SDFormat 1.9; plugins are their own.
CHILDREN = {
    "sdf": {"model"},
    "model": {"link", "joint", "plugin"},
    "link": {"pose", "inertial", "visual", "collision", "sensor"},
    "visual": {"geometry"},
    "collision": {"geometry"},
    "geometry": {"cylinder"},
    "cylinder": {"radius", "length"},
    "sensor": {"always_on", "update_rate"},
    "inertial": {"pose", "mass", "inertia"},
    "inertia": {"ixx", "ixy", "ixz", "iyy", "iyz", "izz"},
    "joint": {"parent", "child", "axis"},
    "axis": {"xyz", "limit"},
    "limit": {"lower", "upper"},
}

#: What MulticopterMotorModel of gz-sim reads.
MOTOR = {
    *("jointName", "linkName", "turningDirection", "motorType", "actuator_number"),
    *("timeConstantUp", "timeConstantDown", "maxRotVelocity", "motorConstant", "momentConstant"),
    *("rotorDragCoefficient", "rollingMomentCoefficient", "rotorVelocitySlowdownSim"),
    "commandSubTopic",
}


def check(element):
    """Elements in their places, and names that are there once."""
    if element.name == "plugin":
        assert {child.name for child in element.children} == MOTOR
        return
    allowed = CHILDREN.get(element.name, set())
    names = [child.name for child in element.children]
    assert set(names) <= allowed, element.name
    if element.name != "model":
        assert len(set(names) - {"sensor"}) == len(names) - names.count("sensor")
    for child in element.children:
        check(child)


def body(link):
    """Mass, centre and inertia about it of a link that a simulator takes."""
    (mass,) = link.numbers("inertial/mass")
    position, centre = (np.array(link.numbers(path)) for path in ("pose", "inertial/pose"))
    assert position.shape == centre.shape == (6,)
    assert not np.any(position[3:])
    inertia = link.one("inertial/inertia")
    xx, xy, xz, yy, yz, zz = (inertia.numbers(name)[0] for name in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
    matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    moments = np.linalg.eigvalsh(matrix)
    assert mass > 0.0
    assert moments[0] > 0.0
    assert moments[2] <= moments[:2].sum() * (1.0 + 1e-9)
    return mass, position[:3] + centre[:3], matrix


@pytest.mark.parametrize("vehicle", [documents.vehicle_file, documents.lopsided_file])
def test_links_together_are_the_vehicle(vehicle, tmp_path):
    fit = ev.load_fit(documents.written(documents.of_speeds(), tmp_path))
    root = xml_tree(fit.export("gazebo", vehicle=vehicle(tmp_path), priors=documents.PRIORS))
    check(root)
    assert (root.name, root.attributes["version"]) == ("sdf", "1.9")
    model = root.one("model")
    parts = {child.name for link in model.all("link") for child in link.children}
    assert {"visual", "collision", "sensor"} <= parts
    bodies = [body(link) for link in model.all("link")]
    mass = sum(item[0] for item in bodies)
    centre = sum(item[0] * item[1] for item in bodies) / mass
    inertia = sum(
        matrix + each * (item @ item * np.eye(3) - np.outer(item, item)) for each, item, matrix in bodies
    )
    assert mass == pytest.approx(0.03, rel=1e-12)
    np.testing.assert_allclose(centre, 0.0, atol=1e-15)
    np.testing.assert_allclose(inertia, np.diag([1.43e-5, 1.45e-5, 2.7e-5]), atol=1e-17)


def test_motors_are_those_of_the_flight(tmp_path):
    text = documents.exported("gazebo", tmp_path)
    model = xml_tree(text).one("model")
    links = {link.attributes["name"] for link in model.all("link")}
    joints = {joint.attributes["name"]: joint for joint in model.all("joint")}
    motors = model.all("plugin")
    assert len(motors) == 4
    for number, motor in enumerate(motors):
        assert motor.attributes["filename"] == "gz-sim-multicopter-motor-model-system"
        assert motor.attributes["name"] == "gz::sim::systems::MulticopterMotorModel"
        joint = joints[motor.one("jointName").text]
        assert joint.one("child").text == motor.one("linkName").text
        assert {joint.one("parent").text, joint.one("child").text} <= links
        assert motor.one("turningDirection").text == ("ccw", "cw")[number % 2]
        assert motor.numbers("actuator_number") == [number]
        assert motor.numbers("timeConstantUp") == motor.numbers("timeConstantDown") == [documents.LAG]
        assert motor.numbers("momentConstant") == [0.034]
    lift = 4 * motors[0].numbers("motorConstant")[0] * documents.HOVER**2
    assert lift == pytest.approx(0.03 * 9.8)
    assert motors[0].numbers("motorConstant")[0] == pytest.approx(
        0.03 * documents.GAIN / 4 * 9.8 / documents.GRAVITY
    )
    assert "Gazebo has no drag along the rotors' axes, and drag_z" in text


def test_a_curved_map_enters_by_its_slope_at_hover(tmp_path):
    reported = documents.document()
    reported["model"]["input_map"] = "square"
    reported["model"]["input_measured"] = True
    made = ev.load_fit(documents.written(reported, tmp_path)).to_statespace()
    assert made.B.item() == pytest.approx(23.9 * 2.0 * 0.41)
    assert (made.A.item(), made.states) == (-0.3, ("velocity_z",))


@pytest.mark.parametrize("name", [*documents.JOINT, "delay", "hover_input"])
def test_what_is_refused_must_be_given(name, tmp_path):
    fit = ev.load_fit(documents.written(documents.refused(documents.document(), name), tmp_path))
    with pytest.raises(NotIdentifiedError, match=f"{name} is refused. The flight does not identify it"):
        fit.to_statespace()
    reported = json.loads(fit.export("statespace", priors={name: (0.2, 0.01)}))
    assert (reported["numbers"][name]["value"], reported["numbers"][name]["source"]) == (0.2, "given")
    assert reported["schema"] == "eivor.statespace/1"
    assert np.shape(reported["A"]) == (2, 2)


@pytest.mark.thorough  # python-control takes seconds to import
def test_python_control_takes_it_and_climbs_as_the_flight_did(tmp_path):
    control = pytest.importorskip("control", reason="python-control is not installed")
    speeds = documents.of_speeds(delay=(0.02, 0.0))
    speeds["parameters"]["viscous_friction"] = documents.quantity(documents.FRICTION, 0.02)
    linear = ev.load_fit(documents.written(speeds, tmp_path)).to_statespace()
    made = linear.to_control()
    assert (made.input_labels, made.output_labels) == (["rotor_command"], ["velocity_z"])
    assert made.state_labels == ["actuator", "velocity_z"]
    hover = speeds["derived"]["hover_input"]["value"]
    assert float(np.real(control.dcgain(made))) == pytest.approx(
        2.0 * documents.GAIN * hover / documents.FRICTION
    )
    answer = control.step_response(made, T=np.linspace(0.0, 1.0, 101))
    assert 1e-4 * hover * answer.outputs[-1] == pytest.approx(documents.climb(1.0 + 1e-4, 1.0), rel=1e-3)
    late = made * control.tf(*control.pade(linear.delay_s, 4))
    behind = control.step_response(late, T=np.linspace(0.0, 1.0, 101)).outputs
    np.testing.assert_allclose(behind[20:], answer.outputs[18:-2], rtol=1e-3)
