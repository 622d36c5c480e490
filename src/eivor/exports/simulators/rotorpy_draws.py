"""Draws as a Python file for RotorPy: ``vehicles``, a list of dictionaries such as `rotorpy` writes one."""

from __future__ import annotations

from typing import final

from eivor.exports.comments import hash_comments
from eivor.exports.fitted import Exported, Fitted, Supplied
from eivor.exports.simulators.described import describe
from eivor.exports.simulators.parts import Columns
from eivor.exports.simulators.randomisation import JOINT, Randomisation
from eivor.exports.simulators.rotorpy import NAME, NEEDS, rotorpy_columns, vehicle_lines

VEHICLES = """
vehicles = [
    quad_params
    | {name: column[row] for name, column in draws.items()}
    | {"rotor_pos": {name: arm_scale[row] * place for name, place in quad_params["rotor_pos"].items()}}
    for row in range(len(arm_scale))
]
"""


@final
class RotorpyDraws(Randomisation):
    """Takes ``BatchedMultirotorParams(vehicles, ...)``, or ``Multirotor(vehicle)`` each."""

    name = "rotorpy"
    words = "vehicles of RotorPy (Python file with vehicles, a list of dictionaries)"

    def export(self, fitted: Fitted, supplied: Supplied, draws: Columns, seed: int) -> Exported:
        """See `Randomisation`."""
        made = describe(fitted, supplied, NAME, NEEDS)
        drawn = describe(fitted, supplied, NAME, NEEDS, draws, seed)
        columns = {name: one for name, one in rotorpy_columns(drawn).items() if one.min() < one.max()}
        arms = drawn.values["arm_scale"] / made.values["arm_scale"]
        lines = [
            *hash_comments([JOINT]),
            *vehicle_lines(made),
            "",
            "draws = {",
            *(f'    "{name}": {column.tolist()},' for name, column in columns.items()),
            "}",
            f"arm_scale = {arms.tolist()}",
        ]
        return Exported("\n".join(lines) + VEHICLES, made.left_out)
