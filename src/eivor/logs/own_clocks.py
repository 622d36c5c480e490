"""Columns that have a clock of their own in a table whose rows are those of several.

Topics of several rates that are joined by their stamps make a table in which a column has values in some of
the rows only. The blanks between are no values that were lost, nor setpoints that are not in force: the
channel was not logged then.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from eivor.logs.silences import silenced
from eivor.signals.recording import Channel, Finding

#: A column has a clock of its own where at least this share of the steps between its values skips rows. What
#: is lost now and then skips fewer, and a setpoint that is not in force for a while skips many rows at once.
SKIPPING_SHARE = 0.1
#: Fewer values tell nothing of a clock.
FEWEST_VALUES = 10


def on_own_clock(channel: Channel) -> Channel:
    """Return the channel at the rows that it has values in, where these are its own; else as it is.

    A setpoint or a command that has no value for longer than a second is not in force from then on.

    Parameters
    ----------
    channel : Channel
        With a value or NaN for each row of a table.
    """
    own = np.isfinite(channel.values)
    rows = np.flatnonzero(own)
    if rows.size < FEWEST_VALUES or np.mean(np.diff(rows) > 1) < SKIPPING_SHARE:
        return channel
    quality = replace(channel.quality, missing_values=0)
    on_own = replace(channel, time_s=channel.time_s[own], values=channel.values[own], quality=quality)
    return silenced(on_own, float(channel.time_s[-1])) if channel.held else on_own


def own_clock_findings(before: Mapping[str, Channel], after: Mapping[str, Channel]) -> list[Finding]:
    """Say which columns have clocks of their own, and how quick these are."""
    told = [f"{name} {one.rate_hz:.3g} Hz" for name, one in after.items() if one is not before[name]]
    if not told:
        return []
    return [
        Finding(
            "own_clock", f"Without a value in some rows, and read at rates of their own: {', '.join(told)}."
        )
    ]
