"""What fleet reports say of vehicles that change, and the command that finds out.

    python -m validation.fleet_changes.study --kept FILE.jsonl [--size small|full] [--page FILE.md]

simulates the fleets of the grid beside this file, keeps every cell in the file, and prints its table: false
alarms, wear with its sign and interval, steps and their dates. The exit code is 0 when every requirement is
met, 3 when one is not, 2 for an input of no use.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

from eivor.lab.experiments import markdown
from eivor.strict_toml import read_toml
from validation.fleet_changes.trials import SEED, Cell, Told, told
from validation.kept_study import Answer, KeptStudyCommand, keep, kept_lines
from validation.requirement import Requirement
from validation.suites import versions

PART = "fleet-changes"
GRID = Path(__file__).with_name("grid.toml")
#: Asked: vehicles with a false alarm at most, or told to differ; worn ones with the sign, and with an
#: interval that covers; steps dated within three flights.
ALARMS, SIGN, COVERED, DATED = 0.05, 0.95, 0.93, 0.80
HEADER = (
    "what happens",
    "flights",
    "vehicles of a fleet",
    "fleets",
    "flights off by 30 %",
    "payload",
    "told to change, in any quantity",
    "in the gain",
    "drift's interval below zero",
    "drift's interval holds the wear",
    "step dated within 3 flights",
    "flights left open hold it",
    "flights off that are told to deviate",
    "vehicles with another that is",
    "weaker vehicles that are told to differ",
    "others that are",
)


def answer(grid: Path, size: str, kept: Path) -> Answer:
    """Simulate what the file does not have yet, and judge all of it."""
    known = {_key(one): one for one in kept_lines(kept, Told)}
    found = []
    for cell in _cells(grid, size):
        key = _key(cell)
        if key not in known:
            known[key] = told(cell)
            keep(kept, [known[key]])
        found.append(known[key])
    requirements = tuple(_requirements(found))
    return _tables(found, requirements), requirements


def _key(one: Cell | Told) -> tuple[str, int, int, int, int, float]:
    return one.what, one.flights, one.vehicles, one.fleets, one.outliers, one.payload


def _cells(grid: Path, size: str) -> Iterator[Cell]:
    root = read_toml(grid, "grid of fleets")
    weather, battery = root.number("weather"), root.number("battery")
    for table in root.sections("cells"):
        what, share = table.choice("what", ("nothing", "wear", "step", "weaker")), table.number("share")
        flights, vehicles = table.whole("flights"), table.whole("vehicles")
        fleets = {name: table.whole(name) for name in ("small", "full")}[size]
        outliers, payload = table.whole("outliers", default=0), table.number("payload", default=0.0)
        table.finish()
        yield Cell(what, share, flights, vehicles, fleets, weather, battery, outliers, payload)
    root.finish()


def _requirements(found: list[Told]) -> Iterator[Requirement]:
    for one in found:
        where = f"{one.flights} flights, fleets of {one.vehicles}"
        where += f", {one.outliers} flights off" if one.outliers else ""
        where += ", growing payload" if one.payload else ""
        if one.what == "nothing":
            met = one.changes <= ALARMS
            yield Requirement(
                f"vehicles with a false alarm: {where}", f"at most {ALARMS:g}", f"{one.changes:.3f}", met
            )
        if one.what in ("nothing", "weaker") and one.vehicles > 1:
            yield Requirement(
                f"vehicles alike that are told to differ: {one.what}, {where}",
                f"at most {ALARMS:g}",
                f"{one.others:.3f}",
                one.others <= ALARMS,
            )
        for what, words, asked, measured in (
            ("wear", "the drift has the sign of the wear", SIGN, one.sign),
            ("wear", "the drift's interval holds the wear", COVERED, one.covered),
            ("step", "steps dated within three flights", DATED, one.dated),
        ):
            if one.what == what:
                yield Requirement(
                    f"{words}: {where}", f"at least {asked:g}", f"{measured:.3f}", measured >= asked
                )


def _tables(found: list[Told], requirements: tuple[Requirement, ...]) -> str:
    asked = [(one.what, one.asked, one.measured, "yes" if one.met else "no") for one in requirements]
    return "\n\n".join(
        (
            f"Made by `python -m validation.fleet_changes.study` with {versions()}, seed {SEED}.",
            markdown(("what", "asked", "measured", "met"), asked),
            markdown(HEADER, map(_line, found)),
        )
    )


def _line(one: Told) -> tuple[str, ...]:
    wear, step = one.what == "wear", one.what == "step"
    return (
        one.what,
        f"{one.flights}",
        f"{one.vehicles}",
        f"{one.fleets}",
        f"{one.outliers}",
        f"{one.payload:g}",
        f"{one.changes:.3f}",
        f"{one.gain_changes:.3f}",
        f"{one.sign:.3f}" if wear else "-",
        f"{one.covered:.3f}" if wear else "-",
        f"{one.dated:.3f}" if step else "-",
        f"{one.held:.3f}" if step else "-",
        f"{one.deviating:.3f}" if one.outliers else "-",
        f"{one.wrong:.4f}",
        f"{one.differing:.3f}" if one.what == "weaker" else "-",
        f"{one.others:.3f}",
    )


COMMAND = KeptStudyCommand("validation.fleet_changes.study", __doc__, GRID, PART, answer)
main = COMMAND.main


if __name__ == "__main__":
    sys.exit(main())
