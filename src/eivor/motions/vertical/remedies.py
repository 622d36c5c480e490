"""What to do about grounds that several quantities share."""

from __future__ import annotations

FLY = (
    "Fly vertical position steps or a sine sweep of about 2 m/s and 2 m for 60 s in position mode, calm air."
)
QUICKER = "Fly quicker steps, and log command and acceleration at 50 Hz or more."
LOG_REFERENCE = "Log the position setpoint, or the pilot's stick, at 50 Hz or more."
