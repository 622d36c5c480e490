"""The facts about the real recordings that the readers must find."""

import numpy as np
import pytest

import eivor as ev

pytestmark = pytest.mark.recordings

OVERFLOWING = {"B2_circle_medium_rep3", "B9_trefoil_fast_rep3", "B9_trefoil_fast_rep15"}


def names(recording):
    return [finding.name for finding in recording.findings]


@pytest.fixture(scope="module")
def nanobench(recordings):
    return {path.stem: ev.read_log(path) for path in sorted((recordings / "nanobench").glob("*.csv"))}


def test_nanobench_overflow(nanobench):
    assert len(nanobench) == 9
    assert {name for name, r in nanobench.items() if "overflow" in names(r)} == OVERFLOWING
    assert {name for name, r in nanobench.items() if "extrapolated" in names(r)} == OVERFLOWING
    for r in nanobench.values():
        for rotor in r.family("rotor_command_*"):
            assert np.nanmax(rotor.values) <= 1.01
            assert np.nanmin(rotor.values) >= 0.0


def test_nanobench_twins(nanobench):
    assert nanobench["B9_trefoil_fast_rep3"].sha256 == nanobench["B9_trefoil_fast_rep15"].sha256
    assert len({r.sha256 for r in nanobench.values()}) == 8


def test_nanobench_units(nanobench):
    for r in nanobench.values():
        assert (r.frame, r.input_map, len(r.family("rotor_command_*"))) == (ev.Frame.Z_UP, "square", 4)
        assert "mixed_units" not in names(r)
        force = r.channels["specific_force_body_z"].values
        assert np.nanmedian(force) == pytest.approx(9.81, abs=0.35)
        assert r.span_s[0] == 0.0
        assert r.channels["reference_position_z"].held
    assert np.nanmax(nanobench["B6_linear_ramp_rep1"].channels["position_z"].values) < 0.25


def test_ekf_failure(recordings):
    r = ev.read_log(recordings / "px4" / "ekf_failure.ulg")
    assert r.parameters["MPC_THR_HOVER"] == pytest.approx(0.35)
    assert r.channels["input"].source == "-vehicle_thrust_setpoint.xyz[2]"
    assert np.nanmin(r.channels["position_z"].values) < -16
    assert r.channels["input"].rate_hz == pytest.approx(50, rel=0.01)
    assert "reference_position_z" not in r.channels  # logged, and never in force
    assert "trajectory_setpoint.position[2]" in " ".join(f.message for f in r.findings)
    assert r.channels["battery_voltage"].values.max() > 20
    assert len(r.family("actuator_output_*")) == 4


def test_battery_brownout(recordings):
    r = ev.read_log(recordings / "px4" / "battery_brownout.ulg")
    assert "battery_voltage" not in r.channels  # the battery is not connected to the sensor: 0.05 V
    assert np.isfinite(r.channels["reference_position_z"].values).sum() == 122
    assert np.isfinite(r.channels["feedback_reference_velocity_z"].values).any()


def test_px4_old_names(recordings):
    r = ev.read_log(recordings / "px4" / "sample_appended_multiple.ulg")
    assert r.channels["input"].source == "vehicle_attitude_setpoint.thrust"
    assert r.channels["specific_force_body_z"].source == "sensor_combined.accelerometer_m_s2[2]"
    assert "acceleration_z" not in r.channels


def test_ardupilot(recordings):
    r = ev.read_log(recordings / "ardupilot" / "log_0036_mechanical_failure.bin")
    assert r.span_s == pytest.approx((0.01, 150.71), abs=0.01)
    assert r.vehicle == "rotary wing"
    sources = {"velocity_z": "NKF1.VD", "input": "RATE.AOut", "reference_position_z": "-CTUN.DAlt"}
    assert {name: r.channels[name].source for name in sources} == sources
    assert r.channels["velocity_z"].values.size == 1502
    assert np.median(r.channels["specific_force_body_z"].values) == pytest.approx(-9.7, abs=0.1)
    assert r.channels["battery_voltage"].values[0] == pytest.approx(16.5, abs=0.3)
    assert np.isfinite(r.channels["reference_position_z"].values).sum() == 612  # in altitude hold
    assert len(r.parameters) == 593  # one of 594 was set again
    # a whole file; the motors fit the throttle, and the filters are at 20 Hz
    assert names(r) == ["pulse_widths", "sensor_delay"]


CRAZYFLIE_SOURCES = [f"{group}.{axis}" for group in ("acc", "gyro") for axis in "xyz"]
CRAZYFLIE_SOURCES += [f"motor.m{rotor}" for rotor in range(1, 5)]


@pytest.fixture(scope="module")
def crazyflie(recordings):
    return {name: ev.read_log(recordings / "arpl-crazyflie" / name) for name in ("log10", "log15", "log16")}


@pytest.mark.parametrize(
    ("name", "count", "seconds", "gaps"),
    [
        ("log10", 50496, 50.007, "1 gap of 5.98 ms"),
        ("log15", 62774, 62.188, "5 gaps of 4.94 to 7 ms"),
        ("log16", 47182, 46.726, "1 gap of 3.96 ms"),
    ],
)
def test_crazyflie_logs(crazyflie, name, count, seconds, gaps):
    r = crazyflie[name]
    assert sorted(c.source for c in r.channels.values()) == sorted(CRAZYFLIE_SOURCES)
    assert {c.values.size for c in r.channels.values()} == {count}
    motor = r.channels["rotor_command_1"]
    assert motor.time_s[-1] == pytest.approx(seconds, abs=1e-3)
    assert np.median(np.diff(motor.time_s)) == pytest.approx(0.99e-3, abs=0.005e-3)
    # the checksum fits, nothing is left out, and the accelerations are near one g
    assert names(r) == ["dropouts", "sensor_delay"]
    assert gaps in r.findings[0].message


def test_crazyflie_columns_by_a_map(crazyflie, recordings, tmp_path):
    (tmp_path / "m.toml").write_text(
        'name = "m"\n[time]\ncolumn = "timestamp"\n'
        '[channels.input]\nexpression = \'"motor.m1" + "motor.m2"\'\n'
        '[channels.angular_rate_x]\ncolumn = "fixedFrequency:gyro.x"\nunit = "deg/s"\n'
    )
    r = ev.read_log(recordings / "arpl-crazyflie" / "log15", channel_map=tmp_path / "m.toml")
    known = crazyflie["log15"].channels
    total = 65535.0 * (known["rotor_command_1"].values + known["rotor_command_2"].values)
    np.testing.assert_allclose(r.channels["input"].values, total, atol=1e-6)
    np.testing.assert_array_equal(r.channels["angular_rate_x"].values, known["angular_rate_x"].values)
    np.testing.assert_array_equal(r.channels["input"].time_s, known["rotor_command_1"].time_s)
