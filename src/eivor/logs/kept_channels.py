"""Channels of a log of any length: as many as fit stay in memory, others are made when they are asked for.

A part of a long log is read like a log of its own, so that it costs what a log of its length does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from math import inf

from eivor.signals.made_channels import MadeChannels
from eivor.signals.recording import Channel

#: What reads a part of a log, see `KeptChannels`.
Cut = Callable[[float, float, float], "KeptChannels"]
#: What stays in memory: all channels of most logs [bytes].
KEPT_BYTES = 48 << 20


@dataclass(slots=True)
class KeptChannels(MadeChannels):
    """Channels by name, the first of which are kept.

    Parameters
    ----------
    limit : int
        What kept channels may hold together [bytes].
    cut : callable, optional
        Reads a part of the log: from one second to another, its samples so many seconds apart.
    """

    limit: int = KEPT_BYTES
    cut: Cut | None = None
    _makers: dict[str, Callable[[], Channel]] = field(default_factory=dict)
    _kept: dict[str, Channel] = field(default_factory=dict)
    _held: dict[int, int] = field(default_factory=dict)
    _span_s: tuple[float, float] = (inf, -inf)

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
        if channel.time_s.size:
            first, last = self._span_s
            self._span_s = min(first, float(channel.time_s[0])), max(last, float(channel.time_s[-1]))
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

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last stamp over all channels [s]."""
        first, last = self._span_s
        return (first, last) if first <= last else (0.0, 0.0)

    def part(self, start_s: float, end_s: float, step_s: float = 0.0) -> MadeChannels:
        """Return the channels of a part of the log, all of it where it cannot be cut."""
        if self.cut is None:
            return self
        found = self.cut(start_s, end_s, step_s)
        found._span_s = self._span_s
        return found

    def __getitem__(self, name: str) -> Channel:
        kept = self._kept.get(name)
        return self._makers[name]() if kept is None else kept

    def __contains__(self, name: object) -> bool:
        return name in self._makers

    def __iter__(self) -> Iterator[str]:
        return iter(self._makers)

    def __len__(self) -> int:
        return len(self._makers)
