"""Setpoints of a plan at the rate of those who fly it."""

from __future__ import annotations

import numpy as np

from eivor.planning.plan import FlightPlan
from eivor.planning.setpoints import STEP_S
from eivor.shapes import Float


def sampled(plan: FlightPlan, rate_hz: float) -> Float[np.ndarray, "n 4"]:
    """Time [s], height above take-off [m], velocity [m/s] and acceleration [m/s^2] at about that rate."""
    every = max(round(1.0 / (rate_hz * STEP_S)), 1)
    columns = np.column_stack([plan.time_s, plan.height, plan.velocity, plan.acceleration])
    return columns[::every]
