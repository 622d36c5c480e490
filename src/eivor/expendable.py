"""Whether this process may die of what it reads, because another one waits for it and goes on without it."""

from __future__ import annotations

_SAID: list[bool] = []


def may_die() -> None:
    """Say that this process was begun to die of what it reads, where that is hostile."""
    _SAID.append(True)


def is_expendable() -> bool:
    """Whether that was said: then nothing needs to be tried in a further process first."""
    return bool(_SAID)
