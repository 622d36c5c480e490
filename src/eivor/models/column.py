"""Columns: which channel, at which lag, times which gain, makes a column of a regression.

The tags say which measurement noise two columns share, so that compensated methods can work it out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eivor.errors import TooFewSamplesError, UsageError
from eivor.signals.signals import Signals


@dataclass(frozen=True, slots=True)
class Column:
    """``gain * channel[k - lag]``.

    Parameters
    ----------
    channel : str
        Canonical name; empty for the intercept, which is a column of ones without noise.
    lag : int
        Samples back, zero or more.
    gain : float
        Constant, noise-free factor.

    Raises
    ------
    UsageError
        When the lag is negative.
    """

    channel: str
    lag: int = 0
    gain: float = 1.0

    def __post_init__(self) -> None:
        if self.lag < 0:
            raise UsageError(
                "a lag of zero or more samples", f"{self.lag}", "Only past samples are regressors."
            )

    @property
    def name(self) -> str:
        """How the column is called in tables: ``input(k-3)``."""
        if not self.channel:
            return "intercept"
        return f"{self.channel}(k-{self.lag})" if self.lag else self.channel

    def values(self, signals: Signals, first: int) -> Float[np.ndarray, " rows"]:
        """Column of `signals`, for the samples from `first` on.

        Raises
        ------
        TooFewSamplesError
            When no sample is that late.
        """
        count = signals.sample_count - first
        if count < 1 or self.lag > first:
            raise TooFewSamplesError(
                f"more than {max(first, self.lag)} samples",
                f"{signals.sample_count}",
                "Give a longer record or fewer lags.",
            )
        if not self.channel:
            return np.full(count, self.gain)
        values = signals.channel(self.channel)
        return self.gain * values[first - self.lag : first - self.lag + count]


def lags(channel: str, first: int, last: int) -> tuple[Column, ...]:
    """Columns of `channel` at the lags from `first` to `last`, both included.

    Raises
    ------
    UsageError
        When `last` lies before `first`, or a lag is negative.
    """
    if last < first:
        raise UsageError("first <= last", f"first={first}, last={last}", "Both ends are included.")
    return tuple(Column(channel, lag) for lag in range(first, last + 1))
