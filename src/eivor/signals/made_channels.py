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

    @property
    @abstractmethod
    def span_s(self) -> tuple[float, float]:
        """First and last stamp over all channels of the log [s], without making them."""

    @abstractmethod
    def part(self, start_s: float, end_s: float, step_s: float = 0.0) -> MadeChannels:
        """Return the channels of a part of the log, or of more of it where its reader cannot cut.

        Parameters
        ----------
        start_s, end_s : float
            The part [s]. States that were set before it are in it.
        step_s : float
            Samples that are closer are thinned to this distance [s]; zero keeps all.
        """
