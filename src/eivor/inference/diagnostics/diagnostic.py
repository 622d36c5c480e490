"""What every diagnostic can say: its numbers as rows, itself in lines, and what should be known of it.

A diagnostic is one file: the statistic, what it is held against, its rows and its sentences. Whoever tells
of it, a table, a report or a verdict, reads the same object, and so the same number.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from eivor.inference.verdict import Reason
from eivor.shapes import Float

#: Level at which a test speaks: four tests of a good estimate are silent together in 96 records of 100.
SIGNIFICANT = 0.01
#: Level from which on what a test says is beyond doubt, so that a verdict may rest on it.
BEYOND_DOUBT = 0.001


@dataclass(frozen=True, slots=True)
class Row:
    """One number of a diagnostic.

    Parameters
    ----------
    diagnostic : str
        Name of the number.
    of : str
        Parameter, lag or band that it is of; empty for the whole.
    value : float
        The number.
    compare : float or None
        The critical value, p-value, standard error or band that it is to be held against.
    """

    diagnostic: str
    of: str
    value: float
    compare: float | None


@dataclass(frozen=True)
class Subject:
    """What a diagnostic is of, as its sentences name it.

    Parameters
    ----------
    names : tuple of str
        Each joint parameter.
    std_errors : ndarray, shape (n,)
        Of the parameters.
    at_row : callable
        Where a row of the record is, in words.
    rows : int
        Rows of the record.
    """

    names: tuple[str, ...]
    std_errors: Float[np.ndarray, " n"]
    at_row: Callable[[int], str]
    rows: int

    def when(self, share: float) -> str:
        """Where a share of the rows is, in words."""
        return self.at_row(round(share * self.rows))


class Diagnostic(ABC):
    """A statistic with what it is held against, its rows and its sentences."""

    @abstractmethod
    def rows(self, of: Subject, /) -> Iterator[Row]:
        """Every number."""

    @abstractmethod
    def lines(self, of: Subject, /) -> Iterator[str]:
        """The main numbers, a line each."""

    def reasons(self, _of: Subject, /) -> Iterator[Reason]:
        """What speaks against the estimate or should be known of it, each with what to do."""
        return iter(())


def told(p_value: float, words: tuple[str, str, str]) -> str:
    """Word for the outcome of a test: kept, doubtful, rejected.

    Parameters
    ----------
    p_value : float
        Of the test.
    words : tuple of str
        For p-values from `SIGNIFICANT` on, above `BEYOND_DOUBT`, and from there down.
    """
    if p_value >= SIGNIFICANT:
        return words[0]
    return words[1] if p_value > BEYOND_DOUBT else words[2]
