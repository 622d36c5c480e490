"""Shares of trials, and how far a number of trials can tell them."""

from __future__ import annotations

import math
from dataclasses import dataclass

from eivor.inference.quantiles import normal_quantile


@dataclass(frozen=True, slots=True)
class Share:
    """A share of trials, with its binomial error.

    Parameters
    ----------
    hits, count : int
        Trials that did, and all.
    level : float
        Confidence level of the interval.
    """

    hits: int
    count: int
    level: float = 0.95

    @property
    def value(self) -> float:
        """Hits per count; NaN of nothing."""
        return self.hits / self.count if self.count else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's interval of the share; (0, 1) of nothing.

        Notation: z the normal quantile, n the count, p the share. Wilson (1927), J. Am. Stat. Assoc. 22.
        """
        if not self.count:
            return 0.0, 1.0
        z, n, p = normal_quantile(self.level), self.count, self.value
        centre = (p + z * z / (2 * n)) / (1 + z * z / n)
        half = z / (1 + z * z / n) * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
        return max(centre - half, 0.0), min(centre + half, 1.0)
