"""The friction that a flight would give to an estimator without any error, by either equation."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool
from scipy.spatial.transform import Rotation

from eivor.flights.prepared import PreparedFlight
from eivor.motions.rigid_body.vehicle import Vehicle
from eivor.simulation.environment import FlightTruth, effective_parameters
from eivor.simulation.rigid_body import RigidBodyFlight


def vertical_truth(flight: RigidBodyFlight, vehicle: Vehicle) -> FlightTruth:
    """What is true of the flight's vertical motion."""
    truth, rotors = flight.truth, vehicle.rotors
    body = Rotation.from_quat(truth.attitude[:, [1, 2, 3, 0]])
    return FlightTruth(
        time_s=truth.time_s,
        specific_force_z=body.apply(truth.specific_force)[:, 2],
        air_velocity_z=truth.air_velocity[:, 2],
        rotor_state=truth.rotor_speed,
        cos_tilt=body.as_matrix()[:, 2, 2],
        actuator_lag=rotors.lag_up,
        delay=rotors.delay,
        viscous_friction=truth.parameters.drag[2],
        input_gain=rotors.count * truth.parameters.thrust_gain,
        hover_input=vehicle.hover_speed,
    )


def effective_vertical(flight: RigidBodyFlight, vehicle: Vehicle, used: Bool[np.ndarray, " n"]) -> float:
    """K of the noise-free vertical motion over some steps [1/s]."""
    return effective_parameters(vertical_truth(flight, vehicle), used, np.square).viscous_friction


def effective_along(flight: RigidBodyFlight, vehicle: Vehicle, used: Bool[np.ndarray, " n"]) -> float:
    """Drag over mass at hover of the noise-free force along the body's z over some steps [1/s]."""
    truth, positions = flight.truth, np.array(vehicle.rotors.positions)
    body = Rotation.from_quat(truth.attitude[:, [1, 2, 3, 0]])
    air = body.inv().apply(truth.air_velocity)
    hub = air[:, None, :] + np.cross(truth.angular_rate[:, None, :], positions[None, :, :])
    speed = truth.rotor_speed
    hover = vehicle.rotors.count * vehicle.hover_speed
    columns = np.column_stack(
        [
            -(speed * hub[:, :, 2]).sum(axis=1) / hover,
            (speed**2).sum(axis=1),
            (hub[:, :, :2] ** 2).sum(axis=(1, 2)),
        ]
    )[used]
    columns -= columns.mean(axis=0)
    force = truth.specific_force[used, 2]
    solution = np.linalg.lstsq(columns / columns.std(axis=0), force - force.mean(), rcond=None)[0]
    return float(solution[0] / columns[:, 0].std())


def used_steps(flight: RigidBodyFlight, prepared: PreparedFlight) -> Bool[np.ndarray, " n"]:
    """Steps of the simulation that an identification used."""
    time_s = prepared.grid.time_s
    used = np.interp(flight.truth.time_s, time_s, prepared.used.astype(np.float64), left=0.0, right=0.0)
    return np.asarray(used > 0.5)
