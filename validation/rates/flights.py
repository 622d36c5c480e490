"""Flights of the study: three vehicles of the whole-vehicle simulator, and how they are flown and logged.

The rate loop runs at 400 Hz and differentiates a noisy gyroscope; the logger keeps every eighth setpoint, or
as many as 250 Hz are. The gyroscope has no filter, so that the lag from setpoint to rate is lag and delay
of the rotors, and is logged at 200 Hz. Gusts turn the vehicle, three rad/s^2 about roll and pitch; of yaw
one, since the heavy vehicle has but four there, and is lost under three.
"""

from __future__ import annotations

from dataclasses import dataclass

from eivor.lab.disturbances import OrnsteinUhlenbeck
from eivor.motions.rigid_body.vehicle import BodyDrag, Rotors, Vehicle
from eivor.signals.noise import WhiteNoise
from eivor.simulation.controller import FlightController, Sensor
from eivor.simulation.environment import TrajectoryKind
from eivor.simulation.excitation import RandomSteps
from eivor.simulation.rigid_body_spec import (
    AxisExcitations,
    Logged,
    RigidBodyFlightSpec,
    Sensors,
    TorqueDisturbance,
)

CONTROLLER_HZ, GYROSCOPE_HZ = 400.0, 200.0
#: Of the gyroscope [rad/s], and of the gusts' angular acceleration about each axis [rad/s^2], correlated [s].
NOISE, GUSTS, GUST_S = 0.05, (3.0, 3.0, 1.0), 0.3


def _vehicle(mass: float, arm: float, inertia: tuple[float, float, float], lag: float) -> Vehicle:
    """A quadrotor X whose rotors lift some four times its weight, with a delay of 5 ms."""
    rotors = Rotors(
        positions=((arm, arm, 0.0), (arm, -arm, 0.0), (-arm, -arm, 0.0), (-arm, arm, 0.0)),
        spins=(1, -1, 1, -1),
        highest_speed=900.0,
        thrust_quadratic=1.2e-5 * mass,
        torque_ratio=0.016,
        lag_up=lag,
        lag_down=lag,
        delay=0.005,
    )
    return Vehicle(mass, inertia, rotors, BodyDrag(quadratic=(0.01, 0.01, 0.02)))


#: Effectiveness of roll and pitch 250, 120 and 60 rad/s^2 or so.
VEHICLES = {
    "light, quick": _vehicle(0.5, 0.09, (0.0018, 0.0021, 0.0035), 0.02),
    "usual": _vehicle(1.2, 0.16, (0.0155, 0.018, 0.03), 0.035),
    "heavy, slow": _vehicle(3.0, 0.25, (0.12, 0.14, 0.23), 0.06),
}


@dataclass(frozen=True, slots=True)
class Condition:
    """How a cell of the study is flown and logged."""

    name: str  # In words
    steps: float  # Attitude steps of roll and pitch [rad]; none where zero
    setpoint_hz: float  # At which setpoints are logged [Hz]
    # Which requirements it is held against: "50 Hz", "250 Hz", or "small", whose flights may be refused
    judged: str


def flight_of(vehicle: str, condition: Condition, seconds: float, seed: int) -> RigidBodyFlightSpec:
    """Specification of a flight."""
    flight = VEHICLES[vehicle]
    steps = RandomSteps(condition.steps, 0.7, 1.8) if condition.steps else None
    return RigidBodyFlightSpec(
        flight,
        rate_hz=CONTROLLER_HZ,
        duration=seconds,
        trajectory=TrajectoryKind.HOVER,
        attitude=AxisExcitations(steps, steps),
        controller=FlightController(
            rate_hz=CONTROLLER_HZ, attitude_hz=CONTROLLER_HZ, derivative_share=0.5, hold=0.2
        ),
        torque_disturbance=TorqueDisturbance(*(OrnsteinUhlenbeck(gust, GUST_S) for gust in GUSTS)),
        sensors=Sensors(angular_rate=Sensor(WhiteNoise(NOISE), rate_hz=GYROSCOPE_HZ)),
        logged=Logged(setpoint_hz=condition.setpoint_hz, reference_hz=50.0),
        seed=seed,
    )
