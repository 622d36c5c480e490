"""A draw of the flights of a pool, before quantities are derived from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from eivor.models.separable import Values


@dataclass(frozen=True, slots=True)
class Drawn:
    """What a draw of flights says, before quantities are derived from it.

    Parameters
    ----------
    parameters : mapping of str to float
        Linear parameters.
    at : mapping of str to float
        Every nuisance.
    sums : mapping of str to float
        Those of `Motion.flight_sums` there, over the flights drawn.
    """

    parameters: Mapping[str, float]
    at: Values
    sums: Mapping[str, float]
