"""Blackbox logs of Betaflight and INAV: every encoding, scales, damage, and turning that is identified."""

from __future__ import annotations

import numpy as np
import pytest
from blackbox_writer import FIELDS, blackbox_log, gyro_scale

import eivor as ev
from motions.turning_logs import Vehicle, turned


def walks(count=700):
    """Integer columns that need every packing: steps of all sizes, and constant parts."""
    columns, rng, shares = {}, np.random.default_rng(5), [0.3, 0.4, 0.2, 0.07, 0.03]
    for name, signed, *_ in FIELDS:
        walk = np.cumsum(rng.integers(-9, 10, count) * rng.choice([0, 1, 7, 40, 3000], count, p=shares))
        columns[name] = np.clip(walk, -30000, 30000) if signed else np.abs(walk) % 2000 + 200
    columns["loopIteration"] = np.arange(count)
    columns["time"] = 2**32 - 50_000 + np.cumsum(rng.integers(240, 260, count))  # the clock goes round
    return columns


def values(recording, name):
    return recording.channels[name].values


def test_every_encoding_and_predictor(read):
    columns = walks()
    logged = {**columns, "time": columns["time"] % 2**32}
    log = read(blackbox_log(logged, {"gyro_scale": gyro_scale(0.5)}))
    assert log.format == "blackbox"
    assert log.origin.firmware.startswith("Betaflight 4.5.0")
    assert (log.origin.airframe, log.origin.start.year) == ("five inch", 2025)
    for axis, letter in enumerate("xyz"):
        rate = np.radians(0.5 * columns[f"gyroADC[{axis}]"])
        np.testing.assert_allclose(values(log, f"angular_rate_{letter}"), rate, atol=1e-9)
        parts = [columns.get(f"axis{part}[{axis}]", 0.0 * columns["time"]) for part in "PIDF"]
        np.testing.assert_allclose(values(log, f"torque_setpoint_{letter}"), np.sum(parts, axis=0) / 1000)
    for rotor in range(4):
        share = (columns[f"motor[{rotor}]"] - 158) / (2047 - 158)
        np.testing.assert_allclose(values(log, f"actuator_output_{rotor + 1}"), share)
        speed = columns[f"eRPM[{rotor}]"] * 100 / 7 * 2 * np.pi / 60
        np.testing.assert_allclose(values(log, f"rotor_speed_{rotor + 1}"), speed)
    np.testing.assert_allclose(values(log, "pilot_roll"), columns["rcCommand[0]"] / 500)
    np.testing.assert_allclose(values(log, "battery_voltage"), 0.01 * columns["vbatLatest"])
    clock = log.channels["angular_rate_x"].time_s
    np.testing.assert_allclose(np.diff(clock), 1e-6 * np.diff(columns["time"]), atol=1e-9)


def test_high_resolution_and_counts_to_a_g(read):
    columns = walks(64) | {"gyroADC[0]": 30 * np.arange(64) - 900, "accSmooth[2]": 2000 - np.arange(64)}
    log = read(blackbox_log(columns, {"blackbox_high_resolution": "1", "acc_1G": "4096"}))
    np.testing.assert_allclose(values(log, "angular_rate_x"), np.radians(columns["gyroADC[0]"] / 10))
    force = 9.80665 * columns["accSmooth[2]"] / 4096
    np.testing.assert_allclose(values(log, "specific_force_body_z"), force, rtol=1e-6)


def test_the_longest_log_of_a_file_is_read(read):
    content = blackbox_log(walks(40)) + blackbox_log(walks(400)) + blackbox_log(walks(64))
    log = read(content)
    assert values(log, "pilot_roll").size == 400
    assert any("3 logs" in finding.message for finding in log.findings)


def test_damage_costs_the_frames_until_the_next_whole_one(read):
    columns = walks()
    content = bytearray(blackbox_log(columns))
    middle = len(content) // 2
    content[middle : middle + 40] = np.random.default_rng(5).bytes(40)
    log = read(bytes(content))
    clock = columns["time"] - columns["time"][0]
    at = np.searchsorted(clock, np.round(1e6 * log.channels["pilot_roll"].time_s).astype(int))
    assert 600 < at.size < 700
    assert np.mean(values(log, "pilot_roll") == columns["rcCommand[0]"][at] / 500) > 0.99
    assert any(finding.name == "damaged" for finding in log.findings)


ONE_BYTE = tuple((name, signed, intra, inter, first, 9) for name, signed, intra, inter, first, _ in FIELDS)


@pytest.mark.parametrize("value", ["nan", "inf", "1e300", "-", "1," * 50])
def test_numbers_of_a_head_that_are_none(read, value):
    names = ("minthrottle", "vbatref", "motorOutput", "acc_1G", "motor_poles", "gyro_scale")
    log = read(blackbox_log(walks(64), dict.fromkeys(names, value)))
    assert values(log, "pilot_roll").size == 64


def quantised(flight):
    """A flight as Betaflight counts it: a finer clock and rates in tenths of a degree a second."""
    clock = flight.channels["angular_rate_x"].time_s

    def held(name):
        channel = flight.channels[name]
        return channel.values[np.maximum(np.searchsorted(channel.time_s, clock + 1e-9, side="right") - 1, 0)]

    columns = {"loopIteration": np.arange(clock.size), "time": np.round(1e6 * clock) + 7e6}
    for axis, letter in enumerate("xyz"):
        columns[f"gyroADC[{axis}]"] = np.round(10.0 * np.degrees(held(f"angular_rate_{letter}")))
        columns[f"axisP[{axis}]"] = np.round(1000.0 * held(f"torque_setpoint_{letter}"))
        name = f"reference_{('roll', 'pitch', 'yaw')[axis]}"
        requested = held(name) if name in flight.channels else 0.0 * clock
        columns[f"rcCommand[{axis}]"] = np.round(4000.0 * requested)
    return columns | {"rcCommand[3]": 1500.0 + 0.0 * clock, "motor[0]": 900.0 + 0.0 * clock}


@pytest.mark.thorough
def test_turning_is_identified_from_a_blackbox_log(read):
    vehicle = Vehicle()
    flight = turned(3, vehicle=vehicle, seconds=40.0, command_hz=200.0)
    log = read(blackbox_log(quantised(flight), {"blackbox_high_resolution": "1"}))
    fit = ev.identify_flight(log, model="rates")
    for axis, truth in zip(("roll", "pitch"), vehicle.effectiveness, strict=False):
        low, high = fit.quantities[f"{axis}_effectiveness"].interval
        assert low < truth < high < 1.5 * low


def test_inav_logs_have_height_and_velocity(read):
    count, zeros = 300, dict.fromkeys(("navVel[0]", "navVel[1]", "attitude[1]"), 0)
    levels = {"navPos[2]": 900, "navVel[2]": 70, "navTgtPos[2]": 1000, "attitude[0]": 100, **zeros}
    levels |= {f"motor[{rotor}]": 1500 for rotor in range(4)}
    fields = [FIELDS[0], FIELDS[1], *((name, 1, 0, 1, 0, 0) for name in levels)]
    columns = {"loopIteration": np.arange(count), "time": 1000 + 4000 * np.arange(count)}
    columns |= {name: np.full(count, level) for name, level in levels.items()}
    head = {"Firmware revision": "INAV 7.1.2 (4e1e59eb) MATEKF405"}
    log = read(blackbox_log(columns, head, fields=fields))
    for name, value in (("position_z", 9.0), ("velocity_z", 0.7), ("reference_position_z", 10.0)):
        np.testing.assert_allclose(values(log, name), value)
    np.testing.assert_allclose(values(log, "rotor_command_1"), 0.5)
    np.testing.assert_allclose(values(log, "cos_tilt"), np.cos(np.radians(10.0)))
