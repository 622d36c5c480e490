"""The grid of a flight study: read from its published file, checked, and laid out flight by flight.

The file is data (its own comments say what each key means). This module turns it into specifications:
every combination of a class's fixed values, with what is left open drawn, see `validation.drawn`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from itertools import product
from pathlib import Path

from eivor.simulation.environment import NoiseKind, SensorNoise, TrajectoryKind
from eivor.simulation.vertical import VerticalFlightSpec
from eivor.strict_toml import TomlTable, read_toml, toml_table
from validation.drawn import Draw, Value, draws, lists
from validation.flight_recipe.rotorpy_flight import RotorpyFlightSpec
from validation.flight_recipe.rotorpy_vehicles import Vehicle

FlightSpec = VerticalFlightSpec | RotorpyFlightSpec

#: What a class may be scored as.
KINDS = ("excited", "climbs", "hover", "hover-steps")
SIMULATORS = ("vertical", "rotorpy")


@dataclass(frozen=True, slots=True)
class FlightCase:
    """One flight of the grid."""

    name: str  # Class and number in the class
    flight_class: str  # Class
    simulator: str  # "vertical" or "rotorpy"
    kind: str  # What it is scored as, one of `KINDS`
    calm: bool  # Excited, with gusts up to the grid's limit
    small: bool  # Flown in the small size too
    spec: FlightSpec  # The flight


@dataclass(frozen=True, slots=True)
class FlightGrid:
    """All flights of a study."""

    name: str  # Name of the grid
    calm_up_to: float  # Largest gusts of a calm flight [m/s]
    cases: tuple[FlightCase, ...]  # In the order of the file

    def small(self) -> FlightGrid:
        """Return the small size: the flights that the file picks out."""
        return FlightGrid(self.name, self.calm_up_to, tuple(case for case in self.cases if case.small))


def published_grid() -> FlightGrid:
    """Return the grid that comes with the package."""
    text = files("validation.flight_recipe").joinpath("grid.toml").read_text(encoding="utf-8")
    return flight_grid(text)


def read_grid(path: Path) -> FlightGrid:
    """Grid from a file; see `flight_grid`."""
    return _grid(read_toml(path, "a grid"))


def flight_grid(text: str) -> FlightGrid:
    """Grid from the text of a TOML file."""
    return _grid(toml_table(text, Path("grid.toml"), "a grid"))


def _grid(table: TomlTable) -> FlightGrid:
    name, duration, calm_up_to = table.text("name"), table.number("duration"), table.number("calm_up_to")
    drawn = {simulator: draws(table, simulator) for simulator in SIMULATORS}
    cases: list[FlightCase] = []
    for entry in table.sections("class"):
        cases.extend(_class_cases(entry, drawn, duration, calm_up_to))
    table.finish()
    names = [case.name for case in cases]
    seeds = [case.spec.seed for case in cases]
    if len(set(names)) < len(names) or len(set(seeds)) < len(seeds):
        raise table.wrong(
            "class",
            "flights with names and seeds of their own",
            "classes of one name, or whose seeds overlap",
            "Give each class its name, and a seed further away from the next than it has flights.",
        )
    return FlightGrid(name, calm_up_to, tuple(cases))


def _class_cases(
    entry: TomlTable, drawn: Mapping[str, dict[str, Draw]], duration: float, calm_up_to: float
) -> list[FlightCase]:
    name, kind = entry.text("name"), entry.choice("kind", KINDS)
    simulator = entry.choice("simulator", SIMULATORS)
    every = lists(entry.section("every"))
    open_draws = drawn[simulator] | draws(entry, "draw")
    seed, replicates, small_every = (
        entry.whole("seed"),
        entry.whole("replicates"),
        entry.whole("small_every", 0),
    )
    entry.finish()
    combinations = [dict(zip(every, values, strict=True)) for values in product(*every.values())] * replicates
    cases = []
    for number, fixed in enumerate(combinations):
        open_values = {
            key: draw.value(seed + number, key) for key, draw in open_draws.items() if key not in fixed
        }
        spec = _spec(entry, simulator, fixed | open_values, seed + number, duration)
        calm = kind == "excited" and spec.gust_rms <= calm_up_to
        small = small_every > 0 and number % small_every == 0
        cases.append(FlightCase(f"{name} {number:03d}", name, simulator, kind, calm, small, spec))
    return cases


def _spec(
    entry: TomlTable, simulator: str, values: Mapping[str, Value], seed: int, duration: float
) -> FlightSpec:
    """Specification with these values; noise levels and kind go into one `SensorNoise`."""
    given = dict(values)
    try:
        noise = SensorNoise(
            kind=NoiseKind(str(given.pop("noise"))),
            acceleration=float(given.pop("acceleration_noise")),
            velocity=float(given.pop("velocity_noise")),
            position=float(given.pop("position_noise")),
        )
        trajectory = TrajectoryKind(str(given.pop("trajectory")))
        vehicle = {"vehicle": Vehicle(str(given.pop("vehicle")))} if simulator == "rotorpy" else {}
        numbers = {key: float(value) for key, value in given.items()}
        common = {"noise": noise, "trajectory": trajectory, "seed": seed, "duration": duration}
        maker = RotorpyFlightSpec if simulator == "rotorpy" else VerticalFlightSpec
        return maker(**(vehicle | numbers | common))  # type: ignore[arg-type]
    except (KeyError, TypeError, ValueError) as error:
        expected = f"every value of a flight of the simulator '{simulator}', and no other,"
        raise entry.wrong("", expected, f"{error!r}") from error
