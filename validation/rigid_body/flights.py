"""Flights of the study: RotorPy's vehicles in Eivor's simulator of the whole vehicle, and their logs.

The simulator's derivatives are RotorPy's to 1e-11 (`tests/validation/test_rigid_body_against_rotorpy.py`); it
is quicker by far. The controller runs at 500 Hz, and steps roll and pitch by .25 rad at uneven times while
yaw and height wander.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from eivor.lab.disturbances import OrnsteinUhlenbeck
from eivor.motions.rigid_body.vehicle import KnownNumber, KnownVehicle
from eivor.motions.rigid_body.vehicle import Vehicle as RigidBody
from eivor.signals.noise import WhiteNoise
from eivor.signals.recording import Recording
from eivor.simulation.controller import FlightController, Sensor
from eivor.simulation.environment import TrajectoryKind
from eivor.simulation.excitation import FilteredWhite, RandomSteps
from eivor.simulation.rigid_body_spec import (
    AxisExcitations,
    Logged,
    RigidBodyFlightSpec,
    Sensors,
    TorqueDisturbance,
)
from eivor.tools import Float
from validation.flight_recipe.rotorpy_vehicles import Vehicle, rigid_body, vehicle_parameters
from validation.rigid_body.scenario import Scenario

CONTROLLER_HZ, FINE_HZ = 500.0, 1000.0
#: Onboard filters [Hz].
GYROSCOPE_CUTOFF_HZ, ACCELEROMETER_CUTOFF_HZ = 80.0, 30.0
#: Nominal noise: gyroscope [rad/s], accelerometer [m/s^2], velocity [m/s], position [m], attitude [rad].
NOISE = (0.02, 0.5, 0.05, 0.01, 0.002)
#: Rates [Hz] and first instants [s] of the same sensors where they are out of step.
OUT_OF_STEP = ((1000.0 / 3.0, 0.001), (250.0, 0.003), (100.0, 0.007), (100.0, 0.006), (200.0, 0.002))
#: Correlation of the torques of the air [s].
TORQUE_S = 0.3
#: Jitter moves no stamp further than this share of the distance to the next.
LARGEST_JITTER = 0.45


def flown_vehicle(vehicle: Vehicle, scenario: Scenario) -> RigidBody:
    """Vehicle of RotorPy, with the delay of the scenario."""
    body = rigid_body(vehicle_parameters(vehicle, None))
    return replace(body, rotors=replace(body.rotors, delay=scenario.delay_s))


def known_vehicle(vehicle: Vehicle, scenario: Scenario) -> KnownVehicle:
    """What whoever identifies the flight knows of the vehicle."""
    rotors, taken = flown_vehicle(vehicle, scenario).rotors, scenario.taken_delay_s
    return KnownVehicle(
        str(vehicle),
        tuple((x, y) for x, y, _ in rotors.positions),
        rotors.spins,
        delay=None if taken is None else KnownNumber(taken),
        gyro_cutoff_hz=GYROSCOPE_CUTOFF_HZ if scenario.filtered else None,
        accelerometer_cutoff_hz=ACCELEROMETER_CUTOFF_HZ if scenario.filtered else None,
    )


def flight_of(vehicle: Vehicle, scenario: Scenario, seconds: float, number: int) -> RigidBodyFlightSpec:
    """Specification of a flight."""
    air = OrnsteinUhlenbeck(scenario.torque, TORQUE_S) if scenario.torque else None
    added = FilteredWhite(scenario.injected, 0.5, 8.0) if scenario.injected else None
    return RigidBodyFlightSpec(
        flown_vehicle(vehicle, scenario),
        rate_hz=FINE_HZ if scenario.jitter_s else CONTROLLER_HZ,
        duration=seconds,
        trajectory=TrajectoryKind.MULTISINE,
        controller=FlightController(quickness=scenario.quickness, derivative_share=scenario.derivative_share),
        attitude=AxisExcitations(RandomSteps(0.25), RandomSteps(0.25), FilteredWhite(0.5, 0.05, 0.6)),
        injection=AxisExcitations(added, added, added),
        torque_disturbance=TorqueDisturbance(air, air, air),
        sensors=_sensors(scenario),
        logged=_logged(scenario),
        seed=scenario.seed + number,
    )


def _logged(scenario: Scenario) -> Logged:
    """Every command and setpoint that the controller issues, and fewer rotor commands where so asked."""
    all_hz = CONTROLLER_HZ if scenario.jitter_s else 0.0
    return Logged(scenario.command_hz or all_hz, all_hz, all_hz)


def _sensors(scenario: Scenario) -> Sensors:
    filters = (GYROSCOPE_CUTOFF_HZ, ACCELEROMETER_CUTOFF_HZ) if scenario.filtered else (0.0, 0.0)
    sensors = []
    for number, std in enumerate(NOISE):
        sensor = Sensor(WhiteNoise(scenario.noise * std), cutoff_hz=(*filters, 0.0, 0.0, 0.0)[number])
        if scenario.jitter_s:
            rate_hz, first_s = OUT_OF_STEP[number]
            sensor = replace(sensor, rate_hz=rate_hz, offset_s=first_s, jitter_s=scenario.jitter_s)
        sensors.append(sensor)
    return Sensors(*sensors)


def jittered(log: Recording, std_s: float, seed: int) -> Recording:
    """Log in which stamps of commands, setpoints and references err, as those of its sensors do already."""
    if not std_s:
        return log
    rng = np.random.default_rng((seed, 1))
    moved: dict[bytes, Float[np.ndarray, " n"]] = {}
    channels = dict(log.channels)
    for name, channel in channels.items():
        if channel.held:
            group = channel.time_s.tobytes()
            if group not in moved:
                moved[group] = _moved(channel.time_s, std_s, rng)
            channels[name] = replace(channel, time_s=moved[group])
    return replace(log, channels=channels)


def _moved(
    time_s: Float[np.ndarray, " n"], std_s: float, rng: np.random.Generator
) -> Float[np.ndarray, " n"]:
    most = LARGEST_JITTER * float(np.diff(time_s).min())
    return time_s + np.clip(std_s * rng.standard_normal(time_s.size), -most, most)
