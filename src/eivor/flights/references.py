"""Reference channels and declared noises of a flight."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import msgspec
import numpy as np

from eivor.errors import MissingNoiseError, UsageError, did_you_mean
from eivor.flights.grid import Grid, Interpolant, Mask, Series, linear, on_grid
from eivor.signals.channels import canonical_channel, family_members, roll_pitch_yaw, unit_of
from eivor.signals.filters import lagged_between_stamps
from eivor.signals.noise import LARGEST_STD
from eivor.signals.recording import Channel, DataSheet, Recording
from eivor.signals.signals import stretches
from eivor.tools import Float

#: In place of numbers: noises are read off each channel's fastest part.
ESTIMATE = "estimate"
#: Most combs of stamps that are put on the grid to see how it thins noise.
COMBS = 24

#: Declaration of the noise of a sample: its standard deviation, or the sensor's data sheet.
Declared = float | DataSheet


class NoiseLevel(msgspec.Struct, frozen=True):
    """Noise of one channel."""

    std: float  # Standard deviation on the grid, in the channel's unit
    logged_std: float
    unit: str
    source: str = ""
    density: float = math.nan

    @property
    def sentence(self) -> str:
        """The noise in words."""
        text = f"{self.logged_std:.3g} {self.unit}".strip() + f" a sample, {self.source}"
        return text if self.std == self.logged_std else f"{text}, {self.std:.3g} on the grid"


def noise_levels(
    log: Recording,
    channels: Iterable[Channel],
    noise: Mapping[str, Declared] | str | None,
    grid_data: tuple[Grid, Mask, Mapping[str, Series]],
    between: Callable[[Channel], Interpolant],
) -> dict[str, NoiseLevel]:
    """Noise of each channel that was measured."""
    measured = {channel.name: channel for channel in channels}
    declared = _by_channel(log, measured, {} if noise is None or isinstance(noise, str) else noise)
    grid, used, values = grid_data
    levels = {}
    for name, channel in measured.items():
        source, logged = "declared", declared.get(name)
        if logged is None:
            source, logged = "by the channel map", channel.noise
        if isinstance(logged, DataSheet):
            source, logged = f"{source}, by a data sheet", logged.std(channel.rate_hz)
        if logged is None and noise == ESTIMATE and not channel.held:
            start, end = (grid.time_s[used][[0, -1]]) if used.any() else (math.inf, -math.inf)
            inside = (channel.time_s >= start) & (channel.time_s <= end) & np.isfinite(channel.values)
            source, logged = "estimated from its fastest part", white_noise_std(channel.values[inside])
        if logged is None:
            level = white_noise_std(values[name][used])
            levels[name] = NoiseLevel(level, level, unit_of(name))
        else:
            share = 1.0 if channel.held else share_left(channel, grid, used, between(channel))
            std = logged * math.sqrt(share)
            density = logged * math.sqrt(2.0 / channel.rate_hz) if channel.rate_hz else math.nan
            levels[name] = NoiseLevel(std, logged, unit_of(name), source, density)
    return levels


def _by_channel(
    log: Recording, measured: Mapping[str, Channel], noise: Mapping[str, Declared]
) -> dict[str, Declared]:
    """Declared noise by channel, that of a family for each of its members."""
    known = dict.fromkeys((*measured, *log.channels))
    declareds: dict[str, Declared] = {}
    for name, declared in noise.items():
        members = [name] if name in known else family_members(name.rstrip("*").rstrip("_"), known)
        if not members:
            expected = f"noise of channels of {log.name}"
            remedy = did_you_mean(
                name, known, "Name one that eivor inspect lists, or a family such as rotor_speed."
            )
            raise UsageError(expected, f"'{name}'", remedy)
        declareds.update(dict.fromkeys(members, declared))
    return declareds


def white_noise_std(values: Series) -> float:
    """Standard deviation of the white noise on a smooth signal; zero for fewer than four samples."""
    if values.size < 4:
        return 0.0
    third = np.diff(values, n=3)
    return float(np.median(np.abs(third)) / 0.6744897501960817 / np.sqrt(20.0))


def share_left(channel: Channel, grid: Grid, used: Mask, between: Interpolant = linear) -> float:
    """Variance on the grid of noise that is white from stamp to stamp, over its variance there."""
    if not used.any():
        return 1.0
    period = math.ceil(grid.step_s * channel.rate_hz) + 3
    offsets = np.unique(np.linspace(0, period - 1, min(period, COMBS)).round().astype(np.int64))
    position, finite = np.arange(channel.values.size) % period, np.isfinite(channel.values)
    total = 0.0
    for offset in offsets.tolist():
        comb = np.where(finite, (position == offset).astype(np.float64), np.nan)
        weights, _ = on_grid(Channel(channel.name, channel.time_s, comb, channel.unit), grid, between)
        total += float(np.mean(weights[used] ** 2))
    return total * period / offsets.size


def check_declared(needed: Iterable[tuple[Mapping[str, NoiseLevel], Sequence[str]]], method: str) -> None:
    """Refuse to estimate without the noises that a method needs."""
    words: dict[str, str] = {}
    for levels, names in needed:
        for name in names:
            level = levels.get(name)
            if level is None or not level.source:
                words[name] = f"{name} in {level.unit}" if level and level.unit else name
    if words:
        first = next(iter(words))
        raise MissingNoiseError(
            f"the measurement noise of {' and '.join(words.values())}, which {method} takes out",
            "none declared",
            f"Give it (--noise {first}=STD, a data sheet's --noise {first}=density:D,bandwidth:HZ,step:S, or "
            "a noise key in a channel map), or have it estimated: --noise estimate.",
        )


def check_noise(noise: object) -> None:
    """Refuse what is no declaration of noise."""
    if noise is None or (isinstance(noise, str) and noise == ESTIMATE):
        return
    if not isinstance(noise, Mapping):
        remedy = 'Give noise={"velocity_z": 0.02}, in SI units, or noise="estimate".'
        raise UsageError("noises by channel, or estimate", f"{noise!r}", remedy)
    for name, declared in noise.items():
        number = isinstance(declared, int | float) and not isinstance(declared, bool)
        known = isinstance(declared, DataSheet) or (number and 0.0 <= declared <= LARGEST_STD)
        if not (isinstance(name, str) and known):
            expected = f"a standard deviation of zero or more for the noise of {name!r}"
            remedy = 'Give noise={"velocity_z": 0.02}, in SI units, or a DataSheet.'
            raise UsageError(expected, f"{declared!r}", remedy)


#: A reference must be in force for this share of the samples used.
IN_FORCE_SHARE = 0.5
#: The pilot must be in control for this share of them for the stick to count.
PILOT_SHARE = 0.5
#: The largest bend of a smooth series grows fourfold with twice the time between its samples, that of a kink
#: twofold, that of a jump not at all; less than this is no smooth series.
SMOOTH_GROWTH = 2.5
#: Jumps are rare: the largest bend is this multiple of the quantile of bends at this share.
RARE, RARE_SHARE = 8.0, 0.9
#: A setpoint holds feedback where so much of its power is no slope, and so much of that what the other lacks.
LEAST_FEEDBACK, FEEDBACK_SHARE = 1e-3, 0.5
#: Fewer values have no bend over twice the time.
FEWEST_VALUES = 5
#: A reference jumps onto what is measured within twice this time [s], from farther than the least [m], by a
#: share of that distance or more, and leaves a small share of it.
RESET_S, LEAST_RESET, JUMP_SHARE, ONTO_SHARE = 0.04, 0.02, 0.8, 0.2
#: It equals what is measured where it is nearer than this share of the movement of this time [s].
EQUAL_S, EQUAL_SHARE = 0.5, 0.02
#: A reference whose standard deviation within runs is below this share of its size is constant.
CONSTANT_SHARE = 1e-6
#: The remark on such a one.
CONSTANT = "constant"


class ReferenceSource(msgspec.Struct, frozen=True):
    """A channel that a motion offers as an instrument."""

    channel: str  # Name
    #: Channel that is above one half while a pilot is in control, when alone this one counts; empty for none
    in_control: str = ""
    #: Channel that is above one half while no loop acts on this one: where it is for all samples used, this
    #: one serves alone, as others are what it was made of; else it does not count. Empty for none
    open_loop: str = ""
    #: Which of the motion's axes it moves; empty for all. What serves one axis says nothing of another.
    axis: str = ""
    #: Channel that measures what it asks for; where it is set to that, it answers the vehicle.
    measured: str = ""
    #: Reference whose slope it is, and what measures that: their difference in it answers the vehicle.
    slope_of: tuple[str, str] = ("", "")
    #: Whether loops stand between it and the axis: it serves where nothing closer that is exogenous does.
    distant: bool = False


@dataclass(frozen=True, slots=True)
class Reference:
    """One candidate instrument."""

    name: str
    usable: bool
    exogenous: bool
    remark: str
    values: Series
    logged: Series | None = None  # With what answers the vehicle; None where nothing does


def references(
    recording: Recording, sources: tuple[ReferenceSource, ...], grid: Grid, used: Mask
) -> tuple[Reference, ...]:
    """Every source in the log, judged over the samples `used`; feedback only when nothing else serves."""
    known = [source for source in sources if source.channel in recording.channels]
    known = [source for source in known if not source.open_loop or source.open_loop in recording.channels]
    judged: dict[str, Reference] = {}
    for axis in dict.fromkeys(source.axis for source in known):
        of_axis = [source for source in known if source.axis == axis]
        results = [_reference(recording, source, grid, used) for source in of_axis]
        judged.update({item.name: item for item in _preferred(results, of_axis)})
    return tuple(judged[source.channel] for source in known)


def _preferred(result: list[Reference], sources: list[ReferenceSource]) -> list[Reference]:
    """References of one axis, those that others make needless no longer usable."""
    pairs = list(zip(result, sources, strict=True))
    if any(item.usable and item.exogenous and not source.distant for item, source in pairs):
        closer = partial(replace, usable=False, remark="others act closer to the axis")
        result = [closer(item) if item.usable and source.distant else item for item, source in pairs]
    chosen, reason = [item.name for item in result if item.exogenous], "contains feedback; others serve"
    open_loop = [reference.name for reference, source in pairs if reference.usable and source.open_loop]
    if open_loop:
        chosen, reason = open_loop, f"{open_loop[0]}, which follows it openly, serves"
    elif not any(reference.usable and reference.exogenous for reference in result):
        # constant references of position leave that loop's setpoints only feedback
        upstream = [item for item, source in pairs if source.distant or source.measured]
        constant = [item.name for item in upstream if item.remark == CONSTANT]
        if not constant:
            return result
        reason = f"a loop computes it, and what that follows never moved ({constant[0]})"
    return [item if item.name in chosen else replace(item, usable=False, remark=reason) for item in result]


def _reference(recording: Recording, source: ReferenceSource, grid: Grid, used: Mask) -> Reference:
    values, in_force = on_grid(recording.channel(source.channel), grid)
    is_exogenous = exogenous(source.channel) or bool(source.open_loop)
    if all(name in recording.channels for name in source.slope_of):
        goal, measured = (on_grid(recording.channel(name), grid)[0] for name in source.slope_of)
        is_exogenous = is_exogenous and not holds_feedback(values, goal, measured, used)
    judged = partial(Reference, source.channel, exogenous=is_exogenous, values=values)
    if not used.any():
        return judged(usable=False, remark="no usable sample of flight")
    share = float(in_force[used].mean())
    if share < IN_FORCE_SHARE:
        return judged(usable=False, remark=f"in force for {share:.0%} of the flight only")
    state = source.in_control if source.in_control in recording.channels else ""
    if state and _share(recording, state, grid, used) < PILOT_SHARE:
        return judged(usable=False, remark="no pilot flies")
    openly = _share(recording, source.open_loop, grid, used) if source.open_loop else 1.0
    if openly < 1.0:
        exception = f", though for {1.0 - openly:.0%} of the flight only" if openly else ""
        return judged(usable=False, remark=f"a loop acts on it{exception}")
    spread = _spread_within_runs(values, used)
    if spread <= CONSTANT_SHARE * max(1.0, float(np.max(np.abs(values[used])))):
        return judged(usable=False, remark=CONSTANT)
    note = ", no loop acts on it" if source.open_loop else ""
    reference = judged(usable=True, remark=f"standard deviation {spread:.3g}{note}")
    return _without_resets(reference, recording.channels.get(source.measured), grid, used)


def holds_feedback(values: Series, goal: Series, measured: Series, used: Mask) -> bool:
    """Whether a setpoint, beyond the slope of another, mostly follows the other's tracking error."""
    if np.count_nonzero(used) < FEWEST_VALUES:
        return False
    columns = np.column_stack([np.ones(goal.size), np.gradient(goal), goal - measured, values])[used]
    slope, rest = np.split(columns, [2], axis=1)
    error, residual = (rest - slope @ np.linalg.lstsq(slope, rest, rcond=None)[0]).T
    size, power = float(error @ error), float(residual @ residual)
    is_slope = power <= LEAST_FEEDBACK * float(np.sum((rest[:, 1] - rest[:, 1].mean()) ** 2))
    return not is_slope and float(error @ residual) ** 2 > FEEDBACK_SHARE * size * power


def _without_resets(reference: Reference, measured: Channel | None, grid: Grid, used: Mask) -> Reference:
    """A reference without its resets to the measured value, where that is logged."""
    if measured is None:
        return reference
    values = reference.values
    coincidences = measured_resets(values, on_grid(measured, grid)[0], grid.step_s)
    resets = [reset for reset in coincidences if used[reset].any()]
    if not resets:
        return reference
    continuous = _continued(values, resets)
    if _spread_within_runs(continuous, used) <= CONSTANT_SHARE * max(1.0, float(np.abs(values[used]).max())):
        return replace(reference, usable=False, remark=f"it is the measured {measured.name}")
    times = ", ".join(f"{grid.time_s[reset.start]:.1f}" for reset in resets)
    remark = f"{reference.remark}; set to the measured {measured.name} at {times} s, which is taken out"
    return replace(reference, remark=remark, values=continuous, logged=values)


def _continued(values: Series, resets: list[slice]) -> Series:
    """Values without their changes during resets."""
    changes = np.diff(values, prepend=values[:1])
    for part in resets:
        changes[part.start + 1 : part.stop] = 0.0
    return np.asarray(values[0] + np.cumsum(changes))


def measured_resets(reference: Series, measured: Series, step_s: float) -> list[slice]:
    """Resets of a reference to its measured value: jumps onto it, or stretches where both are equal."""
    span, distance = max(round(RESET_S / step_s), 1), np.abs(reference - measured)
    coincidences = np.zeros(reference.size, dtype=np.bool_)
    if reference.size > 4 * span:
        before, after = reference[span : -3 * span], reference[3 * span : -span]
        earlier, later = before - reference[: -4 * span], reference[4 * span :] - after
        jump = np.abs(after - before - earlier - later)
        alike = np.abs(later - earlier) < JUMP_SHARE * jump  # at a kink the slope changes by more
        gap, remainder = distance[span : -3 * span], distance[3 * span : -span]
        complete = -_largest_around(-jump, span + 1) > JUMP_SHARE * gap
        onto = complete & alike & (remainder < ONTO_SHARE * gap) & (gap > LEAST_RESET)
        coincidences[2 * span : -2 * span] = onto
    width = max(round(EQUAL_S / step_s), 2)
    movement = _largest_around(measured, width) + _largest_around(-measured, width)
    equal = (_largest_around(distance, width) < EQUAL_SHARE * movement) & (movement > LEAST_RESET)
    return stretches(_largest_around(coincidences, 2 * span + 1) | _largest_around(equal, width + 3))


def _largest_around(values: np.ndarray, width: int) -> np.ndarray:
    """Moving maximum, mirrored at the ends (scipy.ndimage takes longer to import)."""
    largest, reach = np.pad(values, (width // 2, width - width // 2 - 1), mode="symmetric"), 1
    while 2 * reach <= width:
        largest, reach = np.maximum(largest[:-reach], largest[reach:]), 2 * reach
    rest = width - reach
    return np.maximum(largest[: largest.size - rest], largest[rest:])


# -- Setpoints across the ground --

#: Kinds of setpoints, and channels of what goes along and across the heading, in that order.
KINDS = ("position", "velocity", "acceleration")
HEADED = {word: tuple(f"reference_{kind}_{word}" for kind in KINDS) for word in ("forward", "left")}
#: Time constant of the slope of a position setpoint, which holds between its stamps [s].
SLOPE_S = 0.25


def with_headed_references(log: Recording) -> Recording:
    """The log with its setpoints across the ground turned forward and left by the measured heading.

    Of a position its slope: where the ground has its origin says nothing of the vehicle.
    """
    attitude = [item for part in "wxyz" if (item := log.channels.get(f"attitude_{part}")) is not None]
    if len(attitude) < 4 or len({item.time_s.tobytes() for item in attitude}) > 1:
        return log
    headings = roll_pitch_yaw(np.stack([item.values for item in attitude]))[2]
    known, channels = np.isfinite(headings), dict(log.channels)
    for number, kind in enumerate(KINDS if known.any() else ()):
        x, y = (log.channels.get(f"reference_{kind}_{axis}") for axis in "xy")
        if x is None or y is None:
            continue
        time_s, *index = np.intersect1d(x.time_s, y.time_s, return_indices=True)
        across = np.stack([x.values[index[0]], y.values[index[1]]])
        used = np.isfinite(across).all(axis=0)
        if used.sum() < FEWEST_VALUES:
            continue
        heading = np.interp(time_s[used], attitude[0].time_s[known], headings[known])
        along_x, along_y = (
            _along(log, kind, axis, time_s[used], row[used]) for axis, row in zip("xy", across, strict=True)
        )
        on_heading = np.exp(-1j * heading) * (along_x + 1j * along_y)
        for names, values in zip(HEADED.values(), (on_heading.real, on_heading.imag), strict=True):
            series, name = np.full(time_s.size, np.nan), names[number]
            series[used] = values
            channels[name] = replace(x, name=name, time_s=time_s, values=series)
    return replace(log, channels=channels)


def _along(log: Recording, kind: str, axis: str, time_s: Series, values: Series) -> Series:
    """A setpoint along an axis without feedback; of a position its slope."""

    def at_stamps(name: str) -> Series | None:
        if (channel := log.channels.get(name)) is None:
            return None
        known = np.isfinite(channel.values)
        return np.interp(time_s, channel.time_s[known], channel.values[known]) if known.any() else None

    measured = at_stamps(f"position_{axis}")
    if kind == "position":
        if measured is not None:
            values = _continued(values, measured_resets(values, measured, float(np.median(np.diff(time_s)))))
        return (values - lagged_between_stamps(values, time_s, SLOPE_S)) / SLOPE_S
    goal = at_stamps(f"reference_position_{axis}")
    if kind == "velocity" and goal is not None and measured is not None:
        values = values * (not holds_feedback(values, goal, measured, np.ones(values.size, dtype=np.bool_)))
    return values


def jumps(channel: Channel, grid: Grid, used: Mask) -> bool:
    """Whether a channel jumps, or has a kink, between two of its stamps within the samples `used`."""
    if channel.values.size < FEWEST_VALUES:
        return False
    grid_time = grid.time_s
    nearest = np.minimum(np.searchsorted(grid_time, channel.time_s), grid_time.size - 1)
    inside = used[nearest] & (np.abs(grid_time[nearest] - channel.time_s) <= 2.0 * grid.step_s)
    values = np.where(inside, channel.values, np.nan)
    for times in (channel.time_s, np.arange(values.size, dtype=np.float64)):
        over_one, over_two = (_bends(times, values, samples) for samples in (1, 2))
        if not over_two.size or over_two.max() >= SMOOTH_GROWTH * over_one.max():
            return False
        if not over_one.max() > RARE * np.quantile(over_one, RARE_SHARE):
            return False
    return True


def _bends(times: Series, values: Series, samples: int) -> Float[np.ndarray, " m"]:
    """Distances of values from the line between their neighbours at a number of samples, where known."""
    earlier, middle, later = times[: -2 * samples], times[samples:-samples], times[2 * samples :]
    share = (middle - earlier) / (later - earlier)
    line = (1.0 - share) * values[: -2 * samples] + share * values[2 * samples :]
    step = samples * float(np.median(np.diff(times)))
    bends = np.abs(values[samples:-samples] - line) * step**2 / ((middle - earlier) * (later - middle))
    return bends[np.isfinite(bends)]


def _spread_within_runs(values: Series, used: Mask) -> float:
    """Standard deviation about the mean of each run; a reference that only steps between runs has none."""
    index = np.flatnonzero(used)
    runs = np.split(index, np.flatnonzero(np.diff(index) > 1) + 1)
    deviations = np.concatenate([values[run] - values[run].mean() for run in runs])
    return float(np.sqrt(np.mean(deviations**2)))


def _share(recording: Recording, state: str, grid: Grid, used: Mask) -> float:
    values, known = on_grid(recording.channel(state), grid)
    return float((known & (values > 0.5))[used].mean())


def exogenous(name: str) -> bool:
    """Whether a channel does not answer the vehicle; of others than canonical ones the user's word counts."""
    channel = canonical_channel(name)
    return channel is None or channel.exogenous


def named_reference(recording: Recording, name: str, grid: Grid) -> Reference:
    """Any channel, taken as an instrument at the user's word."""
    values, _ = on_grid(recording.channel(name), grid)
    return Reference(name, usable=True, exogenous=exogenous(name), remark="named by the user", values=values)
