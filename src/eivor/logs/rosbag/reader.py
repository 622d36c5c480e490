"""Reader of ROS bags."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from eivor.errors import EmptyLogError
from eivor.logs.channel_map import load_channel_map
from eivor.logs.common import LogFormat, ReadOptions, channel_findings, no_parts
from eivor.logs.mapping import looked_for
from eivor.logs.rosbag.channels import ROS_SOURCES, is_known, is_px4, px4_channels, ros_channels
from eivor.logs.rosbag.containers import (
    MAGICS,
    MCAP,
    ROS1,
    SQLITE,
    bag_files,
    bag_parts,
    check_installed,
    is_bag_folder,
)
from eivor.logs.rosbag.topics import Contents, map_channels, mapped_topics, read_contents
from eivor.logs.ulog.topics import LOOKED_FOR
from eivor.signals.recording import Channel, Finding, Frame, Recording

# -- Format --

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
        lambda path, options: read_bag(path, options, name),
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


# -- Reader --

_MOST_LISTED = 12


def read_bag(path: Path, options: ReadOptions, log_format: str) -> Recording:
    """Read a bag."""
    check_installed()
    files = bag_files(path)
    findings: list[Finding] = []
    input_map = vehicle = ""
    if options.channel_map is not None:
        chosen = load_channel_map(options.channel_map)
        named = mapped_topics(chosen)
        contents = read_contents(files, lambda file: file.topic in named, findings)
        channels = map_channels(chosen, contents.topics, contents.listed, path.name, findings)
        frame, input_map, looked = chosen.frame, chosen.input_map, looked_for(chosen)
    else:
        contents = read_contents(
            files, lambda file: is_px4(file.topic, file.kind) or is_known(file.topic, file.kind), findings
        )
        channels, frame, vehicle = _known_channels(contents, findings)
        looked = LOOKED_FOR if frame is Frame.NED else ROS_SOURCES
        if not channels:
            raise _nothing(path, contents, findings)
    return Recording(
        name=path.name,
        format=log_format,
        channels=channels,
        frame=frame,
        sha256=options.sha256,
        input_map=input_map,
        looked_for=looked,
        findings=(*findings, *channel_findings(channels)),
        vehicle=vehicle,
    )


def _known_channels(contents: Contents, findings: list[Finding]) -> tuple[dict[str, Channel], Frame, str]:
    """The channels of the topics that are known, which way z points, and the kind of vehicle."""
    of_px4 = [raw for raw in contents.topics.values() if is_px4(raw.name, raw.kind)]
    if of_px4:
        channels, vehicle = px4_channels(of_px4, findings)
        if channels:
            return channels, Frame.NED, vehicle
    others = [raw for raw in contents.topics.values() if not is_px4(raw.name, raw.kind)]
    return ros_channels(others, findings), Frame.Z_UP, ""


def _nothing(path: Path, contents: Contents, findings: list[Finding]) -> EmptyLogError:
    topics = [f"{name} ({kind})" for name, kind in sorted(contents.listed.items())]
    text = ", ".join(topics[:_MOST_LISTED]) + (
        f" and {len(topics) - _MOST_LISTED} more" if len(topics) > _MOST_LISTED else ""
    )
    sentence = " ".join(finding.message for finding in findings)
    return EmptyLogError(
        "a bag with topics of PX4 (px4_msgs) or mavros, or with odometry, poses and inertial sensors",
        f"'{path.name}' with {text or 'no messages'}" + (f". {sentence.rstrip('.')}" if sentence else ""),
        'Write a channel map whose columns are TOPIC.FIELD, and whose clock is "stamp" (--map).'
        if topics
        else "Nothing was recorded: check the topics that `rosbag record` or `ros2 bag record` was given.",
    )
