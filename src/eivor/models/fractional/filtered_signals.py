"""Signals behind fractional operators, and the noise of these behind the same operators.

The noise of a channel is a moving average of white noise e, and so is that of a column:

    x(k) = sum_{m <= k} f_m e(k - m)

with f the noise's weights behind the column's operator. What two columns share, averaged over the rows from
sample `first` to n - 1, is then

    C_ij = sum_m f_m g_m min(1, (n - m) / (n - first))

since a term m samples back has been in the rows from sample m on only. For white noise of variance s^2 and
orders a and b it tends to

    s^2 Gamma(1 + a + b) Gamma(h - b) / (Gamma(-b) Gamma(1 + b) Gamma(1 + a + h))

as the record grows, with h the lag of the first column behind the second.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from eivor.errors import DataError, MissingNoiseError, TooFewSamplesError, UsageError
from eivor.models.column import Column
from eivor.models.fractional.column import FractionalColumn, Part
from eivor.models.fractional.operator import FractionalOperator
from eivor.shapes import Float
from eivor.signals.causal_filter import in_a_row
from eivor.signals.signals import Signals

#: Series by channel, order, and whether they are the derivative by it; of order zero the channel itself.
Kept = dict[tuple[str, float, bool], Float[np.ndarray, " n"]]


@dataclass(frozen=True)
class FilteredSignals:
    """Channels behind the operators of one equation.

    Parameters
    ----------
    signals : Signals
        One whole record.
    operator : FractionalOperator
        What an order means.
    known_orders : frozenset of float
        Orders whose series are kept, since they are asked for again.
    both_sides : ndarray, shape (m,)
        Weights of a causal filter of both sides of the equation, which stays as it was; one for none.

    Raises
    ------
    DataError
        When samples are not valid, or the record is part of another one: an operator needs all samples that
        came before.
    """

    signals: Signals
    operator: FractionalOperator
    known_orders: frozenset[float] = frozenset()
    both_sides: Float[np.ndarray, " m"] = field(default_factory=lambda: np.ones(1))
    _series: Kept = field(default_factory=dict, init=False, repr=False)
    _noises: Kept = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        valid = self.signals.valid
        if self.signals.offset or not (valid is None or bool(valid.all())):
            raise DataError(
                "a whole record, every sample of which is valid",
                f"one that begins at sample {self.signals.offset} of another"
                if self.signals.offset
                else "samples that are not valid",
                "A fractional difference has all samples before in it: cut the record where it was at rest.",
            )

    @property
    def count(self) -> int:
        """Samples of the record."""
        return self.signals.sample_count

    def values(self, column: FractionalColumn, first: int) -> Float[np.ndarray, " rows"]:
        """Column of the samples from `first` on.

        Raises
        ------
        MissingChannelError
            When a channel is absent.
        TooFewSamplesError
            When there is no such sample.
        """
        if self.count <= first:
            raise TooFewSamplesError(
                f"more than {first} samples", f"{self.count}", "Give a longer record or fewer lags."
            )
        total: Float[np.ndarray, " rows"] = np.zeros(self.count - first)
        for part in column:
            series = self._behind(self._series, part, self.signals.channel)
            total += part.gain * series[first - part.lag : self.count - part.lag]
        return total

    def shared_noise(
        self, left: Sequence[Column], right: Sequence[FractionalColumn], first: int
    ) -> Float[np.ndarray, "left right"]:
        """Average covariance of the noises of plain columns with those of fractional ones, C of (29).

        Raises
        ------
        MissingNoiseError
            When two are of one channel whose noise is not declared.
        UsageError
            When a column on the left multiplies a channel that the right has as well by another channel.
        """
        shared = np.zeros((len(left), len(right)))
        for channel in self._channels(right):
            own = [i for i, column in enumerate(left) if column.channel == channel]
            if not own:
                continue
            noises = self._noise_of(channel, right) * self._share_of_rows(first)[:, None]
            base = self._moving_average(channel)
            for i in own:
                if left[i].gain_channel:
                    raise UsageError(
                        f"instruments of '{channel}' without a gain of another channel",
                        f"{left[i].name} times '{left[i].gain_channel}'",
                        "Leave the gain out.",
                    )
                lag = left[i].lag
                seen = base[: max(self.count - lag, 0)]
                shared[i] += left[i].gain * (seen @ noises[lag : lag + seen.size])
        return shared

    def noise_covariance(
        self, columns: Sequence[FractionalColumn], first: int
    ) -> Float[np.ndarray, "columns columns"]:
        """Average covariance of the noises of columns among themselves.

        Raises
        ------
        MissingNoiseError
            When the noise of a channel is not declared.
        """
        total = np.zeros((len(columns), len(columns)))
        for channel in self._channels(columns):
            noises = self._noise_of(channel, columns)
            total += (noises * self._share_of_rows(first)[:, None]).T @ noises
        return 0.5 * (total + total.T)

    def _share_of_rows(self, first: int) -> Float[np.ndarray, " n"]:
        """Share of the rows in which a term so many samples back is there."""
        return np.minimum(1.0, (self.count - np.arange(self.count)) / (self.count - first))

    def _noise_of(self, channel: str, columns: Sequence[FractionalColumn]) -> Float[np.ndarray, "n columns"]:
        """Weights of a channel's white noise in each column."""
        weights: Float[np.ndarray, "n columns"] = np.zeros((self.count, len(columns)))
        for place, column in enumerate(columns):
            for part in column:
                if part.channel == channel:
                    behind = self._behind(self._noises, part, self._moving_average)
                    series = behind[: max(self.count - part.lag, 0)]
                    weights[part.lag : part.lag + series.size, place] += part.gain * series
        return weights

    def _moving_average(self, channel: str) -> Float[np.ndarray, " n"]:
        noise = self.signals.noise.get(channel)
        if noise is None:
            raise MissingNoiseError(
                f"a declared noise of channel '{channel}', which columns share",
                f"noise of {', '.join(sorted(self.signals.noise)) or 'no channel'}",
                "Declare it in Signals(noise=...), with std 0 if the channel is exact, or use a method that "
                "needs none: least_squares, or extended_iv with instruments of another channel.",
            )
        weights = noise.moving_average(self.count)
        return weights[: int(np.flatnonzero(weights).max(initial=0)) + 1]  # one weight of white noise

    def _behind(
        self, kept: Kept, part: Part, of: Callable[[str], Float[np.ndarray, " _"]]
    ) -> Float[np.ndarray, " _"]:
        """A channel, or its noise, behind the operator of a part; kept for known orders."""
        key = (part.channel, part.order, part.by_order)
        if key in kept:
            return kept[key]
        if part.order == 0.0 and not part.by_order:
            result = in_a_row(self.both_sides, of(part.channel))
        else:
            made = self.operator.slope if part.by_order else self.operator.weights
            weights = made(part.order, self.count, self.signals.step_s)
            result = in_a_row(weights, self._behind(kept, Part(part.channel), of))
        if part.order in {0.0, *self.known_orders}:
            kept[key] = result
        return result

    @staticmethod
    def _channels(columns: Sequence[FractionalColumn]) -> list[str]:
        return sorted({part.channel for column in columns for part in column})
