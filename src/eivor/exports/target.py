"""What a target of an export is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

from eivor.exports.fitted import Exported, Fitted, Supplied


class Target(ABC):
    """A file format of those who use the numbers."""

    name: ClassVar[str]
    """Its word on the command line."""
    words: ClassVar[str]
    """What the file is."""
    ending: ClassVar[str]
    """How names of such files end."""

    @abstractmethod
    def export(self, fitted: Fitted, supplied: Supplied) -> Exported:
        """The file's content.

        Raises
        ------
        NotIdentifiedError
            When a quantity that it cannot do without is not identified, and was not given.
        UsageError
            When the result is not of the kind that the target takes.
        """
