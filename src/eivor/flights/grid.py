"""Time grid of a flight: airborne runs, resampling, frames and noise levels."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import ceil, floor

import msgspec
import numpy as np

from eivor.errors import InputError
from eivor.signals.channels import canonical_channel
from eivor.signals.recording import GRAVITY, ROTARY_WING, Channel, Frame, MadeChannels, Recording
from eivor.signals.signals import stretches
from eivor.tools import Bool, Float, Int

#: Values on a grid or at stamps, and which of them something is true of.
Series = Float[np.ndarray, " n"]
Mask = Bool[np.ndarray, " n"]

#: A piece whose neighbours are longer or shorter than it by this factor is a line: noise of two stamps that
#: lie close would tilt the curve far.
JITTER = 2.0

#: Values at times `t`, of stamps that increase, their values, and `t`.
Interpolant = Callable[[Float[np.ndarray, " m"], Float[np.ndarray, " m"], Series], Series]


def linear(time: Float[np.ndarray, " m"], values: Float[np.ndarray, " m"], t: Series) -> Series:
    """Lines between stamps, beyond the ends the last value."""
    return np.interp(t, time, values)


def cubic(time: Float[np.ndarray, " m"], values: Float[np.ndarray, " m"], t: Series) -> Series:
    """Cubic curves between even stamps; lines at the ends and between uneven ones."""
    line = linear(time, values, t)
    if time.size < 4:
        return line
    h = np.diff(time)
    with np.errstate(over="ignore", invalid="ignore"):
        chord = np.diff(values) / h
        slope = (h[1:] * chord[:-1] + h[:-1] * chord[1:]) / (h[1:] + h[:-1])
        left_slope, right_slope = slope[:-1] - chord[1:-1], slope[1:] - chord[1:-1]
        neighbours = np.stack([h[:-2], h[1:-1], h[2:]])
        even = neighbours.max(axis=0) <= JITTER * neighbours.min(axis=0)
        even &= np.isfinite(left_slope) & np.isfinite(right_slope)
        piece = np.searchsorted(time, t, side="right") - 2
        inside = np.flatnonzero((piece >= 0) & (piece < even.size))
        inside = inside[even[piece[inside]]]
        k = piece[inside]
        x = (t[inside] - time[k + 1]) / h[k + 1]
        bulge = h[k + 1] * x * (1.0 - x) * ((1.0 - x) * left_slope[k] - x * right_slope[k])
    line[inside] += np.where(np.isfinite(bulge), bulge, 0.0)
    return line


#: Steps of the grid [s]: the fine one when command and accelerometer are logged at FINE_FROM_HZ or more.
STEP_S = 0.010
FINE_STEP_S = 0.005
FINE_FROM_HZ = 150.0
#: A channel faster than this many times the grid is averaged over each step instead of interpolated.
AVERAGED_FROM = 1.5
#: Times closer than this are the same: stamps are rounded [s].
STAMP_ROUNDING_S = 1e-9
#: After a gap or a lost value of the command the actuator's state is not known for so long [s].
RECOVERY_S = 0.3
#: Time before a sample that decides the state of its actuators [s]: behind a lag of 0.3 s, the longest that
#: is searched by default, exp(-26) is left of an earlier change.
MEMORY_S = 8.0
#: Time that is kept behind the samples that are used, and after the last one before a silence [s].
MARGIN_S = 1.0
#: The last sample of the grid may lie this share of a step beyond the last stamp: stamps are rounded.
LAST_SAMPLE_SHARE = 1e-7
#: Longest flight that is put on a grid [s].
LONGEST_S = 6 * 3600.0
#: Stamps that are further apart are not looked into for silences [s].
LONGEST_SPAN_S = 1e12


class Grid(msgspec.Struct, frozen=True):
    """Sample times ``start_s + k * step_s``, for every k of the pieces."""

    start_s: float  # Time of k = 0 [s]
    step_s: float  # [s]
    #: Values of k, increasing. Stretches of time that nothing needs lie between the pieces.
    pieces: tuple[range, ...]

    @property
    def count(self) -> int:
        """Number of samples."""
        return sum(len(piece) for piece in self.pieces)

    @property
    def steps(self) -> Int[np.ndarray, " n"]:
        """Every k."""
        if not self.pieces:
            return np.empty(0, dtype=np.int64)
        return np.concatenate([np.arange(piece.start, piece.stop) for piece in self.pieces])

    @property
    def time_s(self) -> Series:
        """Every sample time [s]."""
        return self.start_s + self.step_s * self.steps

    def select(self, mask: Mask) -> Grid:
        """Grid of the samples of a mask."""
        steps = self.steps[mask]
        edges = np.flatnonzero(np.diff(steps, prepend=-2, append=np.iinfo(np.int64).max) != 1)
        pieces = [range(steps[a], steps[b - 1] + 1) for a, b in pairwise(edges.tolist())]
        return Grid(self.start_s, self.step_s, tuple(pieces))


def common_grid(channels: Sequence[Channel], fast: Sequence[Channel], step_s: float | None = None) -> Grid:
    """Grid over the time that all `channels` share; of a given step, or fine when all `fast` ones are."""
    start = max(float(channel.time_s[0]) for channel in channels)
    end = min(float(channel.time_s[-1]) for channel in channels)
    names = ", ".join(channel.name for channel in channels)
    if end <= start:
        received = f"none (the last begins at {start:.2f} s, the first ends at {end:.2f} s)"
        remedy = "Check the clocks of the log, or leave out the channel that does not fit."
        raise InputError(f"a stretch of time in which {names} are all logged", received, remedy)
    if end - start > LONGEST_SPAN_S:
        raise _too_long(end - start)
    fine = all(channel.rate_hz >= FINE_FROM_HZ for channel in fast)
    step = step_s or (FINE_STEP_S if fine else STEP_S)
    fast_names = {channel.name for channel in fast}
    silences = [
        (ceil((first + MARGIN_S - start) / step), floor((last - MEMORY_S - start) / step))
        for channel in channels
        if channel.name in fast_names or not channel.held
        for first, last in channel.silences()
    ]
    grid = Grid(start, step, _remaining_pieces(silences, int((end - start) / step + LAST_SAMPLE_SHARE) + 1))
    if grid.count * step > LONGEST_S:
        raise _too_long(grid.count * step)
    return grid


def _too_long(covered_s: float) -> InputError:
    hours = covered_s / 3600.0
    received = f"stamps that cover {f'{hours:.1f}' if hours < 1e6 else f'{hours:.3g}'} hours"
    remedy = "Check the unit of the time stamps, or cut the log."
    return InputError(f"a flight of at most {LONGEST_S / 3600:.0f} hours", received, remedy)


def _remaining_pieces(omitted: list[tuple[int, int]], count: int) -> tuple[range, ...]:
    """0 .. count-1 without stretches, each from its first to its last number."""
    pieces, start = [], 0
    for first, last in sorted(omitted):
        if first <= last:
            pieces.append(range(start, min(first, count)))
            start = max(start, last + 1)
    return tuple(piece for piece in (*pieces, range(start, count)) if len(piece))


def with_memory(used: Mask, grid: Grid) -> Mask:
    """Samples `used`, those before them in the actuators' memory, and a margin after them."""
    steps, used_steps = grid.steps, grid.steps[used]
    if not used_steps.size:
        return used
    memory, margin = ceil(MEMORY_S / grid.step_s), ceil(MARGIN_S / grid.step_s)
    until_next = used_steps[np.minimum(np.searchsorted(used_steps, steps), used_steps.size - 1)] - steps
    since_last = steps - used_steps[np.maximum(np.searchsorted(used_steps, steps, side="right") - 1, 0)]
    return ((until_next >= 0) & (until_next <= memory)) | ((since_last >= 0) & (since_last <= margin))


def bridged(channel: Channel) -> Channel:
    """A channel with single missing values interpolated, but not those in gaps."""
    known = np.isfinite(channel.values)
    if known.all() or not known.any():
        return channel
    time, values = channel.time_s[known], channel.values[known]
    missing = ~known & (channel.time_s > time[0]) & (channel.time_s < time[-1])
    shortest_s = max(5.0 * float(np.median(np.diff(channel.time_s))), 0.1)  # as of a channel that loses none
    gaps = Channel(channel.name, time, values, channel.unit).gaps(factor=0.0, at_least_s=shortest_s)
    missing &= ~_inside(gaps, channel.time_s)
    return replace(channel, values=np.where(missing, np.interp(channel.time_s, time, values), channel.values))


def on_grid(channel: Channel, grid: Grid, interpolate: Interpolant = linear) -> tuple[Series, Mask]:
    """Values of `channel` on the grid, and the mask of those supported by data."""
    finite = np.isfinite(channel.values)
    if not finite.any():
        return np.zeros(grid.count), np.zeros(grid.count, dtype=np.bool_)
    if channel.held:
        return _values_in_force(channel, channel.values, grid)
    time, values, t = channel.time_s[finite], channel.values[finite], grid.time_s
    averaged = time.size > 1 and channel.rate_hz > AVERAGED_FROM / grid.step_s
    series = _averaged(time, values, grid) if averaged else interpolate(time, values, t)
    valid = (t >= time[0] - STAMP_ROUNDING_S) & (t <= time[-1] + STAMP_ROUNDING_S)
    valid &= ~_inside(Channel(channel.name, time, values, channel.unit).gaps(), t)
    return series, valid


def unlogged(channel: Channel, grid: Grid) -> Mask:
    """Samples in gaps of a channel that no figure may bridge."""
    finite = np.isfinite(channel.values)
    known = Channel(channel.name, channel.time_s[finite], channel.values[finite], channel.unit)
    gaps = known.gaps(factor=20.0, at_least_s=1.0) if channel.held else known.gaps()
    return _inside(gaps, grid.time_s)


def _inside(intervals: list[tuple[float, float]], t: Series) -> Mask:
    """Times strictly inside one of the intervals, which are in order and do not overlap."""
    if not intervals:
        return np.zeros(t.size, dtype=np.bool_)
    starts, ends = np.array(intervals).T
    interval = np.searchsorted(starts, t, side="left") - 1
    return np.asarray((interval >= 0) & (t < ends[np.maximum(interval, 0)]))


def _values_in_force(
    channel: Channel, values: Float[np.ndarray, "*k m"], grid: Grid
) -> tuple[Float[np.ndarray, "*k n"], Mask]:
    """Value in force at each sample, of a held channel or of other values at its stamps."""
    finite = np.isfinite(channel.values)
    index = np.searchsorted(channel.time_s, grid.time_s + STAMP_ROUNDING_S, side="right") - 1
    last_finite = np.maximum.accumulate(np.where(finite, np.arange(finite.size), -1))
    source = np.where(index >= 0, last_finite[np.maximum(index, 0)], -1)
    start = int(np.argmax(finite))
    return values[..., np.where(source >= 0, source, start)], (index >= 0) & finite[np.maximum(index, 0)]


def command_on_grid(channel: Channel, grid: Grid) -> tuple[Series, Mask]:
    """Values of a command on the grid, and the mask of those whose actuator state is known."""
    is_held = channel.held and np.isfinite(channel.values).any()
    series, valid = _mean_in_force(channel, channel.values, grid) if is_held else on_grid(channel, grid)
    # without its gaps and the time that the actuator needs to forget them
    broken, delay = ~valid | _inside(channel.gaps(), grid.time_s), int(np.ceil(RECOVERY_S / grid.step_s))
    counts = np.concatenate([np.zeros(delay + 1, dtype=np.int64), np.cumsum(broken)])
    return series, counts[delay + 1 :] - counts[: grid.count] == 0


def courses_on_grid(
    command: Channel, courses: Float[np.ndarray, "k m"], grid: Grid
) -> Float[np.ndarray, "k n"]:
    """Courses of a command at its stamps, each as the command itself would be on the grid."""
    if not command.held:
        return np.stack([on_grid(replace(command, values=course), grid)[0] for course in courses])
    return _mean_in_force(command, courses, grid)[0]


def _mean_in_force(
    channel: Channel, values: Float[np.ndarray, "*k m"], grid: Grid
) -> tuple[Float[np.ndarray, "*k n"], Mask]:
    """Mean of a held channel, or of other values at its stamps, over the step that begins at each sample."""
    in_force, valid = _values_in_force(channel, values, grid)
    time, t, step = channel.time_s, grid.time_s, grid.step_s
    # stamps inside the step that begins at a sample are first .. last - 1
    first = np.searchsorted(time, t + STAMP_ROUNDING_S, side="right")
    last = np.searchsorted(time, t + step - STAMP_ROUNDING_S, side="left")
    inside = np.flatnonzero(valid & (last > first))
    if not inside.size:
        return in_force, valid
    first, last, start = first[inside], last[inside], t[inside]
    finite = np.isfinite(channel.values)
    values, missing = np.where(finite, values, 0.0), np.concatenate([[0], np.cumsum(~finite)])
    # between two stamps of one step lies less than a step, so that sums over hours stay small
    area = np.zeros(values.shape)
    np.cumsum(values[..., :-1] * np.minimum(np.diff(time), step), axis=-1, out=area[..., 1:])
    integral = in_force[..., inside] * (time[first] - start) + area[..., last - 1] - area[..., first]
    integral += values[..., last - 1] * (start + step - time[last - 1])
    in_force[..., inside] = integral / step
    valid[inside] = missing[last] == missing[first]
    return in_force, valid


def _averaged(time: Float[np.ndarray, " m"], values: Float[np.ndarray, " m"], grid: Grid) -> Series:
    """Mean of the piecewise linear series over one step around each sample, by its exact integral."""
    integral = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(time))])

    def integral_to(steps: Series) -> tuple[Series, Series]:
        """Times, not beyond the channel's ends, and the integral up to them."""
        edges = np.clip(grid.start_s + grid.step_s * steps, time[0], time[-1])
        index = np.clip(np.searchsorted(time, edges, side="right") - 1, 0, max(time.size - 2, 0))
        inside = edges - time[index]
        slope = (values[index + 1] - values[index]) / (time[index + 1] - time[index])
        return edges, integral[index] + inside * (values[index] + 0.5 * slope * inside)

    (low, low_integral), (high, high_integral) = integral_to(grid.steps - 0.5), integral_to(grid.steps + 0.5)
    width = high - low
    mean = np.divide(high_integral - low_integral, width, out=np.zeros(grid.count), where=width > 0.0)
    return np.asarray(np.where(width > 0.0, mean, np.interp(grid.time_s, time, values)))


# -- Airborne --

#: Input below this share of its flying level is off; below this one motors are at idle.
OFF_SHARE = 0.25
IDLE_SHARE = 0.1
#: Shortest time with the input off that shows the ground, or at idle that ends a flight [s].
OFF_FOR_S = 0.5
#: A vehicle that keeps its height for as long below this share stands on the ground at idle.
CARRIED_SHARE = 0.7
#: Least height off the ground [m].
CLEARANCE_M = 0.1
#: Until the input, over what is felt of gravity, reaches this share of its usual value after take-off, and
#: after the last time that it does, the ground carries the rest of the weight, whatever the height does.
LIFTED_SHARE = 0.9
#: Lower bound of the load factor.
LEAST_LOAD = 0.2
#: A height that is known for a smaller share of the log cannot say where the ground is.
HEIGHT_KNOWN_SHARE = 0.5
#: Left out after take-off and before landing [s].
AIRBORNE_MARGIN_S = 1.0


@dataclass(frozen=True, slots=True)
class Active:
    """Samples that a motion describes (in the air), and the rule that decided."""

    mask: Mask  # True where it does; in the air, margins left out
    rule: str  # The rule that decided, in words
    counted: Mask | None = None  # Samples of it that count; excursions end no run


def airborne_by_log(log: Recording, grid: Grid, input_level: Series) -> Active:
    """Airborne samples of a log: by its land detector, else by the input and the height it holds."""
    landed = height = None
    if "landed" in log.channels:
        on_ground, known = on_grid(log.channels["landed"], grid)
        if known.any():
            landed = (on_ground > 0.5) | ~known
            if "ground_contact" in log.channels:
                contact, measured = on_grid(log.channels["ground_contact"], grid)
                landed |= measured & (contact > 0.5)
    if "position_z" in log.channels:
        level, known = on_grid(log.channels["position_z"], grid)
        height = level if known.mean() >= HEIGHT_KNOWN_SHARE else None
    result = airborne(input_level=input_level, step_s=grid.step_s, landed=landed, height=height)
    if log.vehicle not in ("", ROTARY_WING):
        return result
    lift = input_level
    if "velocity_z" in log.channels:
        # mean level around each sample over the load factor 1 + z''/g: that of hover while only rotors lift
        velocity = on_grid(log.channels["velocity_z"], grid)[0]
        n, index = max(round(0.5 * OFF_FOR_S / grid.step_s), 1), np.arange(input_level.size)
        earlier, later = np.maximum(index - n, 0), np.minimum(index + n, input_level.size - 1)
        area, count = np.cumsum(input_level), np.maximum(later - earlier, 1)
        load = 1.0 + (velocity[later] - velocity[earlier]) / (count * grid.step_s * GRAVITY)
        lift = np.asarray((area[later] - area[earlier]) / count / np.maximum(load, LEAST_LOAD))
    return replace(result, mask=_without_spool_up(result.mask, lift, grid.step_s))


def airborne(*, input_level: Series, step_s: float, landed: Mask | None, height: Series | None) -> Active:
    """Airborne samples of a flight on its grid."""
    if landed is not None:
        # motors at idle for longer than in any flight
        level = float(np.percentile(input_level[~landed], 95)) if not landed.all() else 0.0
        flying = ~landed & ~_long_stretches(input_level < IDLE_SHARE * level, step_s)
        return Active(_without_margins(flying, step_s), "the log's land detector")
    level = float(np.percentile(input_level, 95))
    off = _long_stretches(input_level < OFF_SHARE * level, step_s)
    if level <= 0.0:
        return Active(np.zeros(off.size, dtype=np.bool_), "the input, which never rises above zero")
    if height is not None:
        usual_level = float(np.median(input_level[input_level > 0.5 * level]))
        # weak input at constant height: the ground carries the vehicle
        for stretch in stretches(_long_stretches(input_level < CARRIED_SHARE * usual_level, step_s)):
            off[stretch] |= np.ptp(height[stretch]) < CLEARANCE_M
    if off.sum() * step_s < OFF_FOR_S:
        return Active(np.ones(off.size, dtype=np.bool_), "the input, which is never off")
    if height is None:
        return Active(_without_margins(~off, step_s), "the input (no height is logged)")
    # the ground is where the vehicle is while its input is off at the ends of the log
    on = np.flatnonzero(~off)
    ends = [height[: on[0]], height[on[-1] + 1 :]] if on.size else [height]
    ground = [float(np.median(end)) for end in ends if end.size * step_s >= OFF_FOR_S]
    if not ground:
        return Active(_without_margins(~off, step_s), "the input (it is on at both ends of the log)")
    flying = ~off & (height > min(ground) + CLEARANCE_M)
    return Active(_without_margins(flying, step_s), "the input and the height above ground")


def _without_spool_up(flying: Mask, lift: Series, step_s: float) -> Mask:
    """`flying` without spooling up and down at the ends of each stretch."""
    result = flying.copy()
    margin = round(AIRBORNE_MARGIN_S / step_s)
    for stretch in stretches(flying):
        levels = lift[stretch]
        is_on = levels >= OFF_SHARE * abs(np.percentile(levels, 95))
        usual_level = float(np.median(levels[is_on])) if is_on.any() else np.inf
        lifted = np.flatnonzero(levels >= LIFTED_SHARE * usual_level)
        if stretch.start > 0 and lifted.size and lifted[0] > 0:
            result[stretch.start : stretch.start + int(lifted[0]) + margin] = False
        if stretch.stop < flying.size and lifted.size and lifted[-1] < levels.size - 1:
            result[stretch.start + int(lifted[-1]) + 1 - margin : stretch.stop] = False
    return result


def _long_stretches(mask: Mask, step_s: float) -> Mask:
    """Samples of the stretches of a mask that are half a second long or longer."""
    result = np.zeros(mask.size, dtype=np.bool_)
    for stretch in stretches(mask):
        result[stretch] = (stretch.stop - stretch.start) * step_s >= OFF_FOR_S
    return result


def _without_margins(flying: Mask, step_s: float) -> Mask:
    """`flying` shortened at each take-off and landing, but not where the log begins or ends in the air."""
    margin, index = round(AIRBORNE_MARGIN_S / step_s), np.arange(flying.size)
    grounded = np.concatenate([[0], np.cumsum(~flying)])
    earlier, later = np.maximum(index - margin, 0), np.minimum(index + margin + 1, flying.size)
    return np.asarray(grounded[later] == grounded[earlier])


def upward(recording: Recording) -> Recording:
    """Return the same recording with z up."""
    if recording.frame is Frame.Z_UP:
        return recording
    channels = recording.channels
    if isinstance(channels, MadeChannels):
        flipped: Mapping[str, Channel] = channels.changed(_flipped)
    else:
        flipped = {name: _flipped(channel) for name, channel in channels.items()}
    return replace(recording, channels=flipped, frame=Frame.Z_UP)


def _flipped(channel: Channel) -> Channel:
    known = canonical_channel(channel.name)
    return replace(channel, values=-channel.values) if known is not None and known.flipped else channel
