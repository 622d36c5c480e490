"""Parameters: what an equation's unknowns are called and measured in."""

from __future__ import annotations

from dataclasses import dataclass


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
