"""Files of simulators as tests make them: a small quadrotor, with what no flight tells given."""

from __future__ import annotations

import runpy
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

import eivor as ev
from exports.documents import of_speeds, written

VEHICLE = """
name = "A small quadrotor"
mass = {{ value = 0.03, std = 0.0003 }}

[rotors]
layout = "quad-x"
numbering = "{numbering}"
arm = {{ value = 0.043, std = 0.0004 }}
torque_ratio = 0.034
"""
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


def vehicle_file(folder: Path, numbering: str = "crazyflie") -> Path:
    path = folder / "vehicle.toml"
    path.write_text(VEHICLE.format(numbering=numbering), encoding="utf-8")
    return path


def exported(
    to: str, folder: Path, record: dict[str, Any] | None = None, numbering: str = "crazyflie", **priors: Any
) -> str:
    """Text for a simulator; `priors` take the place of `PRIORS`."""
    fit = ev.load_fit(written(record or of_speeds(), folder))
    given = {name: item for name, item in (PRIORS | priors).items() if item is not None}
    return fit.export(to, vehicle=vehicle_file(folder, numbering), priors=given)


def lopsided_file(folder: Path) -> Path:
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


def saved(to: str, folder: Path, **others: Any) -> str:
    """Path of its file."""
    path = folder / f"vehicle.{to}"
    path.write_text(exported(to, folder, **others), encoding="utf-8")
    return str(path)


def quad_params(folder: Path, **others: Any) -> dict[str, Any]:
    """What a file for RotorPy defines."""
    return runpy.run_path(saved("rotorpy", folder, **others))["quad_params"]


def table(text: str) -> dict[str, Any]:
    """What a file for drone-models says."""
    return tomllib.loads(text)["vehicle"]


def climb(step: float, seconds: float, *, lagged: str = "speed", count: int = 20_000) -> float:
    """Climb rate after a step of the command at hover, by the equation of the vertical motion."""
    time = np.linspace(0.0, seconds, count)
    passed = 1.0 - np.exp(-time / LAG)
    speed, square = 1.0 + (step - 1.0) * passed, 1.0 + (step**2 - 1.0) * passed
    lift = speed**2 if lagged == "speed" else square
    force = GRAVITY * (lift - 1.0)
    return float(np.trapezoid(force * np.exp(FRICTION * (time - seconds)), time))
