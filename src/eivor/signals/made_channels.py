"""Channels of a log that is too long for memory: each is made when it is asked for."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from eivor.signals.recording import Channel


class MadeChannels(Mapping[str, "Channel"]):
    """Channels by name, not all of which are in memory: take one at a time, and let it go."""

    @abstractmethod
    def __contains__(self, name: object) -> bool:
        """Say whether there is such a channel, without making it."""
