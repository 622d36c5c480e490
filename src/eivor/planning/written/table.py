"""A plan as a table, whose columns are channels of a log."""

from __future__ import annotations

from eivor.planning.plan import FlightPlan
from eivor.planning.written.samples import sampled

COLUMNS = ("time", "reference_position_z", "reference_velocity_z", "reference_acceleration_z")
RATE_HZ = 50.0


def csv_text(plan: FlightPlan) -> str:
    """Setpoints at 50 Hz: seconds, metres above the place of take-off, m/s, m/s^2."""
    rows = [",".join(f"{value:.5g}" for value in row) for row in sampled(plan, RATE_HZ).tolist()]
    return "\n".join([",".join(COLUMNS), *rows]) + "\n"
