"""Draws as simulators take them: joint ones, that hover where the vehicle hovered."""

from __future__ import annotations

import json
import runpy
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import eivor as ev
from eivor.errors import UsageError
from eivor.motions.rigid_body.vehicle import load_vehicle
from exports.documents import of_rigid_body, of_speeds, refused, written
from exports.simulated import GAIN, GRAVITY, HOVER, PRIORS, saved, vehicle_file
from exports.test_simulators import WORSE

COUNT = 2000
#: Relative standard deviations of what is drawn.
GAIN_SPREAD, MASS_SPREAD = 8e-9 / GAIN * (8.0 / 6.0) ** 0.5, 0.01


def drawn(to: str, folder: Path, record: dict[str, Any] | None = None) -> str:
    fit = ev.load_fit(written(record or of_speeds(), folder))
    return fit.export(to, vehicle=vehicle_file(folder), priors=PRIORS, draws=COUNT, seed=3)


def python_file(to: str, folder: Path, **others: Any) -> dict[str, Any]:
    path = folder / "draws.py"
    path.write_text(drawn(to, folder, **others), encoding="utf-8")
    return runpy.run_path(str(path))


def spread(column: Any) -> float:
    return float(np.std(column) / np.mean(column))


def test_vehicles_of_rotorpy_hover_alike_though_masses_differ(tmp_path: Path) -> None:
    vehicles = python_file("rotorpy", tmp_path)["vehicles"]
    assert len(vehicles) == COUNT
    mass, thrust = (np.array([vehicle[name] for vehicle in vehicles]) for name in ("mass", "k_eta"))
    hover = np.sqrt(mass * 9.81 / (4 * thrust))
    assert np.median(hover) == pytest.approx(HOVER, rel=1e-4)
    assert spread(hover) == pytest.approx(GAIN_SPREAD / 2.0, rel=0.1)
    assert spread(mass) == pytest.approx(MASS_SPREAD, rel=0.1)
    boxes = np.sqrt(np.random.default_rng(1).permutation(mass) / thrust)
    assert spread(boxes) > 4.0 * spread(hover)
    assert all(vehicle["Izz"] <= vehicle["Ixx"] + vehicle["Iyy"] for vehicle in vehicles)
    arms = [np.hypot(*vehicle["rotor_pos"]["r1"][:2]) for vehicle in vehicles]
    assert spread(arms) == pytest.approx(0.0004 / 0.043, rel=0.1)
    assert min(vehicle["tau_m"] for vehicle in vehicles) > 0.05


def test_rotorpy_flies_a_draw(tmp_path: Path) -> None:
    multirotor = pytest.importorskip("rotorpy.vehicles.multirotor", reason="RotorPy is not installed")
    vehicle = python_file("rotorpy", tmp_path)["vehicles"][7]
    hover = np.sqrt(vehicle["mass"] * 9.81 / (4 * vehicle["k_eta"]))
    rest = {name: np.zeros(3) for name in ("x", "v", "w", "wind")}
    state = rest | {"q": np.array([0.0, 0.0, 0.0, 1.0]), "rotor_speeds": np.full(4, hover)}
    made = multirotor.Multirotor(vehicle, state, "cmd_motor_speeds")
    after = made.step(state, {"cmd_motor_speeds": np.full(4, hover)}, 0.05)
    np.testing.assert_allclose(after["v"], 0.0, atol=1e-6)


@pytest.mark.thorough  # of the extra `simulators`
def test_fields_of_mujoco_fit_its_model(tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed")
    fields = {name: np.array(load) for name, load in json.loads(drawn("mujoco", tmp_path))["fields"].items()}
    model = mujoco.MjModel.from_xml_path(saved("mujoco", tmp_path))
    assert spread(fields["actuator_gainprm"] / fields["body_mass"]) == pytest.approx(GAIN_SPREAD, rel=0.1)
    row = int(np.argmax(fields["body_mass"]))
    model.body_mass[1], model.body_inertia[1] = fields["body_mass"][row], fields["body_inertia"][row]
    model.actuator_gainprm[:, 0] = fields["actuator_gainprm"][row]
    model.actuator_dynprm[:, 0] = fields["actuator_dynprm"][row]
    model.actuator_gear[:, 5] = [-fields["actuator_gear"][row], fields["actuator_gear"][row]] * 2
    model.dof_damping[:3] = fields["dof_damping"][row]
    model.site_pos *= fields["site_pos"][row]
    data = mujoco.MjData(model)
    mujoco.mj_setConst(model, data)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data)
    lift = 4 * fields["actuator_gainprm"][row] / fields["body_mass"][row]
    assert data.qvel[2] / model.opt.timestep == pytest.approx(lift - GRAVITY, abs=1e-3)


def test_ranges_of_isaac_lab_hold_95_percent_of_the_draws(tmp_path: Path) -> None:
    file = python_file("isaaclab", tmp_path)
    draws, thruster = file["draws"], file["thruster"]
    hover = np.sqrt(np.array(draws["mass"]) * 9.81 / (4 * np.array(draws["thrust_const"])))
    assert np.median(hover) * 2.0 * np.pi == pytest.approx(HOVER, rel=1e-4)
    assert spread(hover) < 0.002
    ends = file["events"]["randomize_rigid_body_mass"]["mass_distribution_params"]
    for (low, high), name in (
        (ends, "mass"),
        (thruster["tau_inc_range"], "time_constant"),
        (thruster["thrust_const_range"], "thrust_const"),
    ):
        inside = np.mean((np.array(draws[name]) >= low) & (np.array(draws[name]) <= high))
        assert inside == pytest.approx(0.95, abs=0.002)
    assert np.median(draws["linear_damping"]) == pytest.approx(0.3, rel=0.01)
    assert thruster["use_discrete_approximation"] is False


def test_draws_of_a_rigid_body_keep_what_its_flight_tells(tmp_path: Path) -> None:
    """Inertia over mass and arm is a ratio of gains, told to a tenth of a percent."""
    rigid_body = of_rigid_body(asdict(load_vehicle(vehicle_file(tmp_path))))
    rigid_body["prediction"]["vehicle"]["torque_ratio"] = None
    fit = ev.load_fit(written(rigid_body, tmp_path))
    fields = {
        name: np.array(load) for name, load in json.loads(fit.export("mujoco", draws=COUNT))["fields"].items()
    }
    ratio = fields["body_inertia"][:, 0] / (fields["body_mass"] * fields["site_pos"])
    assert spread(ratio) < 0.004
    assert spread(fields["body_inertia"][:, 0]) > 0.012
    assert np.all(fields["body_inertia"][:, 2] <= fields["body_inertia"][:, :2].sum(axis=1))
    assert np.median(fields["actuator_gear"]) == pytest.approx(0.034, rel=0.01)


@pytest.mark.parametrize("to", ["rotorpy", "isaaclab", "mujoco"])
def test_no_name_breaks_out_of_draws(to: str, tmp_path: Path) -> None:
    reported = refused(of_speeds(), "viscous_friction", WORSE)
    reported["provenance"]["logs"][0]["name"] = WORSE
    text = drawn(to, tmp_path, reported)
    assert text.isascii()
    assert "drag_z is not written: viscous_friction is refused. a" in text
    if to == "mujoco":
        assert not np.any(json.loads(text)["fields"]["dof_damping"])
    else:
        assert "linear_damping" not in python_file(to, tmp_path, record=reported).get("draws", {})


def test_other_targets_take_no_draws(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="draws for rotorpy, mujoco, isaaclab"):
        drawn("gazebo", tmp_path)
