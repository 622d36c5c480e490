"""Types of ROS 2's own packages, of mavros and of rotor commands, for bags that come without definitions.

Facts: names, types and order of the fields, as ROS 2 Humble to Jazzy and mavros 2 have them.
"""

from __future__ import annotations

from eivor.logs.bags.definitions import MessageField, fields_of

_TEXTS = {
    "builtin_interfaces/Time": "int32 sec; uint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp; string frame_id",
    "geometry_msgs/Point": "float64 x; float64 y; float64 z",
    "geometry_msgs/Vector3": "float64 x; float64 y; float64 z",
    "geometry_msgs/Quaternion": "float64 x; float64 y; float64 z; float64 w",
    "geometry_msgs/Pose": "Point position; Quaternion orientation",
    "geometry_msgs/PoseWithCovariance": "Pose pose; float64[36] covariance",
    "geometry_msgs/Twist": "Vector3 linear; Vector3 angular",
    "geometry_msgs/TwistWithCovariance": "Twist twist; float64[36] covariance",
    "geometry_msgs/Accel": "Vector3 linear; Vector3 angular",
    "geometry_msgs/Transform": "Vector3 translation; Quaternion rotation",
    "geometry_msgs/PointStamped": "std_msgs/Header header; Point point",
    "geometry_msgs/Vector3Stamped": "std_msgs/Header header; Vector3 vector",
    "geometry_msgs/PoseStamped": "std_msgs/Header header; Pose pose",
    "geometry_msgs/PoseWithCovarianceStamped": "std_msgs/Header header; PoseWithCovariance pose",
    "geometry_msgs/TwistStamped": "std_msgs/Header header; Twist twist",
    "geometry_msgs/TwistWithCovarianceStamped": "std_msgs/Header header; TwistWithCovariance twist",
    "geometry_msgs/AccelStamped": "std_msgs/Header header; Accel accel",
    "geometry_msgs/TransformStamped": "std_msgs/Header header; string child_frame_id; Transform transform",
    "nav_msgs/Odometry": "std_msgs/Header header; string child_frame_id; "
    "geometry_msgs/PoseWithCovariance pose; geometry_msgs/TwistWithCovariance twist",
    "sensor_msgs/Imu": "std_msgs/Header header; geometry_msgs/Quaternion orientation; "
    "float64[9] orientation_covariance; geometry_msgs/Vector3 angular_velocity; float64[9] "
    "angular_velocity_covariance; geometry_msgs/Vector3 linear_acceleration; float64[9] "
    "linear_acceleration_covariance",
    "sensor_msgs/BatteryState": "std_msgs/Header header; float32 voltage; float32 temperature; "
    "float32 current; float32 charge; float32 capacity; float32 design_capacity; float32 percentage; "
    "uint8 power_supply_status; uint8 power_supply_health; uint8 power_supply_technology; bool present; "
    "float32[] cell_voltage; float32[] cell_temperature; string location; string serial_number",
    "mavros_msgs/AttitudeTarget": "std_msgs/Header header; uint8 type_mask; "
    "geometry_msgs/Quaternion orientation; geometry_msgs/Vector3 body_rate; float32 thrust",
    "mavros_msgs/PositionTarget": "std_msgs/Header header; uint8 coordinate_frame; uint16 type_mask; "
    "geometry_msgs/Point position; geometry_msgs/Vector3 velocity; geometry_msgs/Vector3 "
    "acceleration_or_force; float32 yaw; float32 yaw_rate",
    "mavros_msgs/State": "std_msgs/Header header; bool connected; bool armed; bool guided; "
    "bool manual_input; string mode; uint8 system_status",
    "mavros_msgs/ExtendedState": "std_msgs/Header header; uint8 vtol_state; uint8 landed_state",
    "mavros_msgs/RCOut": "std_msgs/Header header; uint16[] channels",
    "mavros_msgs/ActuatorControl": "std_msgs/Header header; uint8 group_mix; float32[8] controls",
    "mavros_msgs/ESCStatusItem": "std_msgs/Header header; int32 rpm; float32 voltage; float32 current",
    "mavros_msgs/ESCStatus": "std_msgs/Header header; ESCStatusItem[] esc_status",
    "mav_msgs/Actuators": "std_msgs/Header header; float64[] angles; float64[] angular_velocities; "
    "float64[] normalized",
    "actuator_msgs/Actuators": "std_msgs/Header header; float64[] position; float64[] velocity; "
    "float64[] normalized",
}


def common_types() -> dict[str, tuple[MessageField, ...]]:
    """Return the fields of each type."""
    return {name: fields_of(text, name) for name, text in _TEXTS.items()}
