"""Equations: a response, and a parameter for each column it is explained by."""

from __future__ import annotations

from dataclasses import dataclass

from eivor.models.column import Column


@dataclass(frozen=True, slots=True)
class Parameter:
    """One unknown.

    Parameters
    ----------
    name : str
        Term of the field, as used in results ("viscous_friction").
    unit : str
        SI unit, empty for a pure number.
    """

    name: str
    unit: str = ""


@dataclass(frozen=True, slots=True)
class Equation:
    """``response = sum of parameter * column + error``.

    Parameters
    ----------
    response : Column
        Left side.
    terms : tuple of (Parameter, Column)
        Right side, in the order of the parameter vector.
    derivative_of : str
        Channel whose time derivative the response is, but for a constant; empty for none.
    """

    response: Column
    terms: tuple[tuple[Parameter, Column], ...]
    derivative_of: str = ""
