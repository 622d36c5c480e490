"""The vehicle file of a simulated vehicle: what somebody who built it would know before it flies."""

from __future__ import annotations

import json

from eivor.motions.rigid_body.rotors import Rotors
from eivor.simulation.rigid_body.spec import RigidBodyFlightSpec


def vehicle_text(spec: RigidBodyFlightSpec, name: str) -> str:
    """Text of the vehicle file of a flight's vehicle; what a flight is to tell is not in it.

    Parameters
    ----------
    spec : RigidBodyFlightSpec
        The flight, whose sensors may have filters.
    name : str
        What the vehicle is called.
    """
    rotors, sensors = spec.vehicle.rotors, spec.sensors
    lines = ["# The simulated vehicle as it is: every number is exact.", f"name = {_text(name)}"]
    lines.append(f"mass = {spec.vehicle.mass!r}")
    cutoffs = {
        "gyro_cutoff_hz": sensors.angular_rate.cutoff_hz,
        "accelerometer_cutoff_hz": sensors.specific_force.cutoff_hz,
    }
    lines += [f"{key} = {cutoff!r}" for key, cutoff in cutoffs.items() if cutoff]
    lines += ["", "[rotors]", f"positions = {[[x, y] for x, y, _ in rotors.positions]}"]
    lines += [f"spins = {list(rotors.spins)}", "speed_scale = 1.0", f"torque_ratio = {rotors.torque_ratio!r}"]
    lines.append(f"thrust_map = {_text(_thrust_map(rotors))}")
    return "\n".join(lines) + "\n"


def _text(words: str) -> str:
    """Text as TOML has it: letters as they are, question marks for what cannot be printed."""
    return json.dumps("".join(one if one.isprintable() else "?" for one in words), ensure_ascii=False)


def _thrust_map(rotors: Rotors) -> str:
    """Name of the map whose share is that of the quadratic part, for commands in rad/s."""
    if not rotors.thrust_linear:
        return "square"
    if not rotors.thrust_quadratic:
        return "linear"
    return f"mixed:{rotors.thrust_quadratic / (rotors.thrust_linear + rotors.thrust_quadratic)!r}"
