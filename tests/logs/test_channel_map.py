"""Tables of other programs, of flights of known truth: a map is found, the truth is in the intervals."""

from __future__ import annotations

import json
from dataclasses import astuple, is_dataclass

import numpy as np
import polars as pl
import pytest
from dataflash_writer import simulated

import eivor as ev
from eivor.errors import EivorError
from motions.turning_logs import turned

PWM = '[channels.input]\ncolumn = "pwm"\n'
HEAD = 'name = "m"\n[time]\ncolumn = "t"\nunit = "ms"\n'


def write_table(folder):
    k = np.arange(100)
    pl.DataFrame(
        {
            "t": 10.0 * k,
            "v down": np.cos(0.1 * k) * 100.0,
            "roll": np.full(100, 60.0),
            "pitch": np.zeros(100),
            "pwm": np.where(k == 7, 70000, np.where(k == 8, 65535, 30000 + k)),
            "volt": np.full(100, 4.0),
        }
    ).write_csv(folder / "t.csv")


@pytest.fixture
def table(tmp_path):
    write_table(tmp_path)
    return tmp_path


def read(folder, text):
    (folder / "m.toml").write_text(text)
    return ev.read_log(folder / "t.csv", channel_map=folder / "m.toml")


def test_every_key(table):
    r = read(
        table,
        'description = "d"\nframe = "ned"\ninput_map = "square"\n'
        + HEAD
        + """
[columns.pwm]
valid = [0, 65535]
saturates = "upper"
[channels.velocity_z]
column = "v down"
source = "estimator"
unit = "cm/s"
sign = -1
scale = 2
[channels.cos_tilt]
roll_pitch = ["roll", "pitch"]
unit = "deg"
[channels.rotor_command_1]
expression = "pwm * volt / 275247"
held = false
[channels.input]
expression = 'sqrt(abs("v down")) + 1e-3'
[channels.landed]
column = "absent"
optional = true
""",
    )
    k = np.arange(100)
    assert (r.frame.name, r.input_map) == ("NED", "square")
    np.testing.assert_allclose(r.channels["velocity_z"].values, -2 * np.cos(0.1 * k))
    np.testing.assert_allclose(r.channels["velocity_z"].time_s, 0.01 * k)
    np.testing.assert_allclose(r.channels["cos_tilt"].values, 0.5)
    rotor = r.channels["rotor_command_1"]
    np.testing.assert_allclose(rotor.values[9], 30009 * 4 / 275247)
    assert np.isnan(rotor.values[7])
    assert (rotor.quality.overflowed, rotor.quality.saturated, rotor.held) == (1, 1, False)
    np.testing.assert_allclose(r.channels["input"].values[0], 10.001)
    assert {"overflow", "saturation"} <= {f.name for f in r.findings}
    assert "landed" not in r.channels
    assert [name for name, channel in r.channels.items() if channel.estimated] == ["velocity_z"]
    with pytest.raises(Exception, match="absent"):
        r.channel("landed")


def test_a_declared_delay_is_taken_off_the_stamps(table):
    late = '[channels.velocity_z]\ncolumn = "v down"\ndelay_ms = 8\n'
    r = read(table, HEAD + PWM + late)
    np.testing.assert_allclose(r.channels["velocity_z"].time_s, 0.01 * np.arange(100) - 0.008, atol=1e-12)
    np.testing.assert_allclose(r.channels["input"].time_s, 0.01 * np.arange(100))
    assert (r.channels["velocity_z"].delay_s, r.channels["input"].delay_s) == (0.008, 0.0)
    (messages,) = [f.message for f in r.findings if f.name == "sensor_delay"]
    assert messages == "Taken off the stamps, as m.toml says: velocity_z 8 ms."


def test_the_side_of_the_thrust_curve_is_declared(table):
    declared = '[channels.rotor_command_1]\ncolumn = "pwm"\ncurve_side = "behind"\n'
    r = read(table, HEAD + PWM + declared)
    sides = {"input": "UNKNOWN", "rotor_command_1": "BEHIND"}
    assert {name: channel.curve_side.name for name, channel in r.channels.items()} == sides


def test_series_in_time_at_stamps(table):
    made = "ddt(lag(volt + (pwm > 30050 and pwm < 4e4) * 2, 0.2))"
    r = read(
        table, HEAD + f'[channels.velocity_z]\ncolumn = "volt"\n[channels.input]\nexpression = "{made}"\n'
    )
    series = r.channels["input"].values
    # the step at 0.51 s reaches 2 (1 - exp(-t / 0.2)); a command of NaN at 0.07 s is left out
    step = 2.0 * (1.0 - np.exp(-np.maximum(0.01 * np.arange(100) - 0.51, 0.0) / 0.2))
    np.testing.assert_allclose(series[20:-1], np.gradient(step, 0.01)[20:-1], atol=1e-9)


@pytest.mark.parametrize("text", ["0/0*a", "1/0*a", "ln(0)*a", "sqrt(-1)*a", "a/0", "pow(-1, 0.5)*a"])
def test_what_is_not_defined_is_no_value(table, text):
    expression = text.replace("a", "pwm")
    channels = f'[channels.velocity_z]\ncolumn = "volt"\n[channels.input]\nexpression = "{expression}"\n'
    r = read(table, HEAD + channels)
    assert "input" not in r.channels
    assert "never_valid" in {finding.name for finding in r.findings}


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("a + b * 2", 8.0),
        ("-(a - b)", 1.0),
        ("- - a", 2.0),
        ("a - -b", 5.0),
        ("a / b", 2.0 / 3.0),
        ("1/2*a", 1.0),
        ("pow(a, 3) + sqrt(b+1)", 10.0),
        ("greatest(a, b) - least(a, b)", 1.0),
        ("ABS(a - 4.5e0)", 2.5),
        ("atan2(a, a)", np.pi / 4),
        ("exp(ln(a)) + .5", 2.5),
        ('"select" + a', 6.0),
        ("select + a", 6.0),
        ("sin + a", 7.0),
        ("cos(a*a + 2) - sin(b)", np.cos(6) - np.sin(3)),
        ("asin(a/4)+acos(a/4)+atan(0*a)+tan(0*a)", np.pi / 2),
        ("1e300 * a / 1e300", 2.0),
        ("a * 2.5e-7 / 2.5e-7", 2.0),
        ("a * 123456789012345678 / 123456789012345678", 2.0),
        ("-a**2 + b**-1 * 3 + tanh(0*a) + hypot(b, 2*a)", 2.0),
        ("(a < b and not a >= b) + (a > b or a <= 2) * 10", 11.0),
        ("ddt(a*b) + lag(a, .1)", 2.0),
    ],
)
def test_expressions(tmp_path, text, value):
    for stamps in ([0.0, 100.0, 200.0], [0.0, 100.0, 400.0]):
        frame = {"t": stamps} | {name: [number] * 3 for name, number in (("a", 2.0), ("b", 3.0))}
        pl.DataFrame(frame | {"select": [4.0] * 3, "sin": [5.0] * 3}).write_csv(tmp_path / "t.csv")
        np.testing.assert_allclose(expressed(tmp_path, text).values, value)


def expressed(folder, text):
    """The channel that an expression makes of the table."""
    return read(folder, f"{HEAD}[channels.input]\nexpression = {json.dumps(text)}\n").channels["input"]


def test_a_missing_value_stays_missing(tmp_path):
    pl.DataFrame({"t": [0.0, 1.0], "a": [None, 2.0], "b": [1.0, 1.0]}).write_csv(tmp_path / "t.csv")
    for text in ("greatest(a, b)", "least(a, b)", "a + b", "b / a", "atan2(a, b)", "a < b", "not a"):
        assert np.isnan(expressed(tmp_path, text).values).tolist() == [True, False]


@pytest.mark.parametrize(
    ("keys", "noise"),
    [
        ("noise = 2.0", 0.02),
        ("noise_density = 1.0\nnoise_bandwidth_hz = 50.0", (0.01, 50.0, 0.0)),
        ("quantisation = 10", (0.0, None, 0.1)),
        ("", None),
    ],
)
def test_a_map_states_the_noise_of_a_channel(table, keys, noise):
    text = f'{HEAD}[channels.velocity_z]\ncolumn = "v down"\nunit = "cm/s"\n{keys}\n'
    stated = read(table, text).channels["velocity_z"].noise
    assert (astuple(stated) if is_dataclass(stated) else stated and round(stated, 9)) == noise


@pytest.mark.thorough
@pytest.mark.parametrize("column", ["*", "^a$", "^.*$", "a.b", "time::x", "𝔞"])
def test_columns_of_any_name(tmp_path, column):
    frame = pl.DataFrame({"t": [0.0, 1.0], "a": [5.0, 6.0], column: [1.0, 2.0]})
    frame.write_csv(tmp_path / "t.csv")
    frame.write_parquet(tmp_path / "t.parquet")
    (tmp_path / "m.toml").write_text(HEAD + f"[channels.input]\nexpression = '\"{column}\" * 2 + a'\n")
    for table in ("t.csv", "t.parquet"):
        r = ev.read_log(tmp_path / table, channel_map=tmp_path / "m.toml")
        assert r.channels["input"].values.tolist() == [7.0, 10.0]


@pytest.mark.thorough
def test_rotorpys_own_table(tmp_path):
    """The map of RotorPy against a flight of it: the specific force turned to world up is z'' + g."""
    pytest.importorskip("rotorpy")
    from rotorpy.controllers.quadrotor_control import SE3Control
    from rotorpy.environments import Environment
    from rotorpy.trajectories.circular_traj import ThreeDCircularTraj
    from rotorpy.utils.postprocessing import unpack_sim_data
    from rotorpy.vehicles.crazyflie_params import quad_params
    from rotorpy.vehicles.multirotor import Multirotor

    np.random.seed(3)  # noqa: NPY002 - RotorPy's sensors draw from the global generator
    world = Environment(Multirotor(quad_params), SE3Control(quad_params), ThreeDCircularTraj(), sim_rate=100)
    result = world.run(t_final=2, terminate=False, plot=False, animate_bool=False, verbose=False)
    frame = unpack_sim_data(result)
    frame.to_csv(tmp_path / "flight.csv")
    r = ev.read_log(tmp_path / "flight.csv")
    assert r.input_map == "square"
    assert any(f.name == "channel_map" and "'rotorpy'" in f.message for f in r.findings)
    w, x, y, z = (r.channels[f"attitude_{part}"].values for part in "wxyz")
    force = [r.channels[f"specific_force_body_{axis}"].values for axis in "xyz"]
    up = 2 * (x * z - w * y) * force[0] + 2 * (y * z + w * x) * force[1] + (1 - 2 * (x**2 + y**2)) * force[2]
    acceleration = np.gradient(frame["zdot"].to_numpy(), frame["time"].to_numpy())
    np.testing.assert_allclose(up[50:-1] - 9.81, acceleration[50:-1], atol=0.1)
    np.testing.assert_array_equal(r.channels["rotor_command_3"].values, frame["r3des"].to_numpy())


@pytest.mark.parametrize(
    ("unit", "scale", "words"),
    [("rad", 30.0, "are they in degrees"), ("deg", 0.4, "are they in radians"), ("deg", 30.0, "")],
)
def test_angles_in_another_unit_are_told(tmp_path, unit, scale, words):
    t = np.arange(50) * 0.01
    frame = {"t": t, "roll": scale * np.sin(9 * t), "pitch": 0 * t}
    pl.DataFrame(frame).write_csv(tmp_path / "t.csv")
    (tmp_path / "m.toml").write_text(
        HEAD.replace("ms", "s") + f'[channels.cos_tilt]\nroll_pitch = ["roll", "pitch"]\nunit = "{unit}"\n'
    )
    r = ev.read_log(tmp_path / "t.csv", channel_map=tmp_path / "m.toml")
    doubts = [f.message for f in r.findings if f.name == "mixed_units"]
    assert (len(doubts) == 1 and words in doubts[0]) if words else doubts == []


@pytest.mark.thorough
def test_tilt_from_columns_of_any_name(tmp_path):
    names = ["w, *", 'x "1"', "^y.*$", "z" * 300]
    columns = dict(zip(names, ([1.0, 1.0], [0.0, 1.0], [0.0, 0.0], [0.0, 0.0]), strict=True))
    pl.DataFrame({"t": [0.0, 1.0], **columns}).write_parquet(tmp_path / "t.parquet")
    (tmp_path / "m.toml").write_text(HEAD + f"[channels.cos_tilt]\nquaternion = {json.dumps(names)}\n")
    r = ev.read_log(tmp_path / "t.parquet", channel_map=tmp_path / "m.toml")
    np.testing.assert_allclose(r.channels["cos_tilt"].values, [1.0, 0.0], atol=1e-15)
    (tmp_path / "m.toml").write_text(HEAD + f"[channels.cos_tilt]\nroll_pitch = {json.dumps(names[:2])}\n")
    r = ev.read_log(tmp_path / "t.parquet", channel_map=tmp_path / "m.toml")
    np.testing.assert_allclose(r.channels["cos_tilt"].values, [np.cos(1.0), np.cos(1.0) ** 2])
    assert r.channels["cos_tilt"].source == 'cos(1.0 * "w, *") * cos(1.0 * "x "1"")'


def test_tilt_from_a_quaternion_of_any_norm(tmp_path):
    angle = np.linspace(0.0, 1.0, 20)
    frame = {
        "time": np.arange(20) * 0.1,
        "a": 2 * np.cos(angle / 2),
        "b": 2 * np.sin(angle / 2),
        "c": 0 * angle,
    }
    pl.DataFrame(frame).write_csv(tmp_path / "t.csv")
    text = 'name = "m"\n[time]\ncolumn = "time"\n[channels.cos_tilt]\nquaternion = ["a", "b", "c", "c"]\n'
    (tmp_path / "m.toml").write_text(text)
    r = ev.read_log(tmp_path / "t.csv", channel_map=tmp_path / "m.toml")
    np.testing.assert_allclose(r.channels["cos_tilt"].values, np.cos(angle))
    assert not r.channels["cos_tilt"].held


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


@pytest.mark.parametrize(("name", "made"), [("inav_csv", inav), ("crazyflie_csv", crazyflie)])
def test_units_and_signs(tmp_path, name, made):
    flight = simulated(seed=4, duration=2.0)
    path = tmp_path / "flight.csv"
    pl.DataFrame(made(flight)).write_csv(path)
    r = ev.read_log(path)
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


def test_betaflight_has_no_velocity(tmp_path):
    path = tmp_path / "btfl_001.01.csv"
    pl.DataFrame(betaflight(turned(3, seconds=5.0, command_hz=200.0))).write_csv(path)
    recording = ev.read_log(path)
    assert "'betaflight_csv'" in used(recording)
    assert recording.channels["specific_force_body_z"].values[0] == pytest.approx(9.80665)
    with pytest.raises(EivorError, match="velocity_z"):
        ev.identify_flight(recording)


def telemetry(messages=5, magic=0xFD):
    head = {0xFE: 8, 0xFD: 12}[magic]
    item = bytes([magic, 20, 0]) + bytes(head - 3 + 20)
    return b"".join((1_600_000_000_000_000 + 250_000 * n).to_bytes(8, "big") + item for n in range(messages))
