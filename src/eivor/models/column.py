"""Columns: which channel, at which lag, times which gain, makes a column of a regression.

The tags say which measurement noise two columns share, so that compensated methods can work it out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eivor import checks
from eivor.errors import TooFewSamplesError, UsageError
from eivor.shapes import Float
from eivor.signals.signals import Signals

#: Lags of one channel: each is a column of every row, and more of them no record can tell apart.
MOST_LAGS = 10_000


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
        When the lag is no whole number or negative, the gain not finite, or a name no text.
    """

    channel: str
    lag: int = 0
    gain: float = 1.0
    gain_channel: str = ""

    def __post_init__(self) -> None:
        checks.text("channel", self.channel)
        checks.text("gain_channel", self.gain_channel)
        checks.whole("lag", self.lag)
        checks.number("gain", self.gain)
        if not np.isfinite(self.gain):
            raise UsageError("a finite gain", f"{self.gain}", "A column of zeros has the gain 0.")
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


def check_columns(name: str, columns: object) -> None:
    """Refuse what is no tuple of columns.

    Raises
    ------
    UsageError
        With what came instead.
    """
    checks.items(name, columns, Column, "columns", 'Give ev.lags("input", 1, 10), for example.')


def lags(channel: str, first: int, last: int) -> tuple[Column, ...]:
    """Columns of `channel` at the lags from `first` to `last`, both included.

    Raises
    ------
    UsageError
        When `last` lies before `first`, a lag is negative or no whole number, or there are more than
        `MOST_LAGS`.
    """
    checks.whole("first", first)
    checks.whole("last", last)
    if last < first:
        raise UsageError("first <= last", f"first={first}, last={last}", "Both ends are included.")
    if last - first >= MOST_LAGS:
        raise UsageError(
            f"{MOST_LAGS} lags or fewer", f"first={first}, last={last}", "Each is a column of its own."
        )
    return tuple(Column(channel, lag) for lag in range(first, last + 1))
