"""Attitudes as angles."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from eivor.signals.channels import roll_pitch_yaw


def test_angles_are_those_of_successive_turns_and_yaw_goes_on():
    count = 50
    angles = np.stack(
        [np.linspace(-1.0, 1.2, count), np.linspace(0.8, -1.1, count), np.linspace(-2.0, 9.0, count)]
    )
    quaternions = Rotation.from_euler("ZYX", angles[::-1].T).as_quat(scalar_first=True).T
    quaternions[:, ::7] *= -1.0  # the same attitudes
    np.testing.assert_allclose(roll_pitch_yaw(quaternions), angles, atol=1e-12)


def test_what_is_missing_stays_missing():
    quaternions = np.tile(np.array([[1.0], [0.0], [0.0], [0.0]]), 3)
    quaternions[2, 1] = np.nan
    np.testing.assert_array_equal(np.isnan(roll_pitch_yaw(quaternions)), [[False, True, False]] * 3)
