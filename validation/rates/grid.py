"""The grid of the study, from its file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from eivor.strict_toml import TomlTable, read_toml
from validation.rates.flights import Condition

GRID = Path(__file__).with_name("grid.toml")


@dataclass(frozen=True, slots=True)
class Grid:
    """What is flown."""

    seed: int  # Of the first flight of each cell
    seconds: float  # Of a flight [s]
    flights: Mapping[str, int]  # Of each vehicle and condition, by the size of the study
    conditions: tuple[Condition, ...]  # How


def read_grid(path: Path = GRID) -> Grid:
    """Grid of a file."""
    table = read_toml(path, "a grid")
    table.text("name")
    sizes = table.section("flights")
    grid = Grid(
        table.whole("seed"),
        table.number("seconds"),
        {size: sizes.whole(size) for size in ("small", "full")},
        tuple(_condition(section) for section in table.sections("conditions")),
    )
    sizes.finish()
    table.finish()
    return grid


def _condition(table: TomlTable) -> Condition:
    condition = Condition(
        table.text("name"),
        table.number("steps"),
        table.number("setpoint_hz"),
        table.choice("judged", ("50 Hz", "250 Hz", "small")),
    )
    table.finish()
    return condition
