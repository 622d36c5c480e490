"""A plan as a trajectory of RotorPy: a class whose `update` gives the flat outputs at a time."""

from __future__ import annotations

from eivor.planning.plan import FlightPlan
from eivor.planning.written.samples import sampled

RATE_HZ = 50.0
_HEAD = '''"""A planned identification flight as a trajectory of RotorPy: vertical, from rest to rest."""

import numpy as np

# Time [s], height [m], velocity [m/s], acceleration [m/s^2].
SETPOINTS = np.array(
    [
'''
_TAIL = '''    ]
)


class PlannedFlight:
    """Give the flat outputs of the plan above a place."""

    def __init__(self, place=(0.0, 0.0)):
        self.place = np.array([place[0], place[1], 0.0])

    def update(self, t):
        """Flat outputs at a time; before and after the flight those of its ends."""
        time = SETPOINTS[:, 0]
        height, velocity, acceleration = (np.interp(t, time, SETPOINTS[:, k]) for k in (1, 2, 3))
        up = np.array([0.0, 0.0, 1.0])
        none = np.zeros(3)
        return {
            "x": self.place + height * up,
            "x_dot": velocity * up,
            "x_ddot": acceleration * up,
            "x_dddot": none,
            "x_ddddot": none,
            "yaw": 0.0,
            "yaw_dot": 0.0,
            "yaw_ddot": 0.0,
        }
'''


def rotorpy_text(plan: FlightPlan) -> str:
    """Text of a Python module with the class `PlannedFlight`."""
    rows = sampled(plan, RATE_HZ).tolist()
    numbers = "".join(f"        [{', '.join(f'{value:.5g}' for value in row)}],\n" for row in rows)
    return _HEAD + numbers + _TAIL
