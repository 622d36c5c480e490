"""Turning in ArduPilot's logs: fast logging of RATE tells effectiveness and lag; sweeps are instruments."""

import numpy as np
import pytest
from dataflash_writer import FIRMWARES, DataflashWriter

from eivor.inference.verdict import Status
from eivor.logs import read_log
from eivor.motions.identify import identify_flight
from motions.turning_logs import STEP_S, Vehicle, turned

DEG = 180.0 / np.pi
#: Signs of forward, left, up in forward, right, down.
DOWN = {"x": 1.0, "y": -1.0, "z": -1.0}
LETTERS = {"x": "R", "y": "P", "z": "Y"}
STABILIZE, SYSTEM_IDENTIFICATION = 0, 25


def turning_log(flight, mode):
    """Write turning as firmware 4.6 does with LOG_BITMASK's bit 0: RATE and ATT at 400 Hz, IMU at 25 Hz."""
    writer = DataflashWriter().text(FIRMWARES["4.6"]).parameters(SID_AXIS=10.0)
    time = flight.channels["angular_rate_x"].time_s
    writer.add("MODE", 0.0, "MBB", Mode=mode, ModeNum=mode, Rsn=1)
    writer.add("EV", [0.0, time[-1]], "B", Id=[28, 18])
    rate, gyro = {}, {}
    for letter, axis in LETTERS.items():
        turns = DOWN[letter] * flight.channels[f"angular_rate_{letter}"].values
        out = DOWN[letter] * flight.channels[f"torque_setpoint_{letter}"].values
        rate |= {f"{axis}Des": 0.0, axis: turns * DEG, f"{axis}Out": out}
        gyro[f"Gyr{letter.upper()}"] = turns[::16]
    writer.add("RATE", time, "f" * 12, **rate, ADes=0.0, A=0.0, AOut=0.4)
    writer.add("IMU", time[::16], "Bffffff", I=0, **gyro, AccX=0.0, AccY=0.0, AccZ=-9.8)
    attitude = {"AEKF": 3}
    for angle, letter in (("Roll", "x"), ("Pitch", "y"), ("Yaw", "z")):
        requested = DOWN[letter] * flight.channels[f"reference_{angle.lower()}"].values * DEG
        attitude |= {f"Des{angle}": requested, angle: 0.0}
    return writer.add("ATT", time[::8], "Bffffff", **attitude).units()


def identified(tmp_path, writer):
    """The fit of turning, whose headline must be told and hold the truth."""
    path = tmp_path / "flight.bin"
    path.write_bytes(writer.bytes())
    log = read_log(path)
    assert log.channels["angular_rate_x"].source == "RATE.R"
    fit = identify_flight(log, model="rates")
    assert fit.verdict.status is Status.IDENTIFIED
    truth = Vehicle()
    lag_measurements = {
        "roll_effectiveness": truth.effectiveness[0],
        "pitch_effectiveness": truth.effectiveness[1],
    }
    for name, value in (lag_measurements | {"effective_lag": truth.effective_lag_s}).items():
        low, high = fit.quantities[name].interval
        assert low <= value <= high, name
    return fit


@pytest.mark.thorough
def test_sticks_in_stabilize(tmp_path):
    flight = turned(1, command_hz=400.0, rate_hz=400.0)
    identified(tmp_path, turning_log(flight, STABILIZE))


@pytest.mark.thorough
def test_sweeps_into_the_mixer_are_the_instruments(tmp_path):
    """A sweep of roll, then one of pitch, while the sticks rest."""
    count = round(60.0 / STEP_S)
    time = np.arange(count) * STEP_S
    injected = np.zeros((count, 3))
    sweeps = ((0, 4.0, 10), (1, 32.0, 11))
    for axis, start, _ in sweeps:
        within = (time >= start) & (time < start + 26.0)
        since = time[within] - start
        injected[within, axis] = 0.15 * np.sin(2.0 * np.pi * (0.3 * since + 0.5 * 7.7 / 26.0 * since**2))
    flight = turned(1, command_hz=400.0, rate_hz=400.0, seconds=60.0, size=0.0, injected=injected)
    writer = turning_log(flight, SYSTEM_IDENTIFICATION)
    for axis, start, number in sweeps:
        within = (time >= start) & (time < start + 26.0)
        sample = DOWN["xyz"[axis]] * injected[within, axis]
        writer.add("SIDS", start, "Bf", Ax=number, Mag=0.15)
        writer.add("SIDD", time[within], "ff", Time=time[within] - start, Targ=sample)
    fit = identified(tmp_path, writer)
    assert fit.prepared[0].usable_references == ("injected_torque_x", "injected_torque_y")


@pytest.mark.thorough
def test_a_short_sweep_of_the_attitude_serves_its_axis(tmp_path):
    """Half a minute with resting sticks, 15 s of a sweep of roll: pitch, which did not move, is refused."""
    time = np.arange(round(30.0 / STEP_S)) * STEP_S
    within = (time >= 10.0) & (time < 25.0)
    since = time[within] - 10.0
    swept = np.zeros((time.size, 3))
    swept[within, 0] = 0.12 * np.sin(2.0 * np.pi * (0.3 * since + 0.5 * 7.7 / 15.0 * since**2))
    flight = turned(0, command_hz=400.0, rate_hz=400.0, seconds=30.0, size=0.0, swept=swept)
    writer = turning_log(flight, SYSTEM_IDENTIFICATION)
    writer.add("SIDS", 10.0, "Bf", Ax=1, Mag=7.0)
    writer.add("SIDD", time[within], "ff", Time=since, Targ=swept[within, 0] * DEG)
    path = tmp_path / "flight.bin"
    path.write_bytes(writer.bytes())
    fit = identify_flight(read_log(path), model="rates")
    assert fit.prepared[0].usable_references == ("reference_roll",)
    assert fit.verdict.status is Status.REFUSED
    assert fit.quantities["pitch_effectiveness"].verdict is Status.REFUSED
    roll = fit.quantities["roll_effectiveness"]
    assert roll.verdict is Status.IDENTIFIED
    assert roll.interval[0] <= Vehicle().effectiveness[0] <= roll.interval[1]
