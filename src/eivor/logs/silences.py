"""Setpoints that are in force as long as they are logged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from eivor.signals.recording import Channel

#: A setpoint that is silent for longer than this, and than five of its steps, is not in force [s].
SILENCE_S = 1.0


def silenced(channel: Channel, end_s: float) -> Channel:
    """Return the channel with a NaN where its topic falls silent: a held value would outlive its setpoint.

    Parameters
    ----------
    channel : Channel
        Setpoint that is logged only while it is in force.
    end_s : float
        Where the log ends [s].
    """
    limit = SILENCE_S
    if channel.time_s.size > 1:
        limit = max(limit, 5.0 * float(np.median(np.diff(channel.time_s))))
    following = np.append(channel.time_s[1:], end_s)
    # a millisecond more, or the sample that is put in meets the next one
    last = np.flatnonzero((following - channel.time_s > limit + 1e-3) & np.isfinite(channel.values))
    time = np.insert(channel.time_s, last + 1, channel.time_s[last] + limit)
    values = np.insert(channel.values, last + 1, np.nan)
    return replace(channel, time_s=time, values=values)
