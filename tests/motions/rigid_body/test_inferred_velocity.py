"""Velocity along z out of the accelerometer, where none is logged."""

from __future__ import annotations

import numpy as np
import pytest

from eivor.motions.rigid_body.regression import FROM_HZ, inferred_velocity
from eivor.motions.vertical.model import GRAVITY
from eivor.signals.signals import Signals

STEP_S = 0.01
TIME_S = STEP_S * np.arange(4000)


def signals(force: np.ndarray, roll: np.ndarray, **more: np.ndarray) -> Signals:
    rates = {"angular_rate_x": np.gradient(roll, STEP_S), "angular_rate_y": np.zeros(force.size)}
    return Signals(rate_hz=1.0 / STEP_S, channels={"specific_force_body_z": force, **rates, **more})


def velocity(frequency_hz: float) -> np.ndarray:
    return np.sin(2.0 * np.pi * frequency_hz * TIME_S)


def inner(values: np.ndarray) -> np.ndarray:
    return values[500:-500]


@pytest.mark.parametrize("frequency_hz", [FROM_HZ, 0.5, 2.0])
def test_what_is_quick_is_found_whatever_the_bias(frequency_hz):
    moved = velocity(frequency_hz)
    force = np.gradient(moved, STEP_S) + GRAVITY + 0.3
    result = inferred_velocity(signals(force, np.zeros(TIME_S.size)), [slice(0, TIME_S.size)])
    assert result is not None
    assert np.std(inner(result - moved)) < 0.03


@pytest.mark.parametrize("logged", [False, True])
def test_a_tilt_is_no_fall(logged):
    roll = 0.4 * np.sin(2.0 * np.pi * 0.7 * TIME_S)
    moved = velocity(0.5)
    force = np.gradient(moved, STEP_S) + GRAVITY * np.cos(roll)
    quaternion = {"w": np.cos(roll / 2.0), "x": np.sin(roll / 2.0), "y": 0.0 * roll, "z": 0.0 * roll}
    attitude = {f"attitude_{part}": values for part, values in quaternion.items()} if logged else {}
    result = inferred_velocity(signals(force, roll, **attitude), [slice(0, TIME_S.size)])
    assert result is not None
    assert np.std(inner(result - moved)) < 0.03


def test_runs_are_integrated_by_themselves():
    moved = velocity(0.5)
    runs = [slice(100, 1500), slice(2000, 3900)]
    result = inferred_velocity(signals(np.gradient(moved, STEP_S) + GRAVITY, 0.0 * moved), runs)
    assert result is not None
    assert not result[:100].any()
    assert not result[1500:2000].any()
    assert np.std(result[2300:3600] - moved[2300:3600]) < 0.05


def test_without_a_force_there_is_none():
    blind = Signals(rate_hz=100.0, channels={"angular_rate_x": np.zeros(100)})
    assert inferred_velocity(blind, [slice(0, 100)]) is None
