"""Documents of results, as `eivor identify --json` writes them, with numbers that tests choose."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

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


def quantity(
    value: float, std: float, unit: str = "", verdict: str = "identified", **others: Any
) -> dict[str, Any]:
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


def document(degrees: float | None = 8.0, log: str = "flight.ulg", **numbers: Any) -> dict[str, Any]:
    """A result of the vertical motion; `numbers` take the place of `NUMBERS`."""
    told = {**NUMBERS, **numbers}
    scale = np.array([told[name][1] for name in JOINT])
    matrix = CORRELATIONS * np.outer(scale, scale)
    parts = [
        {"name": "equal_weighted_cosines", "matrix": matrix.tolist(), "degrees": degrees, "share": 1.0},
        {"name": "classical", "matrix": (0.25 * matrix).tolist(), "degrees": None, "share": 1.0},
    ]
    at = {name: told[name][0] for name in ("actuator_lag", "delay")}
    best = {"at": at, "best": True, "excess": 0.0, "values": [told[name][0] for name in JOINT]}
    parameters = {name: quantity(*told[name], unit) for name, unit in UNITS.items()}
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
        "derived": {"hover_input": quantity(*told["hover_input"])},
        "covariance": {"names": list(JOINT), "choices": 1, "candidates": [{**best, "parts": parts}]},
        "prediction": {"at": at},
        "provenance": {"version": "0.1.0", "logs": [{"name": log, "sha256": "ab" * 32}]},
    }


def refused(told: dict[str, Any], name: str, reason: str = "The flight does not tell it.") -> dict[str, Any]:
    """The same document with a quantity refused."""
    for part in ("parameters", "derived"):
        if name in told[part]:
            told[part][name] |= {"verdict": "refused", "reasons": [reason]}
    return told


def of_motors(told: dict[str, Any], curve: float = 0.6) -> dict[str, Any]:
    """The same document of signals to motors, with a curve found out."""
    told["model"] |= {"input": "rotor_command", "input_map": f"mixed:{curve}"}
    told["parameters"]["thrust_curve"] = quantity(curve, 0.03)
    return told


def written(told: dict[str, Any], folder: Path) -> Path:
    """Its file."""
    path = folder / "fit.json"
    path.write_text(json.dumps(told), encoding="utf-8")
    return path
