"""What a motion says of the parameter that can be followed over its flight."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from eivor.models.lagged_runs import LaggedRuns
from eivor.models.separable import Prior


@dataclass(frozen=True)
class Followed:
    """A parameter that is followed over a flight, and the rows that tell it.

    Parameters
    ----------
    name : str
        The parameter, one of the problem's.
    runs : LaggedRuns
        Columns of the flight.
    known : mapping of str to Prior
        What is known of other parameters.
    intercept : Prior or None
        What is known of the response without any input and motion; None for nothing.
    told : tuple of str
        The same in sentences.
    """

    name: str
    runs: LaggedRuns
    known: Mapping[str, Prior]
    intercept: Prior | None
    told: tuple[str, ...]
