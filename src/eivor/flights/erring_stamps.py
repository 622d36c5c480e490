"""Samples taken evenly whose stamps were written down late or early: each goes to the line of those around.

Stamps of commands that err are noise in a regressor: of rotors' commands at 500 Hz an error of .8 ms makes
the lag .2 % too long without any other noise, since a longer lag makes less of it. Those of a gyroscope are
noise that goes with how rates change, largest where the flight tells most.

Smooth channels tell whether their samples were taken when their stamps say
(`eivor.flights.uneven_stamps`). Where they were not, the logger's stamps err, and those of its commands too,
which no smooth quantity could tell by themselves. The errors of an even clock's stamps do not add up: stamps
25 samples apart are as far off as neighbours. Where they do add up, as those of a clock that waits after
every sample do, or where samples were lost between, stamps stay as they are.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from eivor.flights.uneven_stamps import PAUSE, stamps_are_true, uneven
from eivor.shapes import Float
from eivor.signals.recording import Finding, Recording
from eivor.signals.stamps import REACH, on_lines

#: Stamps far apart are off by no more than so many times what neighbours are.
ADDED_UP = 1.15


def with_even_stamps(log: Recording) -> tuple[Recording, tuple[Finding, ...]]:
    """Log with stamps that err evened, and a finding that says so; the same log where none is known to err.

    Parameters
    ----------
    log : Recording
        With channels that are smooth between their samples.
    """
    doubtful = {name: one for name, one in log.channels.items() if uneven(one)}
    if stamps_are_true([one for one in doubtful.values() if not one.held]) is not False:
        return log, ()
    evened: dict[bytes, Float[np.ndarray, " n"] | None] = {}
    channels, largest_s = dict(log.channels), 0.0
    for name, one in doubtful.items():
        clock = one.time_s.tobytes()
        if clock not in evened:
            evened[clock] = even_stamps(one.time_s)
        stamps = evened[clock]
        if stamps is not None:
            channels[name] = replace(one, time_s=stamps)
            largest_s = max(largest_s, float(np.std(one.time_s - stamps)))
    if not largest_s:
        return log, ()
    told = (
        f"Samples were taken evenly, and their stamps err, by up to {1e3 * largest_s:.2g} ms (standard "
        "deviation): each is put on the line through those around it."
    )
    return replace(log, channels=channels), (Finding("erring_stamps", told),)


def even_stamps(time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"] | None:
    """Stamps of an even clock with their errors averaged out; None where their errors add up.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Increasing stamps [s].
    """
    distances = np.diff(time_s)
    longest_s = PAUSE * float(np.median(distances))
    unbroken = np.cumsum(np.concatenate([[0], distances > longest_s]))
    far = (time_s[REACH:] - time_s[:-REACH])[unbroken[REACH:] == unbroken[:-REACH]]
    if far.size < REACH or np.std(far) > ADDED_UP * np.std(distances[distances <= longest_s]):
        return None
    stamps = on_lines(time_s, longest_s)
    return stamps if np.all(np.diff(stamps) > 0.0) else None
