"""One uniform grid: every channel brought to it, with a mask of where it really had something to say."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from eivor.errors import InputError
from eivor.signals.recording import Channel

#: Steps of the grid [s]: the fine one when command and accelerometer are logged at FINE_FROM_HZ or more.
STEP_S = 0.010
FINE_STEP_S = 0.005
FINE_FROM_HZ = 150.0
#: A channel faster than this many times the grid is averaged over each step instead of interpolated.
AVERAGED_FROM = 1.5
#: After a gap or a lost value of the command the actuator's state is not known for so long [s].
RECOVERY_S = 0.3
#: The last sample of the grid may lie this share of a step beyond the last stamp: stamps are rounded.
LAST_SAMPLE_SHARE = 1e-7
#: Longest flight that is put on a grid [s].
LONGEST_S = 6 * 3600.0


@dataclass(frozen=True, slots=True)
class Grid:
    """Sample times ``start_s + k * step_s``, k = 0 .. count-1."""

    start_s: float
    step_s: float
    count: int

    @property
    def time_s(self) -> Float[np.ndarray, " n"]:
        """Every sample time [s]."""
        return self.start_s + self.step_s * np.arange(self.count)


def common_grid(channels: list[Channel], fast: list[Channel]) -> Grid:
    """Grid over the time that all `channels` share; fine when all `fast` ones are.

    Raises
    ------
    InputError
        When they share no time, or more than six hours.
    """
    start = max(float(channel.time_s[0]) for channel in channels)
    end = min(float(channel.time_s[-1]) for channel in channels)
    names = ", ".join(channel.name for channel in channels)
    if end <= start:
        raise InputError(
            f"a stretch of time in which {names} are all logged",
            f"none (the last begins at {start:.2f} s, the first ends at {end:.2f} s)",
            "Check the clocks of the log, or leave out the channel that does not fit.",
        )
    if end - start > LONGEST_S:
        raise InputError(
            f"a flight of at most {LONGEST_S / 3600:.0f} hours",
            f"stamps that span {(end - start) / 3600:.1f} hours",
            "Check the unit of the time stamps, or cut the log.",
        )
    fine = all(channel.rate_hz >= FINE_FROM_HZ for channel in fast)
    step = FINE_STEP_S if fine else STEP_S
    return Grid(start, step, int((end - start) / step + LAST_SAMPLE_SHARE) + 1)


def on_grid(channel: Channel, grid: Grid) -> tuple[Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Values of `channel` on the grid and where they stand on data.

    Held channels keep their last value; others are interpolated linearly, or averaged over each step
    when they are logged much faster than the grid. Values inside gaps, beyond the ends, or beside
    missing ones are filled and marked as not standing on data.
    """
    finite = np.isfinite(channel.values)
    if not finite.any():
        return np.zeros(grid.count), np.zeros(grid.count, dtype=np.bool_)
    if channel.held:
        return _held(channel, finite, grid)
    time, values = channel.time_s[finite], channel.values[finite]
    t = grid.time_s
    if time.size > 1 and channel.rate_hz > AVERAGED_FROM / grid.step_s:
        series = _averaged(time, values, grid)
    else:
        series = np.interp(t, time, values)
    good = (t >= time[0] - 1e-9) & (t <= time[-1] + 1e-9)
    for start, end in Channel(channel.name, time, values, channel.unit).gaps():
        good &= (t <= start) | (t >= end)
    return series, good


def _held(
    channel: Channel, finite: Bool[np.ndarray, " m"], grid: Grid
) -> tuple[Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    t = grid.time_s
    index = np.searchsorted(channel.time_s, t + 1e-9, side="right") - 1
    position = np.arange(finite.size)
    last_finite = np.maximum.accumulate(np.where(finite, position, -1))
    source = np.where(index >= 0, last_finite[np.maximum(index, 0)], -1)
    first = int(np.argmax(finite))
    values = channel.values[np.where(source >= 0, source, first)]
    return values, (index >= 0) & finite[np.maximum(index, 0)]


def unbroken(channel: Channel, grid: Grid, good: Bool[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """`good` without the gaps of a command and the time that the actuator needs to forget them."""
    t = grid.time_s
    broken = ~good
    for start, end in channel.gaps():
        broken |= (t > start) & (t < end)
    if not broken.any():
        return good
    wait = int(np.ceil(RECOVERY_S / grid.step_s))
    total = np.concatenate([np.zeros(wait + 1, dtype=np.int64), np.cumsum(broken)])
    return total[wait + 1 :] - total[: grid.count] == 0


def _averaged(
    time: Float[np.ndarray, " m"], values: Float[np.ndarray, " m"], grid: Grid
) -> Float[np.ndarray, " n"]:
    """Mean of the piecewise linear series over one step around each sample, by its exact integral."""
    integral = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(time))])
    edges = np.clip(grid.start_s + grid.step_s * (np.arange(grid.count + 1) - 0.5), time[0], time[-1])
    index = np.clip(np.searchsorted(time, edges, side="right") - 1, 0, max(time.size - 2, 0))
    inside = edges - time[index]
    slope = (values[index + 1] - values[index]) / (time[index + 1] - time[index])
    at_edges = integral[index] + inside * (values[index] + 0.5 * slope * inside)
    width = np.diff(edges)
    mean = np.divide(np.diff(at_edges), width, out=np.zeros(grid.count), where=width > 0.0)
    series: Float[np.ndarray, " n"] = np.where(width > 0.0, mean, np.interp(grid.time_s, time, values))
    return series
