"""DataFlash logs: dialects of the firmware, and what each channel is."""

from __future__ import annotations

import dataflash_writer
import numpy as np
import pytest
from dataflash_writer import FIRMWARES, DataflashWriter, flight_log, simulated, told

import eivor as ev


@pytest.fixture(scope="module")
def flight():
    return simulated(seed=3, duration=20.0)


SOURCES = {
    "3.3": ("EKF1.VD", "-CTUN.DAlt", "CURR.Volt"),
    "3.4": ("NKF6.VD", "-CTUN.DAlt", "CURR.Volt"),
    "4.1": ("XKF1.VD", "PSCD.TPD", "BAT.Volt"),
    "4.6": ("XKF1.VD", "PSCD.DPD", "BAT.Volt"),
}


@pytest.mark.parametrize("dialect", SOURCES)
def test_a_flight_in_each_dialect(read, flight, dialect):
    r = read(flight_log(flight, dialect))
    truth = flight.channels
    channels = r.channels
    assert (r.format, r.frame, r.vehicle) == ("dataflash", ev.Frame.NED, "rotary wing")
    names = ("velocity_z", "reference_position_z", "battery_voltage")
    assert tuple(channels[name].source for name in names) == SOURCES[dialect]
    assert channels["velocity_z"].estimated
    np.testing.assert_allclose(channels["velocity_z"].values, -truth["velocity_z"].values[::4], atol=1e-6)
    np.testing.assert_allclose(channels["velocity_z"].time_s, truth["velocity_z"].time_s[::4], atol=1e-6)
    throttle = truth["rotor_command_1"].values ** 2
    np.testing.assert_allclose(channels["input"].values, throttle, atol=1e-6)
    assert channels["input"].source == "RATE.AOut"
    sides = {name: channel.curve_side.name for name, channel in channels.items() if channel.curve_side.value}
    outputs = {f"actuator_output_{n}": "BEHIND" for n in range(1, 5)}
    assert sides == {"input": "BEFORE", **outputs}
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
    assert not told(r, "motor_range")
    np.testing.assert_array_equal(channels["landed"].values, [0.0, 1.0])


def test_attitude_turns_without_a_jump(read, flight):
    r = read(flight_log(flight, "3.4"))
    tilt = flight.channels["cos_tilt"].values
    w, x, y, z = (r.channels[f"attitude_{part}"].values for part in "wxyz")
    np.testing.assert_allclose(1.0 - 2.0 * (x * x + y * y), tilt, atol=2e-5)
    assert max(np.abs(np.diff(item)).max() for item in (w, z)) < 0.01  # yaw goes from 350 to 10 degrees


def test_pulse_widths_that_do_not_fit_the_throttle(read, flight):
    r = read(flight_log(flight, "4.6", high=1700.0))
    assert "RC3_MIN and RC3_MAX" in told(r, "motor_range")


def without(writer, *names):
    """Leave messages out, but not what describes them."""
    numbers = {writer.numbers[name] for name in names}
    writer.messages = [pair for pair in writer.messages if pair[1][2] not in numbers]
    return writer


def test_throttles_in_thousandths_of_old_firmware_are_shares(read, flight, monkeypatch):
    """Firmware 3.3 logs RATE.AOut as floating-point numbers up to 1000: hover 600 was read."""
    writer = DataflashWriter().text(FIRMWARES["3.3"])
    time = np.arange(100) * 0.02
    writer.add("RATE", time, "ff", R=0.0, AOut=600.0 + 50.0 * np.sin(time))
    channel = read(writer).channels["input"]
    np.testing.assert_allclose(channel.values, 0.6 + 0.05 * np.sin(time), rtol=1e-6)
    # nor do they say that the pulse widths have another range
    add, name = dataflash_writer.add_fast, "throttle"
    in_thousandths = lambda w, t, v, d: add(w, t, v | {name: 1000.0 * v[name]}, d)  # noqa: E731
    monkeypatch.setattr(dataflash_writer, "add_fast", in_thousandths)
    r = read(flight_log(flight, "4.6"))
    assert r.channels["input"].values.max() < 1.0
    assert not told(r, "motor_range")


def test_the_thrust_of_pulse_widths_where_no_throttle_is_logged(read, flight):
    r = read(without(flight_log(flight, "4.6"), "RATE", "CTUN"))
    share = flight.channels["rotor_command_1"].values[::10]
    np.testing.assert_allclose(r.channels["input"].values, share**2, atol=2e-3)
    assert r.channels["input"].source == "RCOU through the thrust curve"
    assert r.channels["input"].curve_side.name == "BEFORE"


def test_height_targets_of_modes_without_a_height_loop(read, flight):
    writer = flight_log(flight, "3.4").add("MODE", 5.0, "MBB", Mode=0, ModeNum=0, Rsn=1)
    writer.add("MODE", 10.0, "MBB", Mode=2, ModeNum=2, Rsn=1)
    r = read(writer)
    target = r.channels["reference_position_z"]
    manual = (target.time_s >= 5.0) & (target.time_s < 10.0)
    np.testing.assert_array_equal(np.isnan(target.values[:-1]), manual[:-1])
    np.testing.assert_array_equal(r.channels["pilot_in_control"].values, [0.0, 1.0, 1.0])
    np.testing.assert_array_equal(r.channels["input_open_loop"].values, [0.0, 1.0, 0.0])
    assert np.isnan(r.channels["feedback_reference_roll"].values[600])
    assert np.isfinite(r.channels["reference_roll"].values[600])


def test_delays_of_filters_are_taken_off(read, flight):
    writer = flight_log(flight, "4.6").parameters(INS_ACCEL_FILTER=20.0, INS_GYRO_FILTER=40.0)
    r = read(writer)
    for name, hertz in (("specific_force_body_z", 20.0), ("angular_rate_x", 40.0)):
        assert r.channels[name].delay_s == pytest.approx(np.sqrt(2.0) / (2.0 * np.pi * hertz))
    assert "INS_ACCEL_FILTER" in told(r, "sensor_delay")


@pytest.mark.parametrize(
    ("axis", "name", "factor"),
    [
        (11, "injected_torque_y", 1.0),
        (13, "injected_throttle", 1.0),
        (7, "reference_angular_rate_x", np.pi / 180.0),
        (3, "reference_yaw", np.pi / 180.0),
    ],
)
def test_sweeps_of_system_identification(read, flight, axis, name, factor):
    time = np.arange(5.0, 10.0, 0.01)
    wave = np.sin(time**2)
    writer = flight_log(flight, "4.6").add("SIDS", 4.9, "Bf", Ax=axis, Mag=1.0)
    writer.add("SIDD", time, "ffffff", Time=time, Targ=wave, F=1.0, Gx=0.0, Gy=0.0, Gz=0.0)
    channel = read(writer).channels[name]
    assert channel.source == "SIDD.Targ"
    within = (channel.time_s > 4.99) & (channel.time_s < 9.995)
    np.testing.assert_allclose(channel.values[within], wave * factor, atol=1e-6)
    assert np.all(channel.values[~within] == 0.0)


def test_sticks_ask_beside_a_sweep_of_the_attitude(read, flight):
    """Sticks set the attitude before the sweep, a loop after it: what the loop asks for is no reference."""
    writer = flight_log(flight, "4.6", modes={0.0: 0, 5.0: 25, 7.0: 5})
    writer.add("SIDS", 5.0, "Bf", Ax=3, Mag=1.0).add("SIDD", np.arange(5.0, 7.0, 0.01), "f", Targ=1.0)
    channel = read(writer).channels["reference_yaw"]
    before, sweep = channel.time_s < 4.99, (channel.time_s > 5.02) & (channel.time_s < 6.98)
    np.testing.assert_allclose(channel.values[before], np.radians(350.0), atol=1e-6)
    np.testing.assert_allclose(channel.values[sweep], np.radians(1.0), atol=1e-6)
    assert np.all(channel.values[channel.time_s > 7.02] == 0.0)
    assert channel.quality.duplicated_stamps == 0


def test_a_sweep_of_the_position_is_named(read, flight):
    writer = flight_log(flight, "4.6").add("SIDS", 4.9, "B", Ax=14)
    assert told(read(writer.add("SIDD", [5.0, 5.1], "f", Targ=[0.1, 0.2])), "sweep_unused")


def test_rotor_speeds_by_instance(read, flight):
    writer = flight_log(flight, "4.6")
    for instance in range(2):
        writer.add("ESC", [1.0, 2.0], "Bf", Instance=instance, RPM=3000.0 * (instance + 1))
    r = read(writer)
    assert r.channels["rotor_speed_2"].values[0] == pytest.approx(2.0 * r.channels["rotor_speed_1"].values[0])
    assert r.channels["rotor_speed_1"].values[0] == pytest.approx(100.0 * np.pi)


def test_density_of_the_air_by_the_barometer(read, flight):
    writer = flight_log(flight).add("BARO", np.arange(5.0), "ff", Press=101325.0, Temp=15.0)
    density = read(writer).channels["air_density"]
    np.testing.assert_allclose(density.values, 1.225, atol=1e-4)  # the standard atmosphere
    assert density.source == "BARO.Press and .Temp"
    broken = flight_log(flight).add("BARO", np.arange(5.0), "ff", Press=101325.0, Temp=0.0)
    assert "air_density" not in read(broken).channels


@pytest.fixture(scope="module")
def flight_text():
    return simulated(seed=3, duration=2.0)


@pytest.mark.thorough
@pytest.mark.parametrize(("dialect", "block"), [("3.3", None), ("3.4", None), ("4.1", 3000), ("4.6", None)])
def test_the_channels_and_numbers_of_the_binary_log(read, flight_text, monkeypatch, dialect, block):
    if block:
        monkeypatch.setattr("eivor.logs.dataflash.messages.TEXT_BLOCK_BYTES", block)
    writer = flight_log(flight_text, dialect)
    written, binary = read(writer.lines()), read(writer.bytes())
    assert list(written.channels) == list(binary.channels)
    for name, channel in binary.channels.items():
        np.testing.assert_array_equal(written.channels[name].time_s, channel.time_s, err_msg=name)
        np.testing.assert_array_equal(written.channels[name].values, channel.values, err_msg=name)
        assert written.channels[name].source == channel.source
    assert (written.format, written.frame, written.vehicle) == ("dataflash", binary.frame, "rotary wing")
    assert (written.parameters, written.findings) == (binary.parameters, binary.findings)


@pytest.mark.parametrize("names", [{"3": "Auto", "0": "STABILIZE"}, {"3": "Auto", "0": "0"}])
def test_modes_by_name_and_lines_of_windows(read, flight_text, names):
    writer = flight_log(flight_text, "3.4", modes={0.0: 3, 1.0: 0})
    for column in ("ModeNum", "Other"):
        writer.columns["MODE"] = [writer.clock, "Mode", column, "Rsn"]
        log = read(b"Ready to drive.\r\n\r\n" + writer.lines(modes=names, newline="\r\n"))
        assert log.channels["input_open_loop"].values.tolist() == [0.0, 1.0]


def test_damaged_lines_are_left_out_and_counted(read, flight_text):
    writer = flight_log(flight_text, "4.6")
    lines = writer.lines().split(b"\n")
    index = next(n for n, line in enumerate(lines) if line.startswith(b"XKF1"))
    lines[index] = lines[index].replace(b"XKF1", b"XK@1")
    lines[index + 20 :] = [
        line.replace(b"1", b"?") if n < 3 else line for n, line in enumerate(lines[index + 20 :])
    ]
    lines[5:5] = [b"FMT, 900, 20, ABC, Qf, TimeUS,X", b"FMT, 1", b"FMT, 77, 20, ABC, Q" + b"f" * 40 + b", X"]
    lines = [b"BAT, 1" if line.startswith(b"BAT") else line for line in lines]
    lines[-1:] = [b"RATE, " + b"9" * 5000, b"RATE, 1"]
    log = read(b"\n".join(lines))
    assert "battery_voltage" not in log.channels
    assert "lines that are no message" in told(log, "corrupt_parts")
    assert "left out: 3" in told(log, "message_formats")
    assert "ends within a line (7 bytes" in told(log, "truncated")
    assert abs(log.channels["velocity_z"].values.size - 50) <= 3


TRUTH = {"viscous_friction": 0.4, "input_gain": 39.2266, "effective_lag": 0.04, "hover_input": 0.25}
LOITER, SYSTEM_IDENTIFICATION, THROTTLE_AXIS = 5, 25, 13


def swept(seconds=80.0, start=12.0, end=70.0):
    """A flight that holds its height in gusts, and in between sweeps the throttle of a resting stick."""
    rng, step, gain, lag = np.random.default_rng(0), 0.0025, TRUTH["input_gain"], TRUTH["effective_lag"]
    time = np.arange(round(seconds / step)) * step
    within = (time >= start) & (time < end)
    sweep = 0.08 * np.sin(2.0 * np.pi * (0.05 * (time - start) + 0.98 / (end - start) * (time - start) ** 2))
    sweep = np.where(within, sweep, 0.0)
    kept, gust, height, speed, state, rows = np.exp(-step), 0.0, 5.0, 0.0, 0.25, []
    gusts = 0.3 * np.sqrt(1.0 - kept**2) * rng.standard_normal(time.size)
    for k in range(time.size):
        if k % 4 == 0:
            gains = (0.003, 0.002) if within[k] else (0.02, 0.04)
            requested = 0.25 + gains[0] * (5.0 - height) - gains[1] * speed + sweep[k]
        gust = kept * gust + gusts[k]
        climb = gain * state - 9.80665 - TRUTH["viscous_friction"] * (speed - gust)
        rows.append((height, speed, climb + 9.80665, requested))
        state += (requested - state) * (1.0 - np.exp(-step / lag))
        speed, height = speed + step * climb, height + step * speed
    time, sweep, within = time[::4], sweep[::4], within[::4]
    height, speed, force, requested = np.array(rows[::4]).T
    values = {"position_z": height, "velocity_z": speed + 0.02 * rng.standard_normal(time.size)}
    values["specific_force_z"] = force + 0.3 * rng.standard_normal(time.size)
    values |= {"cos_tilt": np.ones(time.size), "reference_position_z": np.full(time.size, 5.0)}
    values["rotor_command_1"] = np.sqrt(requested)
    values |= dict.fromkeys(("reference_velocity_z", "reference_acceleration_z"), np.zeros(time.size))
    return ev.recording_from_columns({"time": time, **values}), time[within], sweep[within]


@pytest.mark.thorough
def test_a_sweep_into_the_throttle_is_the_instrument(read):
    flight, time, sweep = swept()
    writer = flight_log(flight, "4.6", modes={0.0: LOITER, time[0]: SYSTEM_IDENTIFICATION, time[-1]: LOITER})
    writer.add("SIDS", time[0], "Bf", Ax=THROTTLE_AXIS, Mag=0.08)
    writer.add("SIDD", time, "ff", Time=time - time[0], Targ=sweep)
    fit = ev.identify_flight(read(writer))
    assert fit.verdict.status is ev.Status.IDENTIFIED
    for name, value in TRUTH.items():
        low, high = fit.quantities[name].interval
        assert low <= value <= high, name
    assert fit.prepared[0].usable_references == ("injected_throttle",)


@pytest.mark.parametrize(
    ("firmware", "parameters", "kind", "wanted"),
    [
        ("ArduPlane V4.5.7 (0358a9c2)", {}, "fixed wing", "--like fixed-wing-roll"),
        ("ArduPlane V4.5.7", {"Q_ENABLE": 1}, "VTOL", "--window START:END"),
        ("ArduRover V4.2.3", {}, "rover", "--like rover"),
        ("ArduRover V4.2.3", {"FRAME_CLASS": 2}, "boat", "--like boat-yaw"),
        ("ArduSub V4.1.0", {}, "submarine", "docs/motions.md says how"),
        ("ArduCopter V4.5.7", {"FRAME_CLASS": 6}, "helicopter", "docs/motions.md says how"),
    ],
)
def test_other_vehicles_are_answered_by_kind(tmp_path, command_line, firmware, parameters, kind, wanted):
    """No verdict on friction where the equation is another: one sentence that says what can be done."""
    writer = flight_log(simulated(seed=3, duration=2.0), vehicle=firmware).parameters(**parameters)
    (tmp_path / "flight.bin").write_bytes(writer.bytes())
    answer = command_line("identify", tmp_path / "flight.bin")
    printed = " ".join((answer.out + answer.err).split())
    assert answer.code == (3 if kind == "helicopter" else 1)  # which turns as a multirotor does
    assert f"which says that it is of a {kind}" in printed
    assert wanted in printed
    assert "friction" not in printed


@pytest.mark.parametrize(("build", "kind"), [(1, "rover"), (13, "helicopter")])
def test_the_build_names_the_vehicle(read, build, kind):
    assert read(flight_log(simulated(seed=3, duration=2.0)).add("VER", 0.0, "B", BU=build)).vehicle == kind
