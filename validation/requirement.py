"""What a study must reach, and what a run of it says."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Requirement:
    """One thing that must hold."""

    what: str  # In words and numbers
    asked: str
    measured: str
    met: bool  # Whether it holds
