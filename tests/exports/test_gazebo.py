"""SDF for Gazebo by a strict reader: elements in their places, bodies that there can be, and their sum."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import eivor as ev
from exports.documents import of_speeds, written
from exports.simulated import (
    GAIN,
    GRAVITY,
    HOVER,
    LAG,
    PRIORS,
    exported,
    lopsided_file,
    vehicle_file,
)
from exports.xml_tree import Element, xml_tree

#: What each element holds, by the specification of SDFormat 1.9; plugins are their own.
CHILDREN = {
    "sdf": {"model"},
    "model": {"link", "joint", "plugin"},
    "link": {"pose", "inertial"},
    "inertial": {"pose", "mass", "inertia"},
    "inertia": {"ixx", "ixy", "ixz", "iyy", "iyz", "izz"},
    "joint": {"parent", "child", "axis"},
    "axis": {"xyz", "limit"},
    "limit": {"lower", "upper"},
}
#: What gz-sim's motor model reads.
MOTOR = {
    *("robotNamespace", "jointName", "linkName", "turningDirection", "motorType", "actuator_number"),
    *("timeConstantUp", "timeConstantDown", "maxRotVelocity", "motorConstant", "momentConstant"),
    *("rotorDragCoefficient", "rollingMomentCoefficient", "rotorVelocitySlowdownSim"),
    *("commandSubTopic", "motorSpeedPubTopic"),
}


def check(element: Element) -> None:
    """Elements in their places, and names that are there once."""
    if element.name == "plugin":
        assert {child.name for child in element.children} == MOTOR
        return
    allowed = CHILDREN.get(element.name, set())
    names = [child.name for child in element.children]
    assert set(names) <= allowed, element.name
    if element.name != "model":
        assert len(set(names)) == len(names)
    for child in element.children:
        check(child)


def body(link: Element) -> tuple[float, np.ndarray, np.ndarray]:
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


@pytest.mark.parametrize("vehicle", [vehicle_file, lopsided_file])
def test_links_together_are_the_vehicle(vehicle: Callable[[Path], Path], tmp_path: Path) -> None:
    fit = ev.load_fit(written(of_speeds(), tmp_path))
    root = xml_tree(fit.export("gazebo", vehicle=vehicle(tmp_path), priors=PRIORS))
    check(root)
    assert (root.name, root.attributes["version"]) == ("sdf", "1.9")
    model = root.one("model")
    bodies = [body(link) for link in model.all("link")]
    mass = sum(item[0] for item in bodies)
    centre = sum(item[0] * item[1] for item in bodies) / mass
    inertia = sum(
        matrix + each * (item @ item * np.eye(3) - np.outer(item, item)) for each, item, matrix in bodies
    )
    assert mass == pytest.approx(0.03, rel=1e-12)
    np.testing.assert_allclose(centre, 0.0, atol=1e-15)
    np.testing.assert_allclose(inertia, np.diag([1.43e-5, 1.45e-5, 2.7e-5]), atol=1e-17)


def test_motors_are_those_of_the_flight(tmp_path: Path) -> None:
    text = exported("gazebo", tmp_path)
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
        assert motor.numbers("timeConstantUp") == motor.numbers("timeConstantDown") == [LAG]
        assert motor.numbers("momentConstant") == [0.034]
    lift = 4 * motors[0].numbers("motorConstant")[0] * HOVER**2
    assert lift == pytest.approx(0.03 * 9.8)
    assert motors[0].numbers("motorConstant")[0] == pytest.approx(0.03 * GAIN / 4 * 9.8 / GRAVITY)
    assert "drag along z is not in this file" in text
