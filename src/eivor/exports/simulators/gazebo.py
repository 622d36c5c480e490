"""A vehicle of Gazebo (SDF) with a MulticopterMotorModel for each rotor.

Of gz-sim's source: thrust is motorConstant times the squared speed, the speed lags by a filter of first
order, and drag is across the rotor's axis only. Drag along it is therefore not in the file. Rotors are links,
which must have masses: theirs and the body's together have the mass and the inertia of the vehicle.
"""

from __future__ import annotations

from typing import final

import numpy as np

from eivor.exports.comments import xml_comments
from eivor.exports.fitted import Exported, Fitted, Supplied
from eivor.exports.simulators.described import BODY, Described, describe
from eivor.exports.simulators.parts import INERTIAS
from eivor.exports.simulators.rotors import Rotors, rotors_of, speed_comments
from eivor.exports.target import Target
from eivor.shapes import Float

NAME = "Gazebo"
#: What its worlds take gravity for [m/s^2].
GRAVITY = 9.8
#: A rotor's share of the mass.
ROTOR_SHARE = 0.005
#: Joints turn slower than rotors by this factor, so that the simulation may take larger steps.
SLOWDOWN = 10
REMARKS = (
    "One lag was identified: it stands for speeding up and for slowing down.",
    "Of the mass each rotor has half a percent; body and rotors together have mass and inertia as above.",
)


@final
class GazeboModel(Target):
    """Commands are rotor speeds on the topic command/motor_speed."""

    name = "gazebo"
    words = "a vehicle of Gazebo (SDF with motor models)"
    ending = ".sdf"

    def export(self, fitted: Fitted, supplied: Supplied) -> Exported:
        """See `Target`."""
        made = describe(fitted, supplied, NAME, (*BODY, "largest_command"))
        rotors = rotors_of(made, GRAVITY)
        told = [*made.comments, *speed_comments(made, NAME, GRAVITY), *REMARKS]
        if "drag_z" in made.values:
            told.append(
                "The motor model has no drag along the rotors' axis: drag along z is not in this file."
            )
        mass, arm = float(made.values["mass"][0]), float(made.values["arm_scale"][0])
        places = [(arm * x, arm * y) for x, y in made.vehicle.positions]
        radius = made.vehicle.rotor_radius or 0.5 * arm * made.vehicle.arm
        disc = ROTOR_SHARE * mass * radius**2 * np.diag([0.25, 0.25, 0.5])
        centre, inertia = _rest(made, places, disc)
        rest = mass * (1.0 - made.count * ROTOR_SHARE)
        lines = [
            '<?xml version="1.0"?>',
            *xml_comments(told),
            '<sdf version="1.9">',
            '  <model name="vehicle">',
            *_link("base_link", "0 0 0 0 0 0", f"{centre[0]!r} {centre[1]!r} 0 0 0 0", rest, inertia),
            *(
                line
                for n, (x, y) in enumerate(places)
                for line in (
                    *_link(f"rotor_{n}", f"{x!r} {y!r} 0 0 0 0", "0 0 0 0 0 0", ROTOR_SHARE * mass, disc),
                    *_joint(n),
                )
            ),
            *(line for n, spin in enumerate(made.vehicle.spins) for line in _motor(n, spin, made, rotors)),
            "  </model>",
            "</sdf>",
        ]
        return Exported("\n".join(lines) + "\n", made.left_out)


def _rest(
    made: Described, places: list[tuple[float, float]], disc: Float[np.ndarray, "3 3"]
) -> tuple[tuple[float, float], Float[np.ndarray, "3 3"]]:
    """Centre of mass of the body without its rotors, and its inertia about it."""
    mass = float(made.values["mass"][0])
    each, rest = ROTOR_SHARE * mass, mass * (1.0 - made.count * ROTOR_SHARE)
    inertia = np.diag([float(made.values[name][0]) for name in INERTIAS])
    for x, y in places:
        inertia = inertia - disc - each * _of_point(x, y)
    x, y = (0.0 - each * sum(place[axis] for place in places) / rest for axis in (0, 1))
    return (x, y), inertia - rest * _of_point(x, y)


def _of_point(x: float, y: float) -> Float[np.ndarray, "3 3"]:
    """Inertia of a point of one kilogram about the origin."""
    return np.array([[y * y, -x * y, 0.0], [-x * y, x * x, 0.0], [0.0, 0.0, x * x + y * y]])


def _link(name: str, pose: str, centre: str, mass: float, inertia: Float[np.ndarray, "3 3"]) -> list[str]:
    places = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    elements = "".join(f"<{word}>{float(inertia[place])!r}</{word}>" for word, place in places.items())
    return [
        f'    <link name="{name}">',
        f"      <pose>{pose}</pose>",
        "      <inertial>",
        f"        <pose>{centre}</pose>",
        f"        <mass>{mass!r}</mass>",
        f"        <inertia>{elements}</inertia>",
        "      </inertial>",
        "    </link>",
    ]


def _joint(number: int) -> list[str]:
    return [
        f'    <joint name="rotor_{number}_joint" type="revolute">',
        "      <parent>base_link</parent>",
        f"      <child>rotor_{number}</child>",
        "      <axis>",
        "        <xyz>0 0 1</xyz>",
        "        <limit><lower>-1e16</lower><upper>1e16</upper></limit>",
        "      </axis>",
        "    </joint>",
    ]


def _motor(number: int, spin: int, made: Described, rotors: Rotors) -> list[str]:
    lag = float(made.values["actuator_lag"][0])
    settings = {
        "robotNamespace": "vehicle",
        "jointName": f"rotor_{number}_joint",
        "linkName": f"rotor_{number}",
        "turningDirection": "cw" if spin > 0 else "ccw",
        "timeConstantUp": repr(lag),
        "timeConstantDown": repr(lag),
        "maxRotVelocity": repr(float(rotors.largest_speed[0])),
        "motorConstant": repr(float(rotors.thrust_constant[0])),
        "momentConstant": repr(float(made.values["torque_ratio"][0])),
        "rotorDragCoefficient": repr(float(rotors.drag_across[0])),
        "rollingMomentCoefficient": "0",
        "rotorVelocitySlowdownSim": f"{SLOWDOWN}",
        "commandSubTopic": "command/motor_speed",
        "motorSpeedPubTopic": f"motor_speed/{number}",
        "actuator_number": f"{number}",
        "motorType": "velocity",
    }
    return [
        '    <plugin filename="gz-sim-multicopter-motor-model-system" '
        'name="gz::sim::systems::MulticopterMotorModel">',
        *(f"      <{word}>{text}</{word}>" for word, text in settings.items()),
        "    </plugin>",
    ]
