"""What a study must reach, and what a run of it says."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Requirement:
    """One thing that must hold.

    Parameters
    ----------
    what, asked, measured : str
        In words and numbers.
    met : bool
        Whether it holds.
    """

    what: str
    asked: str
    measured: str
    met: bool
