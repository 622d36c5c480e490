"""Velocity, and the force that its change tells, on the body's axes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from eivor.motions.rigid_body.regression import body_velocity, force_by_velocity
from eivor.motions.vertical.model import GRAVITY
from eivor.signals.signals import Signals

RATE_HZ = 100.0
TIME = np.arange(400) / RATE_HZ
VELOCITY = np.column_stack([np.sin(TIME), 0.5 * TIME, np.cos(2.0 * TIME)])
FORCE = np.column_stack([np.cos(TIME), np.full(TIME.size, 0.5), GRAVITY - 2.0 * np.sin(2.0 * TIME)])


def tilted(**none: None) -> tuple[Signals, Rotation]:
    body = Rotation.from_euler("xyz", [0.2, -0.3, 0.9])
    x, y, z, w = body.as_quat()
    channels = {
        **{f"velocity_{axis}": VELOCITY[:, i] for i, axis in enumerate("xyz")},
        **{
            f"attitude_{part}": np.full(TIME.size, item)
            for part, item in zip("wxyz", (w, x, y, z), strict=True)
        },
    }
    return Signals(RATE_HZ, {name: channel for name, channel in channels.items() if name not in none}), body


def test_the_change_of_velocity_tells_what_an_accelerometer_reads():
    signals, body = tilted()
    force = force_by_velocity(signals)
    inner = slice(5, -5)
    assert force is not None
    assert force[inner] == pytest.approx(body.inv().apply(FORCE)[inner], abs=1e-6)
    assert body_velocity(signals) == pytest.approx(body.inv().apply(VELOCITY))


def test_without_attitude_neither_is_known():
    signals, _ = tilted(attitude_w=None)
    assert force_by_velocity(signals) is None
    assert body_velocity(signals) is None
