"""Whether parameters, or what the model leaves over, vary periodically: score tests at many frequencies.

If a parameter is theta + a cos(w t + p), its influences M^-1 s_t, which add up to the parameter's deviation,
have a line at w of the amplitude a. So has the residual, where something that the model does not know pushes
periodically, such as a wind: a variation of the intercept. Series are summed over K blocks of time, and the
line at a frequency f is held against the series' own spectrum beside it: with x the power at f over the mean
of m ordinates around it, far enough from f and from each other to be independent,

    P(X > x) = (1 + x / m)^-m,

as of powers that are exponential in a spectrum that is smooth over those ordinates; autocorrelation of the
scores is in them. The supremum is over frequencies from three cycles in the record, in steps of half a cycle,
to one cycle in three blocks. By Bonferroni's bound the smallest of J such tails counts J-fold, which needs no
table.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from eivor.inference.diagnostics.diagnostic import SIGNIFICANT, Diagnostic, Row, Subject
from eivor.inference.products import block_edges
from eivor.inference.verdict import Reason, Status
from eivor.shapes import Float, Int

#: Steps of frequency in one cycle of the record, cycles in the record and blocks in a cycle from which on.
STEPS = 2
LEAST_CYCLES = 3
BLOCKS_PER_CYCLE = 3
#: Ordinates on either side that a line is held against, and how many cycles away the nearest is.
ORDINATES = 6
NEAREST = 2
#: Fewest blocks.
LEAST_BLOCKS = 32


@dataclass(frozen=True, slots=True)
class Swing:
    """The strongest line of one series.

    Parameters
    ----------
    of, unit : str
        Name of a parameter, or of what is left over, and its unit.
    period : float
        In the unit of time.
    amplitude : float
        Half of what it varies by.
    p_value : float
        Tail of the supremum over all frequencies.
    """

    of: str
    unit: str
    period: float
    amplitude: float
    p_value: float

    @property
    def extent(self) -> str:
        """By how much it varies, in words."""
        return f"±{self.amplitude:.2g} {self.unit}".rstrip()


@dataclass(frozen=True)
class Periodicity(Diagnostic):
    """Whether the parameters, or what is left over, vary periodically.

    Parameters
    ----------
    parameters : tuple of Swing
        Of each joint parameter.
    left_over : tuple of Swing
        Of each residual in time.
    time_unit : str
        Of the periods.
    resolution : float
        Smallest difference of frequencies that is told, cycles per unit of time.
    """

    parameters: tuple[Swing, ...]
    left_over: tuple[Swing, ...]
    time_unit: str
    resolution: float

    @property
    def tested(self) -> tuple[Swing, ...]:
        """All that were tested."""
        return self.parameters + self.left_over

    @property
    def p_value(self) -> float:
        """Of all together, by Bonferroni's bound."""
        return min(1.0, len(self.tested) * min(one.p_value for one in self.tested))

    @property
    def speaks(self) -> bool:
        """Whether a swing is worth a word."""
        return self.p_value < SIGNIFICANT

    @property
    def strongest(self) -> Swing:
        """What varies: the one of the smallest p-value.

        Where that is something left over, and a parameter varies beyond doubt with the same period, it is
        the parameter: a gain that varies also pushes.
        """
        first = min(self.tested, key=lambda one: one.p_value)
        if first in self.parameters:
            return first
        alike = (
            one
            for one in self.parameters
            if one.p_value * len(self.tested) < SIGNIFICANT
            and abs(1.0 / one.period - 1.0 / first.period) <= self.resolution
        )
        return min(alike, key=lambda one: one.p_value, default=first)

    def rows(self, _of: Subject, /) -> Iterator[Row]:
        """How many were tested with the p-value of all, and period and amplitude of each."""
        yield Row("periodicity", "", float(len(self.tested)), self.p_value)
        for one in self.tested:
            yield Row("period", one.of, one.period, one.p_value)
            yield Row("swing", one.of, one.amplitude, one.p_value)

    def lines(self, _of: Subject, /) -> Iterator[str]:
        """The likeliest period."""
        one = self.strongest
        likely = f"p-value {self.p_value:.3g}, most likely {one.of} by {one.extent}"
        yield f"period               {one.period:>10.4g}  {self.time_unit}, {likely}"

    def reasons(self, _of: Subject, /) -> Iterator[Reason]:
        """What varies periodically."""
        if not self.speaks:
            return
        one = self.strongest
        period = f"with a period of {one.period:.3g} {self.time_unit} (p-value {self.p_value:.1g})"
        if one in self.left_over:
            yield Reason(
                Status.IDENTIFIED,
                f"What the model leaves over of {one.of} swings by {one.extent} {period}.",
                "Look for what pushes so and is not in the equation, such as a wind or a load that swings.",
            )
        else:
            yield Reason(
                Status.WEAK,
                f"{one.of} varies by {one.extent} {period}.",
                "Look for what varies so, such as a supply or a load; the estimate is a mean.",
            )


@dataclass(frozen=True)
class BlockSums:
    """Sums of series over successive blocks of time.

    Parameters
    ----------
    sums : ndarray, shape (K, s)
        The sums.
    times : ndarray, shape (K,)
        Mean time of each block.
    block, span : float
        Time that one block is of, and that all are of, gaps not counted; several axes are of one time.
    """

    sums: Float[np.ndarray, "K s"]
    times: Float[np.ndarray, " K"]
    block: float
    span: float


def block_sums(
    sums: Float[np.ndarray, "K s"],
    counts: Float[np.ndarray, " K"],
    times: Float[np.ndarray, " rows"] | None,
    step: float,
) -> BlockSums:
    """Sums that are made, with the times that they are of.

    Parameters
    ----------
    sums : ndarray, shape (K, s)
        The sums.
    counts : ndarray, shape (K,)
        Rows in each block.
    times : ndarray, shape (rows,), or None
        Time of each row; None for rows one step apart.
    step : float
        Time that one row is of.
    """
    first = np.concatenate([[0.0], np.cumsum(counts)[:-1]])
    if times is None:
        span = step * float(counts.sum())
        return BlockSums(sums, step * (first + 0.5 * (counts - 1.0)), span / counts.size, span)
    middle = np.add.reduceat(times, first.astype(np.int64)) / counts
    # times of one axis rise: only those of several are sorted
    distinct = times.size if bool((times[1:] > times[:-1]).all()) else np.unique(times).size
    return BlockSums(sums, middle, step * times.size / counts.size, step * distinct)


def blocks_of(
    series: Float[np.ndarray, " rows"], times: Float[np.ndarray, " rows"] | None, step: float, blocks: int
) -> BlockSums:
    """Sums of one series over blocks that differ by one row at most; see `block_sums`."""
    edges = block_edges(series.size, min(blocks, series.size))
    sums = np.add.reduceat(series, edges[:-1])[:, None]
    return block_sums(sums, np.diff(edges).astype(np.float64), times, step)


def strongest_swings(
    of: BlockSums, named: Sequence[tuple[str, str]], weight: float = 1.0
) -> tuple[Swing, ...]:
    """Strongest line of each series; none for fewer than 32 blocks. Performs no checks.

    Parameters
    ----------
    of : BlockSums
        The series.
    named : sequence of tuple of two str
        Name and unit of each.
    weight : float
        By which the sum over all blocks is multiplied to give a mean: 1 for influences, which add up to a
        deviation of the parameter, and one over the rows for a residual.
    """
    if of.times.size < LEAST_BLOCKS:
        return ()
    frequency = np.arange(STEPS // 2, int(0.5 * STEPS * of.span / of.block) + 1) / (STEPS * of.span)
    waves = np.exp(-2j * np.pi * np.outer(frequency, of.times - of.times[0]))
    spectrum = waves @ (of.sums - of.sums.mean(axis=0))
    power = np.abs(spectrum) ** 2
    highest = 1.0 / (BLOCKS_PER_CYCLE * of.block)
    sought = np.flatnonzero((frequency >= (LEAST_CYCLES - 1e-9) / of.span) & (frequency <= highest))
    if not sought.size:
        return ()
    tails = _tails(power, sought)
    found = []
    for series, (name, unit) in enumerate(named):
        best = int(np.argmin(tails[:, series]))
        place = sought[best]
        left = float(np.sinc(frequency[place] * of.block))  # what the mean over a block leaves of the line
        amplitude = 2.0 * weight * float(abs(spectrum[place, series])) / left
        tail = min(1.0, sought.size * float(tails[best, series]))
        found.append(Swing(name, unit, float(1.0 / frequency[place]), amplitude, tail))
    return tuple(found)


def _tails(power: Float[np.ndarray, "F s"], places: Int[np.ndarray, " J"]) -> Float[np.ndarray, "J s"]:
    """Tail of the power at each place, held against the ordinates around it, for each series."""
    away = STEPS * np.arange(NEAREST, NEAREST + ORDINATES)
    around = places[:, None] + np.concatenate([-away, away])
    inside = (around >= 0) & (around < power.shape[0])
    ordinates = inside.sum(axis=1)[:, None]
    beside = np.where(inside[:, :, None], power[np.where(inside, around, 0)], 0.0).sum(axis=1)
    ratio = np.divide(power[places], beside, out=np.zeros_like(beside), where=beside > 0.0)
    return np.asarray((1.0 + ratio) ** -ordinates.astype(np.float64))
