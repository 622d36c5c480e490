"""What numbers say of another flight, and the simpler models that they are held against."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np

from eivor.shapes import Float


class Horizon(Enum):
    """How far ahead a prediction looks."""

    ONE_STEP = "one_step"
    """What is measured at a sample, of everything else that is measured there."""
    OPEN_LOOP = "open_loop"
    """The state over a whole run, of its input alone."""

    @property
    def words(self) -> str:
        """In words."""
        return {"one_step": "one step ahead", "open_loop": "in open loop"}[self.value]


@dataclass(frozen=True)
class Predicted:
    """A measured quantity over the samples of all runs, run after run, and what given numbers say of it.

    Parameters
    ----------
    horizon : Horizon
        How far ahead it looks.
    quantity, unit : str
        What is measured, in words, and its unit as it is shown.
    measured, predicted : ndarray, shape (samples,)
        In that unit. What belongs to a run alone, its trim and its start, is fitted in both alike.
    """

    horizon: Horizon
    quantity: str
    unit: str
    measured: Float[np.ndarray, " samples"]
    predicted: Float[np.ndarray, " samples"]


@dataclass(frozen=True, slots=True)
class SimpleModel:
    """Numbers that a simpler way of looking at the same flight gives, to be held against an estimate.

    Parameters
    ----------
    words : str
        What it is.
    values : mapping of str to float
        Every linear parameter and every nuisance.
    """

    words: str
    values: Mapping[str, float]
