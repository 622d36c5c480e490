"""Functions that say how far they are, to those who wait for them in another process."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

#: Takes what is told.
Tell = Callable[[Any], None]


class Telling(ABC):
    """A function of an item that tells on the way; it is pickled, as is what it tells."""

    @abstractmethod
    def __call__(self, item: Any, tell: Tell) -> Any:
        """Result of an item."""


def nobody(_told: Any, /) -> None:
    """Tell nobody."""
