"""Block bootstrap replicates."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from eivor import checks
from eivor.errors import UsageError
from eivor.inference.distributions import normal_quantile, t_quantile
from eivor.tools import Float, Int

#: A block starts at one of at least so many places within a block's length, where rows allow it.
STEPS_PER_BLOCK = 8
#: With at most so many atoms each row is one.
FINEST_ATOMS = 4096
#: Autocorrelations below so many standard errors are taken for zero (Politis and White 2004).
NEGLIGIBLE = 2.0


class BlockScheme(StrEnum):
    """How blocks are drawn."""

    CIRCULAR = "circular"
    """Blocks of one length, the record joined end to start."""
    MOVING = "moving"
    """Blocks of one length inside the record; its ends are drawn less often."""
    STATIONARY = "stationary"
    """Blocks of random, geometric length on the circle (Politis and Romano 1994)."""


@dataclass(frozen=True, slots=True)
class BlockPlan:
    """Rows in atoms, and atoms in blocks."""

    rows: int
    blocks: int
    steps: int  # Atoms of a block
    scheme: BlockScheme = BlockScheme.CIRCULAR

    @property
    def atoms(self) -> int:
        """Atoms of the record, and of every replicate."""
        return self.blocks * self.steps

    @property
    def block_length(self) -> float:
        """Rows of a block, the mean when lengths are random."""
        return self.rows / self.blocks

    @property
    def bounds(self) -> Int[np.ndarray, " atoms_plus_1"]:
        """First row of each atom, and the number of rows."""
        return np.arange(self.atoms + 1) * self.rows // self.atoms

    @property
    def span(self) -> int:
        """Atoms of a piece, which replicates are put together from: a block, or an atom when lengths vary."""
        return 1 if self.scheme is BlockScheme.STATIONARY else self.steps

    @property
    def pieces(self) -> int:
        """Pieces that may be drawn: piece i begins with atom i."""
        return self.atoms - self.steps + 1 if self.scheme is BlockScheme.MOVING else self.atoms

    def drawn(self, random: np.random.Generator) -> Int[np.ndarray, " k"]:
        """Pieces of one replicate, in its order."""
        if self.scheme is not BlockScheme.STATIONARY:
            return random.integers(0, self.pieces, self.blocks)
        begins = random.random(self.atoms) < 1.0 / self.steps
        begins[0] = True
        first = random.integers(0, self.atoms, int(begins.sum()))
        block = np.cumsum(begins) - 1
        within = np.arange(self.atoms) - np.flatnonzero(begins)[block]
        return np.asarray((first[block] + within) % self.atoms)


def block_plan(rows: int, length: float, scheme: BlockScheme = BlockScheme.CIRCULAR) -> BlockPlan:
    """Plan with blocks of about `length` rows, so many that they fill the record."""
    blocks = min(max(round(rows / length), 1), rows)
    steps = min(rows // blocks, max(STEPS_PER_BLOCK, FINEST_ATOMS // blocks))
    return BlockPlan(rows, blocks, steps, scheme)


def automatic_block_length(
    series: Float[np.ndarray, "rows n"], scheme: BlockScheme = BlockScheme.CIRCULAR
) -> float:
    """Block length that makes the variance of a mean most accurate, for the most persistent series."""
    rows = series.shape[0]
    longest = min(3.0 * math.sqrt(rows), rows / 3.0)
    centred = series - series.mean(axis=0)
    lengths = [_optimal_length(column, scheme) for column in centred.T]
    return float(np.clip(max(lengths, default=1.0), 1.0, max(longest, 1.0)))


def _optimal_length(series: Float[np.ndarray, " rows"], scheme: BlockScheme) -> float:
    rows = series.size
    quiet = max(5, math.ceil(math.sqrt(math.log10(rows)))) if rows > 1 else 5
    reach = min(math.ceil(math.sqrt(rows)) + quiet, rows - 1)
    R = autocovariance(series, reach)
    if not R[0] > 0.0 or reach < 1:
        return 1.0
    small = np.abs(R[1:] / R[0]) < NEGLIGIBLE * math.sqrt(math.log10(rows) / rows)
    # first lag that is followed by `quiet` negligible ones; else the last one that is not negligible
    in_a_row = np.convolve(small, np.ones(quiet), mode="valid") if small.size >= quiet else np.empty(0)
    indices = np.flatnonzero(in_a_row == quiet)
    after = int(indices[0]) if indices.size else int(np.flatnonzero(~small)[-1] + 1 if (~small).any() else 0)
    lags = np.arange(min(2 * max(after, 1), reach) + 1)
    window = np.minimum(1.0, 2.0 * (1.0 - lags / (2 * max(after, 1))))
    weighted = window * R[: lags.size]
    g = float(2.0 * weighted.sum() - weighted[0])
    G = float(2.0 * (lags * weighted).sum())
    D = (2.0 if scheme is BlockScheme.STATIONARY else 4.0 / 3.0) * g * g
    return (2.0 * G * G / D * rows) ** (1.0 / 3.0) if D > 0.0 else 1.0


def autocovariance(series: Float[np.ndarray, " rows"], lags: int) -> Float[np.ndarray, " lags_plus_1"]:
    """Mean products of a centred series with itself, divided by its length, at lags 0 to `lags`."""
    size = 1 << (2 * series.size - 1).bit_length()
    spectrum = np.abs(np.fft.rfft(series, size)) ** 2
    products: Float[np.ndarray, " lags_plus_1"] = np.fft.irfft(spectrum, size)[: lags + 1]
    return products / series.size


def piece_sums(
    atom_sums: Float[np.ndarray, "atoms *columns"], plan: BlockPlan
) -> Float[np.ndarray, "pieces *columns"]:
    """Sums over the atoms of each piece."""
    wrapped = np.concatenate([atom_sums, atom_sums[: plan.span - 1]])
    total = wrapped[: plan.pieces].copy()
    for step in range(1, plan.span):
        total += wrapped[step : step + plan.pieces]
    return total


def check_draws(runs: int, seed: object) -> None:
    """Refuse fewer replicates than two, and a seed that is none."""
    checks.counted("runs", runs, 2, "two runs or more", "A thousand are usual.")
    if isinstance(seed, np.random.Generator):
        return
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer):
        expected = "a whole number or a numpy.random.Generator for seed"
        raise UsageError(expected, checks.described(seed), "Give 0, for example.")
    if seed < 0:
        raise UsageError("a seed of zero or more", f"seed={seed}", "Any other one will do.")


class IntervalKind(StrEnum):
    """How an interval is read from replicates. Notation: v value, v* replicate, s and s* standard errors."""

    PERCENTILE = "percentile"
    """Quantiles of v*."""
    EXPANDED = "expanded"
    """Quantiles of v*, their distances from v times sqrt(c / (c - 1)) t / z: for few pieces."""
    BASIC = "basic"
    """v minus quantiles of v* - v, in reverse order."""
    STUDENTISED = "studentised"
    """v minus quantiles of (v* - v) / s* times s, in reverse order."""


@dataclass(frozen=True)
class Bootstrap:
    """Replicates of an estimate.

    Raises
    ------
    UsageError
        When fewer than two replicates gave an estimate.
    """

    names: tuple[str, ...]  # Of the quantities
    units: tuple[str, ...]  # Of the quantities
    values: Float[np.ndarray, " n"]  # The estimate that the replicates are replicates of
    replicates: Float[np.ndarray, "runs n"]  # Of those runs that gave an estimate
    failed: int  # Runs that did not
    pieces: int  # Blocks, or flights, that a replicate is put together from
    block_length: float  # Rows of a block; NaN when whole flights are drawn
    seed: int | None  # What the generator was made of; None when a generator was given
    #: Standard error of each value, computed as those of the replicates
    std_errors: Float[np.ndarray, " n"] | None = None
    studentised: Float[np.ndarray, "runs n"] | None = None  # (v* - v) / s* of each replicate

    def __post_init__(self) -> None:
        if self.replicates.shape[0] < 2:
            expected = "at least two replicates with an estimate"
            remedy = "Ask for more runs; where most fail, the data do not determine the parameters."
            raise UsageError(expected, f"{self.replicates.shape[0]}, and {self.failed} without", remedy)

    @property
    def covariance(self) -> Float[np.ndarray, "n n"]:
        """Covariance of the replicates, times c / (c - 1): c pieces vary about a mean of their own."""
        spread = self.replicates - self.replicates.mean(axis=0)
        few = self.pieces / (self.pieces - 1) if self.pieces > 1 else math.inf
        return np.asarray(spread.T @ spread / (spread.shape[0] - 1) * few)

    def std_error(self, name: str) -> float:
        """Root of the quantity's variance, see `covariance`."""
        position = checks.index_of("a quantity", name, self.names)
        return math.sqrt(float(self.covariance[position, position]))

    def bias(self, name: str) -> float:
        """Mean of the replicates minus the value."""
        position = checks.index_of("a quantity", name, self.names)
        return float(self.replicates[:, position].mean() - self.values[position])

    def interval(
        self, name: str, level: float = 0.95, kind: IntervalKind = IntervalKind.EXPANDED
    ) -> tuple[float, float]:
        """Confidence interval of a quantity, read from the replicates in one of some ways.

        Raises
        ------
        UsageError
            When the level is not between 0 and 1 or needs more replicates than there are, or a studentised
            interval is asked of replicates without standard errors.
        """
        position = checks.index_of("a quantity", name, self.names)
        checks.level(level)
        try:
            chosen = IntervalKind(kind)
        except ValueError as error:
            known = ", ".join(IntervalKind)
            raise UsageError(f"a kind out of {known}", checks.described(kind), "Name one of them.") from error
        value = float(self.values[position])
        if chosen is IntervalKind.STUDENTISED:
            if self.studentised is None or self.std_errors is None:
                expected = "replicates with standard errors of their own, for a studentised interval"
                remedy = "Draw blocks of one length, or take another kind of interval."
                raise UsageError(expected, "replicates without", remedy)
            low, high = _quantiles(self.studentised[:, position], level)
            std_error = float(self.std_errors[position])
            return value - high * std_error, value - low * std_error
        if chosen is IntervalKind.EXPANDED and self.pieces < 2:
            return -math.inf, math.inf
        low, high = _quantiles(self.replicates[:, position], level)
        if chosen is IntervalKind.BASIC:
            return 2.0 * value - high, 2.0 * value - low
        if chosen is IntervalKind.PERCENTILE:
            return low, high
        wider = math.sqrt(self.pieces / (self.pieces - 1)) * t_quantile(level, self.pieces - 1)
        wider /= normal_quantile(level)
        return value + wider * (low - value), value + wider * (high - value)


def _quantiles(values: Float[np.ndarray, " runs"], level: float) -> tuple[float, float]:
    """Order statistics (R + 1) p of R runs: another replicate is below the p-quantile with probability p."""
    needed = math.ceil(2.0 / (1.0 - level) * (1.0 - 1e-12)) - 1
    if values.size < needed:
        remedy = "Draw more runs, or ask for a lower level."
        raise UsageError(f"{needed} replicates or more for a level of {level:g}", f"{values.size}", remedy)
    low, high = np.quantile(values, [0.5 - 0.5 * level, 0.5 + 0.5 * level], method="weibull")
    return float(low), float(high)
