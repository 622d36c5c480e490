"""Exports to simulators: a table, a function and a template each, and draws of vehicles; targets by name."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from eivor import checks
from eivor.exports import vehicle
from eivor.exports.autopilots import ARDUPILOT, AUTOPILOTS, PX4
from eivor.exports.fitted import (
    Exported,
    Fitted,
    Supplied,
    Target,
    hash_comments,
    one_line,
    targets,
)
from eivor.exports.models import DRAWN_MODELS, MODELS
from eivor.exports.vehicle import REMARKS, Columns, ExportOfDraws, VehicleDescription
from eivor.motions.vertical.model import share_of
from eivor.signals.recording import GRAVITY
from eivor.signals.thrust_map import Mixed
from eivor.tools import Float

#: What simulators take gravity for [m/s^2].
GAZEBO_GRAVITY = PYBULLET_GRAVITY = 9.8
ROTORPY_GRAVITY = ISAAC_LAB_GRAVITY = 9.81
PER_MINUTE = 2.0 * math.pi / 60.0
WITH_LARGEST = (*vehicle.BODY, "largest_command")


def _describe(
    fitted: Fitted, supplied: Supplied, target: str, gravity: float, needs: tuple[str, ...] = WITH_LARGEST
) -> tuple[VehicleDescription, dict[str, float], dict[str, float], tuple[str, ...]]:
    """A vehicle, numbers of its first row, those of its rotors, and comments."""
    craft = vehicle.describe(fitted, supplied, target, needs)
    comments = (*craft.comments, *vehicle.speed_comments(craft, target, gravity))
    value, rotor = vehicle.first_row(craft.values), vehicle.first_row(vehicle.rotors_of(craft, gravity))
    return craft, value, rotor, comments


def _drone_models(fitted: Fitted, supplied: Supplied) -> Exported:
    """Parameters, and the dynamics with what the parameters cannot hold as a disturbance."""
    craft, value, rotor, comments = _describe(fitted, supplied, "drone-models", GRAVITY, vehicle.BODY)
    arm = value["arm_scale"] * craft.vehicle.arm
    forward, left = vehicle.rotor_positions(craft)[0].T / arm
    return vehicle.render(
        "drone-models.txt",
        craft,
        comments,
        gravity=GRAVITY,
        arm=arm,
        thrust=rotor["thrust_constant"] * PER_MINUTE**2,
        torque=rotor["torque_constant"] * PER_MINUTE**2,
        mixing=np.stack([left, 0.0 - forward, craft.vehicle.spins]).tolist(),
        c=asdict(vehicle.coefficients(craft)),
    )


#: A rotor's share of the mass.
ROTOR_SHARE = 0.005
#: What joints are slower than rotors; the inertia of a rotor is larger by as much.
SLOWDOWN = 10.0


def _gazebo(fitted: Fitted, supplied: Supplied) -> Exported:
    """Commands are rotor speeds on the topic command/motor_speed."""
    craft, value, rotor, comments = _describe(fitted, supplied, "Gazebo", GAZEBO_GRAVITY)
    mass, arm = value["mass"], value["arm_scale"]
    rotor_mass, body_mass = ROTOR_SHARE * mass, mass * (1.0 - craft.vehicle.count * ROTOR_SHARE)
    radius = craft.vehicle.rotor_radius or 0.5 * arm * craft.vehicle.arm
    disc = rotor_mass * radius**2 * np.diag([0.25, 0.25, 0.5])
    if "rotor_inertia" in value:
        disc = SLOWDOWN * value["rotor_inertia"] * np.diag([0.5, 0.5, 1.0])
    # the body without its rotors, about its own centre of mass
    positions = _rotor_positions(craft)[0]
    com = np.array([*(value.get(name, 0.0) for name in vehicle.CENTRE), -value.get(vehicle.HEIGHT, 0.0)])
    centre = 0.0 - rotor_mass * positions.sum(axis=0) / body_mass
    inertia = np.diag([value[name] for name in vehicle.INERTIAS]) - body_mass * _point_inertia(centre)
    inertia -= sum(disc + rotor_mass * _point_inertia(point) for point in positions)
    return vehicle.render(
        "gazebo.sdf",
        craft,
        comments,
        rotor=rotor,
        lags=vehicle.rotor_lags(value),
        rest=body_mass,
        each=rotor_mass,
        centre=(com + centre).tolist(),
        slowdown=SLOWDOWN,
        size=arm * craft.vehicle.arm,
        radius=radius,
        disc=disc.tolist(),
        inertia=inertia.tolist(),
    )


def _px4_gazebo(fitted: Fitted, supplied: Supplied) -> Exported:
    """Elements to put into an existing model of PX4, whose geometry stays."""
    craft, value, rotor, comments = _describe(fitted, supplied, "a model of PX4", GAZEBO_GRAVITY)
    lags = vehicle.rotor_lags(value)
    return vehicle.render("px4.xml", craft, comments, rotor=rotor, lags=lags)


def _point_inertia(point: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"]:
    """Inertia of a point of one kilogram about the origin."""
    return np.asarray(point @ point * np.eye(3) - np.outer(point, point))


#: Isaac Lab's Thruster takes no thrust_const below it, until an environment is reset [N/rps^2].
ISAAC_LAB_LEAST_THRUST = 1e-6


def _isaac_lab(fitted: Fitted, supplied: Supplied, draws: Columns, seed: int) -> Exported:
    """``events``, ``thruster`` and ``draws``, as plain dictionaries."""
    craft, *_, comments = _describe(fitted, supplied, "Isaac Lab", ISAAC_LAB_GRAVITY)
    sample = vehicle.describe(fitted, supplied, "Isaac Lab", WITH_LARGEST, draws, seed)
    values, rotors = sample.values, vehicle.rotors_of(sample, ISAAC_LAB_GRAVITY)
    columns = {
        "mass": values["mass"],
        **{name: values[name] for name in vehicle.INERTIAS},
        "thrust_const": rotors["thrust_constant"] * (2.0 * math.pi) ** 2,
        "thrust_max": rotors["thrust_constant"] * rotors["largest_speed"] ** 2,
        "time_constant": values["actuator_lag"],
        "torque_to_thrust_ratio": values["torque_ratio"],
    }
    if "drag_z" in values:
        columns["linear_damping"] = values["drag_z"] / values["mass"]
    columns |= {
        f"com_{axis}": values[name] for axis, name in zip("xy", vehicle.CENTRE, strict=True) if name in values
    }
    if np.any(columns["thrust_const"] < ISAAC_LAB_LEAST_THRUST):
        comments = (*comments, REMARKS["isaac_lab"])
    return vehicle.render(
        "isaaclab.txt",
        craft,
        (REMARKS["draws"], *comments),
        columns=columns,
        ranges={
            name: tuple(np.quantile(column, (0.025, 0.975)).tolist()) for name, column in columns.items()
        },
        medians={name: float(np.median(column)) for name, column in columns.items()},
    )


#: Density of a fluid whose added mass is none [kg/m^3].
THIN = 1e-6


def _mujoco_vehicle(fitted: Fitted, supplied: Supplied) -> VehicleDescription:
    """With all that MuJoCo lacks: an ellipsoid drags along all axes or along none."""
    craft = vehicle.describe(fitted, supplied, "MuJoCo", vehicle.BODY)
    if 0 < sum(name in craft.values for name in vehicle.QUADRATIC) < len(vehicle.QUADRATIC):
        return vehicle.describe(fitted, supplied, "MuJoCo", vehicle.BODY, also=("square",))
    return craft


def _mujoco_drags(craft: VehicleDescription) -> list[Float[np.ndarray, " n"]]:
    """Drag along and about the axes; drag above the centre of mass also acts against turning."""
    values, zero = craft.values, np.zeros_like(craft.values["mass"])
    torques = zip(vehicle.TORQUES, vehicle.rotor_damping(craft), strict=True)
    drags = [values.get(name, zero) for name in vehicle.DRAGS] + [values.get(*torque) for torque in torques]
    along_x, along_y = drags[:2]
    for row, drag in ((3, along_y), (4, along_x)):
        drags[row] = drags[row] - drag * values.get(vehicle.HEIGHT, zero) ** 2
    return drags


def _mujoco(fitted: Fitted, supplied: Supplied) -> Exported:
    """Numbers stand where MuJoCo's fields have them, so that draws may take their places."""
    craft = _mujoco_vehicle(fitted, supplied)
    value, rotor = vehicle.first_row(craft.values), vehicle.first_row(vehicle.rotors_of(craft))
    limited = "largest_command" in value
    remarks = [*REMARKS["mujoco"], *([] if limited else [REMARKS["mujoco_limits"]])]
    size, fluid = 0.5 * value["arm_scale"] * craft.vehicle.arm, None
    if all(name in value for name in vehicle.QUADRATIC):
        # the area that an ellipsoid has along an axis, times a coefficient, is the drag along it
        drag = np.array([value[name] for name in vehicle.QUADRATIC])
        unit = drag.prod() ** (1.0 / 3.0) / size**2
        fluid = (unit / (math.pi * THIN), (np.sqrt(drag.prod() / unit) / drag).tolist())
    return vehicle.render(
        "mujoco.xml",
        craft,
        (*craft.comments, *remarks),
        gravity=GRAVITY,
        size=size,
        fluid=fluid,
        thin=THIN,
        gain=value["mass"] * GRAVITY / craft.vehicle.count,
        most=(rotor["largest_speed"] / rotor["hover_speed"]) ** 2 if limited else 100.0,
        drag=[float(column[0]) for column in _mujoco_drags(craft)],
        hover=" ".join([*["1"] * craft.vehicle.count, *["0"] * 6]),
        ones=" ".join("1" * craft.vehicle.count),
    )


def _mujoco_draws(fitted: Fitted, supplied: Supplied, draws: Columns, seed: int) -> Exported:
    """Controls count as in the model: one hovers the vehicle of the estimates, not that of a row."""
    craft = _mujoco_vehicle(fitted, supplied)
    sample = vehicle.describe(fitted, supplied, "MuJoCo", vehicle.BODY, draws, seed)
    values = sample.values
    zero = np.zeros_like(values["mass"])
    drag_sites = np.tile([*vehicle.drag_centre(craft), 0.0], (zero.size, 1, 1))
    drag_sites[:, 0, 2] = values.get(vehicle.HEIGHT, zero)
    rotors = np.pad(np.multiply.outer(values["arm_scale"], craft.vehicle.positions), ((0, 0), (0, 0), (0, 1)))
    fields: Mapping[str, Float[np.ndarray, "n ..."]] = {  # gears are of a rotor that spins clockwise
        "body_mass": values["mass"],
        "body_inertia": np.stack([values[name] for name in vehicle.INERTIAS], axis=1),
        "body_ipos": np.stack([*(values.get(name, zero) for name in vehicle.CENTRE), zero], axis=1),
        "actuator_biasprm": 0.0 - np.stack(_mujoco_drags(sample), axis=1),
        "actuator_gainprm": values["thrust"] * vehicle.mapped_hover(craft),
        "actuator_dynprm": values["actuator_lag"],
        "actuator_gear": values["torque_ratio"],
        "site_pos": np.concatenate([drag_sites, rotors], axis=1),
    }
    document = {
        "schema": "eivor.draws.mujoco/1",
        "comments": [one_line(line) for line in (REMARKS["draws"], *craft.comments, *REMARKS["mujoco"])],
        "fields": {name: column.tolist() for name, column in fields.items()},
    }
    return Exported(json.dumps(document) + "\n", craft.omitted, craft.lost)


def _pybullet(fitted: Fitted, supplied: Supplied) -> Exported:
    """A class that applies the forces, which PyBullet itself has none of."""
    craft, value, rotor, comments = _describe(fitted, supplied, "PyBullet", PYBULLET_GRAVITY, vehicle.BODY)
    return vehicle.render(
        "pybullet.txt",
        craft,
        comments,
        c=asdict(vehicle.coefficients(craft)) | {"thrust_quadratic": rotor["thrust_constant"]},
        hover=vehicle.manoeuvre(craft, 0.0)[0].tolist(),
        most=rotor["largest_speed"] if math.isfinite(rotor["largest_speed"]) else None,
        size=0.5 * value["arm_scale"] * craft.vehicle.arm,
    )


URDF = "gym-pybullet-drones"


def _urdf(fitted: Fitted, supplied: Supplied) -> Exported:
    """Without the lag of the rotors, which gym-pybullet-drones does not have."""
    needs = tuple(name for name in WITH_LARGEST if name != "actuator_lag")
    craft, value, rotor, comments = _describe(fitted, supplied, URDF, PYBULLET_GRAVITY, needs)
    order = vehicle.by_quarters(craft.vehicle, URDF)
    forward, sideways = vehicle.mean_distances(craft.vehicle)
    arm, thrust = value["arm_scale"], rotor["thrust_constant"]
    size, weight = arm * craft.vehicle.arm, value["mass"] * PYBULLET_GRAVITY
    return vehicle.render(
        "gym.urdf",
        craft,
        comments,
        rotor=rotor,
        thrust=thrust * PER_MINUTE**2,
        torque=-craft.vehicle.spins[order[0]] * rotor["torque_constant"] * PER_MINUTE**2,
        weights=craft.vehicle.count * thrust * rotor["largest_speed"] ** 2 / weight,
        size=size,
        radius=craft.vehicle.rotor_radius or 0.5 * size,
        positions=[(arm * forward * x, arm * sideways * y) for x, y in vehicle.QUARTERS],
    )


def _rotorpy(fitted: Fitted, supplied: Supplied, draws: Columns | None = None, seed: int = 0) -> Exported:
    """Draws are for ``BatchedMultirotorParams(vehicles, ...)``, or ``Multirotor(vehicle)`` each."""
    craft, *_, comments = _describe(fitted, supplied, "RotorPy", ROTORPY_GRAVITY)
    values: dict[str, object] = {
        "row": vehicle.first_row(_rotorpy_columns(craft)),
        "positions": _rotor_positions(craft)[0].tolist(),
    }
    if draws is not None:
        sample = vehicle.describe(fitted, supplied, "RotorPy", WITH_LARGEST, draws, seed)
        columns = _rotorpy_columns(sample)
        varying = {name: column for name, column in columns.items() if column.min() < column.max()}
        comments = (REMARKS["draws"], *comments)
        values |= {"draws": varying, "places": _rotor_positions(sample).tolist()}
    return vehicle.render("rotorpy.txt", craft, comments, **values)


def _rotor_positions(craft: VehicleDescription) -> Float[np.ndarray, "n rotors 3"]:
    """Where the rotors are from the centre of mass, of each vehicle [m]."""
    positions = np.pad(vehicle.rotor_positions(craft), ((0, 0), (0, 0), (0, 1)))
    positions[:, :, 2] += craft.values.get(vehicle.HEIGHT, np.zeros(1))[:, None]
    return positions


def _rotorpy_columns(craft: VehicleDescription) -> Columns:
    values, rotors = craft.values, vehicle.rotors_of(craft, ROTORPY_GRAVITY)
    zero = np.zeros_like(values["mass"])
    return {
        "mass": values["mass"],
        **{f"I{name[-2:]}": values[name] for name in vehicle.INERTIAS},
        **dict.fromkeys(("Ixy", "Ixz", "Iyz"), zero),
        **{f"c_D{name[-1]}": values.get(name, zero) for name in vehicle.QUADRATIC},
        "k_eta": rotors["thrust_constant"],
        "k_m": rotors["torque_constant"],
        "k_d": rotors["drag_across"],
        "k_z": rotors["drag_along"],
        "k_h": values.get("translational_lift", zero) / craft.vehicle.count,
        "k_flap": zero,
        "tau_m": values["actuator_lag"],
        "rotor_speed_min": zero,
        "rotor_speed_max": rotors["largest_speed"],
        "motor_noise_std": zero,
    }


def _sih(fitted: Fitted, supplied: Supplied) -> Exported:
    craft = vehicle.describe(fitted, supplied, "SIH", WITH_LARGEST)
    vehicle.by_quarters(craft.vehicle, "SIH")
    value = vehicle.first_row(craft.values)
    forward, sideways = vehicle.mean_distances(craft.vehicle)
    largest = value["thrust"] * float(craft.thrust_map(craft.values["largest_command"])[0])
    values = {
        "SIH_MASS": value["mass"],
        **{f"SIH_I{axes.upper()}": value[f"inertia_{axes}"] for axes in ("xx", "yy", "zz")},
        **dict.fromkeys(("SIH_IXY", "SIH_IXZ", "SIH_IYZ"), 0.0),
        "SIH_T_MAX": largest,
        "SIH_Q_MAX": value["torque_ratio"] * largest,
        "SIH_L_ROLL": value["arm_scale"] * sideways,
        "SIH_L_PITCH": value["arm_scale"] * forward,
        "SIH_T_TAU": value["actuator_lag"],
        "SIH_KDV": vehicle.common_value(value, "other_than_z"),
        "SIH_KDW": vehicle.common_value(value, "turning_other"),
        "THR_MDL_FAC": 0.0,
    }
    hover = value["mass"] * GRAVITY / (craft.vehicle.count * largest)
    remarks = list(REMARKS["sih"])
    if beyond := PX4.hover.beyond((hover, (hover, hover))):
        remarks.append(f"MPC_THR_HOVER is not written: {beyond}")
    else:
        values["MPC_THR_HOVER"] = hover
    return vehicle.render("px4.params", craft, (*craft.comments, *remarks), rows=values)


#: Tilt at which the reference speed is computed [rad], and the fastest that is searched [m/s].
SITL_TILT, SITL_FASTEST = math.radians(20.0), 100.0
#: What SITL makes of its numbers: the arm of the yaw torque over the diagonal, turning rates that die away
#: at this over refRotRate [deg/s], and the density of the air at refAlt 0 [kg/m^3].
SITL_YAW, SITL_DAMPING, AIR = 0.05, 400.0, 1.225
#: Speeds that rotors may have at most [Hz].
MOTOR_HZ = (10.0, 1000.0)
#: By the spin of the front right rotor: FRAME_TYPE, and `QUARTERS` in the order of its motors.
SITL_MOTORS = {-1: (1, (0, 2, 3, 1)), 1: (18, (1, 0, 2, 3))}


def _sitl_frame(fitted: Fitted, supplied: Supplied) -> tuple[VehicleDescription, int, dict[str, Any]]:
    """A frame of ArduPilot's simulator, as its sources read it: forward, right and down; with FRAME_TYPE."""
    craft = vehicle.describe(fitted, supplied, "SITL", WITH_LARGEST)
    quarters = vehicle.by_quarters(craft.vehicle, "SITL")
    frame_type, motors = SITL_MOTORS[craft.vehicle.spins[quarters[0]]]
    value, positions, count = vehicle.first_row(craft.values), _rotor_positions(craft)[0], craft.vehicle.count
    weight, diagonal = value["mass"] * GRAVITY, 2.0 * value["arm_scale"] * craft.vehicle.arm
    mapped, largest = float(vehicle.mapped_hover(craft)[0]), value["largest_command"]
    exponent, signal = vehicle.exponent_at_hover(craft), craft.thrust_map.inverse(mapped) / largest
    share = min(max(share_of(exponent, signal), 0.0), 1.0)  # the same exponent at hover, and what is exact
    if isinstance(craft.thrust_map, Mixed):
        share = craft.thrust_map.share * largest / (1.0 + craft.thrust_map.share * (largest - 1.0))
    output = (1.0 - share) * signal + share * signal**2
    gain = mapped / output / float(craft.thrust_map(craft.values["largest_command"])[0])
    if not math.isclose(gain, 1.0, rel_tol=1e-6):
        text = f"SITL has no such curve: it is as at hover, with {gain:.3g} times the thrust at full command."
        craft = replace(craft, lost=(*craft.lost, text), comments=(*craft.comments, text))
    hover = vehicle.manoeuvre(craft, 0.0)[0] / vehicle.rotors_of(craft)["hover_speed"]
    linear, quadratic = (vehicle.common_value(value, name) for name in ("other_than_x", "quadratic_other"))
    disc = count * math.pi * (craft.vehicle.rotor_radius or 0.25 * diagonal) ** 2
    push, tilted = weight * math.tan(SITL_TILT), linear * math.cos(SITL_TILT) ** 1.5
    steady = max(tilted + math.sqrt(tilted**2 + 4.0 * quadratic * push), 2.0 * push / SITL_FASTEST)
    rotor_drag = linear / count * float(np.square(positions[:, 1:]).sum())
    damping = (vehicle.common_value(value, "turning_other") - rotor_drag) / value["inertia_xx"]
    frame = vehicle.TABLES["sitl"] | {
        "mass": value["mass"],
        "diagonal_size": diagonal,
        "moment_inertia": [value[name] for name in vehicle.INERTIAS],
        "refSpd": 2.0 * push / steady,
        "refAngle": math.degrees(SITL_TILT),
        "propExpo": share,
        "refRotRate": math.radians(SITL_DAMPING) / damping if damping > 0.0 else 0.0,
        "hoverThrOut": output,
        "disc_area": disc,
        "mdrag_coef": linear / math.sqrt(AIR * disc * weight),
        "num_motors": count,
    }
    for number, rotor in enumerate((quarters[quarter] for quarter in motors), 1):
        x, y, z = positions[rotor].tolist()
        frame[f"motor{number}_position"] = [x, -y, -z]
        yaw = -craft.vehicle.spins[rotor] * value["torque_ratio"] * exponent / (1.0 + exponent)
        at_hover = signal * hover[rotor] ** (2.0 / exponent)  # so that unequal rotors do not turn it
        frame[f"motor{number}_yaw"] = yaw / (SITL_YAW * diagonal * at_hover)
    return craft, frame_type, frame


def _sitl(fitted: Fitted, supplied: Supplied) -> Exported:
    craft, _, frame = _sitl_frame(fitted, supplied)
    # SITL reads from the first brace on: comments stand behind it
    comments = hash_comments((*craft.comments, *REMARKS["sitl"]))
    return Exported(f"{{\n{comments}\n{json.dumps(frame, indent=2)[2:]}\n", craft.omitted, craft.lost)


def _sitl_parameters(fitted: Fitted, supplied: Supplied) -> Exported:
    """What ArduPilot flies the frame with, and the ``SIM_`` parameters that are of the vehicle."""
    craft, frame_type, frame = _sitl_frame(fitted, supplied)
    largest_hz = float(vehicle.rotors_of(craft)["largest_speed"][0]) / (2.0 * math.pi)
    rows = {
        "FRAME_CLASS": 1.0,
        "FRAME_TYPE": frame_type,
        **{f"MOT_{name.upper()}": frame[name] for name in ("spin_min", "spin_max")},
        **{f"MOT_PWM_{name[3:].upper()}": frame[name] for name in ("pwmMin", "pwmMax")},
        "MOT_THST_EXPO": frame["propExpo"],
        "MOT_THST_HOVER": frame["hoverThrOut"],
        "SIM_VIB_MOT_MAX": largest_hz,
        "SIM_FRM_MASS": frame["mass"],
        "SIM_FRM_MDRAG": frame["mdrag_coef"],
    }
    beyond = ARDUPILOT.hover.beyond((frame["hoverThrOut"], (frame["hoverThrOut"],) * 2))
    speeds = craft.thrust_map.name == "square" and MOTOR_HZ[0] <= largest_hz <= MOTOR_HZ[1]
    no_speeds = "" if speeds else "commands are no rotor speeds. Give --prior speed_scale=VALUE."
    missing = {"MOT_THST_HOVER": beyond, "SIM_VIB_MOT_MAX": no_speeds}
    remarks = [f"{name} is not written: {why}" for name, why in missing.items() if why]
    remarks.append(REMARKS["sitl_parameters"])
    values = {name: value for name, value in rows.items() if not missing.get(name)}
    return vehicle.render("ardupilot.param", craft, (*craft.comments, *remarks), rows=values)


SIMULATORS = targets(
    {
        "sih": _sih,
        "rotorpy": _rotorpy,
        "mujoco": _mujoco,
        "pybullet": _pybullet,
        "urdf": _urdf,
        "gazebo": _gazebo,
        "px4-gazebo": _px4_gazebo,
        "sitl": _sitl,
        "sitl-parameters": _sitl_parameters,
        "drone-models": _drone_models,
    }
)
DRAWN: dict[str, ExportOfDraws] = {"rotorpy": _rotorpy, "mujoco": _mujoco_draws, "isaaclab": _isaac_lab}
#: Files of draws by their word on the command line.
RANDOMISATIONS: dict[str, ExportOfDraws] = DRAWN | DRAWN_MODELS
TARGETS: dict[str, Target] = {target.name: target for target in (*AUTOPILOTS, *MODELS, *SIMULATORS)}


def motions_for(target: str) -> tuple[str, ...]:
    """Names of the motions that a target takes, the preferred one first."""
    if target in {item.name for item in MODELS}:
        return ("vertical", "rigid-body", "rates")
    is_autopilot = target in {item.name for item in AUTOPILOTS}
    return ("vertical",) if is_autopilot else ("rigid-body", "vertical")


def target_by_name(name: str) -> Target:
    """Target of a word."""
    remedy = "It takes draws: --draws 1000." if name in RANDOMISATIONS else "Name one of them."
    checks.index_of("a target", name, TARGETS, remedy)
    return TARGETS[name]
