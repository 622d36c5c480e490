"""The grid of a flight study: read from its published file, checked, and laid out flight by flight.

The file is data (its own comments say what each key means). This module turns it into specifications:
every combination of a class's fixed values, with what is left open drawn from streams that belong to the
flight's seed and the drawn quantity's name, so that no draw depends on another.
"""

from __future__ import annotations

import tomllib
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from itertools import product
from pathlib import Path

import numpy as np

from eivor.errors import UsageError
from eivor.simulation.flights.sensor_noise import NoiseKind, SensorNoise
from eivor.simulation.flights.trajectories import TrajectoryKind
from eivor.simulation.flights.vertical_flight_spec import VerticalFlightSpec
from validation.flight_recipe.rotorpy_flight import RotorpyFlightSpec
from validation.flight_recipe.rotorpy_vehicles import Vehicle

FlightSpec = VerticalFlightSpec | RotorpyFlightSpec
Value = float | str

#: What a class may be scored as.
KINDS = ("excited", "climbs", "hover", "hover-steps")
SIMULATORS = ("vertical", "rotorpy")
DRAWS = ("uniform", "log_uniform", "choice")
#: Distinguishes the streams of drawn parameters from those that the simulators spawn.
DRAW_KEY = 99
#: Drawn numbers are rounded to so many significant digits, which a table can show in full.
DIGITS = 4


@dataclass(frozen=True, slots=True)
class FlightCase:
    """One flight of the grid.

    Parameters
    ----------
    name : str
        Class and number in the class.
    flight_class : str
        Class.
    simulator : str
        "vertical" or "rotorpy".
    kind : str
        What it is scored as, one of `KINDS`.
    calm : bool
        Excited, with gusts up to the grid's limit.
    small : bool
        Flown in the small size too.
    spec : VerticalFlightSpec or RotorpyFlightSpec
        The flight.
    """

    name: str
    flight_class: str
    simulator: str
    kind: str
    calm: bool
    small: bool
    spec: FlightSpec


@dataclass(frozen=True, slots=True)
class FlightGrid:
    """All flights of a study.

    Parameters
    ----------
    name : str
        Name of the grid.
    calm_up_to : float
        Largest gusts of a calm flight [m/s].
    cases : tuple of FlightCase
        In the order of the file.
    """

    name: str
    calm_up_to: float
    cases: tuple[FlightCase, ...]

    def small(self) -> FlightGrid:
        """Return the small size: the flights that the file picks out."""
        return FlightGrid(self.name, self.calm_up_to, tuple(case for case in self.cases if case.small))


def published_grid() -> FlightGrid:
    """Return the grid that comes with the package."""
    text = files("validation.flight_recipe").joinpath("grid.toml").read_text(encoding="utf-8")
    return flight_grid(text)


def read_grid(path: Path) -> FlightGrid:
    """Grid from a file; see `flight_grid`."""
    return flight_grid(path.read_text(encoding="utf-8"))


def flight_grid(text: str) -> FlightGrid:
    """Grid from the text of a TOML file.

    Raises
    ------
    UsageError
        When it is not TOML, a key is missing or unknown, a value is of the wrong type, or a flight's
        specification is out of range.
    """
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise UsageError("a grid in TOML", f"{error}", "Correct the file.") from error
    _check_keys("the grid", table, {"name", "duration", "calm_up_to", "class"}, set(SIMULATORS))
    duration, calm_up_to = (_number("the grid", table, key) for key in ("duration", "calm_up_to"))
    cases: list[FlightCase] = []
    for entry in table["class"]:
        cases.extend(_class_cases(entry, table, duration, calm_up_to))
    names = [case.name for case in cases]
    seeds = [case.spec.seed for case in cases]
    if len(set(names)) < len(names) or len(set(seeds)) < len(seeds):
        raise UsageError(
            "flights with names and seeds of their own",
            "classes of one name, or whose seeds overlap",
            "Give each class its name, and a seed further away from the next than it has flights.",
        )
    return FlightGrid(str(table["name"]), calm_up_to, tuple(cases))


def _class_cases(
    entry: Mapping[str, object], table: Mapping[str, object], duration: float, calm_up_to: float
) -> list[FlightCase]:
    where = f"class '{entry.get('name', '?')}'"
    _check_keys(
        where, entry, {"name", "simulator", "kind", "seed", "replicates", "every"}, {"draw", "small_every"}
    )
    name, simulator, kind = (str(entry[key]) for key in ("name", "simulator", "kind"))
    if kind not in KINDS or simulator not in SIMULATORS:
        raise UsageError(
            f"a kind out of {', '.join(KINDS)} and a simulator out of {', '.join(SIMULATORS)}",
            f"'{kind}' and '{simulator}' in {where}",
            "Correct the grid.",
        )
    every = _lists(where, entry["every"])
    draws = _draws(where, table.get(simulator, {})) | _draws(where, entry.get("draw", {}))
    seed, replicates = (int(_number(where, entry, key)) for key in ("seed", "replicates"))
    small_every = int(_number(where, entry, "small_every")) if "small_every" in entry else 0
    combinations = [dict(zip(every, values, strict=True)) for values in product(*every.values())] * replicates
    cases = []
    for number, fixed in enumerate(combinations):
        drawn = {key: draw.value(seed + number, key) for key, draw in draws.items() if key not in fixed}
        spec = _spec(where, simulator, fixed | drawn, seed + number, duration)
        calm = kind == "excited" and spec.gust_rms <= calm_up_to
        small = small_every > 0 and number % small_every == 0
        cases.append(FlightCase(f"{name} {number:03d}", name, simulator, kind, calm, small, spec))
    return cases


@dataclass(frozen=True, slots=True)
class _Draw:
    """How a quantity is drawn: a range, or a set."""

    rule: str
    values: tuple[Value, ...]

    def value(self, seed: int, name: str) -> Value:
        """Value for the flight of that seed."""
        stream = np.random.SeedSequence(seed, spawn_key=(DRAW_KEY, zlib.crc32(name.encode())))
        rng = np.random.Generator(np.random.PCG64(stream))
        if self.rule == "choice":
            return self.values[int(rng.integers(len(self.values)))]
        low, high = (float(end) for end in self.values)
        if self.rule == "log_uniform":
            low, high = np.log(low), np.log(high)
        drawn = rng.uniform(low, high)
        return float(f"{np.exp(drawn) if self.rule == 'log_uniform' else drawn:.{DIGITS}g}")


def _draws(where: str, table: object) -> dict[str, _Draw]:
    if not isinstance(table, Mapping):
        raise UsageError("tables of what is drawn", f"{table!r} in {where}", "Correct the grid.")
    _check_keys(where, table, set(), set(DRAWS))
    found: dict[str, _Draw] = {}
    for rule, quantities in table.items():
        for key, values in _lists(where, quantities).items():
            numeric = all(isinstance(value, float) for value in values)
            if rule != "choice" and not (len(values) == 2 and numeric and values[0] < values[1]):  # type: ignore[operator]
                raise UsageError(
                    f"a range of two numbers for {key}", f"{list(values)} in {where}", "Correct the grid."
                )
            found[key] = _Draw(rule, values)
    return found


def _spec(where: str, simulator: str, values: Mapping[str, Value], seed: int, duration: float) -> FlightSpec:
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
        raise UsageError(
            f"every value of a flight of the simulator '{simulator}', and no other",
            f"{error!r} in {where}",
            "Correct the grid.",
        ) from error


def _check_keys(where: str, table: Mapping[str, object], needed: set[str], optional: set[str]) -> None:
    if missing := needed - table.keys():
        raise UsageError(
            f"the keys {', '.join(sorted(needed))} in {where}", f"none called {missing}", "Add it."
        )
    if unknown := table.keys() - needed - optional:
        raise UsageError(
            f"no keys but {', '.join(sorted(needed | optional))} in {where}",
            f"{sorted(unknown)}",
            "Remove it.",
        )


def _number(where: str, table: Mapping[str, object], key: str) -> float:
    value = table[key]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise UsageError(f"a number for {key} in {where}", f"{value!r}", "Correct the grid.")
    return float(value)


def _lists(where: str, table: object) -> dict[str, tuple[Value, ...]]:
    """Lists of numbers or words by name."""
    if not isinstance(table, Mapping):
        raise UsageError(f"lists of values in {where}", f"{table!r}", "Correct the grid.")
    found: dict[str, tuple[Value, ...]] = {}
    for key, values in table.items():
        if not isinstance(values, Sequence) or isinstance(values, str) or not values:
            raise UsageError(f"a list of values for {key} in {where}", f"{values!r}", "Correct the grid.")
        found[key] = tuple(value if isinstance(value, str) else float(value) for value in values)
    return found
