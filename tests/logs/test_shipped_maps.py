"""Tables of other programs, of flights of known truth: a map is found, the truth is in the intervals."""

import numpy as np
import polars as pl
import pytest
from dataflash_writer import simulated

from eivor.errors import EivorError, MissingReaderError
from eivor.inference.verdict import Status
from eivor.logs import read_log
from eivor.motions.identify import identify_flight
from motions.turning_logs import Vehicle, turned

TRUTH = {"viscous_friction": 0.4, "effective_lag": 0.04, "hover_input": 0.5}


def parts(flight):
    values = {name: channel.values for name, channel in flight.channels.items()}
    return flight.channels["position_z"].time_s, values


def used(recording):
    return next(finding.message for finding in recording.findings if finding.name == "channel_map")


def inav(flight):
    """A flight as INAV's table, with its blanks before names."""
    t, values = parts(flight)
    zeros = 0.0 * t
    table = {"loopIteration": np.arange(t.size), " time (us)": 5_000_000 + np.round(1e6 * t)}
    table |= {f" gyroADC[{axis}]": zeros for axis in range(3)}
    table |= {f" navPos[{axis}]": 100.0 * values["position_z"] if axis == 2 else zeros for axis in range(3)}
    table |= {f" navVel[{axis}]": 100.0 * values["velocity_z"] if axis == 2 else zeros for axis in range(3)}
    table[" navAcc[2]"] = 100.0 * (values["specific_force_z"] - 9.80665)
    table[" attitude[0]"] = 10.0 * np.degrees(np.arccos(np.clip(values["cos_tilt"], -1.0, 1.0)))
    table |= {" attitude[1]": zeros, " attitude[2]": zeros}
    table |= {f" motor[{rotor}]": 1000.0 + 1000.0 * values["rotor_command_1"] for rotor in range(4)}
    table[" navTgtPos[2]"] = 100.0 * values["reference_position_z"]
    table[" navTgtVel[2]"] = 100.0 * values["reference_velocity_z"] + 3.0
    return table


def crazyflie(flight):
    """A flight as a program of cflib logs it; the low-pass of the firmware is in no acceleration of it."""
    t, values = parts(flight)
    table = {"timestamp": 1000.0 * t, "stateEstimate.z": values["position_z"]}
    table |= {"stateEstimate.vz": values["velocity_z"], "ctrltarget.z": values["reference_position_z"]}
    late = np.interp(t - np.sqrt(2.0) / (2.0 * np.pi * 30.0), t, values["specific_force_z"])
    table["stateEstimate.az"] = late / 9.80665 - 1.0
    table["stabilizer.roll"] = np.degrees(np.arccos(np.clip(values["cos_tilt"], -1.0, 1.0)))
    table["stabilizer.pitch"] = 0.0 * t
    return table | {f"motor.m{rotor}": 65535.0 * values["rotor_command_1"] for rotor in range(1, 5)}


@pytest.mark.parametrize(
    ("name", "made"),
    [
        pytest.param("inav_csv", inav, marks=pytest.mark.thorough),
        pytest.param("crazyflie_csv", crazyflie, marks=pytest.mark.long),
    ],
)
def test_the_truth_is_in_the_intervals(tmp_path, name, made):
    path = tmp_path / "flight.csv"
    pl.DataFrame(made(simulated(seed=4, duration=40.0))).write_csv(path)
    recording = read_log(path)
    assert f"'{name}'" in used(recording)
    fit = identify_flight(recording)
    assert fit.verdict.status is Status.IDENTIFIED
    for quantity, value in TRUTH.items():
        low, high = fit.quantities[quantity].interval
        assert low <= value <= high, quantity


@pytest.mark.parametrize(("name", "made"), [("inav_csv", inav), ("crazyflie_csv", crazyflie)])
def test_units_and_signs(tmp_path, name, made):
    flight = simulated(seed=4, duration=2.0)
    path = tmp_path / "flight.csv"
    pl.DataFrame(made(flight)).write_csv(path)
    r = read_log(path)
    assert f"'{name}'" in used(r)
    _, values = parts(flight)
    for channel in ("velocity_z", "position_z", "rotor_command_1", "cos_tilt", "reference_position_z"):
        np.testing.assert_allclose(r.channels[channel].values, values[channel], atol=1e-6, err_msg=channel)
    assert r.input_map == "square"
    assert r.channels["velocity_z"].estimated
    assert np.median(r.channels["acceleration_z"].values) == pytest.approx(
        np.median(values["specific_force_z"]) - 9.80665, abs=0.3
    )
    assert "reference_velocity_z" not in r.channels


def betaflight(flight):
    """A flight as Betaflight's table."""
    clock = flight.channels["angular_rate_x"].time_s

    def held(name):
        channel = flight.channels[name]
        indices = np.searchsorted(channel.time_s, clock + 1e-9, side="right") - 1
        return channel.values[np.maximum(indices, 0)]

    table = {"loopIteration": np.arange(clock.size), " time (us)": np.round(1e6 * clock) + 7e6}
    for axis, letter in enumerate("xyz"):
        table[f" gyroADC[{axis}]"] = np.degrees(held(f"angular_rate_{letter}"))
        shares = (0.5, 0.2, 0.2, 0.1) if axis < 2 else (0.6, 0.3, 0.1)
        for part, share in zip("PIDF" if axis < 2 else "PIF", shares, strict=True):
            table[f" axis{part}[{axis}]"] = share * 1000.0 * held(f"torque_setpoint_{letter}")
    for axis, name in enumerate(("roll", "pitch", "yaw")):
        text = f"reference_{name}"
        stick = 400.0 * held(text) if text in flight.channels else 0.0 * clock
        table[f" rcCommand[{axis}]"] = stick
    table[" rcCommand[3]"] = 1500.0 + 0.0 * clock
    table[" accSmooth[2]"] = 2048.0 + 0.0 * clock
    table |= {f" motor[{rotor}]": 900.0 + np.arange(clock.size) % 7 for rotor in range(4)}
    table[" flightModeFlags (flags)"] = ["ANGLE_MODE"] * clock.size
    return table


@pytest.mark.long
def test_betaflight_turns_by_its_sticks(tmp_path):
    vehicle = Vehicle()
    flight = turned(3, vehicle=vehicle, seconds=40.0, command_hz=200.0)
    path = tmp_path / "btfl_001.01.csv"
    pl.DataFrame(betaflight(flight)).write_csv(path)
    recording = read_log(path)
    result = identify_flight(recording, model="rates")
    assert result.verdict.status is Status.IDENTIFIED
    for axis, truth in zip(("roll", "pitch"), vehicle.effectiveness, strict=False):
        assert result.quantities[f"{axis}_effectiveness"].value == pytest.approx(truth, rel=0.08)


def test_betaflight_has_no_velocity(tmp_path):
    path = tmp_path / "btfl_001.01.csv"
    pl.DataFrame(betaflight(turned(3, seconds=5.0, command_hz=200.0))).write_csv(path)
    recording = read_log(path)
    assert "'betaflight_csv'" in used(recording)
    assert recording.channels["specific_force_body_z"].values[0] == pytest.approx(9.80665)
    with pytest.raises(EivorError, match="velocity_z"):
        identify_flight(recording)


def telemetry(messages=5, magic=0xFD):
    head = {0xFE: 8, 0xFD: 12}[magic]
    item = bytes([magic, 20, 0]) + bytes(head - 3 + 20)
    return b"".join((1_600_000_000_000_000 + 250_000 * n).to_bytes(8, "big") + item for n in range(messages))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (telemetry(), "telemetry log.*the vehicle's card: .bin of ArduPilot, .ulg of PX4"),
        (telemetry(magic=0xFE), "telemetry log"),
        (bytes(16) + b"BUILD" + bytes(300), "DJI.*no commands"),
        (bytes(242) + b"DJI_LOG_V3" + bytes(300), "DJI"),
        ((500).to_bytes(8, "little") + b"\x90\x01\x0e" + bytes(1000), "flight record of DJI"),
    ],
)
def test_logs_that_tell_too_little(tmp_path, content, words):
    path = tmp_path / "log.txt"
    path.write_bytes(content)
    with pytest.raises(MissingReaderError, match=f"(?s){words}"):
        read_log(path)
