"""Bags as rows of the table of formats: how they are told, and what to record."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from eivor.logs.bags.files import MAGICS, MCAP, ROS1, SQLITE, bag_parts, is_bag_folder
from eivor.logs.log_format import LogFormat, ReadOptions, no_parts
from eivor.signals.recording import Recording

#: Topics to record, of PX4's own and of mavros.
TO_RECORD = {
    "velocity_z": "/fmu/out/vehicle_local_position, or /mavros/local_position/velocity_local",
    "position_z": "/fmu/out/vehicle_local_position, or /mavros/local_position/odom",
    "input": "/fmu/out/vehicle_thrust_setpoint, or /mavros/setpoint_raw/target_attitude",
    "reference_position_z": "/fmu/out/trajectory_setpoint, or /mavros/setpoint_raw/target_local",
    **{f"attitude_{part}": "/fmu/out/vehicle_attitude, or /mavros/imu/data" for part in "wxyz"},
    **{f"specific_force_body_{axis}": "/fmu/out/sensor_combined, or /mavros/imu/data_raw" for axis in "xyz"},
    **{f"angular_rate_{axis}": "/fmu/out/sensor_combined, or /mavros/imu/data_raw" for axis in "xyz"},
    "battery_voltage": "/fmu/out/battery_status, or /mavros/battery",
}
_ADVICE = (
    "Take the vehicle's own log where there is one (ULog of PX4, .bin of ArduPilot): it has the same "
    "quantities at higher rates, and parameters.",
    "Of PX4, record what dds_topics.yaml sends out, with vehicle_local_position, vehicle_attitude, "
    "sensor_combined, vehicle_thrust_setpoint, trajectory_setpoint and vehicle_land_detected among it, "
    "each at 100 Hz or more where the link can.",
    "Of mavros, record local_position/odom, local_position/velocity_local, imu/data, imu/data_raw, "
    "setpoint_raw/target_attitude, setpoint_raw/target_local and extended_state, and raise their rates to "
    "50 Hz or more (the service set_message_interval of mavros; SR parameters of ArduPilot).",
    "Fly height steps, so that the height reference changes: a hover cannot be identified.",
)


def _sniffing(kind: str, *, folders: bool) -> Callable[[bytes, Path], bool]:
    magic = next(start for start, known in MAGICS.items() if known == kind)
    return lambda head, file: head.startswith(magic) or (folders and is_bag_folder(file))


def _reading(name: str) -> Callable[[Path, ReadOptions], Recording]:
    def read(path: Path, options: ReadOptions) -> Recording:
        from eivor.logs.bags.reader import read_bag

        return read_bag(path, options, name)

    return read


def _advice(channel: str) -> tuple[str, ...]:
    """Which topics to record."""
    if not channel:
        return _ADVICE
    return (f"Record {TO_RECORD[channel]}.",) if channel in TO_RECORD else ()


def _bag(name: str, label: str, kind: str, ending: str, *, folders: bool = False) -> LogFormat:
    return LogFormat(
        name,
        label,
        _sniffing(kind, folders=folders),
        _reading(name),
        takes_map=True,
        advice=_advice,
        setpoints="trajectory_setpoint, or mavros/setpoint_raw/local and target_local (the height "
        "reference), vehicle_thrust_setpoint, or mavros/setpoint_raw/target_attitude (the command).",
        endings=(ending,),
        parts=bag_parts if folders else no_parts,
    )


#: ROS 1 bags, ROS 2 bags (a folder, or a file of sqlite3), and MCAP.
BAGS: tuple[LogFormat, ...] = (
    _bag("ros1", "ROS 1 bag", ROS1, ".bag"),
    _bag("ros2", "ROS 2 bag", SQLITE, ".db3", folders=True),
    _bag("mcap", "MCAP", MCAP, ".mcap"),
)
