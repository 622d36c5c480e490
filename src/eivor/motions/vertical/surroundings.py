"""What surrounds a vertical flight: the ground below it, and the voltage of its supply, on its grid."""

from __future__ import annotations

import numpy as np

from eivor.flights.grid import on_grid
from eivor.flights.prepared import PreparedFlight
from eivor.shapes import Float

VOLTAGE = "battery_voltage"
#: The lowest height of the log is that of the ground when the flight stays so far above it; else the ground
#: is taken to be so far below the flight [m].
ABOVE_GROUND, BELOW_FLIGHT = 0.1, 0.5


def height_logged(flight: PreparedFlight) -> Float[np.ndarray, " n"] | None:
    """Height as logged, z up; None where it is not [m]."""
    channel = flight.recording.channels.get("position_z")
    if channel is None or np.isfinite(channel.values).sum() < 2:
        return None
    return on_grid(channel, flight.grid)[0]


def ground(flight: PreparedFlight) -> float | None:
    """Height of the ground, of a flight that has runs; None where the log does not tell it [m].

    It is told where the log begins or ends on it: its lowest height is then below all of the flight.
    """
    height = height_logged(flight)
    if height is None:
        return None
    lowest = float(np.nanquantile(flight.recording.channels["position_z"].values, 0.005))
    return lowest if float(height[flight.used].min()) - lowest > ABOVE_GROUND else None


def height_over_ground(flight: PreparedFlight) -> Float[np.ndarray, " n"] | None:
    """Height over the ground; over a place below all of the flight where the log does not tell it [m]."""
    height = height_logged(flight)
    if height is None:
        return None
    known = ground(flight)
    return height - (float(height[flight.used].min()) - BELOW_FLIGHT if known is None else known)


def voltage(flight: PreparedFlight) -> Float[np.ndarray, " n"] | None:
    """Voltage of the supply; None where it is not logged, or not above zero in the mean [V]."""
    channel = flight.recording.channels.get(VOLTAGE)
    if channel is None or np.isfinite(channel.values).sum() < 2:
        return None
    volts = on_grid(channel, flight.grid)[0]
    return volts if float(volts[flight.used].mean()) > 0.0 else None


def voltage_change(flight: PreparedFlight) -> float | None:
    """What the voltage changed by over the time used, as a share of its mean; None where it is not logged.

    The ends of a steady fall are the root of 12 standard deviations apart.
    """
    volts = voltage(flight)
    return (
        None if volts is None else float(np.sqrt(12.0) * volts[flight.used].std() / volts[flight.used].mean())
    )
