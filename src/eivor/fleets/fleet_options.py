"""What is asked of every log of a fleet, and the hash that rows of one table have in common."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from fnmatch import fnmatchcase
from importlib.metadata import version
from pathlib import Path
from typing import Any

from eivor.errors import UsageError
from eivor.fleets.named_by_path import PathPattern
from eivor.flights.motion import Motion
from eivor.flights.options import FlightOptions
from eivor.logs.channel_map import load_channel_map, shipped_maps
from eivor.motions import DEFAULT, motion_by_name
from eivor.process_pool import Limits

#: Digits of the hash that rows are marked with.
HASH_DIGITS = 16


@dataclass(frozen=True, slots=True)
class FleetOptions:
    """What is asked of every log."""

    motion: str = DEFAULT  # name of the motion
    vehicle_file: str = ""  # vehicle of the motions that ask for one: a name, or a file
    flight: FlightOptions = field(default_factory=FlightOptions)  # of every identification
    # patterns of logs' or files' names, and channel maps (names or files); the first that fits is taken
    maps: tuple[tuple[str, str], ...] = ()
    # pattern of paths with ``{vehicle}``, see `PathPattern`, or a column of the list or of the logs;
    # empty for the board's id
    vehicle_from: str = ""
    limits: Limits = field(default_factory=Limits)  # of one log

    def __post_init__(self) -> None:
        self.chosen_motion()
        for _, chosen in self.maps:
            load_channel_map(chosen)
        self.pattern()

    def chosen_motion(self) -> Motion[Any]:
        """The motion, of its vehicle; its channels are known from then on."""
        motion = motion_by_name(self.motion)
        return motion.of_vehicle(self.vehicle_file) if self.vehicle_file else motion

    def pattern(self) -> PathPattern | None:
        """Pattern of paths; None when there is none."""
        return PathPattern(self.vehicle_from) if "{" in self.vehicle_from else None

    def map_of(self, name: str) -> str:
        """Channel map of a log; empty for none."""
        names = (name, name.rpartition("/")[2])
        return next((one for pattern, one in self.maps if any(fnmatchcase(n, pattern) for n in names)), "")

    def document(self) -> dict[str, Any]:
        """Everything that rows depend on, as JSON: files by their content's hash."""
        return {
            "motion": self.motion,
            "vehicle": _content(self.vehicle_file),
            "flight": _plain(asdict(self.flight)),
            "maps": [[pattern, _content(one)] for pattern, one in self.maps],
            "vehicle_from": self.vehicle_from,
            "limits": asdict(self.limits),
        }

    def hash(self) -> str:
        """What rows of the same options are marked with."""
        text = json.dumps(self.document(), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()[:HASH_DIGITS]

    def marks(self) -> dict[str, str]:
        """Columns that all rows have alike."""
        return {"motion": self.motion, "eivor_version": version("eivor"), "options_hash": self.hash()}


def given_maps(texts: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    """Patterns and maps as typed: ``PATTERN=MAP``; a map alone is that of all logs."""
    found = []
    for text in texts:
        pattern, equals, chosen = text.rpartition("=")
        if not chosen or (equals and not pattern):
            raise UsageError(
                f"PATTERN=MAP, with a file or one of {', '.join(shipped_maps())}",
                f"'{text}'",
                "Write --map 'lab/*.csv=lab.toml', for example.",
            )
        found.append((pattern or "*", chosen))
    return tuple(found)


def _content(text: str) -> str:
    """A name as it is, a file as its hash: another content is another choice."""
    path = Path(text)
    return f"sha256:{hashlib.sha256(path.read_bytes()).hexdigest()}" if text and path.is_file() else text


def _plain(value: Any) -> Any:
    """Value as JSON can have it."""
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(one) for one in value]
    return value if value is None or isinstance(value, str | int | float | bool) else repr(value)
