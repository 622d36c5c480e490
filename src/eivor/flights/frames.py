"""Frames: turn a recording's axes to z up.

From north-east-down and forward-right-down to north-west-up and forward-left-up is half a turn about x
for the world and the body alike: y and z of every vector change sign, and so do y and z of the attitude
quaternion. The vertical model needs no particular heading of the horizontal axes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from eivor.signals.canonical import canonical_channel
from eivor.signals.made_channels import MadeChannels
from eivor.signals.recording import Channel, Frame, Recording


def upward(recording: Recording) -> Recording:
    """Return the same recording with z up."""
    if recording.frame is Frame.Z_UP:
        return recording
    logged = recording.channels
    channels: Mapping[str, Channel]
    if isinstance(logged, MadeChannels):
        channels = _TurnedChannels(logged)
    else:
        channels = {name: _turned(channel) for name, channel in logged.items()}
    return replace(recording, channels=channels, frame=Frame.Z_UP)


@dataclass(frozen=True, slots=True, eq=False)
class _TurnedChannels(MadeChannels):
    """Channels that are made, and then turned."""

    logged: MadeChannels

    def __getitem__(self, name: str) -> Channel:
        return _turned(self.logged[name])

    def __contains__(self, name: object) -> bool:
        return name in self.logged

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last stamp over all channels [s]."""
        return self.logged.span_s

    def part(self, start_s: float, end_s: float, step_s: float = 0.0) -> MadeChannels:
        """Return the channels of a part of the log."""
        return _TurnedChannels(self.logged.part(start_s, end_s, step_s))

    def __iter__(self) -> Iterator[str]:
        return iter(self.logged)

    def __len__(self) -> int:
        return len(self.logged)


def _turned(channel: Channel) -> Channel:
    return replace(channel, values=-channel.values) if _flipped(channel.name) else channel


def _flipped(name: str) -> bool:
    channel = canonical_channel(name)
    return channel is not None and channel.flipped
