"""Kernels and bandwidths of long-run covariances."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from eivor import checks
from eivor.errors import UsageError
from eivor.tools import Float

Block = Float[np.ndarray, "_ n"]
Square = Float[np.ndarray, "n n"]

#: Below this argument the quadratic spectral kernel is its series, 1 - z^2/10.
SMALL_ARGUMENT = 1e-3


class Kernel(ABC):
    """Weights of autocovariances."""

    name: ClassVar[str]  # what results call it
    ends: ClassVar[bool] = True  # whether the kernel is zero from x = 1 on

    @abstractmethod
    def weights(self, x: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """k(x) at x >= 0."""

    def span(self, bandwidth: float) -> float:
        """S of a bandwidth in lags."""
        return bandwidth + 1.0 if self.ends else bandwidth


@dataclass(frozen=True, slots=True)
class Bartlett(Kernel):
    """1 - x (Newey and West 1987)."""

    name = "bartlett"

    def weights(self, x: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        return np.maximum(1.0 - x, 0.0)


@dataclass(frozen=True, slots=True)
class Parzen(Kernel):
    """1 - 6 x^2 + 6 x^3 up to 1/2, 2 (1 - x)^3 up to 1 (Gallant 1987)."""

    name = "parzen"

    def weights(self, x: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        near = 1.0 - 6.0 * x**2 * (1.0 - x)
        return np.where(x <= 0.5, near, 2.0 * np.maximum(1.0 - x, 0.0) ** 3)


@dataclass(frozen=True, slots=True)
class QuadraticSpectral(Kernel):
    """3/z^2 (sin z / z - cos z) with z = 6 pi x / 5 (Andrews 1991); it has no end."""

    name = "quadratic_spectral"
    ends = False

    def weights(self, x: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        z = 1.2 * np.pi * x
        safe = np.where(z < SMALL_ARGUMENT, 1.0, z)
        far = 3.0 / safe**2 * (np.sin(safe) / safe - np.cos(safe))
        return np.where(z < SMALL_ARGUMENT, 1.0 - z**2 / 10.0, far)


def kernel_sum_covariance(blocks: Iterable[Block], count: int, kernel: Kernel, bandwidth: float) -> Square:
    """Covariance of the sum of autocorrelated scores, sum_l k(l/S) sum_t s_t s_{t-l}'."""
    span = kernel.span(bandwidth)
    if kernel.ends:
        return _from_blocks(blocks, kernel, min(int(np.ceil(span)) - 1, count - 1), span)
    return _from_spectrum(np.concatenate(list(blocks)), kernel, span)


def _from_blocks(blocks: Iterable[Block], kernel: Kernel, lags: int, span: float) -> Square:
    weights = kernel.weights(np.arange(lags + 1) / span)
    total, before = np.zeros(()), None
    for block in blocks:
        before = block[:0] if before is None else before
        joined, known = np.concatenate([before, block]), before.shape[0]
        total = total + block.T @ block
        for lag in range(1, min(lags, joined.shape[0] - 1) + 1):
            # Pairs whose later score is in this block and whose earlier one has been seen.
            first = max(known, lag)
            cross = joined[first:].T @ joined[first - lag : joined.shape[0] - lag]
            total += weights[lag] * (cross + cross.T)
        before = joined[max(joined.shape[0] - lags, 0) :]
    if before is None:
        raise UsageError("scores", "none", "Give a longer record.")
    return total


def _from_spectrum(scores: Float[np.ndarray, "samples n"], kernel: Kernel, span: float) -> Square:
    """All lags by FFT, padded so that they do not wrap around."""
    from scipy import fft  # late: few ask for it

    if span <= 0.0:
        return scores.T @ scores
    count, length = len(scores), fft.next_fast_len(2 * len(scores), real=True)
    lags = np.arange(length)
    weights = kernel.weights(np.minimum(lags, length - lags) / span)
    spectrum = fft.rfft(scores, n=length, axis=0) * fft.rfft(weights)[:, None]
    return scores.T @ fft.irfft(spectrum, n=length, axis=0)[:count]


#: Andrews' (1991, his (6.2)) constants, and the exponent that goes with each: 1/(2q + 1).
ANDREWS = {Bartlett: (1.1447, 1), Parzen: (2.6614, 2), QuadraticSpectral: (1.3221, 2)}
#: Largest correlation of successive scores that Andrews' rule believes.
LARGEST_CORRELATION = 0.97

Blocks = Callable[[], Iterable[Block]]


class Bandwidth(ABC):
    """A way to choose the bandwidth."""

    @abstractmethod
    def lags(self, blocks: Blocks, count: int, kernel: Kernel, /) -> float:
        """Bandwidth in lags, for so many scores, which are given in blocks, anew in each call."""


@dataclass(frozen=True, slots=True)
class FixedBandwidth(Bandwidth):
    """Chosen by the user, in lags: zero or more."""

    bandwidth: float | int

    def __post_init__(self) -> None:
        checks.number("bandwidth", self.bandwidth)
        if not self.bandwidth >= 0.0:
            raise UsageError("a bandwidth of zero lags or more", f"{self.bandwidth}", "Zero sees no lag.")

    def lags(self, _blocks: Blocks, _count: int, _kernel: Kernel, /) -> float:
        return float(self.bandwidth)


@dataclass(frozen=True, slots=True)
class NeweyWestRule(Bandwidth):
    """4 (N/100)^(2/9), the rule of thumb that goes with Newey and West (1994)."""

    def lags(self, _blocks: Blocks, count: int, _kernel: Kernel, /) -> float:
        return float(newey_west_bandwidth(count))


@dataclass(frozen=True, slots=True)
class SquareRootRule(Bandwidth):
    """1.3 sqrt(N), which asks for fixed-b critical values (Lazarus, Lewis, Stock and Watson 2018)."""

    def lags(self, _blocks: Blocks, count: int, _kernel: Kernel, /) -> float:
        return 1.3 * float(np.sqrt(count)) - 1.0


@dataclass(frozen=True, slots=True)
class AndrewsRule(Bandwidth):
    """Andrews' (1991) plug-in rule: as if each score, of variance one, were a first-order autoregression."""

    def lags(self, blocks: Blocks, count: int, kernel: Kernel) -> float:
        power, products, last = 0.0, 0.0, None
        for block in blocks():
            joined = block if last is None else np.concatenate([last, block])
            products = products + (joined[1:] * joined[:-1]).sum(axis=0)
            power = power + (block**2).sum(axis=0)
            last = block[-1:]
        correlation = np.clip(
            np.divide(products, power, out=np.zeros_like(products), where=np.asarray(power) > 0.0),
            -LARGEST_CORRELATION,
            LARGEST_CORRELATION,
        )
        shape = (1.0 - correlation**2) ** 2 / (1.0 - correlation) ** 4  # spectrum at zero, squared
        constant, order = ANDREWS[type(kernel)]
        bend = 4.0 * correlation**2 / (1.0 - correlation) ** 4
        if order == 1:
            bend *= (1.0 - correlation) ** 2 / (1.0 + correlation) ** 2
        alpha = float((bend * shape).sum() / shape.sum())
        span = constant * (alpha * count) ** (1.0 / (2 * order + 1))
        return float(np.ceil(max(span - (1.0 if kernel.ends else 0.0), 0.0)))


def newey_west_bandwidth(count: int) -> int:
    """Rule of thumb for the number of lags, 4 (n/100)^(2/9)."""
    return int(4.0 * (count / 100.0) ** (2.0 / 9.0))
