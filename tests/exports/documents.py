"""Documents of results with numbers that tests choose, and files of simulators that are made of them."""

from __future__ import annotations

import ast
import json
import runpy
from typing import Any

import numpy as np

import eivor as ev

UNITS = {"viscous_friction": "1/s", "input_gain": "m/s^2", "actuator_lag": "s", "delay": "s"}

#: Value and standard error of a flight of a thrust setpoint.
NUMBERS = {
    "viscous_friction": (0.3, 0.02),
    "input_gain": (23.9, 0.1),
    "actuator_lag": (0.05, 0.002),
    "delay": (0.0, 0.0),
    "hover_input": (0.41, 0.002),
}

JOINT = ("viscous_friction", "input_gain", "actuator_lag")
CORRELATIONS = np.array([[1.0, 0.3, 0.1], [0.3, 1.0, 0.85], [0.1, 0.85, 1.0]])


def quantity(value, std, unit="", verdict="identified", **others):
    """One quantity."""
    return {
        "value": value,
        "unit": unit,
        "std_error": std,
        "interval": [value - 2.0 * std, value + 2.0 * std],
        "verdict": verdict,
        "reasons": [],
        "lowest": None,
        "systematic": [],
        **others,
    }


def document(degrees=8.0, log="flight.ulg", **numbers):
    """A result of the vertical motion; `numbers` take the place of `NUMBERS`."""
    selected = {**NUMBERS, **numbers}
    scale = np.array([selected[name][1] for name in JOINT])
    matrix = CORRELATIONS * np.outer(scale, scale)
    parts = [
        {"name": "equal_weighted_cosines", "matrix": matrix.tolist(), "degrees": degrees, "share": 1.0},
        {"name": "classical", "matrix": (0.25 * matrix).tolist(), "degrees": None, "share": 1.0},
    ]
    index = {name: selected[name][0] for name in ("actuator_lag", "delay")}
    best = {"at": index, "best": True, "excess": 0.0, "values": [selected[name][0] for name in JOINT]}
    parameters = {name: quantity(*selected[name], unit) for name, unit in UNITS.items()}
    parameters["actuator_lag"]["lowest"] = 0.0
    return {
        "schema": "eivor.identify/1",
        "logs": [{"name": log, "format": "ulog"}],
        "model": {
            "name": "vertical_motion",
            "input": "input",
            "input_map": "linear",
            "input_measured": False,
        },
        "verdict": "identified",
        "reasons": [],
        "parameters": parameters,
        "derived": {"hover_input": quantity(*selected["hover_input"])},
        "covariance": {"names": list(JOINT), "choices": 1, "candidates": [{**best, "parts": parts}]},
        "prediction": {"at": index},
        "provenance": {"version": "0.1.0", "logs": [{"name": log, "sha256": "ab" * 32}]},
    }


def refused(record, name, reason="The flight does not identify it."):
    """The same document with a quantity refused."""
    for part in ("parameters", "derived"):
        if name in record[part]:
            record[part][name] |= {"verdict": "refused", "reasons": [reason]}
    return record


def written(record, folder):
    """Its file."""
    path = folder / "fit.json"
    path.write_text(json.dumps(record), encoding="utf-8")
    return path


def of_speeds(record=None, **numbers):
    """The document of a flight whose commands are rotor speeds."""
    speeds = {"input_gain": (3.068e-6, 8e-9), "hover_input": (1787.9, 2.0), "actuator_lag": (0.072, 0.001)}
    record = record or document(**(speeds | numbers))
    record["model"] |= {"input": "rotor_command", "input_map": "square"}
    return record


#: Combinations of a rigid body, each with its standard error: those of 30 g with inertias of 1.43e-5,
#: 1.45e-5 and 2.7e-5 kg m^2, thrust of 2.3e-8 N/(rad/s)^2 and a torque ratio of .034 m.
COMBINATIONS = {
    "roll_coupling": (-0.874126, 0.01),
    "pitch_coupling": (0.875862, 0.01),
    "roll_gain": (2.3e-8 / 1.43e-5, 2e-6),
    "pitch_gain": (2.3e-8 / 1.45e-5, 2e-6),
    "yaw_gain": (0.034 * 2.3e-8 / 2.7e-5, 5e-9),
    "thrust_gain": (2.3e-8 / 0.03, 2e-10),
    "drag_x": (0.25, 0.01),
    "drag_y": (0.27, 0.01),
    "drag_z": (0.18, 0.01),
    "actuator_lag": (0.068, 0.0007),
    "delay": (0.004, 0.0005),
}

#: The vehicle of `VEHICLE`, as a document has it; its torque ratio is what the flight tells.
OFFSET = 0.043 / 2**0.5
KNOWN_VEHICLE: dict[str, Any] = {
    "name": "A small quadrotor",
    "positions": [[OFFSET, -OFFSET], [-OFFSET, -OFFSET], [-OFFSET, OFFSET], [OFFSET, OFFSET]],
    "spins": [-1, 1, -1, 1],
    "arm_scale": {"value": 1.0, "std": 0.0004 / 0.043},
    "mass": {"value": 0.03, "std": 0.0003},
    "thrust_map": "square",
    **dict.fromkeys(("speed_scale", "torque_ratio", "yaw_inertia_ratio", "delay", "rotor_radius")),
    **dict.fromkeys(("gyro_cutoff_hz", "accelerometer_cutoff_hz")),
}


#: What a flight of the same vehicle identifies whose centre of mass is 4 mm forward, 2 mm to the right and
#: 2 mm below its rotors.
BESIDE = {
    "roll_damping": (0.35, 0.01),
    "pitch_damping": (0.35, 0.01),
    "yaw_damping": (0.5, 0.01),
    "roll_offset": (3.2e-6, 1e-8),
    "pitch_offset": (6.4e-6, 1e-8),
    "quadratic_drag_x": (0.065, 0.002),
    "quadratic_drag_y": (0.069, 0.002),
    "quadratic_drag_z": (0.13, 0.005),
    "rotor_reaction": (1e-3, 1e-5),
    "roll_by_drag_y": (0.002 * 0.0081 / 1.43e-5, 0.01),
    "pitch_by_drag_x": (-0.002 * 0.0075 / 1.45e-5, 0.01),
}


def of_lopsided(vehicle=KNOWN_VEHICLE, **others):
    """Its result, with further combinations."""
    return of_rigid_body(vehicle, COMBINATIONS | BESIDE | others)


#: 1.2 kg with inertias of .012, .013 and .02 kg m^2, thrust of 8e-6 N/(rad/s)^2 and a torque ratio of .016 m.
HEAVY = COMBINATIONS | {
    "roll_coupling": (-0.007 / 0.012, 0.01),
    "pitch_coupling": (0.008 / 0.013, 0.01),
    "roll_gain": (8e-6 / 0.012, 1e-6),
    "pitch_gain": (8e-6 / 0.013, 1e-6),
    "yaw_gain": (0.016 * 8e-6 / 0.02, 1e-8),
    "thrust_gain": (8e-6 / 1.2, 1e-8),
}


def of_heavy():
    """Its result."""
    at = (4.0 * np.array(KNOWN_VEHICLE["positions"])).tolist()
    return of_rigid_body(KNOWN_VEHICLE | {"positions": at, "mass": {"value": 1.2, "std": 0.01}}, HEAVY)


#: Results of rigid bodies: a small vehicle, ones with quadratic drag and with all else, and a heavy one.
VEHICLES = {
    "small": lambda: of_rigid_body(KNOWN_VEHICLE),
    "quadratic drag": lambda: of_rigid_body(
        KNOWN_VEHICLE, COMBINATIONS | {name: pair for name, pair in BESIDE.items() if "quadratic" in name}
    ),
    "lopsided": of_lopsided,
    "heavy": of_heavy,
}


def of_rigid_body(vehicle, combinations=COMBINATIONS):
    """A result of the rigid body whose combinations are independent."""
    reported = document()
    reported["model"] |= {"name": "rigid_body", "input": "rotor_command", "input_map": "square"}
    reported["parameters"] = {name: quantity(*pair) for name, pair in combinations.items()}
    reported["derived"] = {}
    values, errors = (np.array([pair[side] for pair in combinations.values()]) for side in (0, 1))
    parts = [{"name": "given", "matrix": np.diag(errors**2).tolist(), "degrees": 30.0, "share": 1.0}]
    best = {"at": {}, "best": True, "excess": 0.0, "values": values.tolist(), "parts": parts}
    reported["covariance"] = {"names": list(combinations), "choices": 1, "candidates": [best]}
    reported["prediction"] = {"at": {}, "vehicle": vehicle}
    return reported


VEHICLE = """
name = "A small quadrotor"
mass = {{ value = 0.03, std = 0.0003 }}

[rotors]
layout = "quad-x"
numbering = "{numbering}"
arm = {{ value = 0.043, std = 0.0004 }}
torque_ratio = 0.034
"""

#: The same vehicle with rotors ahead, behind and on its sides.
PLUS = VEHICLE.format(numbering="px4").replace("quad-x", "quad-plus")

#: With them a vertical flight is enough.
PRIORS = {
    "inertia_xx": (1.43e-5, 1e-6),
    "inertia_yy": (1.45e-5, 1e-6),
    "inertia_zz": (2.7e-5, 1e-6),
    "largest_command": (2500.0, 0.0),
}

#: What the flight of `of_speeds` tells.
GAIN, LAG, FRICTION, GRAVITY = 3.068e-6, 0.072, 0.3, 9.80665
HOVER = (GRAVITY / GAIN) ** 0.5


def vehicle_file(folder, numbering="crazyflie"):
    path = folder / "vehicle.toml"
    path.write_text(VEHICLE.format(numbering=numbering), encoding="utf-8")
    return path


def exported(to, folder, record=None, numbering="crazyflie", **priors):
    """Text for a simulator; `priors` take the place of `PRIORS`."""
    fit = ev.load_fit(written(record or of_speeds(), folder))
    given = {name: item for name, item in (PRIORS | priors).items() if item is not None}
    return fit.export(to, vehicle=vehicle_file(folder, numbering), priors=given)


def lopsided_file(folder):
    """The same vehicle, whose rotors are not around its centre of mass."""
    path = vehicle_file(folder)
    text = path.read_text(encoding="utf-8")
    layout = 'layout = "quad-x"\nnumbering = "crazyflie"\narm = { value = 0.043, std = 0.0004 }\n'
    texts = (
        "positions = [[0.04, -0.03], [-0.03, -0.03], [-0.03, 0.02], [0.03, 0.03]]\nspins = [-1, 1, -1, 1]\n"
    )
    assert layout in text
    path.write_text(text.replace(layout, texts), encoding="utf-8")
    return path


def saved(to, folder, **others):
    """Path of its file."""
    path = folder / f"vehicle.{to}"
    path.write_text(exported(to, folder, **others), encoding="utf-8")
    return str(path)


def quad_params(folder, **others):
    """What a file for RotorPy defines."""
    return runpy.run_path(saved("rotorpy", folder, **others))["quad_params"]


def table(text):
    """Parameters of a file for drone-models."""
    return ast.literal_eval(text[text.index("vehicle = ") + 10 : text.index("\n\n\ndef dynamics")])


def climb(step, seconds, *, lagged="speed", count=20_000):
    """Climb rate after a step of the command at hover, by the equation of the vertical motion."""
    time = np.linspace(0.0, seconds, count)
    passed = 1.0 - np.exp(-time / LAG)
    speed, square = 1.0 + (step - 1.0) * passed, 1.0 + (step**2 - 1.0) * passed
    lift = speed**2 if lagged == "speed" else square
    force = GRAVITY * (lift - 1.0)
    return float(np.trapezoid(force * np.exp(FRICTION * (time - seconds)), time))
