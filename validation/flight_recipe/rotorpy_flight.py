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

from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

from eivor.errors import UsageError
from eivor.signals.recording import Recording
from eivor.simulation.environment import (
    FlightTruth,
    SensorErrors,
    SensorNoise,
    SimulatedFlight,
    Trajectory,
    TrajectoryKind,
    altitude_reference,
    gusts,
    sensor_errors,
    simulated_recording,
)
from validation.flight_recipe.rotorpy_states import flat_output, initial_state, is_lost, measured
from validation.flight_recipe.rotorpy_vehicles import (
    GRAVITY,
    STEP_S,
    Vehicle,
    hover_speed,
    integrator_options,
    tuned_controller,
    vehicle_parameters,
)


@dataclass(frozen=True, slots=True)
class RotorpyFlightSpec:
    """Everything that a flight is a function of."""

    vehicle: Vehicle = Vehicle.CRAZYFLIE  # Which multirotor
    actuator_lag: float | None = None  # Time constant of the rotors [s]; None for the vehicle's own
    delay: float = 0.0  # Delay of the commands [s], a multiple of 0.01
    gust_rms: float = 0.0  # Standard deviation of the wind on each of the three axes [m/s]
    gust_correlation: float = 1.0  # Correlation time of the wind, an Ornstein-Uhlenbeck process [s]
    noise: SensorNoise = field(default_factory=SensorNoise)  # Levels and kind
    trajectory: TrajectoryKind = TrajectoryKind.MULTISINE  # The altitude reference
    # Reference, wind and noise have streams of their own, so that a change of the noise's kind leaves
    # trajectory and wind as they were
    seed: int = 0
    duration: float = 60.0  # [s], a multiple of 0.01

    def __post_init__(self) -> None:
        lag = 0.01 if self.actuator_lag is None else self.actuator_lag
        if not (0.0 < lag <= 0.5 and 0.0 <= self.gust_rms < np.inf and self.gust_correlation > 0.0):
            raise UsageError(
                "a lag in (0, 0.5] s, gusts of at least 0 m/s, a positive correlation time",
                f"lag {self.actuator_lag}, gusts {self.gust_rms}, correlation time {self.gust_correlation}",
                "Correct the flight's specification.",
            )
        steps = self.delay / STEP_S
        if not 0.0 <= self.delay <= 0.2 or abs(steps - round(steps)) > 1e-6:
            raise UsageError(
                f"a delay between 0 and 0.2 s that is a multiple of {STEP_S} s",
                f"{self.delay}",
                "The simulator delays whole control steps.",
            )
        if not 2.0 <= self.duration <= 3600.0:
            raise UsageError("a duration of 2 to 3600 s", f"{self.duration}", "Choose another one.")

    @property
    def count(self) -> int:
        """Number of stamps."""
        return round(self.duration / STEP_S)


def simulate_rotorpy_flight(
    spec: RotorpyFlightSpec, reference: Trajectory | None = None, vertical_gains: float = 1.0
) -> SimulatedFlight:
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
        errors=sensor_errors(spec.noise, count=spec.count, axes=3, rng=sensors),
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
    errors: SensorErrors


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
    force = force + errors.acceleration[:count]
    return simulated_recording(
        f"rotorpy {spec.vehicle}, {spec.trajectory}, seed {spec.seed}",
        simulator="rotorpy",
        time_s=STEP_S * np.arange(count),
        held={
            **{f"rotor_command_{i + 1}": log.command[:, i] for i in range(log.command.shape[1])},
            "reference_position_z": reference.position[:count],
            "reference_velocity_z": reference.velocity[:count],
            "reference_acceleration_z": reference.acceleration[:count],
        },
        sampled={
            "position_z": log.position[:, 2] + errors.position[:count, 2],
            "velocity_z": log.velocity[:, 2] + errors.velocity[:count, 2],
            **{f"attitude_{axis}": log.seen_attitude[:, i] for i, axis in enumerate("xyzw")},
            **{f"specific_force_body_{axis}": force[:, i] for i, axis in enumerate("xyz")},
        },
    )
