"""Time stamps: jitter, aliasing of the command period and the command clock."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import msgspec
import numpy as np

from eivor.errors import UsageError
from eivor.signals.filters import PAUSE, REACH, on_lines
from eivor.signals.recording import Channel, Finding, Recording
from eivor.tools import Float, Int

#: A line has so many times the power that white noise has on average, which chance reaches in no log.
LINE = 25.0
#: Lines below this frequency are clocks that drift.
SLOWEST = 0.02
#: Frequencies looked at closely beside the highest of the spectrum, and phases of the saw.
CLOSELY, PHASES = 33, 32
#: The size of the saw may be off by this share.
SIZE = 0.15
#: A distance of more medians than this is a pause.
BEATING_PAUSE = 2.5
#: Fewer stamps carry no information; so many carry enough information.
FEWEST_STAMPS, MOST_BEATING_STAMPS = 500, 6000
#: Over so many instants, pauses among them, a phase is followed.
MOST_INSTANTS = 20 * MOST_BEATING_STAMPS


def period_from_aliasing(time_s: Float[np.ndarray, " n"], shortest_s: float) -> float | None:
    """Time between two commands h_c [s] that jittering stamps beat with; None where they do not."""
    if time_s.size < FEWEST_STAMPS:
        return None
    # the number of each stamp's even instant
    distances = np.diff(time_s[:MOST_BEATING_STAMPS])
    pause = distances > BEATING_PAUSE * np.median(distances)
    whole = np.cumsum(np.where(pause, np.rint(distances / distances[~pause].mean()), 1.0))
    number = np.concatenate([[0], whole]).astype(np.int64)
    number = number[number <= MOST_INSTANTS]
    if number.size < FEWEST_STAMPS:
        return None
    logged, first = np.polyfit(number, time_s[: number.size], 1).tolist()
    away = time_s[: number.size] - first - logged * number
    beat = _line(number, away)
    if beat is None:
        return None
    most = int(logged / shortest_s)
    steps = [logged / (k + sign * beat) for k in range(1, most + 1) for sign in (-1.0, 1.0)]
    results = [(step, *_saw(number, away, logged / step)) for step in steps if shortest_s <= step < logged]
    fitting = [(power, step) for step, size, power in results if abs(size / step - 1.0) <= SIZE]
    return max(fitting)[1] if fitting else None


def _line(number: Int[np.ndarray, " n"], offsets: Float[np.ndarray, " n"]) -> float | None:
    """Frequency of the strongest line; None where none is beyond chance."""
    row = np.zeros(int(number[-1]) + 1)
    row[number] = offsets
    power = np.abs(np.fft.rfft(row)) ** 2 / float(offsets @ offsets)
    frequency = np.fft.rfftfreq(row.size)
    power[frequency < SLOWEST] = 0.0
    index = int(np.argmax(power))
    if power[index] < LINE:
        return None
    near = frequency[index] + np.linspace(-1.0, 1.0, CLOSELY) / row.size
    near = np.append(near[near < 0.5], 0.5) if near[-1] > 0.5 else near
    result = np.abs(np.exp(-2j * np.pi * np.outer(near, number)) @ offsets)
    return float(near[int(np.argmax(result))])


def _saw(number: Int[np.ndarray, " n"], away: Float[np.ndarray, " n"], turns: float) -> tuple[float, float]:
    """Amplitude [s] of a sawtooth of a frequency at its best phase, and the power that it explains."""
    phases = (np.arange(PHASES) + 0.5)[:, None] / PHASES
    saws = -np.mod(phases + np.mod(turns, 1.0) * number, 1.0)
    saws -= saws.mean(axis=1, keepdims=True)
    along, squares = saws @ away, np.sum(saws**2, axis=1)
    best = int(np.argmax(along / np.sqrt(squares)))
    return float(along[best] / squares[best]), float(along[best] ** 2 / squares[best])


#: Even stamps: the standard deviation of their distances, pauses left out, is below this share of the median.
EVEN_SHARE = 0.03
#: A distance of more medians than this is a pause.
UNEVEN_PAUSE = 3.0
#: Samples to both sides over which the slope is taken.
SLOPE_REACH = 5
#: Fewer samples carry no information.
FEWEST_SAMPLES = 100
#: Standard errors by which a coefficient must differ from one half.
DISTINCT_ERRORS = 3.0


def has_jitter(channel: Channel) -> bool:
    """Whether a channel's stamps are uneven."""
    steps = np.diff(channel.time_s)
    if steps.size < FEWEST_SAMPLES:
        return False
    steps = steps[steps <= UNEVEN_PAUSE * np.median(steps)] / np.median(steps)
    return float(np.std(steps - np.maximum(np.rint(steps), 1.0))) > EVEN_SHARE  # lost rows are whole steps


def truth_of(result: Iterable[tuple[float, float]]) -> bool | None:
    """Whether stamps are true, by the jitter estimates of channels; None if undecided."""
    selected = [(value, variance) for value, variance in result if np.isfinite(value) and variance > 0.0]
    if not selected:
        return None
    values, variances = np.array(selected).T
    weights = 1.0 / variances
    mean = float(weights @ values / weights.sum())
    return mean > 0.5 if abs(mean - 0.5) * np.sqrt(weights.sum()) > DISTINCT_ERRORS else None


def jitter_estimate(channel: Channel) -> tuple[float, float]:
    """Coefficient of a channel's regression, and its variance; NaN where its stamps are even or it rests."""
    known = np.isfinite(channel.values)
    time, values = channel.time_s[known], channel.values[known]
    if time.size < FEWEST_SAMPLES or not has_jitter(channel):
        return np.nan, np.nan
    number = np.arange(1, time.size - 1)
    low, high = np.maximum(number - SLOPE_REACH, 0), np.minimum(number + SLOPE_REACH, time.size - 1)
    curvature_of_time = _from_middle(time)
    is_even = np.abs(curvature_of_time) <= np.median(np.diff(time))
    expected = (curvature_of_time * (values[high] - values[low]) / (time[high] - time[low]))[is_even]
    value_bend = _from_middle(values)[is_even]
    power = float(expected @ expected)
    if power <= 0.0:
        return np.nan, np.nan
    value = float(expected @ value_bend) / power
    return value, float(np.sum((expected * (value_bend - value * expected)) ** 2)) / power**2


def _from_middle(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " m"]:
    return np.asarray(values[1:-1] - 0.5 * (values[:-2] + values[2:]))


#: A distance of stamps within this share of another is taken as the same.
SAME_SHARE = 0.025
#: Mean cosine of the angles that distances make on the circle of a step; 1 when all are multiples of it.
#: Chance gives 0 with a standard deviation of 1 over the root of twice their number; so many are requested.
MIN_FIT = 0.6
BEYOND_CHANCE = 3.2
#: A larger step that fits the distances as well as this is preferred.
FIT_MARGIN = 0.02
#: So small a share of distances that are no multiples of the usual one are a logger's slips.
ODD_SHARE = 0.002
#: Largest number of stamps that is read.
MOST_COMMAND_STAMPS = 20_000
#: No controller of a vehicle's height runs at shorter steps [s].
SHORTEST_STEP_S = 0.001
#: Loops of position, whose demands a faster loop follows, take at most so long for a step [s].
SLOWEST_LOOP_S = 0.020
#: A command logged more rarely [s] than this is not searched for a shorter period: the search grows with it.
RARELY_LOGGED_S = 1.0
#: Stamps rounded to a power of ten up to this are multiples of it, whatever was rounded [s].
ROUNDED_S = 0.001
#: A command that was logged at uneven steps up to this is taken as logged whenever it was issued, unless
#: other channels are logged more often [s]; also then, if theirs are uneven and its own are even.
QUICK_STEP_S = 0.0105
#: Upper end of the band of spectral rows, as a share of the rate of a log that does not hold every command: a
#: jump of the reference between two stamps moves the command by what no line between stamps has.
BAND_SHARE = 1.0 / 40.0
#: Values that repeat are those of a logger that looks what is in force: this share of them or more, each no
#: more than so many times, and in a command whose usual change is so many times its least.
REPEATED_SHARE, MOST_TIMES, USUAL_CHANGES = 0.05, 4, 20.0
#: Parts of a distance of stamps within which commands are not known to be held.
FINE_PARTS = 8
#: Largest ratio of a controller's rate to its setting.
NOMINAL = 1.2
#: Another channel is logged more often when its step is shorter than this share of the command's.
MORE_OFTEN = 0.7


class Clock(msgspec.Struct, frozen=True):
    """When a command was logged and when it was issued."""

    logged_s: float
    issued_s: float  # Time between two commands h_c that is assumed [s]
    is_known: bool = True
    looked: bool = False
    is_even: bool = False  # Stamps are even: a slower loop of the controller may run in step with them

    @property
    def locked_s(self) -> float:
        """Largest distance of a stamp from the middle of a command's hold in such a loop [s]."""
        shortest_s = self.issued_s if self.is_known else SHORTEST_STEP_S
        return 0.5 * max(min(self.logged_s, SLOWEST_LOOP_S) - shortest_s, 0.0) if self.is_even else 0.0

    @property
    def thinned(self) -> bool:
        """Commands were issued, or may have been, that the log does not hold."""
        return self.issued_s < self.logged_s

    @property
    def slack_s(self) -> float:
        """Largest error of the command's time, where the log does not show when it was issued [s]."""
        return 0.0 if self.is_known else 0.5 * self.issued_s

    def band_hz(self, band_hz: tuple[float, float]) -> tuple[float, float]:
        """Part of a band in which the line between stamps is as good as the commands [Hz]."""
        low, high = band_hz
        return (low, min(high, BAND_SHARE / self.logged_s)) if self.thinned else band_hz

    @property
    def sentence(self) -> str:
        """Treatment of commands that the log may not hold, in words."""
        logged, issued = 1e3 * self.logged_s, 1e3 * self.issued_s
        if self.looked:
            return (
                "The command's stamps are uneven and some of its values repeat: the log holds what was in "
                "force when the logger looked. The command is taken from the line between stamps."
            )
        text = f"The command is logged every {logged:.3g} ms"
        if self.is_known:
            between = "those between are taken from the line between two stamps"
            return f"{text} and was issued every {issued:.3g} ms, as its stamps determine: {between}."
        known = f"when it acts is known to ±{1e3 * self.slack_s:.2g} ms"
        text = f"{text}, and the log does not show whether more were issued: {known}."
        return f"{text} Give --controller-rate where it is known."


def check_rate(command: Channel, rate_hz: float) -> None:
    """Refuse a controller's rate [Hz] below that at which its command changes."""
    known = np.isfinite(command.values)
    steps = np.diff(command.time_s[known][1:][np.diff(command.values[known]) != 0.0])
    steps = steps[steps <= UNEVEN_PAUSE * np.median(steps)] if steps.size else steps
    if steps.size >= FEWEST_SAMPLES and rate_hz * NOMINAL * steps.mean() < 1.0:
        expected = (
            f"a controller's rate of {1.0 / steps.mean():.3g} Hz or more, at which {command.name} changes"
        )
        remedy = "Give the rate at which commands are issued; leave it out where it is not known."
        raise UsageError(expected, f"{rate_hz:g} Hz", remedy)


def known_clock(command: Channel, rate_hz: float) -> Clock:
    """Clock of a held command whose controller's rate [Hz] is known."""
    logged = float(np.median(np.diff(command.time_s)))
    issued = logged if 1.0 / rate_hz > (1.0 - SAME_SHARE) * logged else 1.0 / rate_hz
    is_even = not has_jitter(command) and (logged > RARELY_LOGGED_S or finer_step(command.time_s) is None)
    return Clock(logged, issued, is_even=is_even)


def command_clock(command: Channel, others: Iterable[Channel], issued_within_s: float = np.inf) -> Clock:
    """Read a held command's clock off its stamps, and the rates of other channels."""
    steps = np.diff(command.time_s)
    logged = float(np.median(steps))
    is_frequent = logged <= RARELY_LOGGED_S
    finer, jitter = finer_step(command.time_s) if is_frequent else None, has_jitter(command)
    if finer is None and is_frequent and jitter:
        beat = period_from_aliasing(command.time_s, SHORTEST_STEP_S)
        if beat is not None:
            return Clock(logged, beat)
    jitters, shortest, sampled_with_it = [], np.inf, False
    for channel in others:
        time_s = channel.time_s
        jitters.append(jitter_estimate(channel))
        sampled_with_it |= not channel.held and are_among(time_s, command.time_s)
        if time_s.size > 1:
            shortest = min(shortest, float(np.median(np.diff(time_s), overwrite_input=True)))
    if finer is not None and not sampled_with_it:
        return Clock(logged, finer)
    every_logged, looked_at = Clock(logged, logged), truth_of(jitters)
    jitter &= looked_at is not False or not sampled_with_it  # stamps of even rows that err
    unknown = Clock(logged, 0.5 * min(logged, issued_within_s), is_known=False, is_even=not jitter)
    multiples, quick = steps / logged, logged <= QUICK_STEP_S
    # distances are multiples of the usual one, but for a logger's slips
    is_regular = float(np.mean(np.abs(multiples - np.rint(multiples)) > SAME_SHARE)) <= ODD_SHARE
    if looked_at and quick and is_regular and not sampled_with_it:
        return every_logged
    if looked_at and jitter and _repeats(command):
        return Clock(logged, logged / FINE_PARTS, looked=True)
    # of rows at multiples of a tick the same: whether commands were issued at each is not known
    if finer is not None or (looked_at and jitter and not sampled_with_it):
        return unknown
    return every_logged if quick and shortest >= MORE_OFTEN * logged and jitter else unknown


def are_among(time_s: Float[np.ndarray, " m"], rows_s: Float[np.ndarray, " n"]) -> bool:
    """Whether stamps are those of rows, all or some of them."""
    nearest = np.minimum(np.searchsorted(rows_s, time_s), rows_s.size - 1)
    return bool(time_s.size and np.array_equal(rows_s[nearest], time_s))


def _repeats(command: Channel) -> bool:
    """Whether some values repeat, as a polling logger repeats them."""
    values = command.values[np.isfinite(command.values)]
    changes = np.abs(np.diff(values))
    nonzero = changes[changes > 0.0]
    if not nonzero.size or np.median(nonzero) < USUAL_CHANGES * nonzero.min():
        return False  # rounded values repeat by themselves
    starts = np.flatnonzero(np.concatenate([[True], changes > 0.0, [True]]))
    lengths = np.diff(starts)
    short = (lengths <= MOST_TIMES) & ~np.isin(values[starts[:-1]], (values.min(), values.max()))
    return bool(np.sum(lengths[short] - 1) >= REPEATED_SHARE * values.size)


def finer_step(time_s: Float[np.ndarray, " n"]) -> float | None:
    """Largest step of which distances of stamps are multiples, and not the usual distance; None without."""
    distances = np.diff(time_s[:MOST_COMMAND_STAMPS])
    if not distances.size:
        return None
    usual = float(np.sort(distances)[distances.size // 2])  # one of them: of two kinds the median is neither
    for _ in range(3):  # to the middle of those around it
        usual = float(distances[np.abs(distances - usual) <= SAME_SHARE * usual].mean())
    slips, limit = ODD_SHARE * distances.size, int(usual / SHORTEST_STEP_S)
    distance_off = np.abs(distances / usual - np.rint(distances / usual))
    if np.count_nonzero(distance_off * limit > 0.49) <= slips:  # of fewer parts no more distances are odd
        return None
    fits: dict[float, float] = {}
    for parts in range(2, limit + 1):
        angles = distances * (parts / usual)
        cosines = np.cos(2.0 * np.pi * angles)
        at_odd = cosines[np.rint(angles) % parts != 0]
        if at_odd.size > slips and cosines.mean() >= MIN_FIT:
            fit = float(at_odd.mean())
            if fit >= max(MIN_FIT, BEYOND_CHANCE / np.sqrt(2.0 * at_odd.size)):
                fits[usual / parts] = fit
    if not fits:
        return None
    step = next(step for step, fit in fits.items() if fit >= max(fits.values()) - FIT_MARGIN)
    # stamps that are rounded are multiples of a power of ten from zero on, whatever was rounded
    decimal = 10.0 ** round(float(np.log10(step)))
    counts = time_s / decimal
    is_decimal = decimal <= ROUNDED_S and abs(step / decimal - 1.0) <= 1e-3
    return None if is_decimal and np.abs(counts - np.rint(counts)).max() <= 1e-3 else step


def as_issued(command: Channel, clock: Clock) -> Channel:
    """Return the command with interpolated values between its stamps."""
    time, values = command.time_s, command.values
    distances = np.diff(time)
    parts = np.maximum(np.rint(distances / clock.issued_s), 1.0).astype(np.int64)
    known = np.isfinite(values)
    parts[~(known[1:] & known[:-1]) | (distances > PAUSE * clock.logged_s)] = 1
    for start, end in command.gaps():
        parts[np.searchsorted(time, start) : np.searchsorted(time, end)] = 1
    if (parts == 1).all():
        return command
    interval = np.repeat(np.arange(distances.size), parts)
    share = (np.arange(interval.size) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[interval]
    stamps = time[interval] + share * distances[interval]
    change = np.where(parts > 1, np.diff(np.nan_to_num(values)), 0.0)
    # a part holds the mean of the line over it, as long as a command was held
    held_s = 0.0 if clock.looked else clock.issued_s
    share = share + 0.5 * (1.0 / parts - held_s / distances)[interval]
    return replace(
        command,
        time_s=np.append(stamps, time[-1]),
        values=np.append(values[interval] + share * change[interval], values[-1]),
    )


#: Largest ratio of errors of distant stamps to those of neighbours.
ERROR_GROWTH_LIMIT = 1.15


def with_corrected_stamps(log: Recording) -> tuple[Recording, tuple[Finding, ...]]:
    """Log with stamps that err evened, and a finding that says so."""
    doubtful = {name: channel for name, channel in log.channels.items() if has_jitter(channel)}
    if truth_of(jitter_estimate(item) for item in doubtful.values() if not item.held) is not False:
        return log, ()
    channels, largest_s = dict(log.channels), 0.0
    for name, entry in doubtful.items():
        stamps = corrected_stamps(entry.time_s)
        if stamps is not None:
            channels[name] = replace(entry, time_s=stamps)
            largest_s = max(largest_s, float(np.std(entry.time_s - stamps)))
    if not largest_s:
        return log, ()
    text = (
        f"Samples were taken evenly, and their stamps err, by up to {1e3 * largest_s:.2g} ms (standard "
        "deviation): each is put on the line through those around it."
    )
    return replace(log, channels=channels), (Finding("erring_stamps", text),)


def corrected_stamps(time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"] | None:
    """Stamps of an even clock with their errors averaged out; None where their errors add up."""
    distances = np.diff(time_s)
    longest_s = UNEVEN_PAUSE * float(np.median(distances))
    unbroken = np.cumsum(np.concatenate([[0], distances > longest_s]))
    far = (time_s[REACH:] - time_s[:-REACH])[unbroken[REACH:] == unbroken[:-REACH]]
    if far.size < REACH or np.std(far) > ERROR_GROWTH_LIMIT * np.std(distances[distances <= longest_s]):
        return None
    stamps = on_lines(time_s, longest_s)
    return stamps if np.all(np.diff(stamps) > 0.0) else None
