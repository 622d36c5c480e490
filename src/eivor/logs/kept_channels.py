"""Channels of a log of any length: as many as fit stay in memory, others are made when they are asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

from eivor.signals.made_channels import MadeChannels
from eivor.signals.recording import Channel

#: What stays in memory: all channels of most logs [bytes].
KEPT_BYTES = 48 << 20


@dataclass(slots=True)
class KeptChannels(MadeChannels):
    """Channels by name, the first of which are kept.

    Parameters
    ----------
    limit : int
        What kept channels may hold together [bytes].
    """

    limit: int = KEPT_BYTES
    _makers: dict[str, Callable[[], Channel]] = field(default_factory=dict)
    _kept: dict[str, Channel] = field(default_factory=dict)
    _held: dict[int, int] = field(default_factory=dict)

    def put(self, channel: Channel, make: Callable[[], Channel]) -> None:
        """Add a channel, or put it in the place of another.

        Parameters
        ----------
        channel : Channel
            Kept when there is room.
        make : callable
            Makes the same channel again.
        """
        self._kept.pop(channel.name, None)
        self._makers[channel.name] = make
        # channels of one clock share its array
        arrays = {id(array): array.nbytes for array in (channel.time_s, channel.values)}
        if sum((self._held | arrays).values()) <= self.limit:
            self._held |= arrays
            self._kept[channel.name] = channel

    def settled(self) -> Mapping[str, Channel]:
        """Return the channels: as a dictionary when all of them are kept."""
        if len(self._kept) < len(self._makers):
            return self
        return {name: self._kept[name] for name in self._makers}

    def __getitem__(self, name: str) -> Channel:
        kept = self._kept.get(name)
        return self._makers[name]() if kept is None else kept

    def __contains__(self, name: object) -> bool:
        return name in self._makers

    def __iter__(self) -> Iterator[str]:
        return iter(self._makers)

    def __len__(self) -> int:
        return len(self._makers)
