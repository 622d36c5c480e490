"""Physical parameters of drone-models, which crazyflow flies: TOML in the words of its ``data/params.toml``.

Rotor speeds are in revolutions per minute; thrust is c0 + c1 n + c2 n^2; a rotor's speed follows its command
by rotor_dyn_coef, up and down.
"""

from __future__ import annotations

import math
from typing import final

import numpy as np

from eivor.exports.comments import hash_comments
from eivor.exports.fitted import Exported, Fitted, Supplied
from eivor.exports.simulators.described import BODY, Described, describe
from eivor.exports.simulators.parts import DRAGS, INERTIAS
from eivor.exports.simulators.rotors import rotors_of, speed_comments
from eivor.exports.target import Target
from eivor.motions.vertical.model import GRAVITY

NAME = "drone-models"
PER_MINUTE = 2.0 * math.pi / 60.0
REMARKS = (
    "pwm and motor voltages are not of the flight, and not in this file. Rotors count as without inertia.",
)


@final
class DroneModelsParameters(Target):
    """One table, [vehicle], for the first-principles model."""

    name = "drone-models"
    words = "physical parameters of drone-models and crazyflow (TOML)"
    ending = ".toml"

    def export(self, fitted: Fitted, supplied: Supplied) -> Exported:
        """See `Target`."""
        made = describe(fitted, supplied, NAME, BODY)
        comments = (*made.comments, *speed_comments(made, NAME), *REMARKS)
        rows = [f"{name} = {_toml(value)}" for name, value in _values(made).items()]
        return Exported("\n".join([*hash_comments(comments), "[vehicle]", *rows]) + "\n", made.left_out)


def _values(made: Described) -> dict[str, object]:
    value = {name: float(column[0]) for name, column in made.values.items()}
    rotors = rotors_of(made)
    thrust, torque = (
        float(one[0]) * PER_MINUTE**2 for one in (rotors.thrust_constant, rotors.torque_constant)
    )
    rate, arm = 1.0 / value["actuator_lag"], made.vehicle.arm
    limits = {
        "thrust_min": 0.0,
        "thrust_max": float(rotors.thrust_constant[0] * rotors.largest_speed[0] ** 2),
    }
    return {
        "gravity_vec": [0.0, 0.0, -GRAVITY],
        "mass": value["mass"],
        "L": value["arm_scale"] * arm,
        "J": np.diag([value[name] for name in INERTIAS]).tolist(),
        "rpm2thrust": [0.0, 0.0, thrust],
        "rpm2torque": [0.0, 0.0, torque],
        "thrust2torque": value["torque_ratio"],
        "rotor_dyn_coef": [rate, 0.0, rate, 0.0],
        "rotor_dyn_coef_simple": rate,
        "thrust_dyn_coef": rate,
        "mixing_matrix": [
            [y / arm for _, y in made.vehicle.positions],
            [0.0 - x / arm for x, _ in made.vehicle.positions],
            [float(spin) for spin in made.vehicle.spins],
        ],
        "drag_matrix": np.diag([0.0 - value.get(name, 0.0) for name in DRAGS]).tolist(),
        "prop_inertia": 0.0,
        **(limits if "largest_command" in value else {}),
    }


def _toml(value: object) -> str:
    """Numbers and lists of them."""
    if isinstance(value, list):
        return f"[{', '.join(_toml(one) for one in value)}]"
    return repr(value)
