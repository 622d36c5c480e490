"""Quantities of a grid that are drawn for each flight: a range, or a set, as its file says.

Each is drawn from a stream that belongs to the flight's seed and to the quantity's name, so that no draw
depends on another.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

from eivor.strict_toml import TomlTable

Value = float | str

RANGES = ("uniform", "log_uniform")
RULES = (*RANGES, "choice")
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


def draws(outer: TomlTable, key: str) -> dict[str, Draw]:
    """What a table says is drawn, by name; nothing without the key."""
    if not outer.has(key):
        return {}
    table = outer.section(key)
    result: dict[str, Draw] = {}
    for rule in RULES:
        part = table.section(rule) if table.has(rule) else table.part({}, rule)
        for name, values in lists(part).items():
            result[name] = Draw(rule, values)
            ends = part.numbers(name) if rule in RANGES else (0.0, 1.0)
            if len(ends) != 2 or ends[0] >= ends[1]:
                raise part.wrong(name, "a range of two numbers, the smaller first,", f"{list(ends)}")
    table.finish()
    return result


def lists(table: TomlTable) -> dict[str, tuple[Value, ...]]:
    return {key: _words_or_numbers(table, key) for key in table.values}


def _words_or_numbers(table: TomlTable, key: str) -> tuple[Value, ...]:
    given = table.values[key]
    words = isinstance(given, list) and bool(given) and isinstance(given[0], str)
    values = table.texts(key) if words else table.numbers(key)
    if not values:
        raise table.wrong(key, "one value or more", "none")
    return values
