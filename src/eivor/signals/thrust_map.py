"""Maps from commands to thrust."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from eivor.errors import UsageError, did_you_mean
from eivor.tools import Float


@dataclass(frozen=True, slots=True)
class Power:
    """``state ** exponent``, sign kept: 1 for thrust commands, 2 for rotor speeds."""

    exponent: float = 1.0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.exponent) and self.exponent > 0.0):
            expected = "a positive exponent of the input map"
            raise UsageError(expected, f"{self.exponent}", "Use linear, square or power:1.5.")

    @property
    def name(self) -> str:
        """The word that the command line and channel maps use."""
        return {1.0: "linear", 2.0: "square"}.get(self.exponent, f"power:{_shortest(self.exponent)}")

    def __call__(self, state: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """Mapped value of each state."""
        if self.exponent == 1.0:
            return state
        if self.exponent == 2.0:
            return np.multiply(size := np.abs(state), state, out=size)
        return np.asarray(np.sign(state) * np.abs(state) ** self.exponent)

    def inverse(self, mapped: float) -> float:
        """State whose mapped value is `mapped`; NaN when there is none."""
        return float(np.sign(mapped) * np.abs(mapped) ** (1.0 / self.exponent))

    def slope(self, state: float) -> float:
        """Derivative of the mapped value at `state`."""
        return float(self.exponent * np.abs(state) ** (self.exponent - 1.0))


@dataclass(frozen=True, slots=True)
class Mixed:
    """``(1 - share) state + share state**2``: PX4's thrust curve, share = THR_MDL_FAC."""

    share: float  # Between 0 and 1

    def __post_init__(self) -> None:
        if not 0.0 <= self.share <= 1.0:
            raise UsageError("a share between 0 and 1", f"mixed:{self.share}", "Use mixed:0.3, for example.")

    @property
    def name(self) -> str:
        return f"mixed:{_shortest(self.share)}"

    def __call__(self, state: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        return (1.0 - self.share) * state + self.share * state * np.abs(state)

    def inverse(self, mapped: float) -> float:
        if mapped < 0.0:
            return float("nan")
        linear = 1.0 - self.share
        return (
            float(2.0 * mapped / (linear + np.sqrt(linear**2 + 4.0 * self.share * mapped))) if mapped else 0.0
        )

    def slope(self, state: float) -> float:
        return float(1.0 - self.share + 2.0 * self.share * np.abs(state))


#: A monotone map of an actuator's state (zero or more) to thrust per unit of gain.
InputMap: TypeAlias = Power | Mixed


def _shortest(number: float) -> str:
    """Fewest digits that give the number back."""
    return f"{number:g}" if float(f"{number:g}") == number else repr(float(number))


def input_map(name: str) -> InputMap:
    """Input map of a name: linear, square, power:EXPONENT, or mixed:SHARE."""
    word, _, number = name.partition(":")
    try:
        if word in {"linear", "square"} and not number:
            return Power(1.0 if word == "linear" else 2.0)
        if word == "power":
            return Power(float(number))
        if word == "mixed":
            return Mixed(float(number))
    except ValueError:
        pass
    expected = "an input map linear, square, power:EXPONENT or mixed:SHARE"
    remedy = "Rotor speeds want square, thrust setpoints linear."
    raise UsageError(
        expected, f"'{name}'", did_you_mean(word, ("linear", "square", "power", "mixed"), remedy)
    )
