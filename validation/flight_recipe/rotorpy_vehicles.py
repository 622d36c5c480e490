"""RotorPy's multirotors: parameter sets, and the integrator and controller that suit them.

RotorPy: rotor speed w' = (command - w)/tau_m with the command clipped to the rotor's range, thrust
k_eta w^2 along the body's z, rotor drag -k_z w v_z for each rotor (v the air velocity in the body's
axes), parasitic drag -c |v| v. In still air at hover, K = k_z (sum of the hover speeds)/m: parasitic
drag is quadratic and adds nothing there, and K_u = (number of rotors) k_eta/m for the mean squared speed.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Any

import numpy as np

from eivor.errors import MissingReaderError
from eivor.motions.rigid_body.vehicle import BodyDrag, Rotors
from eivor.motions.rigid_body.vehicle import Vehicle as RigidBody

#: Step of the controller and of the log [s].
STEP_S = 0.01
#: RotorPy's acceleration of gravity [m/s^2].
GRAVITY = 9.81


class Vehicle(StrEnum):
    """The multirotors: two that RotorPy ships and one of 1.2 kg."""

    CRAZYFLIE = "crazyflie"
    HUMMINGBIRD = "hummingbird"
    MEDIUM = "medium-1.2kg"


#: A quadrotor of 1.2 kg in the size of the common 450 mm frames; Eivor's own choice, not a measured
#: vehicle. k_eta: a 10 x 4.5 inch propeller, C_T about .11 in C_T rho D^4/(2 pi)^2. k_m/k_eta: .016 m,
#: usual for such propellers. Inertia: scaled from the shipped Hummingbird by mass x arm^2. k_z: makes K
#: about .4 1/s at hover, the size published for real quadrotors; k_d: half of it, as in the Hummingbird.
_MEDIUM: Mapping[str, Any] = {
    "mass": 1.2,
    "Ixx": 0.0153,
    "Iyy": 0.0155,
    "Izz": 0.0296,
    "Ixy": 0.0,
    "Iyz": 0.0,
    "Ixz": 0.0,
    "num_rotors": 4,
    "rotor_pos": {
        "r1": np.array([0.1591, 0.1591, 0.0]),
        "r2": np.array([0.1591, -0.1591, 0.0]),
        "r3": np.array([-0.1591, -0.1591, 0.0]),
        "r4": np.array([-0.1591, 0.1591, 0.0]),
    },
    "rotor_directions": np.array([1, -1, 1, -1]),
    "rI": np.zeros(3),
    "c_Dx": 0.01,
    "c_Dy": 0.01,
    "c_Dz": 0.02,
    "k_eta": 1.39e-5,
    "k_m": 2.2e-7,
    "k_d": 1.3e-4,
    "k_z": 2.6e-4,
    "k_h": 0.0,
    "k_flap": 0.0,
    "tau_m": 0.04,
    "rotor_speed_min": 0,
    "rotor_speed_max": 900,
    "motor_noise_std": 0.0,
    "kp_att": 544,
    "kd_att": 46.64,
}


def vehicle_parameters(vehicle: Vehicle, lag_s: float | None) -> dict[str, Any]:
    """RotorPy's parameter set of the vehicle, with another actuator lag when one is given [s]."""
    try:
        from rotorpy.vehicles import crazyflie_params, hummingbird_params
    except ModuleNotFoundError as error:
        raise MissingReaderError(
            "the simulator RotorPy",
            f"an environment without it ({error})",
            "Install it: python -m pip install 'rotorpy>=3.0'.",
        ) from error
    sets: Mapping[Vehicle, Mapping[str, Any]] = {
        Vehicle.CRAZYFLIE: crazyflie_params.quad_params,
        Vehicle.HUMMINGBIRD: hummingbird_params.quad_params,
        Vehicle.MEDIUM: _MEDIUM,
    }
    parameters = dict(sets[vehicle])
    if lag_s is not None:
        parameters["tau_m"] = lag_s
    return parameters


def rigid_body(parameters: Mapping[str, Any]) -> RigidBody:
    """Vehicle of Eivor's own simulator with RotorPy's parameters."""
    moments = tuple(float(parameters[name]) for name in ("Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz"))
    quadratic = tuple(float(parameters.get(name, 0.0)) for name in ("c_Dx", "c_Dy", "c_Dz"))
    thrust, torque = float(parameters["k_eta"]), float(parameters["k_m"])
    rotors = Rotors(
        positions=tuple(tuple(float(x) for x in parameter) for parameter in parameters["rotor_pos"].values()),
        spins=tuple(int(direction) for direction in parameters["rotor_directions"]),
        highest_speed=float(parameters["rotor_speed_max"]),
        lowest_speed=float(parameters["rotor_speed_min"]),
        thrust_quadratic=thrust,
        torque_ratio=torque / thrust,
        lag_up=float(parameters["tau_m"]),
        lag_down=float(parameters["tau_m"]),
        drag=float(parameters.get("k_d", 0.0)),
        inflow=float(parameters.get("k_z", 0.0)),
        translational_lift=float(parameters.get("k_h", 0.0)),
        flapping=float(parameters.get("k_flap", 0.0)),
    )
    return RigidBody(float(parameters["mass"]), moments, rotors, BodyDrag(quadratic=quadratic))


def hover_speed(parameters: Mapping[str, Any]) -> float:
    """Rotor speed at which the thrust carries the weight [rad/s]."""
    lift = parameters["num_rotors"] * parameters["k_eta"]
    return float(np.sqrt(parameters["mass"] * GRAVITY / lift))


def integrator_options(lag: float) -> dict[str, Any]:
    """Options of the integrator, by the actuator's lag [s]."""
    method = "RK45" if lag >= 4.0 * STEP_S else "DOP853"
    return {"method": method, "rtol": 1e-6, "atol": 1e-7, "first_step": min(STEP_S, lag)}


def tuned_controller(parameters: Mapping[str, Any], delay_s: float) -> Any:
    """RotorPy's SE3 controller, its gains lowered where the actuator's lag asks for it."""
    from rotorpy.controllers.quadrotor_control import SE3Control

    controller = SE3Control(dict(parameters))
    slowness = float(parameters["tau_m"]) + delay_s + STEP_S / 2
    controller.kd_att = min(controller.kd_att, 0.6 / slowness)
    controller.kp_att = min(controller.kp_att, 0.3 / slowness * controller.kd_att)
    sideways, upward = min(4.0, 0.15 / slowness), min(9.0, 0.9 / slowness)
    controller.kd_pos = np.array([sideways, sideways, upward])
    side_gain = min(6.5, 0.06 / slowness * sideways)
    controller.kp_pos = np.array([side_gain, side_gain, min(15.0, 0.185 * upward**2)])
    return controller
