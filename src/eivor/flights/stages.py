"""How far an identification is, for those who wait for it."""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum


class Stage(StrEnum):
    """What an identification is at."""

    PREPARING = "preparing"
    IDENTIFYING = "identifying"
    DIAGNOSING = "diagnosing"


#: Called with each stage when it begins.
Progress = Callable[[Stage], None]


def silent(_stage: Stage, /) -> None:
    """Tell nobody."""
