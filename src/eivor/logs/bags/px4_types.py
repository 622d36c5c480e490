"""Fields of `px4_msgs` by release, for bags that come without definitions.

ROS 2 before Iron keeps none in sqlite3 bags, and PX4 changes its messages from release to release. Facts:
names, types and order of the fields. A message says no version of itself; what tells is its length, and that
all topics of a bag are of one release. What still fits more than one layout is used as far as they agree.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

from eivor.logs.bags.definitions import MessageField, fields_of

PACKAGE = "px4_msgs"
_SAMPLED = "uint64 timestamp; uint64 timestamp_sample; "
_VECTOR = f"{_SAMPLED}float32[3] xyz"

_PLACE = (
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
        "VehicleLocalPosition": f"{_PLACE}float32 heading; "
        f"{_TURN}{_ORIGIN}{_GROUND}{_ERRORS}float32 hagl_max",
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
        "VehicleLocalPosition": f"{_PLACE}float32 heading; float32 unaided_heading; {_TURN}{_ORIGIN}{_GROUND}"
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
        "VehicleLocalPosition": f"{_PLACE}float32 heading; float32 heading_var; float32 unaided_heading; "
        f"{_TURN}"
        f"float32 tilt_var; {_ORIGIN}{_GROUND}{_ERRORS}float32 hagl_max",
        "VehicleStatus": f"{_STATE}uint8 executor_in_charge; uint32 valid_nav_states_mask; "
        f"uint32 can_set_nav_states_mask; {_KIND}bool failsafe_and_user_took_over; "
        "uint8 failsafe_defer_state; "
        f"{_LINKS}",
    },
    "1.16": {
        "VehicleLocalPosition": f"{_PLACE}float32 heading; float32 heading_var; float32 unaided_heading; "
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
