"""Flights of the study: RotorPy's vehicles in Eivor's simulator, height and attitude excited, logs at 100 Hz.

The derivatives of both simulators agree to rounding; Eivor's has the loops that follow steps of attitude.
Controller, log, gusts and noise are those of the vertical study; gusts blow along all axes of the world.
"""

from __future__ import annotations

from dataclasses import replace

from eivor.lab.disturbances import OrnsteinUhlenbeck
from eivor.motions.rigid_body.vehicle import KnownVehicle, Vehicle
from eivor.signals.noise import MeasurementNoise, WhiteNoise
from eivor.simulation.controller import FlightController, Sensor
from eivor.simulation.environment import ACCELERATION_ORDER, VELOCITY_ORDER
from eivor.simulation.excitation import RandomSteps
from eivor.simulation.rigid_body_spec import AxisExcitations, Logged, RigidBodyFlightSpec, Sensors, Wind
from validation.flight_recipe.rotorpy_flight import RotorpyFlightSpec
from validation.flight_recipe.rotorpy_vehicles import rigid_body, vehicle_parameters
from validation.joint.noise import noise_of

#: Of the simulation, and of controller and log [Hz].
SIMULATION_HZ, LOG_HZ = 500.0, 100.0
#: Steps of roll and pitch, and of yaw [rad], and how long a level is held [s].
TILT, TURN, HELD_S = 0.25, 0.5, (0.7, 1.8)
#: Gain towards the place where the flight began [1/s].
HOLD = 0.2


def flight_of(spec: RotorpyFlightSpec) -> RigidBodyFlightSpec:
    """Flight of the whole vehicle with the settings of a flight of the vertical study."""
    vehicle = rigid_body(vehicle_parameters(spec.vehicle, spec.actuator_lag))
    vehicle = replace(vehicle, rotors=replace(vehicle.rotors, delay=spec.delay))
    noise, count = spec.noise, round(spec.duration * SIMULATION_HZ)
    tilt = RandomSteps(TILT, *HELD_S)
    gust = OrnsteinUhlenbeck(spec.gust_rms, spec.gust_correlation)

    def logged(error: MeasurementNoise) -> Sensor:
        return Sensor(error, rate_hz=LOG_HZ)

    return RigidBodyFlightSpec(
        vehicle,
        rate_hz=SIMULATION_HZ,
        duration=spec.duration,
        trajectory=spec.trajectory,
        attitude=AxisExcitations(tilt, tilt, RandomSteps(TURN, *HELD_S)),
        controller=FlightController(rate_hz=LOG_HZ, attitude_hz=LOG_HZ, height_hz=LOG_HZ, hold=HOLD),
        wind=Wind(x=gust, y=gust, z=gust),
        sensors=Sensors(
            angular_rate=logged(WhiteNoise(noise.angular_rate)),
            specific_force=logged(noise_of(noise.kind, noise.acceleration, ACCELERATION_ORDER, count)),
            velocity=logged(noise_of(noise.kind, noise.velocity, VELOCITY_ORDER, count)),
            position=logged(WhiteNoise(noise.position)),
            attitude=logged(WhiteNoise(noise.attitude)),
        ),
        logged=Logged(rotor_command_hz=LOG_HZ, setpoint_hz=LOG_HZ, reference_hz=LOG_HZ),
        seed=spec.seed,
    )


def known(vehicle: Vehicle) -> KnownVehicle:
    """What the identification is told: places and spins of the rotors."""
    rotors = vehicle.rotors
    return KnownVehicle("simulated", tuple((x, y) for x, y, _ in rotors.positions), rotors.spins)
