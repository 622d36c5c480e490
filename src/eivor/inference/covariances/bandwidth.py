"""How many lags a kernel counts: fixed, by a rule of the number of scores, or from their own correlation."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from eivor import checks
from eivor.errors import UsageError
from eivor.inference.covariances.kernel import Bartlett, Kernel, Parzen, QuadraticSpectral
from eivor.shapes import Float

#: Andrews' (1991, his (6.2)) constants, and the exponent that goes with each: 1/(2q + 1).
ANDREWS = {Bartlett: (1.1447, 1), Parzen: (2.6614, 2), QuadraticSpectral: (1.3221, 2)}
#: Largest correlation of successive scores that Andrews' rule believes.
LARGEST_CORRELATION = 0.97

Blocks = Callable[[], Iterable[Float[np.ndarray, "_ n"]]]


class Bandwidth(ABC):
    """A way to choose the bandwidth."""

    @abstractmethod
    def lags(self, blocks: Blocks, count: int, kernel: Kernel, /) -> float:
        """Bandwidth in lags.

        Parameters
        ----------
        blocks : callable
            Gives the scores in blocks, anew in each call.
        count : int
            Number of scores.
        kernel : Kernel
            What it is for.
        """


@dataclass(frozen=True, slots=True)
class FixedBandwidth(Bandwidth):
    """Chosen by the user.

    Parameters
    ----------
    bandwidth : float
        In lags.

    Raises
    ------
    UsageError
        When it is negative.
    """

    bandwidth: float | int

    def __post_init__(self) -> None:
        checks.number("bandwidth", self.bandwidth)
        if not self.bandwidth >= 0.0:
            raise UsageError("a bandwidth of zero lags or more", f"{self.bandwidth}", "Zero sees no lag.")

    def lags(self, _blocks: Blocks, _count: int, _kernel: Kernel, /) -> float:
        """The number given."""
        return float(self.bandwidth)


@dataclass(frozen=True, slots=True)
class NeweyWestRule(Bandwidth):
    """4 (N/100)^(2/9), the rule of thumb that goes with Newey and West (1994)."""

    def lags(self, _blocks: Blocks, count: int, _kernel: Kernel, /) -> float:
        """Whole lags, from the number of scores alone."""
        return float(newey_west_bandwidth(count))


@dataclass(frozen=True, slots=True)
class SquareRootRule(Bandwidth):
    """1.3 sqrt(N), which asks for fixed-b critical values (Lazarus, Lewis, Stock and Watson 2018)."""

    def lags(self, _blocks: Blocks, count: int, _kernel: Kernel, /) -> float:
        """Lags, from the number of scores alone."""
        return 1.3 * float(np.sqrt(count)) - 1.0


@dataclass(frozen=True, slots=True)
class AndrewsRule(Bandwidth):
    """Andrews' (1991) plug-in rule: as if each score were a first-order autoregression.

    Columns weigh alike: their own variance, which would depend on their unit, is divided out.
    """

    def lags(self, blocks: Blocks, count: int, kernel: Kernel) -> float:
        """Whole lags; one more pass over the scores."""
        correlation = np.clip(_lag_one(blocks()), -LARGEST_CORRELATION, LARGEST_CORRELATION)
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


def _lag_one(blocks: Iterable[Float[np.ndarray, "_ n"]]) -> Float[np.ndarray, " n"]:
    """Correlation of successive scores of each column."""
    power, products, last = 0.0, 0.0, None
    for block in blocks:
        joined = block if last is None else np.concatenate([last, block])
        products = products + (joined[1:] * joined[:-1]).sum(axis=0)
        power = power + (block**2).sum(axis=0)
        last = block[-1:]
    return np.divide(products, power, out=np.zeros_like(products), where=np.asarray(power) > 0.0)
