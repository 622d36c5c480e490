"""Where the vehicle is in the air.

By the land detector where one is logged, which includes its ground contact. Else by a stated rule: it flies
but where its input is below a quarter of the level it flies at (the 95th percentile) for half a second or
more, if the log shows that, and, where the height is logged and the input is off at the beginning or the end
of the log, only while it is also 0.1 m above the ground (the lower of the median heights there: with the
input off in mid-air, in a dive, the vehicle is not on the ground). A log whose input is never off is taken
as airborne throughout.

Either way motors at idle for half a second or more end the flight: what falls, lies upside down or has
crashed does not fly, whatever a land detector says.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eivor.flights.grid import Grid, on_grid
from eivor.shapes import Bool, Float
from eivor.signals.recording import Recording
from eivor.signals.signals import stretches

#: Input below this share of its flying level is off; below this one motors are at idle.
OFF_SHARE = 0.25
IDLE_SHARE = 0.1
#: So long must the input be off for the rule to know the ground, or at idle to end a flight [s].
OFF_FOR_S = 0.5
#: So high is off the ground [m].
CLEARANCE_M = 0.1
#: A height that is known for a smaller share of the log cannot say where the ground is.
HEIGHT_KNOWN_SHARE = 0.5
#: Left out after take-off and before landing [s].
MARGIN_S = 1.0


@dataclass(frozen=True, slots=True)
class Active:
    """Where the vehicle does what a motion describes (where it flies), and how that is known.

    Parameters
    ----------
    mask : ndarray of bool, shape (n,)
        True where it does; in the air, margins left out.
    rule : str
        Which rule was used, in words.
    """

    mask: Bool[np.ndarray, " n"]
    rule: str


def airborne_by_log(log: Recording, grid: Grid, input_level: Float[np.ndarray, " n"]) -> Active:
    """Airborne samples of a log: by its land detector, else by the input and the height it holds.

    Parameters
    ----------
    log : Recording
        Z up; `landed`, `ground_contact` and `position_z` count where they are logged.
    grid : Grid
        Samples to judge.
    input_level : ndarray, shape (n,)
        Mean of the actuators' commands on the grid, positive up.
    """
    landed = height = None
    if "landed" in log.channels:
        on_ground, known = on_grid(log.channels["landed"], grid)
        if known.any():
            landed = (on_ground > 0.5) | ~known
            if "ground_contact" in log.channels:
                touching, told = on_grid(log.channels["ground_contact"], grid)
                landed |= told & (touching > 0.5)
    if "position_z" in log.channels:
        level, known = on_grid(log.channels["position_z"], grid)
        height = level if known.mean() >= HEIGHT_KNOWN_SHARE else None
    return airborne(input_level=input_level, step_s=grid.step_s, landed=landed, height=height)


def airborne(
    *,
    input_level: Float[np.ndarray, " n"],
    step_s: float,
    landed: Bool[np.ndarray, " n"] | None,
    height: Float[np.ndarray, " n"] | None,
) -> Active:
    """Airborne samples of a flight on its grid.

    Parameters
    ----------
    input_level : ndarray, shape (n,)
        Mean of the actuators' commands, positive up.
    step_s : float
        Step of the grid [s].
    landed : ndarray of bool, shape (n,), optional
        The land detector.
    height : ndarray, shape (n,), optional
        Height, z up [m].
    """
    if landed is not None:
        flying = ~landed & ~_idle(input_level, ~landed, step_s)
        return Active(_without_margins(flying, step_s), "the log's land detector")
    level = float(np.percentile(input_level, 95))
    off = _for_long(input_level < OFF_SHARE * level, step_s)
    if level <= 0.0:
        return Active(np.zeros(off.size, dtype=np.bool_), "the input, which never rises above zero")
    if off.sum() * step_s < OFF_FOR_S:
        return Active(np.ones(off.size, dtype=np.bool_), "the input, which is never off")
    flying = ~off
    ground = None if height is None else _ground(height, off, step_s)
    if height is None or ground is None:
        missing = "no height is logged" if height is None else "it is on at both ends of the log"
        return Active(_without_margins(flying, step_s), f"the input ({missing})")
    flying &= height > ground + CLEARANCE_M
    return Active(_without_margins(flying, step_s), "the input and the height above ground")


def _ground(height: Float[np.ndarray, " n"], off: Bool[np.ndarray, " n"], step_s: float) -> float | None:
    """Height of the ground: where the vehicle is while its input is off at the ends of the log."""
    on = np.flatnonzero(~off)
    ends = [height[: on[0]], height[on[-1] + 1 :]] if on.size else [height]
    known = [float(np.median(end)) for end in ends if end.size * step_s >= OFF_FOR_S]
    return min(known) if known else None


def _idle(
    input_level: Float[np.ndarray, " n"], airborne: Bool[np.ndarray, " n"], step_s: float
) -> Bool[np.ndarray, " n"]:
    """Samples of motors at idle for so long that nothing flies."""
    level = float(np.percentile(input_level[airborne], 95)) if airborne.any() else 0.0
    return _for_long(input_level < IDLE_SHARE * level, step_s)


def _for_long(mask: Bool[np.ndarray, " n"], step_s: float) -> Bool[np.ndarray, " n"]:
    """Samples of the stretches of a mask that are half a second long or longer."""
    held = np.zeros(mask.size, dtype=np.bool_)
    for stretch in stretches(mask):
        held[stretch] = (stretch.stop - stretch.start) * step_s >= OFF_FOR_S
    return held


def _without_margins(flying: Bool[np.ndarray, " n"], step_s: float) -> Bool[np.ndarray, " n"]:
    """`flying` shortened at each take-off and landing, but not where the log begins or ends in the air."""
    margin = round(MARGIN_S / step_s)
    grounded = np.concatenate([[0], np.cumsum(~flying)])
    index = np.arange(flying.size)
    earlier = np.maximum(index - margin, 0)
    later = np.minimum(index + margin + 1, flying.size)
    return np.asarray(grounded[later] - grounded[earlier] == 0)
