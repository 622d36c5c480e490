"""References: what the vehicle was asked to do, and which of it may serve as an instrument.

A reference is usable when it does not answer the vehicle: a position setpoint; velocity and acceleration
feed-forward of a trajectory; the pilot's throttle while a pilot flies. The velocity setpoint that a
position loop computes contains feedback; it is used only when nothing else varies, and never gives more
than a weak verdict.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from eivor.flights.grid import Grid, on_grid
from eivor.signals.recording import Recording

CLEAN = ("reference_position_z", "reference_velocity_z", "reference_acceleration_z", "pilot_throttle")
FEEDBACK = "feedback_reference_velocity_z"
#: A reference must be in force for this share of the samples used.
IN_FORCE_SHARE = 0.5
#: The pilot must be in control for this share of them for the stick to count.
PILOT_SHARE = 0.5
#: A reference whose standard deviation within runs is below this share of its size is constant.
CONSTANT_SHARE = 1e-6


@dataclass(frozen=True, slots=True)
class Reference:
    """One candidate instrument.

    Parameters
    ----------
    name : str
        Channel.
    usable : bool
        It may serve as an instrument.
    remark : str
        Why not, or how much it moves.
    values : ndarray, shape (n,)
        On the flight's grid, filled where it is not in force.
    """

    name: str
    usable: bool
    remark: str
    values: Float[np.ndarray, " n"]


def references(recording: Recording, grid: Grid, used: Bool[np.ndarray, " n"]) -> tuple[Reference, ...]:
    """Every reference in the log, judged over the samples `used`; feedback only when nothing else serves."""
    found = [
        _reference(recording, name, grid, used) for name in (*CLEAN, FEEDBACK) if name in recording.channels
    ]
    if any(reference.usable and reference.name != FEEDBACK for reference in found):
        found = [
            reference
            if reference.name != FEEDBACK
            else Reference(FEEDBACK, False, "contains feedback; others serve", reference.values)
            for reference in found
        ]
    return tuple(found)


def _reference(recording: Recording, name: str, grid: Grid, used: Bool[np.ndarray, " n"]) -> Reference:
    values, in_force = on_grid(recording.channel(name), grid)
    if not used.any():
        return Reference(name, False, "no usable sample of flight", values)
    share = float(in_force[used].mean())
    if share < IN_FORCE_SHARE:
        return Reference(name, False, f"in force for {share:.0%} of the flight only", values)
    if name == "pilot_throttle" and not _pilot_flies(recording, grid, used):
        return Reference(name, False, "no pilot flies", values)
    spread = _spread_within_runs(values, used)
    if spread <= CONSTANT_SHARE * max(1.0, float(np.max(np.abs(values[used])))):
        return Reference(name, False, "constant", values)
    return Reference(name, True, f"standard deviation {spread:.3g}", values)


def _spread_within_runs(values: Float[np.ndarray, " n"], used: Bool[np.ndarray, " n"]) -> float:
    """Standard deviation about the mean of each run; a reference that only steps between runs has none."""
    index = np.flatnonzero(used)
    runs = np.split(index, np.flatnonzero(np.diff(index) > 1) + 1)
    deviations = np.concatenate([values[run] - values[run].mean() for run in runs])
    return float(np.sqrt(np.mean(deviations**2)))


def _pilot_flies(recording: Recording, grid: Grid, used: Bool[np.ndarray, " n"]) -> bool:
    if "pilot_in_control" not in recording.channels:
        return True
    flies, known = on_grid(recording.channel("pilot_in_control"), grid)
    return float((known & (flies > 0.5))[used].mean()) >= PILOT_SHARE


def named_reference(recording: Recording, name: str, grid: Grid) -> Reference:
    """Any channel, taken as an instrument at the user's word.

    Raises
    ------
    MissingChannelError
        When the log does not have it.
    """
    values, _ = on_grid(recording.channel(name), grid)
    return Reference(name, True, "named by the user", values)
