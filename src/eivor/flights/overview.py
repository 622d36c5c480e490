"""When the vehicle moved as a motion says, over a log of hours: of a few samples a second.

It says which part of a long log is worth looking at; what is identified is prepared from all samples.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from eivor.flights.frames import upward
from eivor.flights.grid import common_grid, on_grid
from eivor.flights.motion import Motion
from eivor.flights.options import FlightOptions
from eivor.flights.prepare import refuse_empty
from eivor.signals.recording import Recording
from eivor.signals.signals import stretches

#: Distance of samples [s]: shorter than what begins or ends a flight, and than that of slow telemetry.
OVERVIEW_STEP_S = 0.05


def overview(
    recording: Recording, motion: Motion[Any], options: FlightOptions
) -> tuple[str, tuple[tuple[float, float], ...]]:
    """How it is known when the vehicle moved, and the stretches in which it did [s].

    Parameters
    ----------
    recording : Recording
        Whose channels do not fit into memory together.
    motion : Motion
        What it is looked at for.
    options : FlightOptions
        Choices; the window is left aside.

    Raises
    ------
    MissingChannelError
        When the motion's channels, or the options', are not in the log.
    InputError
        When the channels share no time, or more than six hours.
    """
    log = upward(recording)
    log = log.part(*log.span_s, OVERVIEW_STEP_S)
    selected = motion.select(log, options)
    for channel in selected.channels:
        refuse_empty(log, channel)
    grid = common_grid(selected.channels, selected.commands, motion.memory_s, OVERVIEW_STEP_S)
    level = np.mean([on_grid(command, grid)[0] for command in selected.commands], axis=0)
    active = motion.active(log, grid, level)
    time_s = grid.time_s
    found = tuple((float(time_s[one.start]), float(time_s[one.stop - 1])) for one in stretches(active.mask))
    return active.rule, found
