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
    """``gain * gain_channel[k] * channel[k - lag]``.

    Parameters
    ----------
    channel : str
        Canonical name; empty for the intercept, which is a column of ones without noise.
    lag : int
        Samples back, zero or more.
    gain : float
        Constant, noise-free factor.
    gain_channel : str
        Channel whose values, known without noise, multiply the column row by row; empty for none.

    Raises
    ------
    UsageError
        When the lag is negative.
    """

    channel: str
    lag: int = 0
    gain: float = 1.0
    gain_channel: str = ""

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

    def gain_series(self, signals: Signals, first: int) -> float | Float[np.ndarray, " rows"]:
        """Gain of each row from sample `first` on, or one number when it is constant."""
        if not self.gain_channel:
            return self.gain
        series: Float[np.ndarray, " rows"] = self.gain * signals.channel(self.gain_channel)[first:]
        return series

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
        gain = self.gain_series(signals, first)
        if not self.channel:
            return np.full(count, gain)
        values = signals.channel(self.channel)
        return gain * values[first - self.lag : first - self.lag + count]


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
