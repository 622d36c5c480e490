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
    known = {_key(kept_line): kept_line for kept_line in kept_lines(kept, Told)}
    results = []
    for cell in _cells(grid, size):
        key = _key(cell)
        if key not in known:
            known[key] = told(cell)
            keep(kept, [known[key]])
        results.append(known[key])
    requirements = tuple(_requirements(results))
    return _tables(results, requirements), requirements


def _key(first: Cell | Told) -> tuple[str, int, int, int, int, float]:
    return first.what, first.flights, first.vehicles, first.fleets, first.outliers, first.payload


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


def _requirements(tolds: list[Told]) -> Iterator[Requirement]:
    for item in tolds:
        where = f"{item.flights} flights, fleets of {item.vehicles}"
        where += f", {item.outliers} flights off" if item.outliers else ""
        where += ", growing payload" if item.payload else ""
        if item.what == "nothing":
            met = item.changes <= ALARMS
            yield Requirement(
                f"vehicles with a false alarm: {where}", f"at most {ALARMS:g}", f"{item.changes:.3f}", met
            )
        if item.what in ("nothing", "weaker") and item.vehicles > 1:
            yield Requirement(
                f"vehicles alike that are told to differ: {item.what}, {where}",
                f"at most {ALARMS:g}",
                f"{item.others:.3f}",
                item.others <= ALARMS,
            )
        for what, words, entry, measured in (
            ("wear", "the drift has the sign of the wear", SIGN, item.sign),
            ("wear", "the drift's interval holds the wear", COVERED, item.covered),
            ("step", "steps dated within three flights", DATED, item.dated),
        ):
            if item.what == what:
                yield Requirement(
                    f"{words}: {where}", f"at least {entry:g}", f"{measured:.3f}", measured >= entry
                )


def _tables(tolds: list[Told], requirements: tuple[Requirement, ...]) -> str:
    requested = [
        (requirement.what, requirement.asked, requirement.measured, "yes" if requirement.met else "no")
        for requirement in requirements
    ]
    return "\n\n".join(
        (
            f"Made by `python -m validation.fleet_changes.study` with {versions()}, seed {SEED}.",
            markdown(("what", "asked", "measured", "met"), requested),
            markdown(HEADER, map(_line, tolds)),
        )
    )


def _line(first: Told) -> tuple[str, ...]:
    wear, step = first.what == "wear", first.what == "step"
    return (
        first.what,
        f"{first.flights}",
        f"{first.vehicles}",
        f"{first.fleets}",
        f"{first.outliers}",
        f"{first.payload:g}",
        f"{first.changes:.3f}",
        f"{first.gain_changes:.3f}",
        f"{first.sign:.3f}" if wear else "-",
        f"{first.covered:.3f}" if wear else "-",
        f"{first.dated:.3f}" if step else "-",
        f"{first.held:.3f}" if step else "-",
        f"{first.deviating:.3f}" if first.outliers else "-",
        f"{first.wrong:.4f}",
        f"{first.differing:.3f}" if first.what == "weaker" else "-",
        f"{first.others:.3f}",
    )


COMMAND = KeptStudyCommand("validation.fleet_changes.study", __doc__, GRID, PART, answer)
main = COMMAND.main


if __name__ == "__main__":
    sys.exit(main())
