"""Whether the parameters stay the same over the record: a sup-Wald test on the scores.

The record is cut into 64 groups of equal length. At every group k from 15 to 85 % the mean of the scores
before is compared with that after it, with the long-run covariance of the scores from six cosine averages of
either side by itself, so that a change does not swell the covariance it is measured by:

    W_k = (m_1 - m_2)' [(1/k + 1/(64 - k)) (S_1 + S_2) / 2]^-1 (m_1 - m_2),   sup_k (13 - n) / (12 n) W_k

(after Andrews 1993, with the covariance held at twelve averages however long the record, as in
Lazarus, Lewis, Stock and Watson 2018). For scores whose autocorrelation is short beside a group the group
sums are independent and normal, and the distribution depends on n alone: `simulated_suprema` draws
from it, and made the table in `constancy_quantiles`.

The scores are taken to have the same variance all along: a record that moves in one half only is told from
one whose parameters change by its leverages, not by this test.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from eivor.inference.diagnostics.constancy_quantiles import QUANTILES, TAILS
from eivor.inference.diagnostics.diagnostic import SIGNIFICANT, Diagnostic, Row, Subject, told
from eivor.inference.diagnostics.influences import influences
from eivor.inference.verdict import Reason, Status
from eivor.shapes import Float

#: Groups of the record, groups at either end that no change is sought in, cosine averages of each side.
GROUPS = 64
TRIMMED = 10
SIDE_AVERAGES = 6


@dataclass(frozen=True)
class Constancy(Diagnostic):
    """Whether the parameters changed during the record.

    Parameters
    ----------
    statistic : float
        Supremum, as an F.
    p_value : float
        Of all parameters together; .001 stands for that or less, .5 for that or more.
    p_values : ndarray, shape (n,)
        Of each parameter by itself.
    break_at : float
        Where a change is most likely, as a share of the record.
    change : ndarray, shape (n,)
        Parameters after less before it, to first order.
    """

    statistic: float
    p_value: float
    p_values: Float[np.ndarray, " n"]
    break_at: float
    change: Float[np.ndarray, " n"]

    @property
    def outcome(self) -> str:
        """What the parameters do, in words."""
        return told(self.p_value, ("stay the same", "may change", "change"))

    @property
    def speaks(self) -> bool:
        """Whether a change is worth a word."""
        return bool(self.p_value < SIGNIFICANT)

    def rows(self, of: Subject, /) -> Iterator[Row]:
        """The statistic, each parameter's change with its p-value, and where it is most likely."""
        yield Row("constancy", "", self.statistic, self.p_value)
        for name, p, change in zip(of.names, self.p_values, self.change, strict=True):
            yield Row("change", name, float(change), float(p))
        yield Row("break_at", "share of the record", self.break_at, None)

    def lines(self, of: Subject, /) -> Iterator[str]:
        """The statistic, and where a change is most likely."""
        likely = f"p-value {self.p_value:.3g}, a change most likely at {of.when(self.break_at)}"
        yield f"constancy            {self.statistic:>10.4g}  {likely}"

    def reasons(self, of: Subject, /) -> Iterator[Reason]:
        """Parameters that change."""
        if self.speaks:
            j = int(np.argmin(self.p_values))
            yield Reason(
                Status.WEAK,
                f"The parameters {self.outcome} during the record, most likely at {of.when(self.break_at)}: "
                f"{of.names[j]} by {self.change[j]:+.3g} (p-value {self.p_value:.1g} or less).",
                "Identify both parts apart, and look for what changed: load, battery, wind, a mode.",
            )


def constancy(sums: Float[np.ndarray, "K n"], sensitivity: Float[np.ndarray, "n n"]) -> Constancy:
    """Test of a change of the parameters. Performs no checks.

    Parameters
    ----------
    sums : ndarray, shape (K, n)
        Sums of the scores over blocks of equal length; K a multiple of 64.
    sensitivity : ndarray, shape (n, n)
        M, of the whole record.
    """
    influence = influences(sums, sensitivity)
    groups = influence.reshape(GROUPS, -1, influence.shape[1]).sum(axis=1)
    unknowns = groups.shape[1]
    each = [wald_path(groups[:, [j]]) for j in range(unknowns)]
    p_values = np.array([p_value(float(path.max()), 1) for path in each])
    if unknowns in QUANTILES:
        path = wald_path(groups)
        statistic = float(path.max())
        joint = p_value(statistic, unknowns)
    else:  # too many for one covariance on twelve averages: the strongest of them, by Bonferroni's bound
        path = each[int(np.argmin(p_values))]
        statistic = float(path.max())
        joint = min(1.0, unknowns * float(p_values.min()))
    k = TRIMMED + int(np.argmax(path))
    change = GROUPS * (groups[k:].mean(axis=0) - groups[:k].mean(axis=0))
    return Constancy(statistic, joint, p_values, k / GROUPS, change)


def wald_path(groups: Float[np.ndarray, "64 n"]) -> Float[np.ndarray, " breaks"]:
    """Wald statistic, as an F, for a change after each group from the tenth on. Performs no checks."""
    n = groups.shape[1]
    scale = groups.std(axis=0)
    transformed = np.tensordot(_transforms(), groups / np.where(scale > 0.0, scale, 1.0), axes=1)
    difference, L = transformed[:, 0], transformed[:, 1:]
    S = np.einsum("kbi,kbj->kij", L, L)
    try:
        W = np.einsum("ki,ki->k", difference, np.linalg.solve(S, difference[:, :, None])[:, :, 0])
    except np.linalg.LinAlgError:
        return np.zeros(difference.shape[0])
    averages = 2 * SIDE_AVERAGES
    return W * (averages - n + 1) / (averages * n)


def p_value(statistic: float, unknowns: int) -> float:
    """Tail of the supremum, from the table: logarithms are interpolated, ends are kept."""
    return float(
        np.exp(np.interp(np.log(max(statistic, 1e-300)), np.log(QUANTILES[unknowns]), np.log(TAILS)))
    )


def simulated_suprema(unknowns: int, runs: int, rng: np.random.Generator) -> Float[np.ndarray, " runs"]:
    """Suprema under constant parameters, from independent normal group sums.

    Parameters
    ----------
    unknowns : int
        n.
    runs : int
        Number of draws.
    rng : numpy.random.Generator
        Source of randomness.
    """
    return np.array([wald_path(rng.standard_normal((GROUPS, unknowns))).max() for _ in range(runs)])


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
        for place, size, first in ((0, k, 0), (SIDE_AVERAGES, right, k)):
            cosines = np.cos(np.pi * j * (np.arange(size) + 0.5) / size) * np.sqrt(2.0 / size)
            rows[i, 1 + place : 1 + place + SIDE_AVERAGES, first : first + size] = cosines
    rows[:, 1:] /= np.sqrt(2.0 * SIDE_AVERAGES)
    return rows
