"""The grid of the study: read from its published file, checked, and laid out flight by flight."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import cache
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import Any

from eivor.errors import InputError
from eivor.simulation.environment import NoiseKind, SensorNoise
from eivor.strict_toml import TomlTable, toml_table
from validation.drawn import Draw, Value, draws
from validation.real_logs.named import NAMES
from validation.real_logs.spec import FlightSpec, Jitter, LoggerSpec, Reference, VehicleSpec

#: Whether the model holds in a family.
HOLDS = ("yes", "short", "no")
#: What the recipe is told of the lag.
GIVEN = ("", "truth", "wrong")
GRID_FILE = "grid.toml"


@dataclass(frozen=True, slots=True)
class Family:
    """Flights of one kind."""

    name: str  # What they are
    seed: int  # First seed, and number of flights; of pools, if they are pooled
    count: int
    holds: str  # One of `HOLDS`
    lag_bias: bool  # The mean error of the lag must be small
    named: str  # What must be said of them; empty for nothing
    share: float  # In which share of them
    given: str  # One of `GIVEN`
    refused: bool  # None of them may be identified
    pool: int  # Flights of a pool; 1 for flights that are judged one by one
    shared: tuple[str, ...]  # What the flights of a pool share
    frequencies: tuple[float, ...]  # Frequencies of the references in a pool [Hz], one flight after the other
    fixed: Mapping[str, Value]  # What is the same in all of them
    drawn: Mapping[str, Draw]  # What differs

    def flight(self, number: int) -> FlightSpec:
        """Specification of a flight; of pools the flights are numbered through."""
        seed = self.seed + number
        first = self.seed + number - number % self.pool
        given: dict[str, Value] = {
            key: draw.value(first if key in self.shared else seed, key) for key, draw in self.drawn.items()
        }
        if self.frequencies:
            given["frequency"] = self.frequencies[number % self.pool % len(self.frequencies)]
        return _spec({**given, **self.fixed}, seed)


@dataclass(frozen=True, slots=True)
class Grid:
    """The study's flights."""

    name: str  # Name of the grid
    lag_given_std: float  # Standard error of a lag that is given [s]
    families: tuple[Family, ...]  # In the order of the file
    text: str  # The file

    def family(self, name: str) -> Family:
        """Return a family by its name."""
        return next(family for family in self.families if family.name == name)


@cache
def published_grid() -> Grid:
    """Return the grid that lies beside this file."""
    return grid_from(files("validation.real_logs").joinpath(GRID_FILE).read_text(encoding="utf-8"))


def grid_from(text: str) -> Grid:
    """Grid from the text of a TOML file."""
    table = toml_table(text, Path(GRID_FILE), "a grid")
    name, std, common = table.text("name"), table.number("lag_given_std"), draws(table, "draw")
    families = tuple(_family(entry, common) for entry in table.sections("family"))
    table.finish()
    taken = sorted((family.seed, family.seed + family.count * family.pool) for family in families)
    separated = all(end <= begin for (_, end), (begin, _) in pairwise(taken))
    if not separated or len({family.name for family in families}) < len(families):
        raise table.wrong(
            "family",
            "families with names and seeds of their own",
            "some of one name, or whose seeds overlap",
            "Give each its name, and a seed further from the next than it has flights.",
        )
    return Grid(name, std, families, text)


def _family(entry: TomlTable, common: Mapping[str, Draw]) -> Family:
    fixed = _fixed(entry)
    drawn = {key: draw for key, draw in {**common, **draws(entry, "draw")}.items() if key not in fixed}
    family = Family(
        entry.text("name"),
        entry.whole("seed"),
        entry.whole("flights"),
        entry.choice("holds", HOLDS, "no"),
        entry.flag("lag_bias", default=False),
        entry.choice("named", ("", *NAMES), ""),
        entry.number("share", 1.0),
        entry.choice("given", GIVEN, ""),
        entry.flag("refused", default=False),
        entry.whole("pool", 1),
        entry.texts("shared") if entry.has("shared") else (),
        entry.numbers("frequencies", ()),
        fixed,
        drawn,
    )
    entry.finish()
    try:
        family.flight(0)
    except (KeyError, TypeError, ValueError) as error:
        raise entry.wrong("", "values of a flight, and no other,", f"{error!r}") from error
    return family


def _fixed(entry: TomlTable) -> dict[str, Value]:
    if not entry.has("fixed"):
        return {}
    table = entry.section("fixed")
    result: dict[str, Value] = {
        key: table.text(key) if isinstance(value, str) else table.number(key)
        for key, value in table.values.items()
    }
    table.finish()
    return result


def _spec(values: Mapping[str, Value], seed: int) -> FlightSpec:
    """Specification with these values."""
    given = dict(values)
    noise = SensorNoise(
        kind=NoiseKind(str(given.pop("noise"))),
        acceleration=float(given.pop("acceleration_noise")),
        velocity=float(given.pop("velocity_noise")),
        position=float(given.pop("position_noise")),
    )
    parts: list[dict[str, Any]] = [
        {name: _TYPES.get(name, float)(given.pop(name)) for name in _names(kind) & given.keys()}
        for kind in (VehicleSpec, LoggerSpec, FlightSpec)
    ]
    if given:
        raise InputError("keys of a flight", ", ".join(given), "Remove them.")
    vehicle, logger, flight = parts
    return FlightSpec(VehicleSpec(**vehicle), LoggerSpec(**logger, noise=noise), seed=seed, **flight)


def _names(kind: type) -> set[str]:
    """Return the fields of a specification."""
    return {field.name for field in fields(kind)}


#: Quantities that are words, or are on or off.
_TYPES: Mapping[str, Callable[[Any], Any]] = {
    "jitter": Jitter,
    "reference": Reference,
    "multirotor": str,
    "voltage_logged": bool,
}
