"""Which columns pass a known onboard filter, and what is left of it when readers took its delay off."""

from __future__ import annotations

import numpy as np
import pytest

from eivor.motions.rigid_body.regression import OnboardFilter, as_logged
from eivor.motions.rigid_body.vehicle import (
    DAMPING,
    DRAG,
    FORCE_Z_EQUATION,
    GAIN,
    OFFSET,
    PITCH_EQUATION,
    THRUST,
)
from eivor.signals.filters import low_passed

STEP_S, CUTOFF_HZ = 0.002, 30.0
OWN_S = np.sqrt(2.0) / (2.0 * np.pi * CUTOFF_HZ)
TIME = STEP_S * np.arange(2000)
INNER = slice(200, -200)


def sine(frequency_hz: float, late_s: float = 0.0) -> np.ndarray:
    return np.sin(2.0 * np.pi * frequency_hz * (TIME - late_s))


@pytest.mark.parametrize(
    ("taken_s", "left_s"), [(0.0, OWN_S), (OWN_S, 0.0), (OWN_S + 0.02, 0.0), (0.002, OWN_S - 0.002)]
)
def test_a_delay_that_was_taken_off_the_stamps_is_not_applied_again(taken_s, left_s):
    onboard_filter = OnboardFilter(STEP_S, CUTOFF_HZ, taken_s)(sine(1.0))
    np.testing.assert_allclose(onboard_filter[INNER], sine(1.0, left_s)[INNER], atol=2e-4)


def test_what_is_more_than_a_delay_is_left():
    result = OnboardFilter(STEP_S, CUTOFF_HZ, OWN_S)(sine(20.0))[INNER]
    amplitude = np.sqrt(2.0 * np.mean(result**2))
    assert amplitude == pytest.approx(1.0 / np.sqrt(1.0 + (20.0 / CUTOFF_HZ) ** 4), rel=0.01)


def test_columns_of_filtered_rates_do_not_pass_the_filter_twice():
    sensor = OnboardFilter(STEP_S, CUTOFF_HZ, 0.0)
    late = low_passed(sine(5.0)[:, None], step_s=STEP_S, cutoff_hz=CUTOFF_HZ)[:, 0]
    turning = as_logged(
        dict.fromkeys((GAIN[PITCH_EQUATION], OFFSET[PITCH_EQUATION], DAMPING[PITCH_EQUATION]), sine(5.0)),
        PITCH_EQUATION,
        sensor,
    )
    np.testing.assert_allclose(turning[GAIN[PITCH_EQUATION]], late)
    np.testing.assert_allclose(turning[OFFSET[PITCH_EQUATION]], late)
    np.testing.assert_allclose(turning[DAMPING[PITCH_EQUATION]], sine(5.0))
    forces = as_logged(dict.fromkeys((THRUST, DRAG[2]), sine(5.0)), FORCE_Z_EQUATION, sensor)
    np.testing.assert_allclose(forces[DRAG[2]], late)
    np.testing.assert_allclose(as_logged({THRUST: sine(5.0)}, FORCE_Z_EQUATION, None)[THRUST], sine(5.0))
