"""Scales of a drawing's axes: where a value stands between the ends, and which values are written there."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from eivor.shapes import Float

#: Steps between ticks are these times a power of ten.
ROUND_STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)


@dataclass(frozen=True, slots=True)
class Tick:
    """A value that is written at an axis.

    Parameters
    ----------
    at : float
        The value.
    words : str
        As it is written.
    """

    at: float
    words: str


class Scale(ABC):
    """How values of an axis are placed."""

    words: str
    """What the axis shows, with its unit."""

    @abstractmethod
    def share(self, values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Place of values: 0 at the low end, 1 at the high one, no further than these."""

    @abstractmethod
    def ticks(self, most: int) -> list[Tick]:
        """Up to about so many values to write."""


@dataclass(frozen=True, slots=True)
class Linear(Scale):
    """Equal steps.

    Parameters
    ----------
    words : str
        What the axis shows.
    low, high : float
        Its ends.
    """

    words: str
    low: float
    high: float

    def share(self, values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Place of values, see `Scale.share`."""
        return np.clip((values - self.low) / (self.high - self.low), 0.0, 1.0)

    def ticks(self, most: int) -> list[Tick]:
        """Round values, see `Scale.ticks`."""
        raw = (self.high - self.low) / most
        power = 10.0 ** math.floor(math.log10(raw))
        step = next(power * one for one in ROUND_STEPS if power * one >= raw * (1.0 - 1e-9))
        first, last = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
        values = [number * step for number in range(first, last + 1)]
        return [Tick(one, words) for one, words in zip(values, _written(values, step), strict=True)]


@dataclass(frozen=True, slots=True)
class Logarithmic(Scale):
    """Equal ratios.

    Parameters
    ----------
    words : str
        What the axis shows.
    low, high : float
        Its ends, above zero.
    """

    words: str
    low: float
    high: float

    def share(self, values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Place of values, see `Scale.share`."""
        inside = np.clip(values, self.low, self.high)
        return np.log(inside / self.low) / math.log(self.high / self.low)

    def ticks(self, most: int) -> list[Tick]:
        """Powers of ten, with others between them where there are few, see `Scale.ticks`."""
        decades = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)) + 1)
        for between in ((1, 2, 5), (1, 3), (1,)):
            values = [one * 10.0**decade for decade in decades for one in between]
            inside = [one for one in values if self.low <= one * (1 + 1e-9) and one <= self.high * (1 + 1e-9)]
            if len(inside) <= most:
                break
        if len(inside) < 2:
            return Linear(self.words, self.low, self.high).ticks(most)
        inside = inside[:: -(-len(inside) // most)]
        return [Tick(one, _power(one)) for one in inside]


@dataclass(frozen=True, slots=True)
class LinearBelow(Scale):
    """Equal steps up to a value, equal ratios above it, from zero on.

    Parameters
    ----------
    words : str
        What the axis shows.
    bend, high : float
        Where the steps end, and the upper end.
    """

    words: str
    bend: float
    high: float

    def share(self, values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Place of values, see `Scale.share`."""
        return np.clip(self._bent(np.maximum(values, 0.0)) / self._bent(np.array([self.high])), 0.0, 1.0)

    def _bent(self, values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        above = 1.0 + np.log10(np.maximum(values, self.bend) / self.bend)
        return np.where(values < self.bend, values / self.bend, above)

    def ticks(self, most: int) -> list[Tick]:
        """Zero, and powers of ten above the bend, see `Scale.ticks`."""
        first = math.floor(math.log10(self.bend)) + 1
        powers = [10.0**power for power in range(first, math.floor(math.log10(self.high)) + 1)]
        return [Tick(one, _power(one)) for one in (0.0, *powers[:: -(-len(powers) // most) or 1])]


def margined(words: str, values: Float[np.ndarray, " n"], share: float = 0.06) -> Linear:
    """Linear scale over all finite values, with a margin; never empty."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    margin = share * (high - low) if high > low else 0.1 * abs(high) or 0.1
    return Linear(words, low - margin, high + margin)


def _written(values: list[float], step: float) -> list[str]:
    """Values with the decimals that their step needs; with a power of ten where they are tiny or huge."""
    largest = max((abs(one) for one in values), default=0.0)
    plain = not largest or 1e-3 <= largest < 1e6
    power = 0 if plain else math.floor(math.log10(largest))
    decimals = next(
        n for n in range(12) if n == 11 or math.isclose(round(step / 10.0**power, n), step / 10.0**power)
    )
    tail = f"e{power}" if power else ""
    return [
        f"{one / 10.0**power + 0.0:.{decimals}f}{tail if one else ''}".replace("-", "−") for one in values
    ]


def _power(value: float) -> str:
    if value == 0.0 or 1e-3 <= value < 1e5:
        return f"{value:g}"
    digit, power = f"{value:.0e}".split("e")
    return f"{digit}e{int(power)}".replace("-", "−")
