"""Exports to simulators, and random draws of vehicles for them."""

from __future__ import annotations

import json
import math
from typing import final
from xml.sax.saxutils import quoteattr

import numpy as np

from eivor.exports.autopilots import PX4, qgroundcontrol
from eivor.exports.fitted import Exported, Fitted, Supplied, Target, hash_comments, one_line, xml_comments
from eivor.exports.vehicle import (
    BODY,
    DRAGS,
    INERTIAS,
    JOINT,
    QUARTERS,
    Column,
    Columns,
    Randomisation,
    SimulatorRotors,
    VehicleDescription,
    by_quarters,
    delay_comments,
    describe,
    mapped_hover,
    mean_distances,
    rotors_of,
    speed_comments,
)
from eivor.motions.vertical.model import GRAVITY
from eivor.tools import Float

# -- Drone models --

DRONE_MODELS_NAME = "drone-models"
PER_MINUTE = 2.0 * math.pi / 60.0
DRONE_MODELS_REMARKS = (
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
        made = describe(fitted, supplied, DRONE_MODELS_NAME, BODY)
        comments = (*made.comments, *speed_comments(made, DRONE_MODELS_NAME), *DRONE_MODELS_REMARKS)
        rows = [f"{name} = {_toml(value)}" for name, value in _values(made).items()]
        return Exported("\n".join([*hash_comments(comments), "[vehicle]", *rows]) + "\n", made.omitted)


def _values(made: VehicleDescription) -> dict[str, object]:
    value = {name: float(column[0]) for name, column in made.values.items()}
    rotors = rotors_of(made)
    thrust, torque = (
        float(item[0]) * PER_MINUTE**2 for item in (rotors.thrust_constant, rotors.torque_constant)
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
        return f"[{', '.join(_toml(item) for item in value)}]"
    return repr(value)


# -- Gazebo --

GAZEBO_NAME = "Gazebo"
#: What its worlds take gravity for [m/s^2].
GAZEBO_GRAVITY = 9.8
#: A rotor's share of the mass.
ROTOR_SHARE = 0.005
#: Joints turn slower than rotors by this factor, so that the simulation may take larger steps.
SLOWDOWN = 10
GAZEBO_REMARKS = (
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
        made = describe(fitted, supplied, GAZEBO_NAME, (*BODY, "largest_command"))
        rotors = rotors_of(made, GAZEBO_GRAVITY)
        selected = [*made.comments, *speed_comments(made, GAZEBO_NAME, GAZEBO_GRAVITY), *GAZEBO_REMARKS]
        if "drag_z" in made.values:
            selected.append(
                "The motor model has no drag along the rotors' axis: drag along z is not in this file."
            )
        mass, arm = float(made.values["mass"][0]), float(made.values["arm_scale"][0])
        positions = [(arm * x, arm * y) for x, y in made.vehicle.positions]
        radius = made.vehicle.rotor_radius or 0.5 * arm * made.vehicle.arm
        disc = ROTOR_SHARE * mass * radius**2 * np.diag([0.25, 0.25, 0.5])
        centre, inertia = _rest(made, positions, disc)
        rest = mass * (1.0 - made.count * ROTOR_SHARE)
        lines = [
            '<?xml version="1.0"?>',
            *xml_comments(selected),
            '<sdf version="1.9">',
            '  <model name="vehicle">',
            *_link("base_link", "0 0 0 0 0 0", f"{centre[0]!r} {centre[1]!r} 0 0 0 0", rest, inertia),
            *(
                line
                for n, (x, y) in enumerate(positions)
                for line in (
                    *_link(f"rotor_{n}", f"{x!r} {y!r} 0 0 0 0", "0 0 0 0 0 0", ROTOR_SHARE * mass, disc),
                    *_joint(n),
                )
            ),
            *(line for n, spin in enumerate(made.vehicle.spins) for line in _motor(n, spin, made, rotors)),
            "  </model>",
            "</sdf>",
        ]
        return Exported("\n".join(lines) + "\n", made.omitted)


def _rest(
    made: VehicleDescription, positions: list[tuple[float, float]], disc: Float[np.ndarray, "3 3"]
) -> tuple[tuple[float, float], Float[np.ndarray, "3 3"]]:
    """Centre of mass of the body without its rotors, and its inertia about it."""
    mass = float(made.values["mass"][0])
    each, rest = ROTOR_SHARE * mass, mass * (1.0 - made.count * ROTOR_SHARE)
    inertia = np.diag([float(made.values[name][0]) for name in INERTIAS])
    for x, y in positions:
        inertia = inertia - disc - each * _of_point(x, y)
    x, y = (0.0 - each * sum(position[axis] for position in positions) / rest for axis in (0, 1))
    return (x, y), inertia - rest * _of_point(x, y)


def _of_point(x: float, y: float) -> Float[np.ndarray, "3 3"]:
    """Inertia of a point of one kilogram about the origin."""
    return np.array([[y * y, -x * y, 0.0], [-x * y, x * x, 0.0], [0.0, 0.0, x * x + y * y]])


def _link(name: str, pose: str, centre: str, mass: float, inertia: Float[np.ndarray, "3 3"]) -> list[str]:
    positions = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    elements = "".join(
        f"<{word}>{float(inertia[position])!r}</{word}>" for word, position in positions.items()
    )
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


def _motor(number: int, spin: int, made: VehicleDescription, rotors: SimulatorRotors) -> list[str]:
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


# -- Isaac lab draws --

ISAAC_LAB_NAME = "Isaac Lab"
#: What it takes gravity for [m/s^2].
ISAAC_LAB_GRAVITY = 9.81
ISAAC_LAB_NEEDS = (*BODY, "largest_command")
#: Quantiles that the ranges reach to.
ISAAC_LAB_QUANTILES = (0.025, 0.975)
ISAAC_LAB_REMARKS = (
    "events are the parameters of a term of events beside its asset_cfg; thruster is what a ThrusterCfg "
    "takes beside dt and thruster_names_expr, with the lag as it is: the approximation that it has by itself "
    "would make the lag longer by dt.",
    "events and thruster are ranges of 95 % of the draws, for terms that draw each number by itself: they "
    "hold vehicles that the flight excludes. draws are the joint ones: set them where you can.",
    "Drag is over mass, as linear_damping has it: of motion along z.",
)


@final
class IsaacLabDraws(Randomisation):
    """``events``, ``thruster`` and ``draws``, as plain dictionaries."""

    name = "isaaclab"
    words = "ranges and draws for Isaac Lab (Python file)"

    def export(self, fitted: Fitted, supplied: Supplied, draws: Columns, seed: int) -> Exported:
        """See `Randomisation`."""
        made = describe(fitted, supplied, ISAAC_LAB_NAME, ISAAC_LAB_NEEDS)
        columns = _columns(describe(fitted, supplied, ISAAC_LAB_NAME, ISAAC_LAB_NEEDS, draws, seed))
        lags, thrusts = (_range(columns[name]) for name in ("time_constant", "thrust_const"))
        masses = f'"mass_distribution_params": {_range(columns["mass"])}'
        uniform = '"operation": "abs", "distribution": "uniform"'
        lines = [
            *hash_comments(
                (
                    JOINT,
                    *made.comments,
                    *speed_comments(made, ISAAC_LAB_NAME, ISAAC_LAB_GRAVITY),
                    *ISAAC_LAB_REMARKS,
                )
            ),
            "events = {",
            f'    "randomize_rigid_body_mass": {{{masses}, {uniform}}},',
            "}",
            "thruster = {",
            f'    "thrust_const_range": {thrusts},',
            f'    "tau_inc_range": {lags},',
            f'    "tau_dec_range": {lags},',
            f'    "thrust_range": {(0.0, float(np.median(columns["thrust_max"])))},',
            '    "use_discrete_approximation": False,',
            f'    "torque_to_thrust_ratio": {float(np.median(columns["torque_to_thrust_ratio"]))!r},',
            "}",
            "draws = {",
            *(f'    "{name}": {column.tolist()},' for name, column in columns.items()),
            "}",
        ]
        return Exported("\n".join(lines) + "\n", made.omitted)


def _columns(drawn: VehicleDescription) -> dict[str, Column]:
    values, rotors = drawn.values, rotors_of(drawn, ISAAC_LAB_GRAVITY)
    friction = {"linear_damping": values["drag_z"] / values["mass"]} if "drag_z" in values else {}
    return {
        "mass": values["mass"],
        **{name: values[name] for name in INERTIAS},
        "thrust_const": rotors.thrust_constant * (2.0 * math.pi) ** 2,
        "thrust_max": rotors.thrust_constant * rotors.largest_speed**2,
        "time_constant": values["actuator_lag"],
        "torque_to_thrust_ratio": values["torque_ratio"],
        **friction,
    }


def _range(column: Column) -> tuple[float, float]:
    low, high = np.quantile(column, ISAAC_LAB_QUANTILES)
    return float(low), float(high)


# -- MuJoCo --

MUJOCO_NAME = "MuJoCo"
TIMESTEP_S = 0.002
MUJOCO_REMARKS = (
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
        made = describe(fitted, supplied, MUJOCO_NAME, BODY)
        return Exported("\n".join(model_lines(made)) + "\n", made.omitted)


def model_lines(made: VehicleDescription) -> list[str]:
    """The file, of the first row."""
    value = {name: float(column[0]) for name, column in made.values.items()}
    rotors, arm = rotors_of(made), value["arm_scale"]
    most = float((rotors.largest_speed[0] / rotors.hover_speed[0]) ** 2)
    limits = f' ctrlrange="0 {most!r}"' if "largest_command" in value else ""
    gain = value["mass"] * GRAVITY / made.count
    inertia = " ".join(repr(value[name]) for name in INERTIAS)
    positions = list(enumerate(made.vehicle.positions, start=1))
    text = " ".join("1" * made.count)
    axes = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}
    slides = (
        f'      <joint name="{axis}" type="slide" axis="{axes[axis]}" damping="{value.get(name, 0.0)!r}"/>'
        for axis, name in zip(axes, DRAGS, strict=True)
    )
    return [
        '<?xml version="1.0"?>',
        *xml_comments((*made.comments, *MUJOCO_REMARKS, *delay_comments(made, MUJOCO_NAME))),
        '<mujoco model="vehicle">',
        f'  <option timestep="{TIMESTEP_S}" gravity="0 0 {-GRAVITY}" integrator="implicitfast"/>',
        "  <worldbody>",
        '    <body name="vehicle" pos="0 0 1">',
        *slides,
        '      <joint name="attitude" type="ball"/>',
        f'      <inertial pos="0 0 0" mass="{value["mass"]!r}" diaginertia="{inertia}"/>',
        f'      <geom type="sphere" size="{0.5 * arm * made.vehicle.arm!r}" contype="0" conaffinity="0"/>',
        *(f'      <site name="rotor{n}" pos="{arm * x!r} {arm * y!r} 0"/>' for n, (x, y) in positions),
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
        f'  <keyframe><key name="hover" qpos="0 0 0 1 0 0 0" act="{text}" ctrl="{text}"/></keyframe>',
        "</mujoco>",
    ]


# -- MuJoCo draws --

MUJOCO_DRAWS_SCHEMA = "eivor.draws.mujoco/1"


@final
class MujocoDraws(Randomisation):
    """Controls count as in the model: one hovers the vehicle of the estimates, not that of a row."""

    name = "mujoco"
    words = "fields of MuJoCo's model (JSON)"

    def export(self, fitted: Fitted, supplied: Supplied, draws: Columns, seed: int) -> Exported:
        """See `Randomisation`."""
        made = describe(fitted, supplied, MUJOCO_NAME, BODY)
        drawn = describe(fitted, supplied, MUJOCO_NAME, BODY, draws, seed)
        document = {
            "schema": MUJOCO_DRAWS_SCHEMA,
            "comments": [one_line(line) for line in (JOINT, *made.comments, *MUJOCO_REMARKS)],
            "fields": {name: _field.tolist() for name, _field in _fields(drawn, made).items()},
        }
        return Exported(json.dumps(document) + "\n", made.omitted)


def _fields(drawn: VehicleDescription, made: VehicleDescription) -> dict[str, Float[np.ndarray, "n ..."]]:
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


# -- PyBullet --

PYBULLET_NAME = "gym-pybullet-drones"
#: What it takes gravity for [m/s^2].
PYBULLET_GRAVITY = 9.8
PYBULLET_REMARKS = (
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
        made = describe(fitted, supplied, PYBULLET_NAME, needs)
        order = by_quarters(made.vehicle, PYBULLET_NAME)
        value = {name: float(column[0]) for name, column in made.values.items()}
        rotors, arm = rotors_of(made, PYBULLET_GRAVITY), value["arm_scale"]
        thrust, speed = float(rotors.thrust_constant[0]), float(rotors.largest_speed[0])
        sign = -made.vehicle.spins[order[0]]
        prediction, aside = mean_distances(made.vehicle)
        size = arm * made.vehicle.arm
        properties = {
            "arm": size,
            "kf": thrust * PER_MINUTE**2,
            "km": sign * float(rotors.torque_constant[0]) * PER_MINUTE**2,
            "thrust2weight": made.count * thrust * speed**2 / (value["mass"] * PYBULLET_GRAVITY),
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
        unlike = (
            []
            if lag is None
            else [f"{PYBULLET_NAME} has no lag of the rotors: {lag:.4g} s is not in this file."]
        )
        comments = (
            *made.comments,
            *speed_comments(made, PYBULLET_NAME, PYBULLET_GRAVITY),
            *unlike,
            *PYBULLET_REMARKS,
        )
        positions = [(arm * prediction * x, arm * aside * y) for x, y in QUARTERS]
        text = " ".join(f"{name}={quoteattr(repr(item))}" for name, item in properties.items())
        lines = [
            '<?xml version="1.0" ?>',
            *xml_comments(comments),
            '<robot name="vehicle">',
            f"  <properties {text}/>",
            *_body(value, size),
            *(line for n, (x, y) in enumerate(positions) for line in _massless(f"prop{n}", x, y)),
            *_massless("center_of_mass", 0.0, 0.0),
            "</robot>",
        ]
        return Exported("\n".join(lines) + "\n", made.omitted)


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


# -- RotorPy --

#: What RotorPy takes gravity for [m/s^2].
ROTORPY_GRAVITY = 9.81
ROTORPY_NAME = "RotorPy"
ROTORPY_NEEDS = (*BODY, "largest_command")


@final
class RotorpyVehicle(Target):
    """A file to import ``quad_params`` from."""

    name = "rotorpy"
    words = "a vehicle of RotorPy (Python file with quad_params)"
    ending = ".py"

    def export(self, fitted: Fitted, supplied: Supplied) -> Exported:
        """See `Target`."""
        made = describe(fitted, supplied, ROTORPY_NAME, ROTORPY_NEEDS)
        return Exported("\n".join(vehicle_lines(made)) + "\n", made.omitted)


def vehicle_lines(made: VehicleDescription) -> list[str]:
    """The file: comments, and the dictionary of the first row."""
    row = {name: float(column[0]) for name, column in rotorpy_columns(made).items()}
    arm = float(made.values["arm_scale"][0])
    positions = [
        f'        "r{number}": np.array([{arm * x!r}, {arm * y!r}, 0.0]),'
        for number, (x, y) in enumerate(made.vehicle.positions, start=1)
    ]
    return [
        *hash_comments((*made.comments, *speed_comments(made, ROTORPY_NAME, ROTORPY_GRAVITY))),
        "import numpy as np",
        "",
        "quad_params = {",
        *(f'    "{name}": {value!r},' for name, value in row.items()),
        f'    "num_rotors": {made.count},',
        '    "rotor_pos": {',
        *positions,
        "    },",
        f'    "rotor_directions": np.array({list(made.vehicle.spins)}),',
        '    "rI": np.zeros(3),',
        "}",
    ]


def rotorpy_columns(made: VehicleDescription) -> Columns:
    """RotorPy's numbers by its names, a row for each vehicle."""
    values, rotors = made.values, rotors_of(made, ROTORPY_GRAVITY)
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


# -- RotorPy draws --

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
        made = describe(fitted, supplied, ROTORPY_NAME, ROTORPY_NEEDS)
        drawn = describe(fitted, supplied, ROTORPY_NAME, ROTORPY_NEEDS, draws, seed)
        columns = {
            name: rotorpy_column
            for name, rotorpy_column in rotorpy_columns(drawn).items()
            if rotorpy_column.min() < rotorpy_column.max()
        }
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
        return Exported("\n".join(lines) + VEHICLES, made.omitted)


# -- SIH --

SIH_NAME = "SIH"
SIH_REMARKS = (
    "Thrust goes linearly with a motor's signal in SIH: THR_MDL_FAC is 0, for the simulation alone.",
    "SIH drags in every direction as along z.",
)


@final
class SihParameters(Target):
    """A file of QGroundControl for the simulation; not for the vehicle."""

    name = "sih"
    words = "PX4's simulator SIH (.params of QGroundControl): SIH_MASS, SIH_T_MAX, SIH_T_TAU, SIH_KDV, ..."
    ending = ".params"

    def export(self, fitted: Fitted, supplied: Supplied) -> Exported:
        """See `Target`."""
        made = describe(fitted, supplied, SIH_NAME, (*BODY, "largest_command"))
        by_quarters(made.vehicle, SIH_NAME)
        value = {name: float(column[0]) for name, column in made.values.items()}
        prediction, aside = mean_distances(made.vehicle)
        largest = value["thrust"] * float(made.thrust_map(made.values["largest_command"])[0])
        values = {
            "SIH_MASS": value["mass"],
            **{f"SIH_I{axes.upper()}": value[f"inertia_{axes}"] for axes in ("xx", "yy", "zz")},
            **dict.fromkeys(("SIH_IXY", "SIH_IXZ", "SIH_IYZ"), 0.0),
            "SIH_T_MAX": largest,
            "SIH_Q_MAX": value["torque_ratio"] * largest,
            "SIH_L_ROLL": value["arm_scale"] * aside,
            "SIH_L_PITCH": value["arm_scale"] * prediction,
            "SIH_T_TAU": value["actuator_lag"],
            **({"SIH_KDV": value["drag_z"]} if "drag_z" in value else {}),
            "THR_MDL_FAC": 0.0,
        }
        hover = value["mass"] * GRAVITY / (made.count * largest)
        remarks = [*SIH_REMARKS, *delay_comments(made, SIH_NAME)]
        beyond = PX4.hover.beyond((hover, (hover, hover)))
        if beyond:
            remarks.append(f"MPC_THR_HOVER is not written: {beyond}")
        else:
            values["MPC_THR_HOVER"] = hover
        return Exported(qgroundcontrol((*made.comments, *remarks), values), made.omitted)
