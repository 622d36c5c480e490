"""Public door `eivor.fleet`: the table of a fleet's flights for work in Python."""

from __future__ import annotations

from eivor.fleet.table import Fleet, open

__all__ = ["Fleet", "open"]


def __dir__() -> list[str]:
    return __all__
