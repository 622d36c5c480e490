"""Draws of a vehicle as a simulator's randomisation: each row is one that the flight may have been of."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

from eivor.exports.fitted import Exported, Fitted, Supplied
from eivor.exports.simulators.parts import Columns

#: What stands above draws.
JOINT = (
    "Rows are joint draws: a thrust goes with the mass of its row, so that the hover command spreads as "
    "little as the flight tells it. Numbers drawn each by itself would lose that."
)


class Randomisation(ABC):
    """A file of draws for those who train or test on many vehicles."""

    name: ClassVar[str]
    """Its word on the command line."""
    words: ClassVar[str]
    """What the file is."""

    @abstractmethod
    def export(self, fitted: Fitted, supplied: Supplied, draws: Columns, seed: int) -> Exported:
        """The file's content.

        Parameters
        ----------
        fitted, supplied : Fitted, Supplied
            As for a target.
        draws : mapping of str to ndarray, shape (n,)
            Joint draws of the parameters.
        seed : int
            Of the draws of what is supplied.

        Raises
        ------
        NotIdentifiedError, UsageError, ParameterError
            See `eivor.exports.simulators.described.describe`.
        """
