"""A vehicle of gym-pybullet-drones, and of pybullet: URDF with the properties that the former reads.

The former finds mass, inertia and collision body by their places in the tree, and rotors by the order of
`quad_x`; rotor speeds are in revolutions per minute. Plain pybullet reads the inertia only when told so, with
``flags=pybullet.URDF_USE_INERTIA_FROM_FILE``.
"""

from __future__ import annotations

import math
from typing import final
from xml.sax.saxutils import quoteattr

from eivor.exports.comments import xml_comments
from eivor.exports.fitted import Exported, Fitted, Supplied
from eivor.exports.simulators.described import BODY, describe
from eivor.exports.simulators.parts import INERTIAS
from eivor.exports.simulators.quad_x import QUARTERS, by_quarters, mean_distances
from eivor.exports.simulators.rotors import rotors_of, speed_comments
from eivor.exports.target import Target

NAME = "gym-pybullet-drones"
#: What it takes gravity for [m/s^2].
GRAVITY = 9.8
PER_MINUTE = 2.0 * math.pi / 60.0
REMARKS = (
    "Ground effect, downwash and largest speed are not of the flight: none, none, and 30 km/h.",
    "Plain pybullet takes the inertia with flags=pybullet.URDF_USE_INERTIA_FROM_FILE.",
)


@final
class PybulletVehicle(Target):
    """Without the lag of the rotors, which gym-pybullet-drones does not have."""

    name = "pybullet"
    words = "a vehicle of gym-pybullet-drones (URDF)"
    ending = ".urdf"

    def export(self, fitted: Fitted, supplied: Supplied) -> Exported:
        """See `Target`."""
        needs = tuple(name for name in (*BODY, "largest_command") if name != "actuator_lag")
        made = describe(fitted, supplied, NAME, needs)
        order = by_quarters(made.vehicle, NAME)
        value = {name: float(column[0]) for name, column in made.values.items()}
        rotors, arm = rotors_of(made, GRAVITY), value["arm_scale"]
        thrust, speed = float(rotors.thrust_constant[0]), float(rotors.largest_speed[0])
        sign = -made.vehicle.spins[order[0]]
        ahead, aside = mean_distances(made.vehicle)
        size = arm * made.vehicle.arm
        properties = {
            "arm": size,
            "kf": thrust * PER_MINUTE**2,
            "km": sign * float(rotors.torque_constant[0]) * PER_MINUTE**2,
            "thrust2weight": made.count * thrust * speed**2 / (value["mass"] * GRAVITY),
            "max_speed_kmh": 30.0,
            "gnd_eff_coeff": 0.0,
            "prop_radius": made.vehicle.rotor_radius or 0.5 * size,
            "drag_coeff_xy": float(rotors.drag_across[0]),
            "drag_coeff_z": float(rotors.drag_along[0]),
            "dw_coeff_1": 0.0,
            "dw_coeff_2": 0.0,
            "dw_coeff_3": 1.0,
        }
        lag = value.get("actuator_lag")
        unlike = [] if lag is None else [f"{NAME} has no lag of the rotors: {lag:.4g} s is not in this file."]
        comments = (*made.comments, *speed_comments(made, NAME, GRAVITY), *unlike, *REMARKS)
        places = [(arm * ahead * x, arm * aside * y) for x, y in QUARTERS]
        told = " ".join(f"{name}={quoteattr(repr(one))}" for name, one in properties.items())
        lines = [
            '<?xml version="1.0" ?>',
            *xml_comments(comments),
            '<robot name="vehicle">',
            f"  <properties {told}/>",
            *_body(value, size),
            *(line for n, (x, y) in enumerate(places) for line in _massless(f"prop{n}", x, y)),
            *_massless("center_of_mass", 0.0, 0.0),
            "</robot>",
        ]
        return Exported("\n".join(lines) + "\n", made.left_out)


def _body(value: dict[str, float], size: float) -> list[str]:
    inertia = " ".join(f'i{name[-2:]}="{value[name]!r}"' for name in INERTIAS)
    shape = [
        '      <origin rpy="0 0 0" xyz="0 0 0"/>',
        f'      <geometry><cylinder radius="{size!r}" length="{0.5 * size!r}"/></geometry>',
    ]
    return [
        '  <link name="base_link">',
        "    <inertial>",
        '      <origin rpy="0 0 0" xyz="0 0 0"/>',
        f'      <mass value="{value["mass"]!r}"/>',
        f'      <inertia {inertia} ixy="0" ixz="0" iyz="0"/>',
        "    </inertial>",
        *("    <visual>", *shape, "    </visual>"),
        *("    <collision>", *shape, "    </collision>"),
        "  </link>",
    ]


def _massless(name: str, x: float, y: float) -> list[str]:
    """A link that marks a place."""
    return [
        f'  <link name="{name}_link">',
        "    <inertial>",
        f'      <origin rpy="0 0 0" xyz="{x!r} {y!r} 0"/>',
        '      <mass value="0"/>',
        '      <inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/>',
        "    </inertial>",
        "  </link>",
        f'  <joint name="{name}_joint" type="fixed">',
        '    <parent link="base_link"/>',
        f'    <child link="{name}_link"/>',
        "  </joint>",
    ]
