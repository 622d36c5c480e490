"""Parameters of RotorPy as its own files of vehicles have them: a Python file with a dictionary.

RotorPy's drag is k_z (along a rotor's axis) and k_d (across it) times the rotors' summed speed: it is the
identified one at hover. It has one k_d: that of the mean of both drags across.
"""

from __future__ import annotations

from typing import final

import numpy as np

from eivor.exports.comments import hash_comments
from eivor.exports.fitted import Exported, Fitted, Supplied
from eivor.exports.simulators.described import BODY, Described, describe
from eivor.exports.simulators.parts import INERTIAS, Columns
from eivor.exports.simulators.rotors import rotors_of, speed_comments
from eivor.exports.target import Target

#: What RotorPy takes gravity for [m/s^2].
GRAVITY = 9.81
NAME = "RotorPy"
NEEDS = (*BODY, "largest_command")


@final
class RotorpyVehicle(Target):
    """A file to import ``quad_params`` from."""

    name = "rotorpy"
    words = "a vehicle of RotorPy (Python file with quad_params)"
    ending = ".py"

    def export(self, fitted: Fitted, supplied: Supplied) -> Exported:
        """See `Target`."""
        made = describe(fitted, supplied, NAME, NEEDS)
        return Exported("\n".join(vehicle_lines(made)) + "\n", made.left_out)


def vehicle_lines(made: Described) -> list[str]:
    """The file: comments, and the dictionary of the first row."""
    row = {name: float(column[0]) for name, column in rotorpy_columns(made).items()}
    arm = float(made.values["arm_scale"][0])
    places = [
        f'        "r{number}": np.array([{arm * x!r}, {arm * y!r}, 0.0]),'
        for number, (x, y) in enumerate(made.vehicle.positions, start=1)
    ]
    return [
        *hash_comments((*made.comments, *speed_comments(made, NAME, GRAVITY))),
        "import numpy as np",
        "",
        "quad_params = {",
        *(f'    "{name}": {value!r},' for name, value in row.items()),
        f'    "num_rotors": {made.count},',
        '    "rotor_pos": {',
        *places,
        "    },",
        f'    "rotor_directions": np.array({list(made.vehicle.spins)}),',
        '    "rI": np.zeros(3),',
        "}",
    ]


def rotorpy_columns(made: Described) -> Columns:
    """RotorPy's numbers by its names, a row for each vehicle."""
    values, rotors = made.values, rotors_of(made, GRAVITY)
    zero = np.zeros_like(values["mass"])
    return {
        "mass": values["mass"],
        **{f"I{name[-2:]}": values[name] for name in INERTIAS},
        **dict.fromkeys(("Ixy", "Ixz", "Iyz", "c_Dx", "c_Dy", "c_Dz"), zero),
        "k_eta": rotors.thrust_constant,
        "k_m": rotors.torque_constant,
        "k_d": rotors.drag_across,
        "k_z": rotors.drag_along,
        "k_h": zero,
        "k_flap": zero,
        "tau_m": values["actuator_lag"],
        "rotor_speed_min": zero,
        "rotor_speed_max": rotors.largest_speed,
        "motor_noise_std": zero,
    }
