"""A vehicle of MuJoCo (MJCF): slides and a ball joint, so that drag is of motion along, not of turning.

A free joint's damping would act on all six velocities. A rotor's control is its mapped command over that at
hover: one hovers. MuJoCo's filter acts on that in place of the command: the lag is the same about hover.
"""

from __future__ import annotations

from typing import final

from eivor.exports.comments import xml_comments
from eivor.exports.fitted import Exported, Fitted, Supplied
from eivor.exports.simulators.described import BODY, Described, describe
from eivor.exports.simulators.parts import DRAGS, INERTIAS
from eivor.exports.simulators.rotors import delay_comments, rotors_of
from eivor.exports.target import Target
from eivor.motions.vertical.model import GRAVITY

NAME = "MuJoCo"
TIMESTEP_S = 0.002
REMARKS = (
    "Controls are mapped commands over that at hover, which is 1; the lag is of them, not of the speed.",
    "Drag is along the world's axes, not the body's.",
)


@final
class MujocoModel(Target):
    """Numbers stand where MuJoCo's fields have them, so that draws may take their places."""

    name = "mujoco"
    words = "a vehicle of MuJoCo (MJCF)"
    ending = ".xml"

    def export(self, fitted: Fitted, supplied: Supplied) -> Exported:
        """See `Target`."""
        made = describe(fitted, supplied, NAME, BODY)
        return Exported("\n".join(model_lines(made)) + "\n", made.left_out)


def model_lines(made: Described) -> list[str]:
    """The file, of the first row."""
    value = {name: float(column[0]) for name, column in made.values.items()}
    rotors, arm = rotors_of(made), value["arm_scale"]
    most = float((rotors.largest_speed[0] / rotors.hover_speed[0]) ** 2)
    limits = f' ctrlrange="0 {most!r}"' if "largest_command" in value else ""
    gain = value["mass"] * GRAVITY / made.count
    inertia = " ".join(repr(value[name]) for name in INERTIAS)
    places = list(enumerate(made.vehicle.positions, start=1))
    ones = " ".join("1" * made.count)
    axes = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}
    slides = (
        f'      <joint name="{axis}" type="slide" axis="{axes[axis]}" damping="{value.get(name, 0.0)!r}"/>'
        for axis, name in zip(axes, DRAGS, strict=True)
    )
    return [
        '<?xml version="1.0"?>',
        *xml_comments((*made.comments, *REMARKS, *delay_comments(made, NAME))),
        '<mujoco model="vehicle">',
        f'  <option timestep="{TIMESTEP_S}" gravity="0 0 {-GRAVITY}" integrator="implicitfast"/>',
        "  <worldbody>",
        '    <body name="vehicle" pos="0 0 1">',
        *slides,
        '      <joint name="attitude" type="ball"/>',
        f'      <inertial pos="0 0 0" mass="{value["mass"]!r}" diaginertia="{inertia}"/>',
        f'      <geom type="sphere" size="{0.5 * arm * made.vehicle.arm!r}" contype="0" conaffinity="0"/>',
        *(f'      <site name="rotor{n}" pos="{arm * x!r} {arm * y!r} 0"/>' for n, (x, y) in places),
        "    </body>",
        "  </worldbody>",
        "  <actuator>",
        *(
            f'    <general name="rotor{n}" site="rotor{n}" dyntype="filterexact" '
            f'dynprm="{value["actuator_lag"]!r}" gainprm="{gain!r}" '
            f'gear="0 0 1 0 0 {spin * value["torque_ratio"]!r}"{limits}/>'
            for n, spin in enumerate(made.vehicle.spins, start=1)
        ),
        "  </actuator>",
        f'  <keyframe><key name="hover" qpos="0 0 0 1 0 0 0" act="{ones}" ctrl="{ones}"/></keyframe>',
        "</mujoco>",
    ]
