"""The grid of the study: read from its published file, and checked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from eivor.strict_toml import TomlTable, toml_table
from validation.flight_recipe.rotorpy_vehicles import Vehicle
from validation.rigid_body.quantities import GROUPS
from validation.rigid_body.scenario import Asked, Scenario

GRID = Path(__file__).with_name("grid.toml")


@dataclass(frozen=True, slots=True)
class Grid:
    """What is flown."""

    name: str  # Of the grid
    seconds: float  # Of a flight [s]
    scenarios: tuple[Scenario, ...]  # In the order of the file
    text: str  # The file

    def scenario(self, name: str) -> Scenario:
        """Return a scenario by its name."""
        return next(item for item in self.scenarios if item.name == name)


@cache
def published_grid() -> Grid:
    """Return the grid that lies beside this file."""
    return grid_from(GRID.read_text(encoding="utf-8"))


def grid_from(text: str) -> Grid:
    """Grid from the text of a TOML file."""
    table = toml_table(text, GRID, "a grid")
    name, seconds = table.text("name"), table.number("seconds")
    grid = Grid(name, seconds, tuple(_scenario(section) for section in table.sections("scenario")), text)
    table.finish()
    return grid


def _scenario(table: TomlTable) -> Scenario:
    requested = Asked(
        _bounds(table, "largest"),
        _bounds(table, "rmse"),
        _bounds(table, "bias"),
        table.number("coverage_each", 0.0),
        table.numbers("coverage_pooled", ()),
    )
    named = table.texts("vehicles") if table.has("vehicles") else (str(Vehicle.CRAZYFLIE),)
    if not set(named) <= set(Vehicle):
        raise table.wrong("vehicles", f"vehicles out of {', '.join(Vehicle)}", ", ".join(named))
    scenario = Scenario(
        table.text("name"),
        table.whole("seed"),
        table.whole("flights"),
        tuple(map(Vehicle, named)),
        table.texts("methods"),
        requested,
        table.whole("others", 0),
        table.number("noise", 1.0),
        table.number("delay", 0.0),
        table.number("taken_delay") if table.has("taken_delay") else None,
        table.number("jitter", 0.0),
        table.number("command_hz", 0.0),
        table.flag("filtered", default=False),
        table.number("torque", 0.0),
        table.number("injected", 0.0),
        table.number("quickness", 0.6),
        table.number("derivative_share", 0.0),
    )
    table.finish()
    return scenario


def _bounds(table: TomlTable, key: str) -> Mapping[str, float]:
    """Bounds by group of quantities."""
    if not table.has(key):
        return {}
    section = table.section(key)
    unknown = sorted(set(section.values) - set(GROUPS))
    if unknown:
        raise table.wrong(key, f"groups out of {', '.join(GROUPS)}", ", ".join(unknown))
    results = {name: section.number(name) for name in section.values}
    section.finish()
    return results
