"""Write the tables of docs/studies/scenarios.md: every kind that a scenario file may name, with its keys.

    python -m docs.scenario_tables

The kinds come from the registry that reads the files, the words from docstrings and from the comments beside
fields. A test compares the page with what this would write.
"""

from __future__ import annotations

import inspect
import logging
import re
import sys
from collections.abc import Callable, Mapping, Set
from itertools import groupby
from pathlib import Path
from typing import Any, get_args

import griffe

from eivor.lab.disturbances import CoefficientCourse
from eivor.lab.scenario_files import (
    DISTURBANCES,
    EXCITATIONS,
    NOISES,
    parameters_of,
    shipped_files,
)
from eivor.motions.rigid_body.vehicle import BodyDrag, Rotors, Vehicle
from eivor.simulation.controller import FlightController, Sensor
from eivor.simulation.environment import SensorNoise
from eivor.simulation.rigid_body import (
    AxisExcitations,
    Logged,
    RigidBodyFlightSpec,
    Sensors,
    TorqueDisturbance,
    Wind,
)
from eivor.simulation.vertical import VerticalFlightSpec
from validation.pages import markdown, page_with

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "studies" / "scenarios.md"
#: What a value of a type is called.
WORDS: Mapping[Any, str] = {
    float: "a number",
    str: "a text",
    int: "a whole number",
    tuple[float, ...]: "a list of numbers",
    tuple[tuple[float, ...], ...]: "a list of lists of numbers",
    tuple[int, ...]: "a list of whole numbers",
    tuple[str, ...]: "a list of texts",
}
#: Keys that the command line gives, or that stand in tables of their own.
ELSEWHERE = {"seed", "noise"}


def parts() -> dict[str, str]:
    """Generated parts of the page by name."""
    flight = {"flight": VerticalFlightSpec, "its `[noise]`": SensorNoise}
    whole = {
        "flight": RigidBodyFlightSpec,
        "`[vehicle]`": Vehicle,
        "`[vehicle.rotors]`": Rotors,
        "`[vehicle.drag]`": BodyDrag,
        "`[attitude]`, `[injection]`": AxisExcitations,
        "`[controller]`": FlightController,
        "`[wind]`": Wind,
        "`[torque_disturbance]`": TorqueDisturbance,
        "`[sensors]`": Sensors,
        "each of `[sensors]`": Sensor,
        "`[logged]`": Logged,
    }
    return {
        "noises": kinds(NOISES),
        "disturbances": kinds(DISTURBANCES),
        "courses": markdown(("coefficient", "keys"), [(summary(CoefficientCourse), keys(CoefficientCourse))]),
        "excitations": kinds(EXCITATIONS),
        "flights": markdown(("table", "keys"), [(name, keys(maker)) for name, maker in flight.items()]),
        "rigid bodies": markdown(
            ("table", "keys"), [(name, keys(maker, {"seed"})) for name, maker in whole.items()]
        ),
        "shipped": shipped(),
    }


def kinds(registry: Mapping[str, Callable[..., Any]]) -> str:
    """Table of kinds."""
    rows = [
        (name if " " in name else f"`{name}`", summary(maker), keys(maker))
        for name, maker in registry.items()
    ]
    return markdown(("kind", "what it is", "keys"), rows)


def summary(maker: Callable[..., Any]) -> str:
    """Text of a docstring before its sections, on one line."""
    text = [part.value for part in sections(maker) if part.kind is griffe.DocstringSectionKind.text]
    return cell(" ".join(text))


def keys(maker: Callable[..., Any], elsewhere: Set[str] = ELSEWHERE) -> str:
    """Keys of a kind: what each means, and its default."""
    meanings = field_comments(maker) if inspect.isclass(maker) else {}
    for part in sections(maker):
        if part.kind is griffe.DocstringSectionKind.parameters:
            meanings |= {item.name: cell(item.description) for item in part.value}
    known = {name: value for name, value in parameters_of(maker).items() if name not in elsewhere}
    lines = []
    for (meaning, annotation), group in groupby(known, lambda name: (meanings[name], known[name][0])):
        names = list(group)
        each = " each" if len(names) > 1 else ""
        defaults = dict.fromkeys(
            shown(known[name][1]) for name in names if known[name][1] is not inspect.Parameter.empty
        )
        text = f"; {' and '.join(defaults)} when left out" if defaults else ""
        called = ", ".join(f"`{name}`" for name in names)
        lines.append(f"{called}, {kind_of_value(annotation)}{each}{text}: {meaning}")
    return "<br>".join(lines)


def field_comments(kind: type) -> dict[str, str]:
    """Comment of each field, beside it or above it; a field without one shares that of the field before."""
    meanings: dict[str, str] = {}
    for part in reversed(kind.__mro__[:-1]):
        above, meaning = "", ""
        for line in inspect.getsource(part).splitlines() if hasattr(part, "__dataclass_fields__") else ():
            code, mark, comment = line.strip().partition("# ")
            if mark and not code:
                above = f"{above} {comment}".strip()
            elif field := re.match(r"(\w+): ", code):
                meaning = above or comment or meaning
                meanings[field[1]] = cell(meaning.rstrip(".") + ".")
                above = ""
            elif code.startswith("def "):
                break
    return meanings


def sections(maker: Callable[..., Any]) -> list[Any]:
    """Sections of a docstring."""
    logging.getLogger("griffe").setLevel(logging.ERROR)  # a docstring without its module has no types
    return griffe.Docstring(inspect.getdoc(maker) or "", lineno=1).parse("numpy")


def kind_of_value(annotation: Any) -> str:
    """What to write for a parameter of a type."""
    if annotation in WORDS:
        return WORDS[annotation]
    options = [option for option in get_args(annotation) if option not in (type(None), ...)]
    if len(options) == 1 and annotation == (options[0] | None):
        return kind_of_value(options[0])
    if options:
        return "tables"
    if hasattr(annotation, "__members__"):
        return " or ".join(f'`"{member.value}"`' for member in annotation)
    return "a table"


def shown(default: object) -> str:
    """Return the default as TOML has it."""
    if default is None or default == ():
        return "none"
    if repr(default) == "<factory>":
        return "its own defaults"
    if hasattr(default, "value"):
        return f'`"{default.value}"`'
    if isinstance(default, tuple):
        return f"`{list(default)}`"
    return f"`{default}`"


def cell(text: str) -> str:
    """Text on one line, without what would end a cell of the table."""
    return " ".join(text.split()).replace("|", "\\|")


def shipped() -> str:
    """Table of the scenarios that come with the package, by their first comment."""
    rows = []
    for name, path in sorted(shipped_files().items()):
        lines = path.read_text(encoding="utf-8").splitlines()
        comment = [line.removeprefix("#").strip() for line in lines[: _first_without_mark(lines)]]
        rows.append((f"`{name}`", cell(" ".join(comment))))
    return markdown(("name", "what it is"), rows)


def _first_without_mark(lines: list[str]) -> int:
    return next(number for number, line in enumerate(lines) if not line.startswith("#"))


if __name__ == "__main__":
    PAGE.write_text(page_with(PAGE.read_text(encoding="utf-8"), parts()), encoding="utf-8")
    sys.stdout.write(f"{PAGE}\n")
