"""Canonical channels, their families and attitudes."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from enum import Enum
from types import MappingProxyType

import msgspec
import numpy as np

from eivor.errors import UsageError
from eivor.strict_toml import package_tables
from eivor.tools import Float


def roll_pitch_yaw(quaternions: Float[np.ndarray, "4 n"]) -> Float[np.ndarray, "3 n"]:
    """Roll, pitch and yaw of attitudes [rad]: about z first, then the new y, then the new x."""
    w, x, y, z = quaternions
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    known = np.isfinite(yaw)
    yaw[known] = np.unwrap(yaw[known])
    return np.stack([roll, pitch, yaw])


#: Letters of the axes and names of the angles, in their order.
AXES, ANGLES = ("x", "y", "z"), ("roll", "pitch", "yaw")
_NAME = re.compile(r"[a-z][a-z0-9_]*(?:_\*)?")
_LONGEST_NAME = 100


class CurveSide(Enum):
    """Where a command stands to the autopilot's own thrust curve, which makes motor signals of setpoints."""

    BEFORE = "before"
    BEHIND = "behind"
    UNKNOWN = ""


def common_side(sides: Iterable[CurveSide]) -> CurveSide:
    """Return the side of the thrust curve that all commands have; unknown where they differ."""
    result = set(sides)
    return result.pop() if len(result) == 1 else CurveSide.UNKNOWN


class CanonicalChannel(msgspec.Struct, frozen=True):
    """A channel that a log may hold; a name that cannot be one raises `UsageError`."""

    name: str  # Small letters, digits and `_`; a last `_*` stands for a rotor's number (1, 2, ...)
    unit: str  # SI unit, empty for a pure number
    held: bool = False  # True for commands, setpoints and states, which a channel map can change
    flipped: bool = False  # True when its sign changes as z down becomes z up: y and z of vectors
    free_unit: bool = False  # True when any unit may be logged, as part of the parameters' meaning
    exogenous: bool = False  # True for what a planner or a pilot sets: it does not answer the vehicle

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name) or len(self.name) > _LONGEST_NAME or self.name == "time":
            expected = "a name of small letters, digits and '_' for a canonical channel, other than 'time'"
            received = f"{self.name[:_LONGEST_NAME]!r}"
            raise UsageError(expected, received, "Rename it; a name for each rotor ends in '_*'.")


def _vector(stem: str, unit: str, **kinds: bool) -> tuple[CanonicalChannel, ...]:
    """The members x, y and z of a vector, or roll, pitch and yaw: all but the first are flipped."""
    members = ANGLES if stem.endswith(("reference_", "pilot_")) else AXES
    return tuple(
        CanonicalChannel(f"{stem}{name}", unit, flipped=name != members[0], **kinds) for name in members
    )


#: The channels that every installation knows.
BUILT_IN: tuple[CanonicalChannel, ...] = tuple(
    channel
    for name, row in package_tables("eivor.signals", "channels.toml").items()
    for channel in (_vector(name, **row) if name.endswith("_") else (CanonicalChannel(name, **row),))
)

#: Channels by name; motions add theirs.
_TABLE: dict[str, CanonicalChannel] = {channel.name: channel for channel in BUILT_IN}


def canonical_channels() -> Mapping[str, CanonicalChannel]:
    """Return all canonical channels by name: those built in, then those that were declared."""
    return MappingProxyType(_TABLE)


def canonical_channel(name: str) -> CanonicalChannel | None:
    """Return the entry of a channel ("rotor_command_*" for "rotor_command_1"); None when there is none."""
    if name in _TABLE:
        return None if name.endswith("*") else _TABLE[name]
    stem, _, number = name.rpartition("_")
    numbered = number.isascii() and number.isdecimal() and len(number) <= 3 and not number.startswith("0")
    return _TABLE.get(f"{stem}_*") if numbered else None


def unit_of(name: str) -> str:
    """Return the SI unit of a canonical channel, empty for a pure number."""
    channel = canonical_channel(name)
    if channel is None:
        expected = "the name of a canonical channel"
        raise UsageError(expected, f"{name!r}", f"The names are {', '.join(canonical_channels())}.")
    return channel.unit


def held_by_default(name: str) -> bool:
    """Say whether a channel of this name is one that holds its value."""
    channel = canonical_channel(name)
    return channel is not None and channel.held


def declare_channels(*declared: CanonicalChannel, replacing: bool = False) -> None:
    """Add channels to the table, for this process; `replacing` those of a name that are not built in."""
    if replacing:
        declared = tuple(item for item in declared if item.name not in {known.name for known in BUILT_IN})
        for item in declared:
            _TABLE.pop(item.name, None)
    added: dict[str, CanonicalChannel] = {}
    for channel in declared:
        taken = [other for other in (*_TABLE.values(), *added.values()) if _collide(channel, other)]
        if any(other != channel for other in taken):
            expected = "a channel that is declared once, or the same each time"
            raise UsageError(expected, f"{channel} where {taken[0]} is known", "Rename one of them.")
        added[channel.name] = channel
    _TABLE.update(added)


def _collide(first: CanonicalChannel, other: CanonicalChannel) -> bool:
    """Whether a channel of a log could be either."""
    names = first.name, other.name
    return names[0] == names[1] or any(
        stem.endswith("_*") and name.startswith(stem[:-1]) and name[len(stem) - 1 :].isdecimal()
        for stem, name in (names, names[::-1])
    )


def family_members(name: str, among: Iterable[str]) -> list[str]:
    """Names out of several that are `name`, or members of the family of that name, in their order."""
    names = set(among)
    if name in names:
        return [name]
    stem = name.rstrip("*").rstrip("_") + "_"
    suffixes = {item.removeprefix(stem) for item in names if item.startswith(stem)}
    numbers = sorted((suffix for suffix in suffixes if suffix.isdecimal()), key=int)
    return [f"{stem}{member}" for member in numbers or [axis for axis in AXES if axis in suffixes]]
