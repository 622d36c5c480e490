"""Closed-loop flights of RotorPy's multirotors: a simulator that others wrote and that Eivor never fits.

Conventions, settled here once:

* Controller and log run at 100 Hz. At each stamp the controller reads the noisy measurements, the same
  values are logged, and its command is held until the next stamp. A delay of d means that the command
  issued at t reaches the rotors at t + d; the log holds it at t, as an autopilot's log does.
* RotorPy: z up, quaternions [x, y, z, w] body to world. Its accelerometer reads R'(v' + g e3). Wind is
  held over a step.
* A lost vehicle ends the flight; what was logged until then is kept.
"""

from __future__ import annotations

import tomllib
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from eivor.errors import MissingReaderError
from eivor.motions.rigid_body.vehicle import BodyDrag, Rotors
from eivor.motions.rigid_body.vehicle import Vehicle as RigidBody
from eivor.signals.recording import Recording
from eivor.simulation.environment import (
    Errors,
    SensorNoise,
    SimulatedFlight,
    Trajectory,
    TrajectoryKind,
    altitude_reference,
    gusts,
    simulated_recording,
)
from validation.effective_parameters import FlightTruth

#: Step of the controller and of the log [s].
STEP_S = 0.01
#: RotorPy's acceleration of gravity [m/s^2].
GRAVITY = 9.81


class Vehicle(StrEnum):
    """The multirotors: two that RotorPy ships and one of 1.2 kg."""

    CRAZYFLIE = "crazyflie"
    HUMMINGBIRD = "hummingbird"
    MEDIUM = "medium-1.2kg"


def vehicle_parameters(vehicle: str, lag_s: float | None) -> dict[str, Any]:
    """RotorPy's parameter set of the vehicle, with another actuator lag when one is given [s]."""
    try:
        from rotorpy.vehicles import crazyflie_params, crazyfliebrushless_params, hummingbird_params
    except ModuleNotFoundError as error:
        raise MissingReaderError(
            "the simulator RotorPy",
            f"an environment without it ({error})",
            "Install it: python -m pip install 'rotorpy>=3.0'.",
        ) from error
    sets: dict[str, Any] = {
        Vehicle.CRAZYFLIE: crazyflie_params.quad_params,
        "crazyflie-brushless": crazyfliebrushless_params.quad_params,
        Vehicle.HUMMINGBIRD: hummingbird_params.quad_params,
        **tomllib.loads(Path(__file__).with_name("multirotors.toml").read_text(encoding="utf-8")),
    }
    parameters = sets.get(sets[vehicle].get("base"), {}) | sets[vehicle]
    if isinstance(parameters["rotor_pos"], list):
        parameters["rotor_pos"] = dict(enumerate(np.array(parameters["rotor_pos"])))
        parameters["rotor_directions"] = np.array(parameters["rotor_directions"])
    return parameters if lag_s is None else parameters | {"tau_m": lag_s}


def rigid_body(parameters: Mapping[str, Any]) -> RigidBody:
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


def initial_state(
    reference: Trajectory, hover: Float[np.ndarray, " rotors"]
) -> dict[str, Float[np.ndarray, " _"]]:
    return {
        "x": np.array([0.0, 0.0, reference.position[0]]),
        "v": np.array([0.0, 0.0, reference.velocity[0]]),
        "q": np.array([0.0, 0.0, 0.0, 1.0]),
        "w": np.zeros(3),
        "wind": np.zeros(3),
        "rotor_speeds": hover,
    }


def flat_output(reference: Trajectory, k: int) -> dict[str, Any]:
    """RotorPy's name for the reference: the vertical one, and none sideways or in yaw."""
    upward = np.array([0.0, 0.0, 1.0])
    return {
        "x": reference.position[k] * upward,
        "x_dot": reference.velocity[k] * upward,
        "x_ddot": reference.acceleration[k] * upward,
        "x_dddot": np.zeros(3),
        "x_ddddot": np.zeros(3),
        "yaw": 0.0,
        "yaw_dot": 0.0,
    }


def measured(state: Mapping[str, Float[np.ndarray, " _"]], errors: Errors, k: int) -> dict[str, Any]:
    x, y, z, w = state["q"]
    a, b, c = 0.5 * errors["attitude"][k]
    # q multiplied from the right by the small rotation [a, b, c, 1], first order in the angles.
    turned = np.array(
        [
            x + w * a + y * c - z * b,
            y + w * b + z * a - x * c,
            z + w * c + x * b - y * a,
            w - x * a - y * b - z * c,
        ]
    )
    return {
        "x": state["x"] + errors["position"][k],
        "v": state["v"] + errors["velocity"][k],
        "q": turned / np.sqrt(turned @ turned),
        "w": state["w"] + errors["angular_rate"][k],
    }


def is_lost(state: Mapping[str, Float[np.ndarray, " _"]], altitude: float) -> bool:
    """Return whether the vehicle is beyond recovery: far from the reference, or tilted by 70 degrees."""
    away = np.abs(state["x"] - np.array([0.0, 0.0, altitude]))
    near = bool(away[0] < 50.0 and away[1] < 50.0 and away[2] < 5.0)
    x, y = float(state["q"][0]), float(state["q"][1])
    return not (near and 1.0 - 2.0 * (x * x + y * y) > np.cos(np.radians(70.0)))


@dataclass(frozen=True, slots=True)
class RotorpyFlightSpec:
    """Everything that a flight is a function of."""

    vehicle: Vehicle = Vehicle.CRAZYFLIE  # Which multirotor
    actuator_lag: float | None = None  # Time constant of the rotors [s]; None for the vehicle's own
    delay: float = 0.0  # Delay of the commands [s], a multiple of 0.01
    gust_rms: float = 0.0  # Standard deviation of the wind on each of the three axes [m/s]
    gust_correlation: float = 1.0  # Correlation time of the wind, an Ornstein-Uhlenbeck process [s]
    noise: SensorNoise = field(default_factory=SensorNoise)  # Levels and kind
    rate_noise: float = 0.01  # Standard deviation of the body rates' error [rad/s]
    trajectory: TrajectoryKind = TrajectoryKind.MULTISINE  # The altitude reference
    # Reference, wind and noise have streams of their own, so that a change of the noise's kind leaves
    # trajectory and wind as they were
    seed: int = 0
    duration: float = 60.0  # [s], a multiple of 0.01

    @property
    def count(self) -> int:
        return round(self.duration / STEP_S)


def simulate_rotorpy_flight(
    spec: RotorpyFlightSpec, reference: Trajectory | None = None, vertical_gains: float = 1.0
) -> SimulatedFlight[FlightTruth]:
    """Fly one closed loop of RotorPy and return its log and its truth."""
    shape, air, sensors = (
        np.random.Generator(np.random.PCG64(s)) for s in np.random.SeedSequence(spec.seed).spawn(3)
    )
    parts = _Parts(
        parameters=vehicle_parameters(spec.vehicle, spec.actuator_lag),
        reference=altitude_reference(spec.trajectory, count=spec.count, step_s=STEP_S, rng=shape)
        if reference is None
        else reference,
        wind=gusts(
            count=spec.count,
            axes=3,
            step_s=STEP_S,
            rms=spec.gust_rms,
            correlation_s=spec.gust_correlation,
            rng=air,
        ),
        errors=spec.noise.errors(spec.count, 3, sensors)
        | {"angular_rate": spec.rate_noise * sensors.standard_normal((spec.count, 3))},
    )
    log, flew = _fly(spec, parts, vertical_gains)
    truth = _truth(spec, parts, log)
    return SimulatedFlight(_recording(spec, parts, log), truth, flew)


@dataclass(frozen=True, slots=True)
class _Parts:
    """What a flight is flown with."""

    parameters: dict[str, Any]
    reference: Trajectory
    wind: Float[np.ndarray, "n 3"]
    errors: Errors


@dataclass(frozen=True, slots=True)
class _Log:
    """Noise-free states, what the controller was told, and what it commanded; one row for each stamp."""

    position: Float[np.ndarray, "n 3"]
    velocity: Float[np.ndarray, "n 3"]
    attitude: Float[np.ndarray, "n 4"]
    acceleration: Float[np.ndarray, "n 3"]
    rotor_state: Float[np.ndarray, "n rotors"]
    seen_attitude: Float[np.ndarray, "n 4"]
    command: Float[np.ndarray, "n rotors"]


def _fly(spec: RotorpyFlightSpec, parts: _Parts, vertical_gains: float) -> tuple[_Log, bool]:
    """Run the loop; the second result is False when the vehicle was lost."""
    from rotorpy.vehicles.multirotor import Multirotor

    hover = np.full(parts.parameters["num_rotors"], hover_speed(parts.parameters))
    state = initial_state(parts.reference, hover)
    options = integrator_options(float(parts.parameters["tau_m"]))
    vehicle = Multirotor(parts.parameters, dict(state), "cmd_motor_speeds", integrator_kwargs=options)
    controller = tuned_controller(parts.parameters, spec.delay)
    controller.kd_pos = controller.kd_pos * np.array([1.0, 1.0, vertical_gains])
    pending = deque([hover] * round(spec.delay / STEP_S))
    rows = []
    flew = True
    for k in range(spec.count):
        state["wind"] = parts.wind[k]
        seen = measured(state, parts.errors, k)
        reported = controller.update(k * STEP_S, seen, flat_output(parts.reference, k))["cmd_motor_speeds"]
        command = np.clip(reported, vehicle.rotor_speed_min, vehicle.rotor_speed_max)
        pending.append(command)
        acting = {"cmd_motor_speeds": pending.popleft()}
        acceleration = vehicle.statedot(state, acting, STEP_S)["vdot"]
        rows.append(
            (state["x"], state["v"], state["q"], acceleration, state["rotor_speeds"], seen["q"], command)
        )
        if is_lost(state, float(parts.reference.position[k])):
            flew = False
            break
        state = vehicle.step(state, acting, STEP_S)
    return _Log(*(np.array(column) for column in zip(*rows, strict=True))), flew


# -------------------------------------------------------------------------------- truth and log


def _truth(spec: RotorpyFlightSpec, parts: _Parts, log: _Log) -> FlightTruth:
    count = log.position.shape[0]
    mass, rotors = float(parts.parameters["mass"]), int(parts.parameters["num_rotors"])
    speed = hover_speed(parts.parameters)
    return FlightTruth(
        time_s=STEP_S * np.arange(count),
        specific_force_z=log.acceleration[:, 2] + GRAVITY,
        air_velocity_z=log.velocity[:, 2] - parts.wind[:count, 2],
        rotor_state=log.rotor_state,
        cos_tilt=1.0 - 2.0 * (log.attitude[:, 0] ** 2 + log.attitude[:, 1] ** 2),
        actuator_lag=float(parts.parameters["tau_m"]),
        delay=spec.delay,
        viscous_friction=float(parts.parameters["k_z"]) * rotors * speed / mass,
        input_gain=rotors * float(parts.parameters["k_eta"]) / mass,
        hover_input=speed,
    )


def _recording(spec: RotorpyFlightSpec, parts: _Parts, log: _Log) -> Recording:
    from scipy.spatial.transform import Rotation

    count = log.position.shape[0]
    errors, reference, gravity = parts.errors, parts.reference, np.array([0.0, 0.0, GRAVITY])
    force = Rotation.from_quat(log.attitude).apply(log.acceleration + gravity, inverse=True)
    force = force + errors["acceleration"][:count]
    return simulated_recording(
        f"rotorpy {spec.vehicle}, {spec.trajectory}, seed {spec.seed}",
        "rotorpy",
        STEP_S * np.arange(count),
        {
            **{f"rotor_command_{i + 1}": log.command[:, i] for i in range(log.command.shape[1])},
            "reference_position_z": reference.position[:count],
            "reference_velocity_z": reference.velocity[:count],
            "reference_acceleration_z": reference.acceleration[:count],
            "position_z": log.position[:, 2] + errors["position"][:count, 2],
            "velocity_z": log.velocity[:, 2] + errors["velocity"][:count, 2],
            **{f"attitude_{axis}": log.seen_attitude[:, i] for i, axis in enumerate("xyzw")},
            **{f"specific_force_body_{axis}": force[:, i] for i, axis in enumerate("xyz")},
        },
    )
