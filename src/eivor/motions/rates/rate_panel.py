"""Rates about an axis to look at, beside what was asked for."""

from __future__ import annotations

import numpy as np

from eivor.flights.prepared import PreparedFlight
from eivor.flights.shown import Panel
from eivor.motions.rates.axes import Axis


def rate_panel(flight: PreparedFlight, axis: Axis) -> Panel:
    """Rate about one axis, and its setpoint where the log has one."""
    asked = flight.asked(f"reference_{axis.rate}")
    measured = np.rad2deg(flight.signals.channel(axis.rate))
    return Panel(f"{axis.name} rate\n[deg/s]", measured, None if asked is None else np.rad2deg(asked))
