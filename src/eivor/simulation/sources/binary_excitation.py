"""Pseudo-random binary sequences of maximal length."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eivor.shapes import Float
from eivor.simulation.sources.excitation import Excitation
from eivor.simulation.sources.parameter_checks import non_negative, require

#: Stages whose sum feeds the register, from its length: primitive polynomials over the integers modulo 2.
_FEEDBACK = {
    2: (2, 1),
    3: (3, 2),
    4: (4, 3),
    5: (5, 3),
    6: (6, 5),
    7: (7, 6),
    8: (8, 6, 5, 4),
    9: (9, 5),
    10: (10, 7),
    11: (11, 9),
    12: (12, 11, 10, 4),
    13: (13, 12, 11, 8),
    14: (14, 13, 12, 2),
    15: (15, 14),
    16: (16, 15, 13, 4),
}


@dataclass(frozen=True, slots=True)
class PseudoRandomBinary(Excitation):
    """Pseudo-random binary sequence of maximal length, at plus or minus an amplitude.

    Parameters
    ----------
    amplitude : float
        Absolute value at every sample.
    register : int
        Stages of the shift register, 2 to 16; the period is 2^register - 1 values.
    hold : int
        Samples for which each value is held.

    Notes
    -----
    The first value comes from the generator, by a shift along the period; the rest follows.
    """

    amplitude: float
    register: int = 10
    hold: int = 1

    def __post_init__(self) -> None:
        non_negative("amplitude", self.amplitude)
        least, most = min(_FEEDBACK), max(_FEEDBACK)
        require(
            least <= self.register <= most,
            f"a register of {least} to {most} stages",
            f"register={self.register}",
        )
        require(self.hold >= 1, "hold of 1 or more", f"hold={self.hold}")

    def sample(self, count: int, _step_s: float, rng: np.random.Generator, /) -> Float[np.ndarray, " count"]:
        """A stretch of the sequence."""
        period = maximal_sequence(self.register)
        start = int(rng.integers(period.size))
        return self.amplitude * period[(start + np.arange(count) // self.hold) % period.size]


def maximal_sequence(register: int) -> Float[np.ndarray, " period"]:
    """One period of the maximal binary sequence of plus and minus one. Performs no checks."""
    stages = [1] * register
    period = np.empty((1 << register) - 1)
    for k in range(period.size):
        period[k] = 2.0 * stages[-1] - 1.0
        fed = 0
        for stage in _FEEDBACK[register]:
            fed ^= stages[stage - 1]
        stages = [fed, *stages[:-1]]
    return period
