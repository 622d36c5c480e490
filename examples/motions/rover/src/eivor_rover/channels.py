"""Channels of a rover: which it adds to Eivor's, and which of them plays which role."""

from __future__ import annotations

import numpy as np

from eivor.flights.grid import Active, Grid
from eivor.flights.options import FlightOptions
from eivor.flights.prepared import InputFamily, Selection, chosen_input
from eivor.flights.references import ReferenceSource
from eivor.signals.channels import CanonicalChannel
from eivor.signals.recording import Recording

SPEED, ACCELERATION, REFERENCE = "forward_speed", "forward_acceleration", "reference_forward_speed"
CHANNELS = (
    CanonicalChannel(SPEED, "m/s"),
    CanonicalChannel(ACCELERATION, "m/s^2"),
    CanonicalChannel("drive_command", "", held=True, free_unit=True),
    CanonicalChannel(REFERENCE, "m/s", held=True, exogenous=True),
)
INPUTS = (InputFamily("drive_command"),)
REFERENCES = (ReferenceSource(REFERENCE),)
#: Band of spectral rows [Hz].
BAND_HZ = (0.05, 5.0)


def throughout(log: Recording, grid: Grid, input_level: np.ndarray) -> Active:
    """Everywhere: a rover need not take off."""
    del log, input_level
    return Active(np.ones(grid.count, dtype=np.bool_), "the record, which is a drive throughout")


def selected(log: Recording, options: FlightOptions) -> Selection:
    """Speed and command, and the accelerometer where there is one."""
    family, commands = chosen_input(
        log, INPUTS, options.input, remedy="Log the command of the drive at 50 Hz or more"
    )
    return Selection(
        family,
        commands,
        states={"velocity": log.channel(SPEED)},
        responses={"acceleration": log.channels.get(ACCELERATION)},
        band_hz=BAND_HZ,
        active=throughout,
    )
