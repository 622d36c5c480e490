"""Diagnostics of excitation: conditioning and periodic input."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from eivor.inference.diagnostics.record import SIGNIFICANT, Diagnostic, EquationProducts, Row, Subject
from eivor.inference.estimating_equation import block_edges
from eivor.inference.verdict import Reason, Status
from eivor.linalg.system import symmetric_eigen
from eivor.tools import Float

PerBlock = Float[np.ndarray, " K"]
PerRow = Float[np.ndarray, " rows"]
Blocks = Float[np.ndarray, "K s"]

#: Steps of frequency in one cycle of the record, cycles in the record and blocks in a cycle from which on.
STEPS = 2
LEAST_CYCLES = 3
BLOCKS_PER_CYCLE = 3
#: Ordinates on either side that a line is held against, and how many cycles away the nearest is.
ORDINATES = 6
NEAREST = 2
#: Fewest blocks.
LEAST_BLOCKS = 32
#: Frequencies whose waves are those of the first of them, turned.
TURNED = 16


@dataclass(frozen=True, slots=True)
class Swing:
    """The strongest line of one series."""

    of: str
    unit: str
    period: float
    amplitude: float
    p_value: float  # Tail of the supremum over all frequencies

    @property
    def extent(self) -> str:
        """Amplitude and unit, in words."""
        return f"±{self.amplitude:.2g} {self.unit}".rstrip()


@dataclass(frozen=True)
class Periodicity(Diagnostic):
    """Whether the parameters, or the residual, vary periodically."""

    parameters: tuple[Swing, ...]
    left_over: tuple[Swing, ...]
    time_unit: str
    resolution: float

    @property
    def tested(self) -> tuple[Swing, ...]:
        return self.parameters + self.left_over

    @property
    def p_value(self) -> float:
        """P-value of all together, by Bonferroni's bound."""
        return min(1.0, len(self.tested) * min(item.p_value for item in self.tested))

    @property
    def speaks(self) -> bool:
        """Whether a swing is worth a word."""
        return self.p_value < SIGNIFICANT

    @property
    def strongest(self) -> Swing:
        """Swing of the smallest p-value."""
        first = min(self.tested, key=lambda item: item.p_value)
        if first in self.parameters:
            return first
        equal = self._parameters_at(1.0, [first])
        return min(equal, key=lambda item: item.p_value, default=first)

    @property
    def biased(self) -> Swing | None:
        """Parameter with a line at twice the frequency of the residual's, where an input has one, too."""
        doubled = self._parameters_at(2.0, self._significant(self.left_over))
        return min(doubled, key=lambda item: item.p_value, default=None)

    def _significant(self, swings: Sequence[Swing]) -> list[Swing]:
        return [item for item in swings if item.p_value * len(self.tested) < SIGNIFICANT]

    def _parameters_at(self, multiple: float, swings: Sequence[Swing]) -> list[Swing]:
        """Parameters with a line at a multiple of the frequency of some swing."""
        return [
            parameter
            for parameter in self._significant(self.parameters)
            for swing in swings
            if abs(1.0 / parameter.period - multiple / swing.period) <= multiple * self.resolution
        ]

    def rows(self, _subject: Subject, /) -> Iterator[Row]:
        likely = f"p-value {self.p_value:.3g}, most likely {self.strongest.of} by {self.strongest.extent}"
        line = f"period               {self.strongest.period:>10.4g}  {self.time_unit}, {likely}"
        yield Row("periodicity", "", float(len(self.tested)), self.p_value, line)
        for swing in self.tested:
            yield Row("period", swing.of, swing.period, swing.p_value)
            yield Row("swing", swing.of, swing.amplitude, swing.p_value)

    def reasons(self, _subject: Subject, /) -> Iterator[Reason]:
        if not self.speaks:
            return
        strongest = self.strongest
        period = f"with a period of {strongest.period:.3g} {self.time_unit} (p-value {self.p_value:.1g})"
        if strongest in self.left_over and self.biased is not None:
            yield Reason(
                Status.WEAK,
                f"What the model leaves over of {strongest.of} swings by {strongest.extent} {period}, as an "
                f"input does: {self.biased.of} cannot be distinguished from it.",
                "Excite at other frequencies, or record longer.",
            )
        elif strongest in self.left_over:
            yield Reason(
                Status.IDENTIFIED,
                f"What the model leaves over of {strongest.of} swings by {strongest.extent} {period}.",
                "Look for what pushes so and is not in the equation, such as a wind or a load that swings.",
            )
        else:
            remedy = "Look for what varies so, such as a supply or a load; the estimate is a mean."
            yield Reason(Status.WEAK, f"{strongest.of} varies by {strongest.extent} {period}.", remedy)


class BlockSums(msgspec.Struct, frozen=True):
    """Sums of series over successive blocks of time."""

    sums: Blocks
    times: PerBlock  # Mean time of each block
    block: float
    span: float


def block_sums(sums: Blocks, counts: PerBlock, times: PerRow | None, step: float) -> BlockSums:
    """Sums with the mean times of their blocks."""
    first = np.concatenate([[0.0], np.cumsum(counts)[:-1]])
    if times is None:
        span = step * float(counts.sum())
        return BlockSums(sums, step * (first + 0.5 * (counts - 1.0)), span / counts.size, span)
    middle = np.add.reduceat(times, first.astype(np.int64)) / counts
    # times of one axis rise: only those of several are sorted
    distinct = times.size if bool((times[1:] > times[:-1]).all()) else np.unique(times).size
    return BlockSums(sums, middle, step * times.size / counts.size, step * distinct)


def blocks_of(series: PerRow, times: PerRow | None, step: float, blocks: int) -> BlockSums:
    """Sums of one series over blocks that differ by one row at most; see `block_sums`."""
    edges = block_edges(series.size, min(blocks, series.size))
    sums = np.add.reduceat(series, edges[:-1])[:, None]
    return block_sums(sums, np.diff(edges).astype(np.float64), times, step)


def strongest_swings(
    blocks: BlockSums, named: Sequence[tuple[str, str]], weight: float = 1.0
) -> tuple[Swing, ...]:
    """Strongest line of each series; none for fewer than 32 blocks. Performs no checks."""
    if blocks.times.size < LEAST_BLOCKS:
        return ()
    # up to the ordinates around the highest frequency; waves are powers of the first, and of one further on
    cycles = STEPS * blocks.span / blocks.block
    last = min(int(0.5 * cycles), int(cycles / BLOCKS_PER_CYCLE) + STEPS * (NEAREST + ORDINATES))
    number = np.arange(STEPS // 2, last + 1)
    span = STEPS * blocks.span
    frequency, turn = number / span, -2j * np.pi * (blocks.times - blocks.times[0]) / span
    first, step, further = np.exp(np.outer([STEPS // 2, 1, TURNED], turn))
    series = first[:, None] * (blocks.sums - blocks.sums.mean(axis=0))
    turned = np.vander(step, TURNED, increasing=True)[:, :, None] * series[:, None]
    waves = np.vander(further, -(-number.size // TURNED), increasing=True).T
    spectrum = (waves @ turned.reshape(len(turned), -1)).reshape(-1, blocks.sums.shape[1])[: number.size]
    power = np.abs(spectrum) ** 2
    highest = 1.0 / (BLOCKS_PER_CYCLE * blocks.block)
    indices = np.flatnonzero((frequency >= (LEAST_CYCLES - 1e-9) / blocks.span) & (frequency <= highest))
    if not indices.size:
        return ()
    # tail of the power at each place, held against the ordinates around it, for each series
    first, count, edge = int(indices[0]), indices.size, STEPS * (NEAREST + ORDINATES)
    padded = np.zeros((len(power) + 2 * edge, power.shape[1] + 1))  # its last column counts ordinates
    padded[edge:-edge, :-1], padded[edge:-edge, -1] = power, 1.0
    distances = STEPS * np.arange(NEAREST, NEAREST + ORDINATES)
    starts = (first + edge + np.concatenate([-distances, distances])).tolist()
    neighbours, ordinates = np.split(sum(padded[start : start + count] for start in starts), [-1], axis=1)
    ratio = np.divide(power[indices], neighbours, out=np.zeros_like(neighbours), where=neighbours > 0.0)
    tails = (1.0 + ratio) ** -ordinates
    results = []
    for series, (name, unit) in enumerate(named):
        best = int(np.argmin(tails[:, series]))
        position = indices[best]
        angle = math.pi * float(frequency[position]) * blocks.block
        attenuation = math.sin(angle) / angle  # of the line, by the mean over a block
        amplitude = 2.0 * weight * float(abs(spectrum[position, series])) / attenuation
        tail = min(1.0, indices.size * float(tails[best, series]))
        results.append(Swing(name, unit, float(1.0 / frequency[position]), amplitude, tail))
    return tuple(results)


#: Variance below this share of a column's largest square is rounding: the column is constant.
VANISHING = 1e-24
#: Samples of a stretch whose spectrum is taken, how many stretches, and how many bands.
STRETCH = 4096
STRETCHES = 16
BANDS = 8
#: Condition of the scaled information from which a combination is called badly determined.
BADLY_CONDITIONED = 1e3


@dataclass(frozen=True)
class Information(Diagnostic):
    """Scaled information matrix."""

    matrix: Float[np.ndarray, "n n"]
    eigenvalues: Float[np.ndarray, " n"]
    eigenvectors: Float[np.ndarray, "n n"]  # Columns, in the order of `eigenvalues`

    @property
    def condition(self) -> float:
        """Largest over smallest eigenvalue; the square root is a ratio of standard errors."""
        smallest = float(self.eigenvalues[0])
        return float(self.eigenvalues[-1]) / smallest if smallest > 0.0 else float("inf")

    def worst(self, names: tuple[str, ...]) -> str:
        """The combination that is determined worst, in words: ``0.71 gain - 0.71 friction``."""
        v = self.eigenvectors[:, 0].round(9)  # equal parts keep their order
        v = v * np.sign(v[np.argmax(np.abs(v))])
        js = [j for j in np.argsort(-np.abs(v), kind="stable") if abs(v[j]) >= 0.1]
        text = " ".join(f"{'-' if v[j] < 0.0 else '+'} {abs(v[j]):.2f} {names[j]}" for j in js)
        return text.removeprefix("+ ")

    def rows(self, subject: Subject, /) -> Iterator[Row]:
        line = f"information          {self.condition:>10.4g}  condition; worst: {self.worst(subject.names)}"
        yield Row("information_condition", "", self.condition, None, line)

    def reasons(self, subject: Subject, /) -> Iterator[Reason]:
        if self.condition > BADLY_CONDITIONED:
            yield Reason(
                Status.WEAK,
                f"One combination of the parameters is determined {np.sqrt(self.condition):.0f} times "
                f"worse than another: {self.worst(subject.names)}, each in units of its column's rms.",
                "Excite them apart from each other, or fix one of them.",
            )


@dataclass(frozen=True)
class BandPower(Diagnostic):
    """Power of the model part against that of the residual in bands."""

    low_hz: Float[np.ndarray, " bands"]
    high_hz: Float[np.ndarray, " bands"]
    input_power: Float[np.ndarray, "bands n"]
    residual_power: Float[np.ndarray, " bands"]
    share_above: Float[np.ndarray, " n"]

    def rows(self, subject: Subject, /) -> Iterator[Row]:
        linear = subject.names[: self.share_above.size]
        for name, share in zip(linear, self.share_above, strict=True):
            if not math.isnan(share):
                line = f"power above residual {share:>10.0%}  {name}"
                yield Row("power_above", name, float(share), None, line)
        for b, (low, high) in enumerate(zip(self.low_hz, self.high_hz, strict=True)):
            for j, name in enumerate(linear):
                power, residual = float(self.input_power[b, j]), float(self.residual_power[b])
                yield Row("band_power", f"{name}, {low:.3g} to {high:.3g} Hz", power, residual)

    def reasons(self, subject: Subject, /) -> Iterator[Reason]:
        for name, share in zip(subject.names, self.share_above, strict=False):
            if share < 0.5:
                yield Reason(
                    Status.IDENTIFIED,
                    f"{1.0 - share:.0%} of what {name} contributes lies in bands where the residual is "
                    "stronger.",
                    "Excite at other frequencies, or harder.",
                )


def largest(series: PerRow) -> float:
    """Largest absolute value, without an array of them."""
    return max(float(series.max()), -float(series.min()))


def information(products: EquationProducts, *, instrumental: bool) -> Information:
    """Information about the parameters, scaled. Performs no checks."""
    matrix = products.regressor_mean
    if instrumental:
        a = products.whitening.T @ products.sensitivity
        matrix = a.T @ a
    length = np.sqrt(matrix.diagonal())
    scale = np.divide(1.0, length, out=np.zeros_like(length), where=length > 0.0)
    matrix = scale[:, None] * matrix * scale
    return Information(matrix, *symmetric_eigen(matrix))


def band_power(
    columns: Sequence[PerRow],
    factors: Sequence[float],
    residual: PerRow,
    rate_hz: float,
    squares: Sequence[float],
) -> BandPower:
    """Spectra of parts and residual in bands of equal ratio; `squares` are the parts' sums of squares."""
    length = min(STRETCH, residual.size)
    number = min(STRETCHES, residual.size // length)
    window = np.sin(np.pi * (np.arange(length) + 0.5) / length) ** 2
    bins = length // 2
    power = np.zeros((len(columns) + 1, bins))
    for start in np.linspace(0, residual.size - length, number).astype(np.int64).tolist():
        block = np.array([series[start : start + length] for series in (*columns, residual)])
        block = (block - block.mean(axis=1, keepdims=True)) * window
        spectrum = np.fft.rfft(block, axis=1)[:, 1 : bins + 1]
        power += spectrum.real**2 + spectrum.imag**2
    # one-sided, over the window's power: the bins add up to the variance (the last bin counts once)
    power *= 2.0 / (number * length * float(window @ window))
    if length % 2 == 0:
        power[:, -1] *= 0.5
    power[:-1] *= np.square(np.asarray(factors, dtype=np.float64))[:, None]
    edges = np.array(sorted({round((bins + 1.0) ** (band / BANDS)) - 1 for band in range(BANDS + 1)}))
    banded = np.add.reduceat(power, edges[:-1], axis=1).T
    above = np.where(banded[:, :-1] > banded[:, -1:], banded[:, :-1], 0.0).sum(axis=0)
    total = banded[:, :-1].sum(axis=0)
    frequency = np.arange(1, bins + 1) * (rate_hz / length)
    moving = [
        # The sum of squares is above the largest: what exceeds its share needs no search for that.
        power > VANISHING * square or power > VANISHING * (factor * largest(column)) ** 2
        for power, square, factor, column in zip(total.tolist(), squares, factors, columns, strict=True)
    ]
    return BandPower(
        frequency[edges[:-1]],
        frequency[edges[1:] - 1],
        banded[:, :-1],
        banded[:, -1],
        # A constant column, or one without a part in the model, has no spectrum to compare.
        np.divide(above, total, out=np.full_like(total, np.nan), where=np.array(moving, dtype=np.bool_)),
    )
