"""Draws as JSON for MuJoCo: fields of the model that `mujoco` writes, with a row for each vehicle."""

from __future__ import annotations

import json
from typing import final

import numpy as np

from eivor.exports.comments import one_line
from eivor.exports.fitted import Exported, Fitted, Supplied
from eivor.exports.simulators.described import BODY, Described, describe
from eivor.exports.simulators.mujoco import NAME, REMARKS
from eivor.exports.simulators.parts import DRAGS, INERTIAS, Columns
from eivor.exports.simulators.randomisation import JOINT, Randomisation
from eivor.exports.simulators.rotors import mapped_hover
from eivor.shapes import Float

SCHEMA = "eivor.draws.mujoco/1"


@final
class MujocoDraws(Randomisation):
    """Controls count as in the model: one hovers the vehicle of the estimates, not that of a row."""

    name = "mujoco"
    words = "fields of MuJoCo's model (JSON)"

    def export(self, fitted: Fitted, supplied: Supplied, draws: Columns, seed: int) -> Exported:
        """See `Randomisation`."""
        made = describe(fitted, supplied, NAME, BODY)
        drawn = describe(fitted, supplied, NAME, BODY, draws, seed)
        document = {
            "schema": SCHEMA,
            "comments": [one_line(line) for line in (JOINT, *made.comments, *REMARKS)],
            "fields": {name: one.tolist() for name, one in _fields(drawn, made).items()},
        }
        return Exported(json.dumps(document) + "\n", made.left_out)


def _fields(drawn: Described, made: Described) -> dict[str, Float[np.ndarray, "n ..."]]:
    """By MuJoCo's names; gears are the torque of a rotor that spins clockwise."""
    values = drawn.values
    zero = np.zeros_like(values["mass"])
    return {
        "body_mass": values["mass"],
        "body_inertia": np.stack([values[name] for name in INERTIAS], axis=1),
        "dof_damping": np.stack([values.get(name, zero) for name in DRAGS], axis=1),
        "actuator_gainprm": values["thrust"] * mapped_hover(made),
        "actuator_dynprm": values["actuator_lag"],
        "actuator_gear": values["torque_ratio"],
        "site_pos": values["arm_scale"] / made.values["arm_scale"],
    }
