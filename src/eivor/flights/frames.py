"""Frames: turn a recording's axes to z up.

From north-east-down and forward-right-down to north-west-up and forward-left-up is half a turn about x
for the world and the body alike: y and z of every vector change sign, and so do y and z of the attitude
quaternion. The vertical model needs no particular heading of the horizontal axes.
"""

from __future__ import annotations

from dataclasses import replace

from eivor.signals.canonical import canonical_channel
from eivor.signals.recording import Frame, Recording


def upward(recording: Recording) -> Recording:
    """Return the same recording with z up."""
    if recording.frame is Frame.Z_UP:
        return recording
    channels = {
        name: replace(channel, values=-channel.values) if _flipped(name) else channel
        for name, channel in recording.channels.items()
    }
    return replace(recording, channels=channels, frame=Frame.Z_UP)


def _flipped(name: str) -> bool:
    channel = canonical_channel(name)
    return channel is not None and channel.flipped
