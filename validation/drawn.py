"""Quantities of a grid that are drawn for each flight: a range, or a set, as its file says.

Each is drawn from a stream that belongs to the flight's seed and to the quantity's name, so that no draw
depends on another.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated

import msgspec
import numpy as np

from eivor.errors import InputError
from eivor.simulation.environment import NoiseKind, SensorNoise
from validation.studies import GridStruct

Value = float | str
Values = Annotated[tuple[Value, ...], msgspec.Meta(min_length=1)]
Range = tuple[float, float]

RULES = ("uniform", "log_uniform", "choice")
#: Distinguishes the streams of drawn parameters from those that the simulators spawn.
DRAW_KEY = 99
#: Drawn numbers are rounded to so many significant digits, which a table can show in full.
DIGITS = 4


@dataclass(frozen=True, slots=True)
class Draw:
    rule: str  # One of `RULES`
    values: tuple[Value, ...]  # The ends of a range, or the members of a set

    def value(self, seed: int, name: str) -> Value:
        stream = np.random.SeedSequence(seed, spawn_key=(DRAW_KEY, zlib.crc32(name.encode())))
        rng = np.random.Generator(np.random.PCG64(stream))
        if self.rule == "choice":
            return self.values[int(rng.integers(len(self.values)))]
        low, high = (float(end) for end in self.values)
        if self.rule == "log_uniform":
            low, high = np.log(low), np.log(high)
        drawn = rng.uniform(low, high)
        return float(f"{np.exp(drawn) if self.rule == 'log_uniform' else drawn:.{DIGITS}g}")


class Drawn(GridStruct, frozen=True):
    """What is drawn, by its rule and name."""

    uniform: dict[str, Range] = msgspec.field(default_factory=dict)
    log_uniform: dict[str, Range] = msgspec.field(default_factory=dict)
    choice: dict[str, Values] = msgspec.field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, (low, high) in (self.uniform | self.log_uniform).items():
            if low >= high:
                raise ValueError(f"expected a range of {name}, the smaller first; received {low}, {high}")

    def draws(self) -> dict[str, Draw]:
        return {name: Draw(rule, values) for rule in RULES for name, values in getattr(self, rule).items()}


def sensor_noise(values: dict[str, Value]) -> SensorNoise:
    """Noise of a flight, whose levels are taken out of its values."""
    kind = NoiseKind(str(values.pop("noise")))
    levels = {name: float(values.pop(f"{name}_noise")) for name in ("acceleration", "velocity", "position")}
    return SensorNoise(kind=kind, **levels)


def check_apart(names: Sequence[str], seeds: Sequence[tuple[int, int]]) -> None:
    """Refuse parts of a grid that have one name, or whose seeds, each from one to another, overlap."""
    ranges = sorted(seeds)
    if len(set(names)) < len(names) or any(end > start for (_, end), (start, _) in pairwise(ranges)):
        raise InputError(
            "parts with names and seeds of their own",
            "some of one name, or whose seeds overlap",
            "Give each its name, and a seed further from the next than it has flights.",
        )
