"""What lines between stamps do to a series, done to what it is held against.

The line between two stamps of a series that moves faster than it was logged is its mean, weighted by a
triangle that reaches one stamp's distance h to both sides: amplitudes at a frequency f shrink by sinc^2(f
h), and nothing is late. An equation holds of series that are all weighted alike. So that both of its sides
are, the triangle of each is applied to the other: of a command that was logged more slowly than it was
issued to what was measured, and of what was measured more slowly than the grid's step to the command.
"""

from __future__ import annotations

import numpy as np

from eivor.flights.command_clock import CommandClock
from eivor.flights.grid import Grid
from eivor.flights.selection import Selection
from eivor.shapes import Float


def spread_alike(
    channels: dict[str, Float[np.ndarray, " n"]],
    selected: Selection,
    clocks: dict[str, CommandClock],
    grid: Grid,
) -> dict[str, Float[np.ndarray, " n"]]:
    """Channels on a grid, commands and what was measured spread by each other's triangles.

    Parameters
    ----------
    channels : dict of str to ndarray, shape (n,)
        Of the selection, as lines between their stamps.
    selected : Selection
        Which are commands, and which were measured.
    clocks : dict of str to CommandClock
        Of the commands.
    grid : Grid
        Where they are known.
    """
    measured = (*selected.states.values(), *selected.logged_responses)
    commanded_s = max((one.logged_s for one in clocks.values() if one.thinned), default=0.0)
    measured_s = max(1.0 / one.rate_hz for one in measured)
    spread = dict(channels)
    for one in measured:
        # what was measured faster than others waits for them
        others = measured_s if 1.0 / one.rate_hz < measured_s else 0.0
        for width_s in (commanded_s, others):
            spread[one.name] = triangle_mean(spread[one.name], grid, width_s)
    for command in selected.commands:
        spread[command.name] = triangle_mean(spread[command.name], grid, measured_s)
    return spread


def triangle_mean(values: Float[np.ndarray, " n"], grid: Grid, width_s: float) -> Float[np.ndarray, " n"]:
    """Mean of a series around each sample, weighted by a triangle of so long a half.

    Parameters
    ----------
    values : ndarray, shape (n,)
        On the grid.
    grid : Grid
        Its pieces are taken each by itself.
    width_s : float
        From the triangle's tip to its end [s]; nothing changes for one up to the grid's step.
    """
    reach = int(np.ceil(width_s / grid.step_s)) - 1
    if reach < 1:
        return values
    distance = np.abs(np.arange(-reach, reach + 1)) * grid.step_s
    weights = 1.0 - distance / width_s
    spread, start = np.empty_like(values), 0
    for piece in grid.pieces:
        inside = slice(start, start + len(piece))
        padded = np.pad(values[inside], reach, mode="edge")
        spread[inside] = np.convolve(padded, weights / weights.sum(), mode="valid")
        start = inside.stop
    return spread
