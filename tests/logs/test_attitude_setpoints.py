"""Setpoints of attitude and rates of a PX4 log, by who made them."""

from __future__ import annotations

import numpy as np
import pytest

from eivor.logs.ulog.channels import attitude_setpoints
from eivor.logs.ulog.topics import Topic

COUNT = 8
TIME = np.arange(COUNT, dtype=np.float64)


def quaternion(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """Z, then y, then x."""
    (cr, cp, cy), (sr, sp, sy) = (f(0.5 * np.array([roll, pitch, yaw])) for f in (np.cos, np.sin))
    return np.array(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )


def log(states=(), **attitude) -> tuple[dict[str, Topic], dict[str, np.ndarray]]:
    rates = {name: np.full(COUNT, value) for name, value in (("roll", 1.0), ("pitch", 2.0), ("yaw", 3.0))}
    topics = {
        "vehicle_attitude_setpoint": Topic("vehicle_attitude_setpoint", 0, attitude),
        "vehicle_rates_setpoint": Topic("vehicle_rates_setpoint", 0, rates),
    }
    clocks = dict.fromkeys(topics, TIME)
    if len(states):
        topics["vehicle_status"] = Topic("vehicle_status", 0, {"nav_state": np.array(states)})
        clocks["vehicle_status"] = TIME[: len(states)] * 2.0
    return topics, clocks


def made(topics, clocks) -> dict[str, np.ndarray]:
    return {name: values for name, _, values, _ in attitude_setpoints(topics, clocks)}


def of(angles) -> dict[str, np.ndarray]:
    parts = np.stack([quaternion(*angle) for angle in angles], axis=1)
    return {f"q_d[{index}]": part for index, part in enumerate(parts)}


def test_quaternions_become_angles_and_yaw_has_no_jumps():
    angles = [(0.1 * k, -0.05 * k, 2.5 + 0.2 * k) for k in range(COUNT)]
    result = made(*log((15, 15, 15, 15), **of(angles)))
    for number, name in enumerate(("roll", "pitch", "yaw")):
        np.testing.assert_allclose(
            result[f"reference_{name}"], [angle[number] for angle in angles], atol=1e-12
        )
        assert np.isnan(result[f"feedback_reference_{name}"]).all()


def test_they_are_told_apart_by_the_mode_in_force():
    # from second 0 stabilized, from 2 position, from 4 acro, from 6 altitude
    result = made(*log((15, 2, 10, 1), **of([(0.3, 0.2, 0.1)] * COUNT)))
    by_sticks = np.isfinite(result["reference_roll"])
    np.testing.assert_array_equal(by_sticks, [True, True, False, False, False, False, True, True])
    np.testing.assert_array_equal(np.isfinite(result["feedback_reference_roll"]), ~by_sticks)
    np.testing.assert_array_equal(
        np.isfinite(result["reference_angular_rate_y"]), [*[False] * 4, True, True, *[False] * 2]
    )
    assert result["reference_angular_rate_y"][4] == 2.0


def test_without_a_mode_a_loop_made_them():
    result = made(*log(**of([(0.3, 0.2, 0.1)] * COUNT)))
    assert np.isnan(result["reference_roll"]).all()
    assert np.isfinite(result["feedback_reference_roll"]).all()
    assert np.isnan(result["reference_angular_rate_x"]).all()


def test_old_logs_hold_angles():
    angles = {
        f"{name}_body": np.full(COUNT, value) for name, value in (("roll", 0.1), ("pitch", 0.2), ("yaw", 0.3))
    }
    never = {f"q_d[{index}]": np.zeros(COUNT) for index in range(4)}
    result = made(*log((0, 0, 0, 0), **angles, **never))
    assert result["reference_pitch"] == pytest.approx(np.full(COUNT, 0.2))


def test_damaged_quaternions_are_missing():
    parts = of([(0.3, 0.2, 0.1)] * COUNT)
    parts["q_d[0]"][3], parts["q_d[1]"][5] = np.nan, 9.0
    result = made(*log((15,), **parts))
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(result["reference_yaw"])), [3, 5])


def test_a_setpoint_of_neither_kind_makes_no_channel():
    assert [item for item in made(*log((15,))) if "angular" not in item] == []
