"""References: what the vehicle was asked to do, and which of it may serve as an instrument.

A reference is usable when it does not answer the vehicle: a position setpoint; velocity and acceleration
feed-forward of a trajectory; the pilot's throttle while a pilot flies. The velocity setpoint that a
position loop computes contains feedback; it is used only when nothing else varies, and never gives more
than a weak verdict.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from eivor.flights.grid import Grid, on_grid
from eivor.shapes import Bool, Float
from eivor.signals.canonical import canonical_channel
from eivor.signals.recording import Channel, Recording

#: A reference must be in force for this share of the samples used.
IN_FORCE_SHARE = 0.5
#: The pilot must be in control for this share of them for the stick to count.
PILOT_SHARE = 0.5
#: The largest bend of a smooth series grows fourfold with twice the time between its samples, that of a kink
#: twofold, that of a jump not at all; less than this is no smooth series.
SMOOTH_GROWTH = 2.5
#: Jumps are few: the largest bend is so many times that which nine bends out of ten stay below.
RARE, RARE_SHARE = 8.0, 0.9
#: Fewer values have no bend over twice the time.
FEWEST_VALUES = 5
#: A reference whose standard deviation within runs is below this share of its size is constant.
CONSTANT_SHARE = 1e-6
#: The remark on such a one.
CONSTANT = "constant"


@dataclass(frozen=True, slots=True)
class ReferenceSource:
    """A channel that a motion offers as an instrument.

    One that answers the vehicle (it is not exogenous in the table of channels), such as a setpoint that a
    loop computes from the vehicle's state, serves only when nothing else varies.

    Parameters
    ----------
    channel : str
        Name.
    in_control : str
        Channel that is above one half while a pilot is in control, without which this one does not count;
        empty for none. A log without that channel is taken as flown by a pilot throughout.
    open_loop : str
        Channel that is above one half while no loop acts on this one, which does not answer the vehicle then.
        It counts only where that channel says so of every sample used, and then it serves alone: others are
        what it was made of. Empty for a channel whose nature does not change.
    axis : str
        Which of the motion's axes it moves; empty for all. What serves one axis says nothing of another.
    """

    channel: str
    in_control: str = ""
    open_loop: str = ""
    axis: str = ""


@dataclass(frozen=True, slots=True)
class Reference:
    """One candidate instrument.

    Parameters
    ----------
    name : str
        Channel.
    usable : bool
        It may serve as an instrument.
    exogenous : bool
        It does not answer the vehicle.
    remark : str
        Why not, or how much it moves.
    values : ndarray, shape (n,)
        On the flight's grid, filled where it is not in force.
    """

    name: str
    usable: bool
    exogenous: bool
    remark: str
    values: Float[np.ndarray, " n"]

    @property
    def constant(self) -> bool:
        """It is logged, and does not vary."""
        return self.remark == CONSTANT


def references(
    recording: Recording, sources: tuple[ReferenceSource, ...], grid: Grid, used: Bool[np.ndarray, " n"]
) -> tuple[Reference, ...]:
    """Every source in the log, judged over the samples `used`; feedback only when nothing else serves."""
    offered = [source for source in sources if source.channel in recording.channels]
    offered = [source for source in offered if not source.open_loop or source.open_loop in recording.channels]
    judged: dict[str, Reference] = {}
    for axis in dict.fromkeys(source.axis for source in offered):
        of_axis = [source for source in offered if source.axis == axis]
        found = [_reference(recording, source, grid, used) for source in of_axis]
        judged.update({one.name: one for one in _preferred(found, of_axis)})
    return tuple(judged[source.channel] for source in offered)


def _preferred(found: list[Reference], sources: list[ReferenceSource]) -> list[Reference]:
    """References of one axis, those that others make needless no longer usable."""
    alone = [
        reference.name
        for reference, source in zip(found, sources, strict=True)
        if reference.usable and source.open_loop
    ]
    if alone:
        return [
            reference
            if reference.name in alone
            else replace(reference, usable=False, remark=f"{alone[0]}, which follows it openly, serves")
            for reference in found
        ]
    if any(reference.usable and reference.exogenous for reference in found):
        return [
            reference
            if reference.exogenous
            else replace(reference, usable=False, remark="contains feedback; others serve")
            for reference in found
        ]
    return found


def _reference(
    recording: Recording, source: ReferenceSource, grid: Grid, used: Bool[np.ndarray, " n"]
) -> Reference:
    values, in_force = on_grid(recording.channel(source.channel), grid)
    clean = exogenous(source.channel) or bool(source.open_loop)
    judged = partial(Reference, source.channel, exogenous=clean, values=values)
    if not used.any():
        return judged(usable=False, remark="no usable sample of flight")
    share = float(in_force[used].mean())
    if share < IN_FORCE_SHARE:
        return judged(usable=False, remark=f"in force for {share:.0%} of the flight only")
    if source.in_control and not _pilot_flies(recording, source.in_control, grid, used):
        return judged(usable=False, remark="no pilot flies")
    openly = _share(recording, source.open_loop, grid, used) if source.open_loop else 0.0
    if source.open_loop and openly < 1.0:
        elsewhere = f", though for {1.0 - openly:.0%} of the flight only" if openly else ""
        return judged(usable=False, remark=f"a loop acts on it{elsewhere}")
    spread = _spread_within_runs(values, used)
    if spread <= CONSTANT_SHARE * max(1.0, float(np.max(np.abs(values[used])))):
        return judged(usable=False, remark=CONSTANT)
    why = ", no loop acts on it" if source.open_loop else ""
    return judged(usable=True, remark=f"standard deviation {spread:.3g}{why}")


def jumps(channel: Channel, grid: Grid, used: Bool[np.ndarray, " n"]) -> bool:
    """Whether a channel jumps, or has a kink, between two of its stamps within the samples `used`.

    Stamps may be uneven, or err: what is smooth against stamps, or against the samples' numbers, is smooth.
    """
    if channel.values.size < FEWEST_VALUES:
        return False
    times = grid.time_s
    nearest = np.minimum(np.searchsorted(times, channel.time_s), times.size - 1)
    within = used[nearest] & (np.abs(times[nearest] - channel.time_s) <= 2.0 * grid.step_s)
    values = np.where(within, channel.values, np.nan)
    numbers = np.arange(values.size, dtype=np.float64)
    return all(_jumps(at, values) for at in (channel.time_s, numbers))


def _jumps(at: Float[np.ndarray, " n"], values: Float[np.ndarray, " n"]) -> bool:
    over_one, over_two = (_bends(at, values, samples) for samples in (1, 2))
    if not over_two.size:
        return False
    largest = over_one.max()
    smooth = over_two.max() >= SMOOTH_GROWTH * largest
    return bool(not smooth and largest > RARE * np.quantile(over_one, RARE_SHARE))


def _bends(
    at: Float[np.ndarray, " n"], values: Float[np.ndarray, " n"], samples: int
) -> Float[np.ndarray, " m"]:
    """Distances of values from the line between those so many samples before and after them, where known.

    Of uneven stamps each is that of even ones: for a second derivative a it is a (samples h)^2 / 2.
    """
    before, middle, after = at[: -2 * samples], at[samples:-samples], at[2 * samples :]
    share = (middle - before) / (after - before)
    line = (1.0 - share) * values[: -2 * samples] + share * values[2 * samples :]
    even = samples * float(np.median(np.diff(at)))
    bends = np.abs(values[samples:-samples] - line) * even**2 / ((middle - before) * (after - middle))
    return bends[np.isfinite(bends)]


def _spread_within_runs(values: Float[np.ndarray, " n"], used: Bool[np.ndarray, " n"]) -> float:
    """Standard deviation about the mean of each run; a reference that only steps between runs has none."""
    index = np.flatnonzero(used)
    runs = np.split(index, np.flatnonzero(np.diff(index) > 1) + 1)
    deviations = np.concatenate([values[run] - values[run].mean() for run in runs])
    return float(np.sqrt(np.mean(deviations**2)))


def _pilot_flies(recording: Recording, in_control: str, grid: Grid, used: Bool[np.ndarray, " n"]) -> bool:
    return in_control not in recording.channels or _share(recording, in_control, grid, used) >= PILOT_SHARE


def _share(recording: Recording, state: str, grid: Grid, used: Bool[np.ndarray, " n"]) -> float:
    """Share of the samples used in which a state is on."""
    values, known = on_grid(recording.channel(state), grid)
    return float((known & (values > 0.5))[used].mean())


def exogenous(name: str) -> bool:
    """Whether a channel does not answer the vehicle; of others than canonical ones the user's word counts."""
    channel = canonical_channel(name)
    return channel is None or channel.exogenous


def named_reference(recording: Recording, name: str, grid: Grid) -> Reference:
    """Any channel, taken as an instrument at the user's word.

    Raises
    ------
    MissingChannelError
        When the log does not have it.
    """
    values, _ = on_grid(recording.channel(name), grid)
    return Reference(name, usable=True, exogenous=exogenous(name), remark="named by the user", values=values)
