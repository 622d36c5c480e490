"""DataFlash logs: dialects of the firmware, and what each channel is."""

import numpy as np
import pytest
from dataflash_writer import DataflashWriter, flight_log, simulated

from eivor.errors import EmptyLogError
from eivor.logs import logging_advice, read_log
from eivor.signals.channels import CurveSide
from eivor.signals.recording import Frame


@pytest.fixture(scope="module")
def flight():
    return simulated(seed=3, duration=20.0)


def read(tmp_path, writer):
    path = tmp_path / "flight.bin"
    path.write_bytes(writer if isinstance(writer, bytes) else writer.bytes())
    return read_log(path)


def findings(recording):
    return [finding.name for finding in recording.findings]


SOURCES = {
    "3.3": ("EKF1.VD", "-CTUN.DAlt", "CURR.Volt"),
    "3.4": ("NKF6.VD", "-CTUN.DAlt", "CURR.Volt"),
    "4.1": ("XKF1.VD", "PSCD.TPD", "BAT.Volt"),
    "4.6": ("XKF1.VD", "PSCD.DPD", "BAT.Volt"),
}


@pytest.mark.parametrize("dialect", SOURCES)
def test_a_flight_in_each_dialect(tmp_path, flight, dialect):
    r = read(tmp_path, flight_log(flight, dialect))
    truth = flight.channels
    channels = r.channels
    assert (r.format, r.frame, r.vehicle) == ("dataflash", Frame.NED, "rotary wing")
    names = ("velocity_z", "reference_position_z", "battery_voltage")
    assert tuple(channels[name].source for name in names) == SOURCES[dialect]
    assert channels["velocity_z"].estimated
    np.testing.assert_allclose(channels["velocity_z"].values, -truth["velocity_z"].values[::4], atol=1e-6)
    np.testing.assert_allclose(channels["velocity_z"].time_s, truth["velocity_z"].time_s[::4], atol=1e-6)
    throttle = truth["rotor_command_1"].values ** 2
    np.testing.assert_allclose(channels["input"].values, throttle, atol=1e-6)
    assert channels["input"].source == "RATE.AOut"
    sides = {name: channel.curve_side for name, channel in channels.items() if channel.curve_side.value}
    outputs = {f"actuator_output_{n}": CurveSide.BEHIND for n in range(1, 5)}
    assert sides == {"input": CurveSide.BEFORE, **outputs}
    force = -truth["specific_force_z"].values / truth["cos_tilt"].values
    np.testing.assert_allclose(channels["specific_force_body_z"].values, force, atol=1e-5)
    reference = -truth["reference_position_z"].values[::10] - (0.5 if dialect == "4.1" else 0.0)
    held = channels["reference_position_z"].values
    np.testing.assert_allclose(held[: reference.size - 1], reference[:-1], atol=1e-6)
    feedback = -truth["reference_velocity_z"].values[::10] - 0.07
    reported = channels["feedback_reference_velocity_z"].values
    np.testing.assert_allclose(reported[: feedback.size - 1], feedback[:-1], atol=0.006)
    np.testing.assert_allclose(channels["battery_voltage"].values, 14.8, atol=1e-5)
    share = truth["rotor_command_1"].values[::10]
    np.testing.assert_allclose(channels["actuator_output_4"].values, share, atol=1e-3)
    assert r.parameters["MOT_THST_EXPO"] == 1.0
    assert "motor_range" not in findings(r)
    np.testing.assert_array_equal(channels["landed"].values, [0.0, 1.0])


def test_attitude_turns_without_a_jump(tmp_path, flight):
    r = read(tmp_path, flight_log(flight, "3.4"))
    tilt = flight.channels["cos_tilt"].values
    w, x, y, z = (r.channels[f"attitude_{part}"].values for part in "wxyz")
    np.testing.assert_allclose(1.0 - 2.0 * (x * x + y * y), tilt, atol=2e-5)
    assert max(np.abs(np.diff(item)).max() for item in (w, z)) < 0.01  # yaw goes from 350 to 10 degrees


def test_pulse_widths_that_do_not_fit_the_throttle(tmp_path, flight):
    r = read(tmp_path, flight_log(flight, "4.6", high=1700.0))
    (finding,) = [item for item in r.findings if item.name == "motor_range"]
    assert "RC3_MIN and RC3_MAX" in finding.message


@pytest.mark.parametrize("dialect", ["4.1", "4.6"])
def test_declared_units_agree(tmp_path, flight, dialect):
    r = read(tmp_path, flight_log(flight, dialect))
    assert "declared_units" not in findings(r)


def declared(tmp_path, letters):
    """Sentence on a log of a climb in whole cm/s and a pitch in centidegrees, whose units are declared so."""
    writer = DataflashWriter().add("CTUN", [0.0, 0.1], "h", DCRt=[100, 50])
    writer.add("ATT", [0.0, 0.1], "ccc", Roll=1.0, Pitch=2.0, Yaw=3.0).units(letters)
    return " ".join(
        finding.message for finding in read(tmp_path, writer).findings if finding.name == "declared_units"
    )


def test_declared_units_that_disagree(tmp_path):
    assert not declared(tmp_path, {"DCRt": "nB", "Pitch": "dB", "Roll": "d-", "Yaw": "h?"})
    reported = declared(tmp_path, {"DCRt": "nC", "Pitch": "n0", "Roll": "E0"})
    assert "CTUN.DCRt as 0.001 m/s, read as 0.01" in reported
    assert "ATT.Pitch in m/s, read in rad" in reported
    assert "ATT.Roll in rad/s" in reported
    assert "ATT.Roll as 0.01 rad, read as 0.0001745" in declared(tmp_path, {"Roll": "r0"})


def without(writer, *names):
    """Leave messages out, but not what describes them."""
    numbers = {writer.numbers[name] for name in names}
    writer.messages = [pair for pair in writer.messages if pair[1][2] not in numbers]
    return writer


def test_the_thrust_of_pulse_widths_where_no_throttle_is_logged(tmp_path, flight):
    r = read(tmp_path, without(flight_log(flight, "4.6"), "RATE", "CTUN"))
    share = flight.channels["rotor_command_1"].values[::10]
    np.testing.assert_allclose(r.channels["input"].values, share**2, atol=2e-3)
    assert r.channels["input"].source == "RCOU through the thrust curve"
    assert r.channels["input"].curve_side is CurveSide.BEFORE


def test_height_targets_of_modes_without_a_height_loop(tmp_path, flight):
    writer = flight_log(flight, "3.4").add("MODE", 5.0, "MBB", Mode=0, ModeNum=0, Rsn=1)
    writer.add("MODE", 10.0, "MBB", Mode=2, ModeNum=2, Rsn=1)
    r = read(tmp_path, writer)
    target = r.channels["reference_position_z"]
    manual = (target.time_s >= 5.0) & (target.time_s < 10.0)
    np.testing.assert_array_equal(np.isnan(target.values[:-1]), manual[:-1])
    np.testing.assert_array_equal(r.channels["pilot_in_control"].values, [0.0, 1.0, 1.0])
    np.testing.assert_array_equal(r.channels["input_open_loop"].values, [0.0, 1.0, 0.0])
    assert np.isnan(r.channels["feedback_reference_roll"].values[600])
    assert np.isfinite(r.channels["reference_roll"].values[600])


def test_setpoints_end_where_their_message_falls_silent(tmp_path, flight):
    writer = flight_log(flight, "4.6")
    number = writer.numbers["PSCD"]
    writer.messages = [(time, item) for time, item in writer.messages if item[2] != number or time < 110.0]
    r = read(tmp_path, writer)
    assert np.isnan(r.channels["reference_position_z"].values[-1])
    assert "setpoint_silent" in findings(r)


def test_delays_of_filters_are_taken_off(tmp_path, flight):
    writer = flight_log(flight, "4.6").parameters(INS_ACCEL_FILTER=20.0, INS_GYRO_FILTER=40.0)
    r = read(tmp_path, writer)
    assert r.channels["specific_force_body_z"].delay_s == pytest.approx(np.sqrt(2.0) / (2.0 * np.pi * 20.0))
    assert r.channels["angular_rate_x"].delay_s == pytest.approx(np.sqrt(2.0) / (2.0 * np.pi * 40.0))
    assert "INS_ACCEL_FILTER" in next(
        finding.message for finding in r.findings if finding.name == "sensor_delay"
    )


@pytest.mark.parametrize(
    ("axis", "name", "factor"),
    [
        (11, "injected_torque_y", 1.0),
        (13, "injected_throttle", 1.0),
        (7, "reference_angular_rate_x", np.pi / 180.0),
        (3, "reference_yaw", np.pi / 180.0),
    ],
)
def test_sweeps_of_system_identification(tmp_path, flight, axis, name, factor):
    time = np.arange(5.0, 10.0, 0.01)
    wave = np.sin(time**2)
    writer = flight_log(flight, "4.6").add("SIDS", 4.9, "Bf", Ax=axis, Mag=1.0)
    writer.add("SIDD", time, "ffffff", Time=time, Targ=wave, F=1.0, Gx=0.0, Gy=0.0, Gz=0.0)
    channel = read(tmp_path, writer).channels[name]
    assert channel.source == "SIDD.Targ"
    within = (channel.time_s > 4.99) & (channel.time_s < 9.995)
    np.testing.assert_allclose(channel.values[within], wave * factor, atol=1e-6)
    assert np.all(channel.values[~within] == 0.0)


def test_sticks_ask_beside_a_sweep_of_the_attitude(tmp_path, flight):
    """Sticks set the attitude before the sweep, a loop after it: what the loop asks for is no reference."""
    writer = flight_log(flight, "4.6", modes={0.0: 0, 5.0: 25, 7.0: 5})
    writer.add("SIDS", 5.0, "Bf", Ax=3, Mag=1.0).add("SIDD", np.arange(5.0, 7.0, 0.01), "f", Targ=1.0)
    channel = read(tmp_path, writer).channels["reference_yaw"]
    before, sweep = channel.time_s < 4.99, (channel.time_s > 5.02) & (channel.time_s < 6.98)
    np.testing.assert_allclose(channel.values[before], np.radians(350.0), atol=1e-6)
    np.testing.assert_allclose(channel.values[sweep], np.radians(1.0), atol=1e-6)
    assert np.all(channel.values[channel.time_s > 7.02] == 0.0)
    assert channel.quality.duplicated_stamps == 0


@pytest.mark.parametrize(("axis", "by_sticks"), [(7, True), (13, True), (14, False), (0, False)])
def test_who_flies_in_system_identification(tmp_path, flight, axis, by_sticks):
    """A sweep of position or velocity has its loops; beside others the sticks set throttle and attitude."""
    r = read(tmp_path, flight_log(flight, "3.4", modes={0.0: 25}).parameters(SID_AXIS=axis))
    for name in ("pilot_in_control", "input_open_loop", "pilot_sets_attitude"):
        assert r.channels[name].values.tolist() == [float(by_sticks)], name
    assert ("reference_roll" in r.channels) is by_sticks
    assert ("reference_position_z" in r.channels) is not by_sticks


def test_a_sweep_of_the_position_is_named(tmp_path, flight):
    writer = flight_log(flight, "4.6").add("SIDS", 4.9, "B", Ax=14)
    writer.add("SIDD", [5.0, 5.1], "f", Targ=[0.1, 0.2])
    assert "sweep_unused" in findings(read(tmp_path, writer))


def test_rotor_speeds_by_instance(tmp_path, flight):
    writer = flight_log(flight, "4.6")
    for instance in range(2):
        writer.add("ESC", [1.0, 2.0], "Bf", Instance=instance, RPM=3000.0 * (instance + 1))
    r = read(tmp_path, writer)
    assert r.channels["rotor_speed_2"].values[0] == pytest.approx(2.0 * r.channels["rotor_speed_1"].values[0])
    assert r.channels["rotor_speed_1"].values[0] == pytest.approx(100.0 * np.pi)


@pytest.mark.parametrize(
    ("text", "vehicle"),
    [
        ("ArduPlane V4.5.7 (0358a9c2)", "fixed wing"),
        ("ArduRover V4.2.3", "rover"),
        ("APM:Copter V3.4.4", "rotary wing"),
        ("Rover V4.5.0 (abc)", "rover"),
        ("Mission: 1 Takeoff", ""),
    ],
)
def test_vehicles(tmp_path, flight, text, vehicle):
    assert read(tmp_path, flight_log(flight, vehicle=text)).vehicle == vehicle


def test_a_log_without_flight_data(tmp_path):
    with pytest.raises(EmptyLogError, match="LOG_BITMASK"):
        read(tmp_path, DataflashWriter().text("ArduCopter V4.6.2").parameters(SYSID=1.0))


def test_advice_names_the_bits():
    assert "LOG_BITMASK" in logging_advice("dataflash")[0]
    assert "IMU_FAST" in logging_advice("dataflash", "specific_force_body_z")[0]
    assert logging_advice("dataflash", "nonsense") == ()


def test_density_of_the_air_by_the_barometer(tmp_path, flight):
    writer = flight_log(flight).add("BARO", np.arange(5.0), "ff", Press=101325.0, Temp=15.0)
    density = read(tmp_path, writer).channels["air_density"]
    np.testing.assert_allclose(density.values, 1.225, atol=1e-4)  # the standard atmosphere
    assert density.source == "BARO.Press and .Temp"
    broken = flight_log(flight).add("BARO", np.arange(5.0), "ff", Press=101325.0, Temp=0.0)
    assert "air_density" not in read(tmp_path, broken).channels
