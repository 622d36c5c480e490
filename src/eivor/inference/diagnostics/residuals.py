"""Diagnostics of residuals: constancy, whiteness, memory, leverage and influence."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from eivor.inference.covariance import unit_scale
from eivor.inference.diagnostics.record import SIGNIFICANT, Diagnostic, Row, Subject, outcome_word
from eivor.inference.distributions import chi_square_tail, normal_quantile
from eivor.inference.verdict import Reason, Status
from eivor.signals.noise import LEAST_BANDWIDTH, estimate_long_memory
from eivor.tools import Float, Int

#: Probability to exceed the quantiles.
TAILS = (0.5, 0.25, 0.1, 0.05, 0.025, 0.01, 0.005, 0.0025, 0.001)
LOG_TAILS = np.log(TAILS)

#: For each number of parameters that are tested together.
QUANTILES: dict[int, tuple[float, ...]] = {
    1: (3.486, 5.883, 9.504, 12.6, 16.14, 21.38, 25.69, 30.83, 38.69),
    2: (3.18, 5.044, 7.727, 9.985, 12.48, 16.5, 19.81, 24.31, 29.82),
    3: (3.114, 4.842, 7.308, 9.404, 11.86, 15.45, 18.58, 22.47, 29.16),
    4: (3.166, 4.904, 7.441, 9.712, 12.25, 16.16, 19.9, 24.46, 30.85),
    5: (3.352, 5.24, 8.009, 10.56, 13.46, 17.96, 22.07, 27.66, 35.76),
    6: (3.644, 5.846, 9.261, 12.34, 15.96, 22.17, 28.04, 35.37, 46.25),
}
LOG_QUANTILES = {unknowns: np.log(row) for unknowns, row in QUANTILES.items()}


def influences(
    sums: Float[np.ndarray, "K n"], sensitivity: Float[np.ndarray, "n n"]
) -> Float[np.ndarray, "K n"]:
    """Contribution of each block to each parameter. Performs no checks."""
    scale = unit_scale(np.abs(sensitivity.diagonal()))
    scaled = scale[:, None] * sensitivity * scale
    return np.asarray(scale * np.linalg.lstsq(scaled, scale[:, None] * sums.T, rcond=None)[0].T)


#: Groups of the record, groups at either end that no change is sought in, cosine averages of each side.
GROUPS = 64
TRIMMED = 10
SIDE_AVERAGES = 6


@dataclass(frozen=True)
class Constancy(Diagnostic):
    """Whether the parameters changed during the record."""

    statistic: float  # Supremum, as an F
    p_value: float
    p_values: Float[np.ndarray, " n"]
    break_at: float
    change: Float[np.ndarray, " n"]

    @property
    def outcome(self) -> str:
        return outcome_word(self.p_value, ("stay the same", "may change", "change"))

    @property
    def speaks(self) -> bool:
        """Whether a change is worth a word."""
        return bool(self.p_value < SIGNIFICANT)

    def sides(self, values: Float[np.ndarray, " n"]) -> Float[np.ndarray, "2 n"]:
        """Parameters before and after, of those that change significantly; the others as they are."""
        change = np.where(self.p_values < SIGNIFICANT, self.change, 0.0)
        return np.stack([values - (1.0 - self.break_at) * change, values + self.break_at * change])

    def rows(self, subject: Subject, /) -> Iterator[Row]:
        likely = f"p-value {self.p_value:.3g}, a change most likely at {subject.when(self.break_at)}"
        line = f"constancy            {self.statistic:>10.4g}  {likely}"
        yield Row("constancy", "", self.statistic, self.p_value, line)
        for name, p, change in zip(subject.names, self.p_values, self.change, strict=True):
            yield Row("change", name, float(change), float(p))
        yield Row("break_at", "share of the record", self.break_at, None)

    def reasons(self, subject: Subject, /) -> Iterator[Reason]:
        if self.speaks:
            j = int(np.argmin(self.p_values))
            yield Reason(
                Status.WEAK,
                f"The parameters {self.outcome} during the record, most likely at "
                f"{subject.when(self.break_at)}: {subject.names[j]} by {self.change[j]:+.3g} "
                f"(p-value {self.p_value:.1g} or less).",
                "Identify both parts apart, and look for what changed: load, battery, wind, a mode.",
            )


def constancy(influence: Float[np.ndarray, "K n"]) -> Constancy:
    """Test of a change of the parameters, from each block's contribution to them. Performs no checks."""
    groups = influence.reshape(GROUPS, -1, influence.shape[1]).sum(axis=1)
    unknowns, (difference, S) = groups.shape[1], sides(groups)
    variances = np.diagonal(S, axis1=1, axis2=2)
    squares = np.divide(difference**2, variances, out=np.zeros(difference.shape), where=variances > 0.0).T
    p_values = p_value(squares.max(axis=1), 1)
    if unknowns in QUANTILES:
        path = wald_path(difference, S)
        joint = float(p_value(path.max(), unknowns))
    else:  # too many for one covariance on twelve averages: the strongest of them, by Bonferroni's bound
        path = squares[int(np.argmin(p_values))]
        joint = min(1.0, unknowns * float(p_values.min()))
    k = TRIMMED + int(np.argmax(path))
    change = GROUPS * (groups[k:].sum(axis=0) / (GROUPS - k) - groups[:k].sum(axis=0) / k)
    return Constancy(float(path.max()), joint, p_values, k / GROUPS, change)


def sides(groups: Float[np.ndarray, "64 n"]) -> tuple[np.ndarray, np.ndarray]:
    """Difference of the means on both sides of each break, and its covariance, but for one unit of both."""
    scale = groups.std(axis=0)
    transformed = np.tensordot(_transforms(), groups / np.where(scale > 0.0, scale, 1.0), axes=1)
    cosines = transformed[:, 1:]
    return transformed[:, 0], cosines.swapaxes(1, 2) @ cosines


def wald_path(difference: np.ndarray, S: np.ndarray) -> Float[np.ndarray, " breaks"]:
    """Wald statistic, as an F, for a change after each group from the tenth on. Performs no checks."""
    try:
        W = np.einsum("ki,ki->k", difference, np.linalg.solve(S, difference[:, :, None])[:, :, 0])
    except np.linalg.LinAlgError:
        return np.zeros(difference.shape[0])
    n, averages = difference.shape[1], 2 * SIDE_AVERAGES
    return W * (averages - n + 1) / (averages * n)


def p_value(statistic: Float[np.ndarray, "*some"] | float, unknowns: int) -> Float[np.ndarray, "*some"]:
    """Tail of the supremum, from the table: logarithms are interpolated, ends are kept."""
    logarithm = np.log(np.maximum(statistic, 1e-300))
    return np.asarray(np.exp(np.interp(logarithm, LOG_QUANTILES[unknowns], LOG_TAILS)))


@lru_cache(maxsize=1)
def _transforms() -> Float[np.ndarray, "breaks rows 64"]:
    """For each break: difference of means over its standard error, and both sides' cosines over sqrt(12)."""
    breaks = range(TRIMMED, GROUPS - TRIMMED + 1)
    rows = np.zeros((len(breaks), 1 + 2 * SIDE_AVERAGES, GROUPS))
    j = np.arange(1, SIDE_AVERAGES + 1)[:, None]
    for i, k in enumerate(breaks):
        right = GROUPS - k
        root = np.sqrt(1.0 / k + 1.0 / right)
        rows[i, 0, :k], rows[i, 0, k:] = 1.0 / (k * root), -1.0 / (right * root)
        for offset, size, first in ((0, k, 0), (SIDE_AVERAGES, right, k)):
            cosines = np.cos(np.pi * j * (np.arange(size) + 0.5) / size) * np.sqrt(2.0 / size)
            rows[i, 1 + offset : 1 + offset + SIDE_AVERAGES, first : first + size] = cosines
    rows[:, 1:] /= np.sqrt(2.0 * SIDE_AVERAGES)
    return rows


#: Change by one stretch, in standard errors of the estimate, that is worth a look; 1/3 is usual for ten.
LARGE_LEVERAGE = 1.5


@dataclass(frozen=True)
class SegmentLeverage(Diagnostic):
    """Effect of leaving out each stretch."""

    shift: Float[np.ndarray, "S n"]
    in_std_errors: Float[np.ndarray, "S n"]  # The same over the standard errors of the estimate
    segments: tuple[tuple[int, int], ...]  # First row and end of each stretch

    @cached_property
    def most(self) -> Int[np.ndarray, " n"]:
        size = np.abs(self.in_std_errors)
        return np.argmax(np.where(np.isnan(size), -1.0, size), axis=0)

    @cached_property
    def largest(self) -> Float[np.ndarray, " n"]:
        """Largest effect, in standard errors, with its sign."""
        return self.in_std_errors[self.most, np.arange(self.shift.shape[1])]

    def rows(self, subject: Subject, /) -> Iterator[Row]:
        for j, name in enumerate(subject.names):
            by, where = float(self.largest[j]), f"{name}, {self._span(j, subject)}"
            line = f"largest leverage     {by:>+10.2f}  standard errors of {where}"
            yield Row("leverage", where, by, 1.0, line)

    def reasons(self, subject: Subject, /) -> Iterator[Reason]:
        for j, name in enumerate(subject.names):
            by = float(self.largest[j])
            if abs(by) > LARGE_LEVERAGE:
                yield Reason(
                    Status.WEAK,
                    f"One stretch of the record, from {self._span(j, subject)}, moves {name} by "
                    f"{abs(by):.1f} standard errors.",
                    "Look at it, and identify without it.",
                )

    def _span(self, j: int, subject: Subject) -> str:
        first, end = self.segments[self.most[j]]
        return f"{subject.at_row(first)} to {subject.at_row(end)}"


def segment_leverage(
    sums: Float[np.ndarray, "S n"],
    sensitivities: Float[np.ndarray, "S n n"],
    std_errors: Float[np.ndarray, " n"],
    segments: tuple[tuple[int, int], ...],
) -> SegmentLeverage:
    """Drop-one estimates from the stretches' own equations. Performs no checks."""
    M = sensitivities.sum(axis=0)
    scale = unit_scale(np.abs(M.diagonal()))
    shift = np.full(sums.shape, np.nan)
    rest = scale[:, None] * (M - sensitivities) * scale
    solvable = np.linalg.cond(rest) < 1.0 / np.finfo(np.float64).eps
    shift[solvable] = -scale * np.linalg.solve(rest[solvable], (scale * sums[solvable])[..., None])[..., 0]
    return SegmentLeverage(shift, shift / std_errors, segments)


#: Longer records are averaged down to this many samples first.
LONGEST = 8192
#: Memory from which a residual is not stationary, and its long-run variance not finite.
NOT_STATIONARY = 0.5


@dataclass(frozen=True, slots=True)
class ResidualMemory(Diagnostic):
    """Memory of a residual."""

    memory: float  # d = -order of the fractional noise
    order_error: float

    @property
    def drifts(self) -> bool:
        """Whether the residual is clearly not stationary."""
        return bool(self.memory - 2.0 * self.order_error > NOT_STATIONARY)

    def rows(self, _subject: Subject, /) -> Iterator[Row]:
        line = f"memory               {self.memory:>10.3f}  standard error {self.order_error:.3f}"
        yield Row("memory", "", self.memory, self.order_error, line)

    def reasons(self, _subject: Subject, /) -> Iterator[Reason]:
        if self.drifts:
            yield Reason(
                Status.WEAK,
                f"The residual drifts: its memory is {self.memory:.2f} +- {2.0 * self.order_error:.2f}, and "
                "from 0.5 on its variance grows with the record.",
                "Add an intercept, whiten or difference the signals, or look for a slow term that is "
                "missing.",
            )


def residual_memory(residual: Float[np.ndarray, " rows"]) -> ResidualMemory | None:
    """Local Whittle order of a residual in time order, with its standard error. Performs no checks."""
    width = -(-residual.size // LONGEST)
    usable = residual.size // width
    means = residual
    if width > 1:
        means = residual[: usable * width].reshape(usable, width) @ np.full(width, 1.0 / width)
    spread = float(np.ptp(means)) if means.size else 0.0
    if means.size <= 2 * LEAST_BANDWIDTH or spread <= 1e-12 * float(np.abs(means).max()):
        return None
    memory = estimate_long_memory(means)
    return ResidualMemory(memory.memory, memory.order_error)


#: Lags that are tested.
LAGS = 20


@dataclass(frozen=True)
class ResidualWhiteness(Diagnostic):
    """Whiteness of a residual."""

    autocorrelation: Float[np.ndarray, " L"]  # At lags 1..L
    band: float
    ljung_box: float
    p_value: float
    durbin_watson: float  # sum (e_t - e_t-1)^2 / sum e_t^2

    @property
    def outside(self) -> int:
        return int((np.abs(self.autocorrelation) > self.band).sum())

    def rows(self, _subject: Subject, /) -> Iterator[Row]:
        line = f"whiteness            {self.ljung_box:>10.4g}  Ljung-Box, p-value {self.p_value:.3g}"
        yield Row("ljung_box", f"{self.autocorrelation.size} lags", self.ljung_box, self.p_value, line)
        line = f"Durbin-Watson        {self.durbin_watson:>10.4g}"
        yield Row("durbin_watson", "", self.durbin_watson, 2.0, line)
        for lag, r in enumerate(self.autocorrelation, start=1):
            yield Row("autocorrelation", f"lag {lag}", float(r), self.band)

    def reasons(self, _subject: Subject, /) -> Iterator[Reason]:
        if self.p_value < SIGNIFICANT:
            yield Reason(
                Status.IDENTIFIED,
                f"The residual is autocorrelated: {self.outside} of {self.autocorrelation.size} lags are "
                f"outside the band, Durbin-Watson is {self.durbin_watson:.3g}.",
                "Keep a covariance that allows for it; white-noise standard errors are wrong here.",
            )


def residual_whiteness(residual: Float[np.ndarray, " rows"], lags: int = LAGS) -> ResidualWhiteness:
    """Whiteness of a residual in time order. Performs no checks; O(rows lags)."""
    count = residual.size
    lags = max(min(lags, (count - 1) // 4), 1)
    sums = np.correlate(np.append(residual, np.zeros(lags)), residual)
    if not sums[0] > 0.0:
        return ResidualWhiteness(np.zeros(lags), normal_quantile(0.95) / np.sqrt(count), 0.0, 1.0, 2.0)
    r = sums[1:] / sums[0]
    Q = float(count * (count + 2.0) * np.sum(r**2 / (count - np.arange(1, lags + 1))))
    ends = float(residual[0] ** 2 + residual[-1] ** 2)
    watson = 2.0 - (2.0 * float(sums[1]) + ends) / float(sums[0])
    return ResidualWhiteness(r, normal_quantile(0.95) / np.sqrt(count), Q, chi_square_tail(Q, lags), watson)
