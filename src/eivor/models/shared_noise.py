"""The noise that columns share: C and c of the paper's compensated equations, from the columns' tags.

For a channel whose noise has autocovariance gamma, two columns of it at lags l_i and l_j share
g_i g_j gamma(|l_i - l_j|); columns of different channels share nothing. Noises need not be stationary,
so what is formed is the sample average over the rows that are used:

    C_ij = 1/|rows| sum_{k in rows} g_i(k) g_j(k) gamma_{|l_i - l_j|}(k - max(l_i, l_j))

where k counts from the beginning of the record. A column without noise (an intercept, a channel that is
declared exact) shares nothing; a channel that nothing is declared of raises.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from eivor.errors import MissingNoiseError, TooFewSamplesError
from eivor.linalg.row_blocks import COPIED_ROWS, row_blocks
from eivor.models.column import Column
from eivor.shapes import Bool, Float
from eivor.signals.noise import MeasurementNoise, WhiteNoise
from eivor.signals.signals import Signals


def shared_noise(
    left: Sequence[Column],
    right: Sequence[Column],
    signals: Signals,
    first: int,
    rows: Bool[np.ndarray, " rows"] | None = None,
) -> Float[np.ndarray, "left right"]:
    """Average covariance of the measurement noises of two sets of columns.

    Parameters
    ----------
    left, right : sequence of Column
        Tags.
    signals : Signals
        With the declared noises.
    first : int
        First row's sample, counted from the signals' own beginning.
    rows : ndarray of bool, optional
        Which of the samples from `first` on are used. Default: all.

    Returns
    -------
    ndarray, shape (len(left), len(right))
        In products of the columns' units.

    Raises
    ------
    MissingNoiseError
        When two columns are of one channel whose noise is not declared.
    TooFewSamplesError
        When there is no row to average over.
    """
    count = signals.sample_count - first
    if count < 1 or not (rows is None or rows.any()):
        raise TooFewSamplesError(
            f"rows: valid samples with {first} more before them",
            f"{signals.sample_count} samples, valid or not, and no row",
            "Give a longer record, fewer lags, or fewer gaps.",
        )
    shared = np.zeros((len(left), len(right)))
    for i, one in enumerate(left):
        for j, other in enumerate(right):
            if one.channel and one.channel == other.channel:
                shared[i, j] = _pair(one, other, signals, first, rows)
    return shared


def _pair(
    one: Column, other: Column, signals: Signals, first: int, rows: Bool[np.ndarray, " rows"] | None
) -> float:
    noise = _declared(one, signals)
    count = signals.sample_count - first
    if isinstance(noise, WhiteNoise) and not (one.gain_channel or other.gain_channel):
        return (
            one.gain * other.gain * (noise.variance if one.lag == other.lag else 0.0)
        )  # the same in every row
    total, used = 0.0, 0
    for start, stop in row_blocks(0, count, COPIED_ROWS):  # no series as long as the record is made
        here = slice(start, stop)
        growth = _growth(one, other, signals, first, here)
        if rows is not None:
            growth = growth[rows[here]]
        total += float(growth.sum())
        used += growth.size
    return one.gain * other.gain * total / used


def _growth(
    one: Column, other: Column, signals: Signals, first: int, here: slice
) -> Float[np.ndarray, " rows"]:
    """What the noises of two columns share in each of some rows, but for constant gains."""
    lag = abs(one.lag - other.lag)
    begin = signals.offset + first - max(one.lag, other.lag)
    growth = signals.noise[one.channel].autocovariance(lag, begin + here.start, here.stop - here.start)
    for column in (one, other):
        if column.gain_channel:
            growth = growth * signals.channel(column.gain_channel)[first:][here]
    return growth


def shared_noise_of_rows(
    left: Sequence[Column], right: Sequence[Column], signals: Signals, first: int
) -> dict[tuple[int, int], Float[np.ndarray, " rows"]]:
    """Covariance of the measurement noises of two sets of columns in every row from `first` on.

    Returns
    -------
    dict of tuple of int to ndarray, shape (rows,)
        Of the pairs that are of one channel, but white ones of different lags, which share nothing.

    Raises
    ------
    MissingNoiseError
        When two columns are of one channel whose noise is not declared.
    """
    whole = slice(0, max(signals.sample_count - first, 0))
    found = {}
    for i, one in enumerate(left):
        for j, other in enumerate(right):
            if not one.channel or one.channel != other.channel:
                continue
            if not isinstance(_declared(one, signals), WhiteNoise) or one.lag == other.lag:
                found[i, j] = one.gain * other.gain * _growth(one, other, signals, first, whole)
    return found


def _declared(column: Column, signals: Signals) -> MeasurementNoise:
    noise = signals.noise.get(column.channel)
    if noise is None:
        raise MissingNoiseError(
            f"a declared noise of channel '{column.channel}', which instruments and regressors share",
            f"noise of {', '.join(sorted(signals.noise)) or 'no channel'}",
            "Declare it in Signals(noise=...), with std 0 if the channel is exact, use other instruments, or "
            "have it estimated: ev.methods.generalized_iv_unknown_noise().",
        )
    return noise
