"""Where each channel is in the topics of mavros and in plain messages of ROS.

World east-north-up, body forward-left-up, as REP 103 has it and mavros turns PX4's and ArduPilot's axes into.

* `imu/data_raw` is the inertial sensor's message as it came. `imu/data` has its attitude's stamp, and
  repeats the last acceleration: it comes second for what is measured.
* `setpoint_raw/local` and `setpoint_position/local` are what a companion asks for.
  `setpoint_raw/target_local` is what the autopilot reports back: its height is the one asked for, and its
  velocity has the position loop's answer in it.
* `setpoint_raw/target_attitude` is what the autopilot flies: its thrust is the command, its attitude and
  rates are those of loops. A companion's own thrust is in `setpoint_raw/attitude`.
* The velocity of odometry is in the body's axes, and is turned.

A topic that no autopilot names is taken for what its type says, where it is the only one of that type; a pose
whose name says that it is asked for is a setpoint.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

#: The folder of mavros' topics.
MAVROS = "mavros/"
#: Words in the name of a topic that is asked for, not measured.
ASKED = re.compile(
    r"set_?point|target|goal|reference|desired|command|cmd|(?:^|[/_])ref(?:[/_]|$)", re.IGNORECASE
)
MAX_ROTORS = 12


@dataclass(frozen=True, slots=True)
class RosSource:
    """One place where a channel may be.

    Parameters
    ----------
    topic : str
        What its name ends with, from the folder of mavros on; empty for the only topic of its type.
    kind : str
        Type of its messages.
    field : str
        Full name of the field.
    sign : float
        -1 where the channel is the negative of the field.
    estimated : bool
        True when an estimator makes the values.
    is_setpoint : bool
        True when the topic falls silent where the setpoint is not in force.
    is_asked : bool
        For the only topic of its type: whether its name must say that it is asked for, or must not.
    """

    topic: str
    kind: str
    field: str
    sign: float = 1.0
    estimated: bool = False
    is_setpoint: bool = False
    is_asked: bool = False

    def serves(self, name: str, kind: str) -> bool:
        """Say whether a topic is this one."""
        if kind != self.kind:
            return False
        if self.topic:
            return f"/{name.lstrip('/')}".endswith(f"/{MAVROS}{self.topic}")
        return f"/{MAVROS}" not in f"/{name.lstrip('/')}" and bool(ASKED.search(name)) == self.is_asked


_ODOMETRY, _POSE, _TWIST = "nav_msgs/Odometry", "geometry_msgs/PoseStamped", "geometry_msgs/TwistStamped"
_IMU, _BATTERY = "sensor_msgs/Imu", "sensor_msgs/BatteryState"
_POSITION, _ATTITUDE = "mavros_msgs/PositionTarget", "mavros_msgs/AttitudeTarget"
_STATE, _ROTORS = "mavros_msgs/State", ("mav_msgs/Actuators", "actuator_msgs/Actuators")
_SPEEDS = ("angular_velocities", "velocity")


def _places(axis: str) -> tuple[RosSource, ...]:
    return (
        RosSource("local_position/odom", _ODOMETRY, f"pose.pose.position.{axis}", estimated=True),
        RosSource("local_position/pose", _POSE, f"pose.position.{axis}", estimated=True),
        RosSource("", _ODOMETRY, f"pose.pose.position.{axis}", estimated=True),
        RosSource("", _POSE, f"pose.position.{axis}"),
        RosSource("", "geometry_msgs/TransformStamped", f"transform.translation.{axis}"),
    )


def _velocities(axis: str) -> tuple[RosSource, ...]:
    return (
        RosSource("local_position/velocity_local", _TWIST, f"twist.linear.{axis}", estimated=True),
        RosSource("local_position/odom", _ODOMETRY, f"twist.world.{axis}", estimated=True),
        RosSource("", _ODOMETRY, f"twist.world.{axis}", estimated=True),
        RosSource("", _TWIST, f"twist.linear.{axis}", estimated=True),
    )


def _turns(part: str) -> tuple[RosSource, ...]:
    return (
        RosSource("imu/data", _IMU, f"orientation.{part}", estimated=True),
        RosSource("local_position/odom", _ODOMETRY, f"pose.pose.orientation.{part}", estimated=True),
        RosSource("local_position/pose", _POSE, f"pose.orientation.{part}", estimated=True),
        RosSource("", _ODOMETRY, f"pose.pose.orientation.{part}", estimated=True),
        RosSource("", _POSE, f"pose.orientation.{part}"),
        RosSource("", "geometry_msgs/TransformStamped", f"transform.rotation.{part}"),
        RosSource("", _IMU, f"orientation.{part}", estimated=True),
    )


def _inertial(field: str) -> tuple[RosSource, ...]:
    return tuple(RosSource(topic, _IMU, field) for topic in ("imu/data_raw", "imu/data", ""))


def _asked(field: str) -> RosSource:
    return RosSource("setpoint_raw/local", _POSITION, field, is_setpoint=True)


def _flown(field: str) -> RosSource:
    return RosSource("setpoint_raw/target_attitude", _ATTITUDE, field)


def _reported(field: str) -> RosSource:
    return RosSource("setpoint_raw/target_local", _POSITION, field, is_setpoint=True)


#: Sources of each channel, the preferred one first.
CHANNEL_SOURCES: Mapping[str, tuple[RosSource, ...]] = {
    **{f"position_{axis}": _places(axis) for axis in "xyz"},
    **{f"velocity_{axis}": _velocities(axis) for axis in "xyz"},
    **{f"specific_force_body_{axis}": _inertial(f"linear_acceleration.{axis}") for axis in "xyz"},
    **{f"attitude_{part}": _turns(part) for part in "wxyz"},
    **{f"angular_rate_{axis}": _inertial(f"angular_velocity.{axis}") for axis in "xyz"},
    "input": (
        _flown("thrust"),
        RosSource("setpoint_raw/attitude", _ATTITUDE, "thrust"),
        RosSource("target_actuator_control", "mavros_msgs/ActuatorControl", "controls[3]"),
    ),
    "reference_position_z": (
        _asked("position.z"),
        RosSource("setpoint_position/local", _POSE, "pose.position.z", is_setpoint=True),
        _reported("position.z"),
        RosSource("", _POSE, "pose.position.z", is_setpoint=True, is_asked=True),
    ),
    "reference_velocity_z": (_asked("velocity.z"),),
    "reference_acceleration_z": (_asked("acceleration_or_force.z"),),
    "feedback_reference_velocity_z": (_reported("velocity.z"),),
    **{f"feedback_reference_{name}": (_flown(name),) for name in ("roll", "pitch", "yaw")},
    **{f"feedback_reference_angular_rate_{axis}": (_flown(f"body_rate.{axis}"),) for axis in "xyz"},
    **{
        f"torque_setpoint_{axis}": (
            RosSource(
                "target_actuator_control", "mavros_msgs/ActuatorControl", f"controls[{place}]", sign=sign
            ),
        )
        for place, (axis, sign) in enumerate((("x", 1.0), ("y", -1.0), ("z", -1.0)))
    },
    **{
        f"rotor_command_{number}": tuple(
            RosSource("", kind, f"{field}[{number - 1}]", is_asked=True)
            for kind, field in zip(_ROTORS, _SPEEDS, strict=True)
        )
        for number in range(1, MAX_ROTORS + 1)
    },
    **{
        f"rotor_speed_{number}": (
            *(
                RosSource("", kind, f"{field}[{number - 1}]")
                for kind, field in zip(_ROTORS, _SPEEDS, strict=True)
            ),
        )
        for number in range(1, MAX_ROTORS + 1)
    },
    **{
        f"actuator_output_{number}": (RosSource("rc/out", "mavros_msgs/RCOut", f"channels[{number - 1}]"),)
        for number in range(1, MAX_ROTORS + 1)
    },
    "battery_voltage": (RosSource("battery", _BATTERY, "voltage"), RosSource("", _BATTERY, "voltage")),
    "landed": (RosSource("extended_state", "mavros_msgs/ExtendedState", "landed"),),
    **{
        name: (RosSource("state", _STATE, name),)
        for name in ("pilot_in_control", "input_open_loop", "pilot_sets_attitude")
    },
}


def _told(source: RosSource) -> str:
    return f"{MAVROS}{source.topic}.{source.field}" if source.topic else f"{source.kind} {source.field}"


#: What was looked for, by channel, in the words of a message.
LOOKED_FOR: Mapping[str, tuple[str, ...]] = {
    name: tuple(_told(source) for source in sources) for name, sources in CHANNEL_SOURCES.items()
}
