"""Message definitions and layouts of bags."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np

from eivor.tools import Bool, Int

# -- Definitions --

#: Bytes of the types that messages are made of; strings have a length of their own.
SIZES: Mapping[str, str] = {
    "bool": "u1",
    "byte": "u1",
    "char": "u1",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
    "float32": "f4",
    "float64": "f8",
}
STRING = "string"
#: Longest text of a definition that is read [characters].
MAX_TEXT = 1 << 18
_LINE = re.compile(
    r"([A-Za-z][A-Za-z0-9_/]*)(?:<=\d+)?(\[(?:<=)?\d{0,18}\])?\s+([A-Za-z][A-Za-z0-9_]*)\s*(=?)"
)
_NEXT = re.compile(r"^={40,}[ \t]*\nMSG:[ \t]*(\S+)[^\n]*\n", re.MULTILINE)
#: Types that have another name in the text than elsewhere, by ROS 1's way of writing.
_SHORT = {"Header": "std_msgs/Header"}


@dataclass(frozen=True, slots=True)
class MessageField:
    """One field of a message."""

    name: str
    kind: str  # A key of `SIZES`, "string", or the name of another type
    count: int | None = None  # Number of values of an array


#: Fields of each type, by "package/Type".
Types = Mapping[str, tuple[MessageField, ...]]


def type_name(name: str) -> str:
    """Return the name of a type without its folder: "nav_msgs/msg/Odometry" is "nav_msgs/Odometry"."""
    package, _, rest = name.partition("/")
    return f"{package}/{rest.rpartition('/')[2]}" if rest else name


def parsed_definition(text: str, name: str) -> dict[str, tuple[MessageField, ...]]:
    """Return the types of a definition, with those that follow it in the same text."""
    parts = _NEXT.split(text[:MAX_TEXT])
    names = [name, *parts[1::2]]
    return {
        type_name(item): tuple(_fields(block, type_name(item)))
        for item, block in zip(names, parts[0::2], strict=True)
    }


def fields_of(text: str, owner: str) -> tuple[MessageField, ...]:
    """Return the fields of one type, each on a line or separated by semicolons."""
    return tuple(_fields(text.replace(";", "\n"), owner))


def _fields(block: str, owner: str) -> list[MessageField]:
    results = []
    for line in block.splitlines():
        match = _LINE.match(line.partition("#")[0].strip())
        if match is None or match[4]:
            continue
        kind, brackets, name = match[1], match[2], match[3]
        count = None if brackets is None else int(brackets[1:-1]) if brackets[1:-1].isdigit() else -1
        results.append(MessageField(name, _type_name(kind, owner), count))
    return results


def _type_name(kind: str, owner: str) -> str:
    if kind in SIZES or kind in {STRING, "wstring", "time", "duration"}:
        return kind
    if "/" in kind:
        return type_name(kind)
    return _SHORT.get(kind, f"{owner.partition('/')[0]}/{kind}")


# -- Common types --

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


# -- IDL --

_SEPARATOR = "=" * 80 + "\n"


def idl_types(text: str) -> dict[str, tuple[MessageField, ...]]:
    """Return the types of a definition; none where it cannot be parsed."""
    from rosbags.typesys import TypesysError, get_types_from_idl

    parts = [part.partition("\n")[2] for part in text[:MAX_TEXT].split(_SEPARATOR) if part.startswith("IDL:")]
    types: dict[str, tuple[MessageField, ...]] = {}
    for part in parts or [text[:MAX_TEXT]]:
        try:
            parsed = get_types_from_idl(part)
        except (TypesysError, ValueError, TypeError, KeyError, IndexError, AttributeError, RecursionError):
            continue
        for name, (_, fields) in parsed.items():
            types[type_name(name)] = tuple(_field(item, described) for item, described in fields)
    return types


def _field(name: str, described: Any) -> MessageField:
    """A field of rosbags' parse tree: a node's number (base, name, array, sequence), and what it is of."""
    from rosbags.interfaces import Nodetype

    node, content = described
    if node in {Nodetype.ARRAY, Nodetype.SEQUENCE}:
        inner, count = content
        return MessageField(name, _idl_type(*inner), count if node == Nodetype.ARRAY else -1)
    return MessageField(name, _idl_type(node, content), None)


def _idl_type(node: Any, content: Any) -> str:
    from rosbags.interfaces import Nodetype

    return str(content[0]) if node == Nodetype.BASE else type_name(str(content))


# -- Layouts --

#: Bounds that no message comes near whose fields are of use here.
MAX_FIELDS = 4096
MAX_NESTING = 12
#: Arrays of more values than this are passed over: they are images, clouds, covariances.
MAX_ARRAY = 64
#: Bytes before a message of ROS 2 that say how it is written.
ENCAPSULATION = 4
#: A message may be filled up to a multiple of this [bytes].
FILLED_TO = 4


class UnsoundMessageError(ValueError):
    """A message whose bytes are not those of its type."""


@dataclass(frozen=True, slots=True)
class MessageLayout:
    """Where the fields of a message are."""

    fields: Mapping[str, tuple[int, str]]  # [bytes]
    lengths: tuple[int, ...]
    size: int  # Length of the message [bytes]

    def table(self, joined: bytes) -> np.ndarray:
        """Return messages of this layout, one after the other, as a structured array."""
        names = list(self.fields)
        return np.frombuffer(
            joined,
            np.dtype(
                {
                    "names": names,
                    "formats": [self.fields[name][1] for name in names],
                    "offsets": [self.fields[name][0] for name in names],
                    "itemsize": self.size,
                }
            ),
        )


def message_layout(message: bytes, kind: str, types: Types, *, ros1: bool) -> MessageLayout:
    """Return the layout of a message, and of all whose texts and sequences are as long."""
    if ros1:
        walk = _MessageWalk(message, types, 0, "<", aligned=False)
    else:
        if message[:1] != b"\x00" or message[1:2] not in (b"\x00", b"\x01"):
            raise UnsoundMessageError("it is not written in plain CDR")
        walk = _MessageWalk(message, types, ENCAPSULATION, "<" if message[1] else ">", aligned=True)
        walk.lengths.append(0)  # how it is written, which messages of one layout share too
    walk.take(kind, "", MAX_NESTING)
    spare = len(message) - walk.position
    filled = not ros1 and 0 <= spare < FILLED_TO and len(message) % FILLED_TO == 0
    if spare and not filled:
        raise UnsoundMessageError(f"{len(message)} bytes, where its type takes {walk.position}")
    return MessageLayout(walk.fields, tuple(walk.lengths), len(message))


@dataclass(slots=True)
class _MessageWalk:
    """The way through one message."""

    message: bytes
    types: Types
    position: int
    order: str
    aligned: bool
    fields: dict[str, tuple[int, str]] = field(default_factory=dict)
    lengths: list[int] = field(default_factory=list)
    steps: int = 0

    def take(self, kind: str, prefix: str, depth: int) -> None:
        """Pass over the fields of a type."""
        known = self.types.get(kind)
        if known is None or not depth:
            raise UnsoundMessageError(f"the type {kind} is not known" if depth else "it is nested too deep")
        for item in known:
            self._field(item, f"{prefix}{item.name}", depth)

    def _field(self, message_field: MessageField, name: str, depth: int) -> None:
        self.steps += 1
        if message_field.count is None:
            self._value(message_field.kind, name, depth)
            return
        count = self._length() if message_field.count < 0 else message_field.count
        if message_field.kind in SIZES:
            self._numbers(message_field.kind, name, count)
            return
        for index in range(count):
            self._value(message_field.kind, f"{name}[{index}]", depth)

    def _value(self, kind: str, name: str, depth: int) -> None:
        self.steps += 1
        if self.steps + len(self.fields) > MAX_FIELDS:
            raise UnsoundMessageError(f"it has more than {MAX_FIELDS} fields")
        if kind in SIZES:
            self._numbers(kind, name, None)
        elif kind == STRING:
            length = self._length()
            if length:
                self.fields[name] = (self.position, f"S{length}")
            self._skip(length)
        elif kind in {"time", "duration"}:
            self._numbers("uint32", f"{name}.sec", None)
            self._numbers("uint32", f"{name}.nanosec", None)
        else:
            self.take(kind, f"{name}.", depth - 1)

    def _numbers(self, kind: str, name: str, count: int | None) -> None:
        """Numbers of one type; those of long arrays get no name."""
        size = int(SIZES[kind][1])
        if count == 0:
            return
        if self.aligned:
            start = self.position - ENCAPSULATION
            self.position = ENCAPSULATION + -(-start // size) * size
        position = self.position
        self._skip(size * (1 if count is None else count))
        kind = f"{self.order}{SIZES[kind]}"
        if count is None:
            self.fields[name] = (position, kind)
        elif count <= MAX_ARRAY:
            self.fields |= {f"{name}[{index}]": (position + index * size, kind) for index in range(count)}

    def _length(self) -> int:
        """The length of a text or of a sequence."""
        if self.aligned:
            self.position += -(self.position - ENCAPSULATION) % 4
        position = self.position
        self._skip(4)
        self.lengths.append(position)
        return int(struct.unpack_from(f"{self.order}I", self.message, position)[0])

    def _skip(self, size: int) -> None:
        self.position += size
        if self.position > len(self.message):
            raise UnsoundMessageError(f"{len(self.message)} bytes, and its type goes on after them")


# -- Messages --

#: Layouts that the messages of one topic may have, those that are none included; more are left out.
MAX_LAYOUTS = 256


@dataclass(frozen=True, slots=True)
class Decoded:
    """Messages of a topic."""

    fields: Mapping[str, np.ndarray]  # shape (n,)
    indices: Int[np.ndarray, " n"]
    reason: str  # Why others are none


def decoded(payloads: Sequence[bytes], layout_of: Callable[[bytes], MessageLayout]) -> Decoded:
    """Read the messages of a topic."""
    tables: list[tuple[list[int], np.ndarray]] = []
    reason, tried = "", 0
    by_length: dict[int, list[int]] = {}
    for index, payload in enumerate(payloads):
        by_length.setdefault(len(payload), []).append(index)
    for waiting in by_length.values():
        rest = waiting
        while rest and tried < MAX_LAYOUTS:
            tried += 1
            try:
                layout = layout_of(payloads[rest[0]])
            except UnsoundMessageError as error:
                reason, rest = reason or str(error), rest[1:]
                continue
            joined = b"".join([payloads[item] for item in rest])
            equal = _same_layout(joined, layout, len(rest))
            same = [item for item, is_so in zip(rest, equal.tolist(), strict=True) if is_so]
            if len(same) < len(rest):
                joined = b"".join([payloads[item] for item in same])
                rest = [item for item, is_so in zip(rest, equal.tolist(), strict=True) if not is_so]
            else:
                rest = []
            tables.append((same, layout.table(joined)))
        if rest:
            reason = reason or f"they have more than {MAX_LAYOUTS} layouts"
    return _merged(tables, reason)


def _same_layout(joined: bytes, layout: MessageLayout, count: int) -> Bool[np.ndarray, " n"]:
    """Which messages are written as the first is, with texts and sequences of the same lengths."""
    rows = np.frombuffer(joined, np.uint8).reshape(count, layout.size)
    same = np.ones(count, dtype=np.bool_)
    for length in layout.lengths:
        same &= np.all(rows[:, length : length + 4] == rows[0, length : length + 4], axis=1)
    return same


def _merged(tables: list[tuple[list[int], np.ndarray]], reason: str) -> Decoded:
    if not tables:
        return Decoded({}, np.empty(0, dtype=np.int64), reason)
    positions = np.concatenate([np.array(item, dtype=np.int64) for item, _ in tables])
    order = np.argsort(positions, kind="stable")
    names = tables[0][1].dtype.names or ()
    shared = [name for name in names if all(name in (table.dtype.names or ()) for _, table in tables)]
    fields = {name: np.concatenate([table[name] for _, table in tables])[order] for name in shared}
    return Decoded(fields, positions[order], reason)


# -- PX4 types --

PACKAGE = "px4_msgs"
_SAMPLED = "uint64 timestamp; uint64 timestamp_sample; "
_VECTOR = f"{_SAMPLED}float32[3] xyz"

_POS = (
    f"{_SAMPLED}bool xy_valid; bool z_valid; bool v_xy_valid; bool v_z_valid; float32 x; float32 y; "
    "float32 z; float32[2] delta_xy; uint8 xy_reset_counter; float32 delta_z; uint8 z_reset_counter; "
    "float32 vx; float32 vy; float32 vz; float32 z_deriv; float32[2] delta_vxy; uint8 vxy_reset_counter; "
    "float32 delta_vz; uint8 vz_reset_counter; float32 ax; float32 ay; float32 az; "
)
_ORIGIN = (
    "bool xy_global; bool z_global; uint64 ref_timestamp; float64 ref_lat; float64 ref_lon; float32 ref_alt; "
)
_TURN = "float32 delta_heading; uint8 heading_reset_counter; bool heading_good_for_control; "
_GROUND = "float32 dist_bottom; bool dist_bottom_valid; uint8 dist_bottom_sensor_bitfield; "
_GROUND_LATER = (
    "bool dist_bottom_valid; float32 dist_bottom; float32 dist_bottom_var; float32 delta_dist_bottom; "
    "uint8 dist_bottom_reset_counter; uint8 dist_bottom_sensor_bitfield; "
)
_ERRORS = (
    "float32 eph; float32 epv; float32 evh; float32 evv; bool dead_reckoning; float32 vxy_max; float32 "
    "vz_max; float32 hagl_min; "
)
_LINKS = (
    "bool gcs_connection_lost; uint8 gcs_connection_lost_counter; bool high_latency_data_link_lost; bool "
    "is_vtol; bool is_vtol_tailsitter; bool in_transition_mode; bool in_transition_to_fw; uint8 "
    "system_type; uint8 system_id; uint8 component_id; bool safety_button_available; bool safety_off; "
    "bool power_input_valid; bool usb_connected; bool open_drone_id_system_present; bool "
    "open_drone_id_system_healthy; bool parachute_system_present; bool parachute_system_healthy; bool "
    "avoidance_system_required; bool avoidance_system_valid; bool rc_calibration_in_progress; bool "
    "calibration_enabled; bool pre_flight_checks_pass"
)
_STATE = (
    "uint64 timestamp; uint64 armed_time; uint64 takeoff_time; uint8 arming_state; uint8 "
    "latest_arming_reason; uint8 latest_disarming_reason; uint64 nav_state_timestamp; uint8 "
    "nav_state_user_intention; uint8 nav_state; "
)
_KIND = "uint16 failure_detector_status; uint8 hil_state; uint8 vehicle_type; bool failsafe; "
_BATTERY = (
    "uint64 timestamp; bool connected; float32 voltage_v; float32 voltage_filtered_v; float32 current_a; "
    "float32 current_filtered_a; float32 current_average_a; float32 discharged_mah; float32 remaining; "
    "float32 scale; float32 time_remaining_s; float32 temperature; uint8 cell_count; uint8 source; uint8 "
    "priority; uint16 capacity; uint16 cycle_count; uint16 average_time_to_empty; uint16 serial_number; "
    "uint16 manufacture_date; uint16 state_of_health; uint16 max_error; uint8 id; uint16 interface_error; "
    "float32[14] voltage_cell_v; float32 max_cell_voltage_delta; bool is_powering_off; bool is_required; "
    "uint16 faults; uint32 custom_faults; uint8 warning; uint8 mode"
)

#: Of each release the types whose fields it changed; a type stays until another release changes it.
_RELEASES: Mapping[str, Mapping[str, str]] = {
    "1.13": {
        "VehicleLocalPosition": f"{_POS}float32 heading; {_TURN}{_ORIGIN}{_GROUND}{_ERRORS}float32 hagl_max",
        "VehicleAttitude": f"{_SAMPLED}float32[4] q; float32[4] delta_q_reset; uint8 quat_reset_counter",
        "VehicleThrustSetpoint": _VECTOR,
        "VehicleTorqueSetpoint": _VECTOR,
        "VehicleAcceleration": _VECTOR,
        "VehicleAngularVelocity": f"{_VECTOR}; float32[3] xyz_derivative",
        "SensorCombined": "uint64 timestamp; float32[3] gyro_rad; uint32 gyro_integral_dt; "
        "int32 accelerometer_timestamp_relative; float32[3] accelerometer_m_s2; uint32 "
        "accelerometer_integral_dt; uint8 accelerometer_clipping; uint8 gyro_clipping; uint8 "
        "accel_calibration_count; uint8 gyro_calibration_count",
        "ActuatorMotors": f"{_SAMPLED}uint16 reversible_flags; float32[12] control",
        "ActuatorOutputs": "uint64 timestamp; uint32 noutputs; float32[16] output",
        "TrajectorySetpoint": "uint64 timestamp; float32[3] position; float32[3] velocity; "
        "float32[3] acceleration; float32[3] jerk; float32 yaw; float32 yawspeed",
        "VehicleLocalPositionSetpoint": "uint64 timestamp; float32 x; float32 y; float32 z; float32 vx; "
        "float32 vy; float32 vz; float32[3] acceleration; float32[3] thrust; float32 yaw; float32 yawspeed",
        "VehicleAttitudeSetpoint": "uint64 timestamp; float32 roll_body; float32 pitch_body; "
        "float32 yaw_body; float32 yaw_sp_move_rate; float32[4] q_d; float32[3] thrust_body; bool "
        "reset_integral; bool fw_control_yaw_wheel",
        "VehicleRatesSetpoint": "uint64 timestamp; float32 roll; float32 pitch; float32 yaw; "
        "float32[3] thrust_body; bool reset_integral",
        "VehicleLandDetected": "uint64 timestamp; bool freefall; bool ground_contact; bool maybe_landed; "
        "bool landed; bool in_ground_effect; bool in_descend; bool has_low_throttle; bool "
        "vertical_movement; bool horizontal_movement; bool rotational_movement; bool "
        "close_to_ground_or_skipped_check; bool at_rest",
        "BatteryStatus": _BATTERY,
        "HoverThrustEstimate": f"{_SAMPLED}float32 hover_thrust; float32 hover_thrust_var; "
        "float32 accel_innov; float32 accel_innov_var; float32 accel_innov_test_ratio; float32 "
        "accel_noise_var; bool valid",
        "EscReport": "uint64 timestamp; uint32 esc_errorcount; int32 esc_rpm; float32 esc_voltage; "
        "float32 esc_current; float32 esc_temperature; uint8 esc_address; uint8 esc_cmdcount; uint8 "
        "esc_state; uint8 actuator_function; uint16 failures; int8 esc_power",
        "EscStatus": "uint64 timestamp; uint16 counter; uint8 esc_count; uint8 esc_connectiontype; "
        "uint8 esc_online_flags; uint8 esc_armed_flags; EscReport[8] esc",
    },
    "1.14": {
        "VehicleLocalPosition": f"{_POS}float32 heading; float32 unaided_heading; {_TURN}{_ORIGIN}{_GROUND}"
        f"{_ERRORS}float32 hagl_max",
        "VehicleStatus": f"{_STATE}{_KIND}bool failsafe_and_user_took_over; {_LINKS}",
        "ManualControlSetpoint": f"{_SAMPLED}bool valid; uint8 data_source; float32 roll; float32 pitch; "
        "float32 yaw; float32 throttle; float32 flaps; uint16 buttons; float32 aux1; float32 aux2; "
        "float32 aux3; float32 aux4; float32 aux5; float32 aux6; bool sticks_moving",
        "BatteryStatus": f"{_BATTERY}; float32 average_power; float32 available_energy; "
        "float32 full_charge_capacity_wh; float32 remaining_capacity_wh; float32 design_capacity; uint16 "
        "average_time_to_full; uint16 over_discharge_count; float32 nominal_voltage",
    },
    "1.15": {
        "VehicleLocalPosition": f"{_POS}float32 heading; float32 heading_var; float32 unaided_heading; "
        f"{_TURN}"
        f"float32 tilt_var; {_ORIGIN}{_GROUND}{_ERRORS}float32 hagl_max",
        "VehicleStatus": f"{_STATE}uint8 executor_in_charge; uint32 valid_nav_states_mask; "
        f"uint32 can_set_nav_states_mask; {_KIND}bool failsafe_and_user_took_over; "
        "uint8 failsafe_defer_state; "
        f"{_LINKS}",
    },
    "1.16": {
        "VehicleLocalPosition": f"{_POS}float32 heading; float32 heading_var; float32 unaided_heading; "
        f"{_TURN}"
        f"float32 tilt_var; {_ORIGIN}{_GROUND_LATER}{_ERRORS}float32 hagl_max_z; float32 hagl_max_xy",
        "VehicleAttitudeSetpoint": "uint64 timestamp; float32 yaw_sp_move_rate; float32[4] q_d; "
        "float32[3] thrust_body; bool fw_control_yaw_wheel",
        "BatteryStatus": "uint64 timestamp; uint8 id; bool connected; float32 voltage_v; float32 current_a; "
        "float32 current_average_a; float32 discharged_mah; float32 remaining; float32 scale; float32 "
        "time_remaining_s; float32 temperature; uint8 priority; uint16 interface_error; float32[14] "
        "voltage_cell_v; float32 max_cell_voltage_delta; bool is_powering_off; bool is_required; uint8 "
        "warning; uint16 faults; float32 ocv_estimate; float32 ocv_estimate_filtered; float32 "
        "volt_based_soc_estimate; float32 voltage_prediction; float32 prediction_error; float32 "
        "estimation_covariance_norm; uint8 cell_count; uint8 source; uint16 capacity; uint16 cycle_count; "
        "uint16 average_time_to_empty; char[32] serial_number; uint16 manufacture_date; uint16 "
        "state_of_health; uint16 max_error; float32 design_capacity_wh; float32 full_charge_capacity_wh; "
        "float32 remaining_capacity_wh; uint16 over_discharge_count; float32 nominal_voltage; float32 "
        "internal_resistance_estimate",
    },
}


@cache
def px4_releases() -> dict[str, dict[str, tuple[MessageField, ...]]]:
    """Return the fields of each type in each release, by its number and then by "px4_msgs/Type"."""
    releases: dict[str, dict[str, tuple[MessageField, ...]]] = {}
    so_far: dict[str, tuple[MessageField, ...]] = {}
    for number, changed in _RELEASES.items():
        full = {f"{PACKAGE}/{name}": text for name, text in changed.items()}
        so_far = so_far | {name: fields_of(text, name) for name, text in full.items()}
        releases[number] = so_far
    return releases
