"""Logs of a whole vehicle's flights beside what is true of them, as `eivor simulate` writes both."""

from __future__ import annotations

from dataclasses import asdict, replace
from importlib.metadata import version

import numpy as np

from eivor.errors import ParameterError
from eivor.motions.rigid_body.dynamics import into_body, rotation
from eivor.simulation.flights.known_log import SCHEMA, KnownLog
from eivor.simulation.rigid_body.flight import RigidBodyFlight, RigidBodyTruth, simulate_rigid_body_flights
from eivor.simulation.rigid_body.spec import RigidBodyFlightSpec

#: Units of what the truth says of every axis.
UNITS = {
    "gyroscopic_ratios": "",
    "torque_gains": "rad/s^2 per m (yaw: no m) and squared rad/s",
    "rate_damping": "1/s",
    "thrust_gain": "m/s^2 per squared rad/s",
    "drag": "1/s",
    "rotor_rate_drag": "1/s per m^2 and rad/s",
    "rotor_drag": "1/s per rad/s",
    "quadratic_drag": "1/m",
    "translational_lift": "1/m",
    "rotor_reaction": "",
    "lag_up": "s",
    "lag_down": "s",
    "delay": "s",
    "control_effectiveness": "rad/s^2 per unit of torque setpoint",
    "hover_speed": "rad/s",
}


def log_of_rigid_body_flight(spec: RigidBodyFlightSpec) -> KnownLog:
    """Log of a flight of a whole vehicle.

    Parameters
    ----------
    spec : RigidBodyFlightSpec
        The flight.

    Raises
    ------
    ParameterError
        When the vehicle is lost.
    """
    (flight,) = simulate_rigid_body_flights([spec])
    if not flight.flew:
        raise ParameterError(
            "a flight that follows its height within 5 m and stays upright",
            f"one that is lost with the seed {spec.seed}",
            "Make gusts, steps or disturbances smaller, or the controller less quick.",
        )
    # Without its input map where that is the rotors' own default: so a CSV can keep all that there is.
    recording = replace(flight.recording, input_map="")
    return KnownLog(recording, spec.rate_hz, spec.count, _truth(spec, flight))


def _truth(spec: RigidBodyFlightSpec, flight: RigidBodyFlight) -> dict[str, object]:
    """Everything true, as a JSON document; what the vertical motion's truth has by the same names."""
    told = flight.truth.parameters
    rotors = spec.vehicle.rotors
    return {
        "schema": SCHEMA,
        "viscous_friction": viscous_friction(flight.truth),
        "input_gain": rotors.count * told.thrust_gain,
        "hover_input": spec.vehicle.hover_speed,
        **asdict(told),
        "control_effectiveness": list(flight.truth.control_effectiveness),
        "hover_speed": spec.vehicle.hover_speed,
        "units": UNITS
        | {
            "viscous_friction": "1/s",
            "input_gain": "m/s^2 per squared rad/s",
            "hover_input": "rad/s",
        },
        "trajectory": str(spec.trajectory),
        "rate_hz": spec.rate_hz,
        "samples": spec.count,
        "seed": spec.seed,
        "provenance": {"version": version("eivor")},
    }


def viscous_friction(truth: RigidBodyTruth) -> float:
    """Friction along z at the speeds of a flight: d_z at hover, and c_z sum |v| v_z^2 / sum v_z^2.

    It is what `eivor identify` calls viscous friction: the body's quadratic drag, at the speeds that it was
    flown at, is part of it.

    Parameters
    ----------
    truth : RigidBodyTruth
        Of a flight.
    """
    told = truth.parameters
    w, x, y, z = truth.attitude.T
    along_x, along_y, along_z = truth.air_velocity.T
    _, _, climb = into_body(rotation(w, x, y, z), along_x, along_y, along_z)
    squared = np.asarray(climb) ** 2
    total = squared.sum()
    if not total > 0.0:
        return told.drag[2]
    speed = np.linalg.norm(truth.air_velocity, axis=1)
    return told.drag[2] + told.quadratic_drag[2] * float(speed @ squared / total)
