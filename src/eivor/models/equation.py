"""Equations: a response, and a parameter for each column it is explained by."""

from __future__ import annotations

from dataclasses import dataclass

from eivor.models.column import Column
from eivor.models.parameter import Parameter


@dataclass(frozen=True, slots=True)
class Equation:
    """``response = sum of parameter * column + error``.

    Parameters
    ----------
    response : Column
        Left side.
    terms : tuple of (Parameter, Column)
        Right side, in the order of the parameter vector.
    """

    response: Column
    terms: tuple[tuple[Parameter, Column], ...]
