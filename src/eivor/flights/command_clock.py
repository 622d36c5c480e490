"""How often a command was issued, as far as its stamps tell, and what was in force between its stamps.

A controller issues a command every h_c seconds, and it stays in force until the next. A log that keeps only
some of them, one every h_l seconds, holds each for too long: taken as it stands, the command is late by
(h_l - h_c) / 2, and the lag that is found is shorter by as much. What was issued between two stamps is best
known from both: the line between them, held for h_c at a time.

Stamps of such a log are those of a controller that runs at even steps, so they lie whole numbers of these
apart: the largest step of which all are multiples is h_c. Where the stamps are as even as a controller's own,
nothing tells h_c; it lies between nothing and h_l.

Where a logger's own instants are irregular, as the stamps of other channels tell, it would keep now one and
now another of more commands: stamps at even steps, some of them left out, are then a controller's own.

A logger may also look at times of its own and write down what is in force. Then stamps are uneven and true,
and some values stand there twice; a value was issued before its stamp, and the line between them is not late.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from eivor.flights.beating_stamps import beating_step
from eivor.flights.uneven_stamps import told_of_stamps, truth_of, uneven
from eivor.shapes import Float
from eivor.signals.recording import Channel

#: A distance of stamps within this share of another is taken as the same.
SAME = 0.025
#: Mean cosine of the angles that distances make on the circle of a step; 1 when all are multiples of it.
#: Chance gives 0 with a standard deviation of 1 over the root of twice their number; so many are asked for.
CLOSE = 0.6
BEYOND_CHANCE = 3.2
#: A larger step that fits the distances as well as this is preferred.
AS_WELL = 0.02
#: So small a share of distances that are no multiples of the usual one are a logger's slips.
ODD_SHARE = 0.002
#: So many stamps say as much as all of a day.
MOST_STAMPS = 20_000
#: No controller of a vehicle's height runs at shorter steps [s].
SHORTEST_STEP_S = 0.001
#: Stamps rounded to a power of ten up to this are multiples of it, whatever was rounded [s].
ROUNDED_S = 0.001
#: A command that was logged at steps up to this is taken as logged whenever it was issued, unless other
#: channels are logged more often [s]; also then, if theirs are uneven and its own are at even steps.
QUICK_STEP_S = 0.0105
#: Upper end of the band of spectral rows, as a share of the rate of a log that does not hold every command: a
#: jump of the reference between two stamps moves the command by what no line between stamps has.
BAND_SHARE = 1.0 / 40.0
#: Values that repeat are those of a logger that looks what is in force: this share of them or more, each no
#: more than so many times, and in a command whose usual change is so many times its least.
REPEATED_SHARE, MOST_TIMES, USUAL_CHANGES = 0.05, 4, 20.0
#: Parts of a distance of stamps in which what was issued is not known to be held.
FINE_PARTS = 8
#: Another channel is logged more often when its step is shorter than this share of the command's.
MORE_OFTEN = 0.7


@dataclass(frozen=True, slots=True)
class CommandClock:
    """When a command was logged and when it was issued.

    Parameters
    ----------
    logged_s : float
        Median distance of its stamps h_l [s].
    issued_s : float
        Time between two commands h_c that is assumed [s]: `logged_s` for a log that holds every command.
    told : bool
        The log tells it; else it lies between zero and the longest that it can be, of which half is assumed.
    looked : bool
        The log holds what was in force when the logger looked, which may have been issued some time before.
    """

    logged_s: float
    issued_s: float
    told: bool = True
    looked: bool = False

    @property
    def thinned(self) -> bool:
        """Commands were issued, or may have been, that the log does not hold."""
        return self.issued_s < self.logged_s

    @property
    def slack_s(self) -> float:
        """What the command may be late or early by, since the log does not tell when it was issued [s]."""
        return 0.0 if self.told else 0.5 * self.issued_s

    def band_hz(self, band_hz: tuple[float, float]) -> tuple[float, float]:
        """Part of a band in which the line between stamps is as good as the commands [Hz]."""
        low, high = band_hz
        return (low, min(high, BAND_SHARE / self.logged_s)) if self.thinned else band_hz

    @property
    def sentence(self) -> str:
        """What is done about commands that the log may not hold."""
        logged, issued = 1e3 * self.logged_s, 1e3 * self.issued_s
        if self.looked:
            return (
                "The command's stamps are uneven and some of its values repeat: the log holds what was in "
                "force when the logger looked, and the command is taken from the line between stamps."
            )
        if self.told:
            return (
                f"The command is logged every {logged:.3g} ms and was issued every {issued:.3g} ms, as its "
                "stamps tell: those between are taken from the line between two stamps."
            )
        return (
            f"The command is logged every {logged:.3g} ms, and the log does not tell whether more were "
            f"issued: the lag may be {1e3 * self.slack_s:.2g} ms longer or shorter."
        )


@dataclass(frozen=True, slots=True)
class _Witness:
    """What another channel tells of a command's clock.

    Parameters
    ----------
    told : tuple of float
        See `told_of_stamps`.
    step_s : float
        Median distance of its stamps [s], infinite where it has none.
    sampled_with_it : bool
        It is sampled, and has the command's stamps.
    """

    told: tuple[float, float]
    step_s: float
    sampled_with_it: bool

    @classmethod
    def of(cls, other: Channel, command: Channel) -> _Witness:
        """Look at a channel."""
        time_s = other.time_s
        step_s = float(np.median(np.diff(time_s), overwrite_input=True)) if time_s.size > 1 else np.inf
        with_it = not other.held and np.array_equal(time_s, command.time_s)
        return cls(told_of_stamps(other), step_s, with_it)


def command_clock(
    command: Channel, others: Iterable[Channel], issued_within_s: float = np.inf
) -> CommandClock:
    """Read a held command's clock off its stamps, and the rates of other channels.

    Parameters
    ----------
    command : Channel
        With two samples or more.
    others : iterable of Channel
        What else was logged of the flight; looked at once, one after the other.
    issued_within_s : float
        The longest that the next command can be waited for [s], where stamps do not tell.
    """
    steps = np.diff(command.time_s)
    logged = float(np.median(steps))
    finer = finer_step(command.time_s)
    if finer is None and uneven(command):
        finer = beating_step(command.time_s, SHORTEST_STEP_S)
    if finer is not None:
        return CommandClock(logged, finer)
    seen = [_Witness.of(one, command) for one in others]
    looked_at = truth_of(one.told for one in seen)
    if looked_at and logged <= QUICK_STEP_S and _multiples(steps, logged):
        return CommandClock(logged, logged)
    if looked_at and uneven(command):
        if _repeats(command):
            return CommandClock(logged, logged / FINE_PARTS, looked=True)
        if not any(one.sampled_with_it for one in seen):
            return CommandClock(logged, 0.5 * min(logged, issued_within_s), told=False)
    quickest = min((one.step_s for one in seen), default=np.inf)
    if logged <= QUICK_STEP_S and quickest >= MORE_OFTEN * logged:
        return CommandClock(logged, logged)
    return CommandClock(logged, 0.5 * min(logged, issued_within_s), told=False)


def _multiples(steps: Float[np.ndarray, " n"], usual: float) -> bool:
    """Whether distances are multiples of the usual one, but for a logger's slips."""
    turns = steps / usual
    return float(np.mean(np.abs(turns - np.rint(turns)) > SAME)) <= ODD_SHARE


def _repeats(command: Channel) -> bool:
    """Whether values repeat now and then, as those do that a logger looks at twice."""
    values = command.values[np.isfinite(command.values)]
    changes = np.abs(np.diff(values))
    moved = changes[changes > 0.0]
    if not moved.size or np.median(moved) < USUAL_CHANGES * moved.min():
        return False  # rounded values repeat by themselves
    same = np.flatnonzero(np.concatenate([[True], changes > 0.0, [True]]))
    times = np.diff(same)
    limits = (values.min(), values.max())
    few = (times <= MOST_TIMES) & ~np.isin(values[same[:-1]], limits)
    return bool(np.sum(times[few] - 1) >= REPEATED_SHARE * values.size)


def finer_step(time_s: Float[np.ndarray, " n"]) -> float | None:
    """Largest step of which distances of stamps are multiples, and not the usual distance; None without.

    Notes
    -----
    The usual distance is a multiple of it, so that only its parts are tried: h = usual / k. Distances d lie
    on the circle of a step at the angles 2 pi d / h, which are zero where it is theirs, and jitter about zero
    where stamps do. Only those that are no multiples of the usual distance tell that the step is finer.
    """
    distances = np.diff(time_s[:MOST_STAMPS])
    if not distances.size:
        return None
    usual = float(np.sort(distances)[distances.size // 2])  # one of them: of two kinds the median is neither
    for _ in range(3):  # to the middle of those around it
        usual = float(distances[np.abs(distances - usual) <= SAME * usual].mean())
    fewest = ODD_SHARE * distances.size
    fits: dict[float, float] = {}
    for parts in range(2, int(usual / SHORTEST_STEP_S) + 1):
        turns = distances * (parts / usual)
        near = np.cos(2.0 * np.pi * turns)
        odd = near[np.rint(turns) % parts != 0]
        if odd.size > fewest and near.mean() >= CLOSE:
            fit = float(odd.mean())
            if fit >= max(CLOSE, BEYOND_CHANCE / np.sqrt(2.0 * odd.size)):
                fits[usual / parts] = fit
    best = max(fits.values(), default=0.0)
    step = next((step for step, fit in fits.items() if fit >= best - AS_WELL), None)
    return None if step is None or _rounded(time_s, step) else step


def _rounded(time_s: Float[np.ndarray, " n"], step: float) -> bool:
    """Whether stamps are multiples of a step for being rounded to it: to a power of ten, and from zero on."""
    tenth = 10.0 ** round(float(np.log10(step)))
    if tenth > ROUNDED_S or abs(step / tenth - 1.0) > 1e-3:
        return False
    away = time_s / tenth
    return bool(np.abs(away - np.rint(away)).max() <= 1e-3)


def as_issued(command: Channel, clock: CommandClock) -> Channel:
    """Return the command with what was issued between its stamps: the line between them, held h_c at a time.

    Gaps, and what lies beside missing values, stay as they are.
    """
    time, values = command.time_s, command.values
    distances = np.diff(time)
    parts = np.maximum(np.rint(distances / clock.issued_s), 1.0).astype(np.int64)
    known = np.isfinite(values)
    parts[~(known[1:] & known[:-1])] = 1
    for start, end in command.gaps():
        parts[np.searchsorted(time, start) : np.searchsorted(time, end)] = 1
    if (parts == 1).all():
        return command
    begins = np.repeat(np.arange(distances.size), parts)
    share = (np.arange(begins.size) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[begins]
    between = time[begins] + share * distances[begins]
    rise = np.where(parts > 1, np.diff(np.nan_to_num(values)), 0.0)
    if clock.looked:
        share = share + 0.5 / parts[begins]  # the line's mean over the part, not its value at the beginning
    return replace(
        command,
        time_s=np.append(between, time[-1]),
        values=np.append(values[begins] + share * rise[begins], values[-1]),
    )
