"""Flights of a whole vehicle from TOML: what `eivor simulate` makes of a file of the kind "rigid-body".

    kind = "rigid-body"
    rate_hz = 500.0                 # of the simulation; optional, as is all but the kind and the vehicle
    duration = 30.0                 # [s]
    trajectory = "multisine"        # of the height, as in a flight

    [vehicle]
    mass = 0.03                     # [kg]
    inertia = [1.43e-5, 1.43e-5, 2.89e-5]   # Ixx, Iyy, Izz, or these and Ixy, Ixz, Iyz [kg m^2]

    [vehicle.rotors]
    positions = [[0.03, 0.03, 0.0], ...]    # forward, left, up of the centre of mass [m]
    spins = [1, -1, 1, -1]          # +1 where the reaction torque on the body points up
    highest_speed = 2500.0          # [rad/s]
    thrust_quadratic = 2.3e-8       # [N/(rad/s)^2]
    torque_ratio = 0.034            # [m]
    lag_up = 0.072                  # [s]
    lag_down = 0.072

    [attitude.roll]                 # and pitch, yaw [rad]: any excitation
    kind = "random_steps"
    amplitude = 0.25

    [injection.roll]                # added to the normalised torque setpoint: any excitation
    [wind]                          # steady = [x, y, z], and [wind.x] and so on: any disturbance [m/s]
    [torque_disturbance.roll]       # any disturbance [rad/s^2]
    [controller]
    [sensors.angular_rate]          # and specific_force, velocity, position, attitude, rotor_speed
    [logged]
    [integrator]

The keys of each table are the parameters of its class, from `RigidBodyFlightSpec` on down. Unknown keys are
errors.
"""

from __future__ import annotations

from importlib.resources import as_file, files
from pathlib import Path

from eivor.errors import UsageError
from eivor.simulation.rigid_body.spec import RigidBodyFlightSpec
from eivor.simulation.scenario_files.kinds import built
from eivor.toml_table import TomlTable, read_toml

#: What a file of such a flight says of itself.
KIND = "rigid-body"
#: Flights that come with the package.
SHIPPED = ("crazyflie", "quadrotor")
#: Most steps of a flight from a file.
MOST_STEPS = 2_000_000


def read_rigid_body_flight(path: Path) -> RigidBodyFlightSpec:
    """Flight from a file, with the seed zero.

    Raises
    ------
    InputError
        When the file cannot be read, or does not describe such a flight; says where and why.
    """
    return rigid_body_flight_from_table(read_toml(path, "a flight of a rigid body"))


def shipped_rigid_body_flight(name: str) -> RigidBodyFlightSpec:
    """Flight that comes with the package.

    Raises
    ------
    UsageError
        When there is none of that name.
    """
    if name not in SHIPPED:
        raise UsageError(f"a flight out of {', '.join(SHIPPED)}", f"'{name}'", "Name one of them.")
    with as_file(files("eivor.simulation.scenario_files").joinpath("flights", f"{name}.toml")) as path:
        return read_rigid_body_flight(path)


def rigid_body_flight_from_table(table: TomlTable) -> RigidBodyFlightSpec:
    """Flight from the top table of a TOML file, all of whose keys it takes.

    Parameters
    ----------
    table : TomlTable
        With ``kind = "rigid-body"``.

    Raises
    ------
    InputError
        When a key is unknown, a value of the wrong type, or a number out of its range.
    """
    table.choice("kind", (KIND,))
    flight: RigidBodyFlightSpec = built(table, RigidBodyFlightSpec, seed=0)
    if flight.count > MOST_STEPS:
        raise table.wrong("duration", f"{MOST_STEPS} steps or fewer", f"{flight.count}", "Ask for fewer.")
    return flight
