"""Planned flights against flights, and the command that flies them.

    python -m validation.plan.study --kept FILE.jsonl [--size small|full] [--page docs/studies/coverage.md]

Each vehicle of the grid beside this file flies a first flight that tells too little, along small steps about
a hover. A plan is made after its result, for friction and for lag in turn, and flown with another controller,
in other gusts and with other noise. The flight's half-widths are held against those that the plan printed.
Every flight is kept in the file, and a run that was interrupted goes on. The exit code is 0 when every
requirement is met, 3 when one is not, 2 for an input of no use.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from eivor.errors import InputError
from eivor.lab.experiments import markdown
from eivor.planning.vehicle import TARGETS
from eivor.strict_toml import read_toml
from validation.kept_study import Answer, KeptStudyCommand, keep, kept_lines
from validation.plan.flights import VEHICLES
from validation.plan.trials import PLANNED_FOR, Outcome, outcomes
from validation.requirement import Requirement
from validation.suites import versions

PART = "planned flights"
GRID = Path(__file__).with_name("grid.toml")
#: Asked of the median ratio of reached to predicted: within these of one, by what is planned for.
RATIOS = {"friction": (0.6, 1.4), "lag": (0.5, 2.0)}
#: Asked: the share of flights in which what was planned for is identified.
IDENTIFIED = 0.9
HEADER = (
    "vehicle",
    "planned for",
    "flights",
    "predicted",
    "reached",
    "ratio",
    "identified",
    "within limits",
)


def answer(grid: Path, size: str, kept: Path) -> Answer:
    """Fly what the file does not have yet, and judge all of it."""
    selected = {
        (kept_line.vehicle, kept_line.target, kept_line.number): kept_line
        for kept_line in kept_lines(kept, Outcome)
    }
    seed, vehicles = _parsed(grid, size)
    results = []
    for name, flights in vehicles.items():
        requested = [(target, number) for target in PLANNED_FOR for number in range(flights)]
        missing = [each for each in requested if (name, *each) not in selected]
        for outcome in outcomes(VEHICLES[name], missing, seed):
            selected[name, outcome.target, outcome.number] = outcome
            keep(kept, [outcome])
        results += [selected[name, target, number] for target, number in requested]
    requirements = tuple(requirements_of(results))
    return _tables(results, requirements), requirements


def _parsed(grid: Path, size: str) -> tuple[int, dict[str, int]]:
    """Seed of the study, and how often each vehicle flies each of its plans."""
    root = read_toml(grid, "grid of planned flights")
    seed = root.whole("seed")
    vehicles = {}
    for section in root.sections("vehicle"):
        name = section.text("name")
        if name not in VEHICLES:
            raise InputError(f"one of {', '.join(VEHICLES)}", f"{name!r}", "Name a vehicle of the study.")
        vehicles[name] = {word: section.whole(word) for word in ("small", "full")}[size]
        section.finish()
    root.finish()
    return seed, vehicles


def requirements_of(result: Sequence[Outcome]) -> Iterator[Requirement]:
    """What is asked of all flights together."""
    for target, (low, high) in RATIOS.items():
        median = float(np.median([item.ratio for item in result if item.target == target]))
        what = f"median of reached over predicted, {TARGETS[target].words}"
        yield Requirement(what, f"{low:g} to {high:g}", f"{median:.2f}", low <= median <= high)
    reported, kept = sum(item.identified for item in result), sum(item.kept for item in result)
    yield Requirement(
        "what was planned for is identified",
        f"at least {IDENTIFIED:g}",
        f"{reported} of {len(result)}",
        reported >= IDENTIFIED * len(result),
    )
    yield Requirement("no limit is left", "every flight", f"{kept} of {len(result)}", kept == len(result))


def table(result: Sequence[Outcome]) -> str:
    """Markdown: for each vehicle and target medians of both half-widths, their ratio, and shares."""
    rows = [
        _row(vehicle, target, [item for item in result if (item.vehicle, item.target) == (vehicle, target)])
        for vehicle, target in dict.fromkeys((item.vehicle, item.target) for item in result)
    ]
    rows += [
        _row("**all**", target, [item for item in result if item.target == target]) for target in PLANNED_FOR
    ]
    return markdown(HEADER, rows)


def _tables(tolds: Sequence[Outcome], requirements: Sequence[Requirement]) -> str:
    requested = [
        (requirement.what, requirement.asked, requirement.measured, "yes" if requirement.met else "no")
        for requirement in requirements
    ]
    made = f"Made by `python -m validation.plan.study` with {versions()}: {len(tolds)} planned flights."
    return "\n\n".join((made, markdown(("what", "asked", "measured", "met"), requested), table(tolds)))


def _row(vehicle: str, target: str, specific: Sequence[Outcome]) -> tuple[str, ...]:
    unit = TARGETS[target].unit
    predicted, reached, ratio = (
        float(np.median([getattr(item, name) for item in specific]))
        for name in ("predicted", "reached", "ratio")
    )
    return (
        vehicle,
        TARGETS[target].words,
        str(len(specific)),
        f"{predicted:.2g} {unit}",
        f"{reached:.2g} {unit}",
        f"{ratio:.2f}",
        f"{sum(item.identified for item in specific)} of {len(specific)}",
        f"{sum(item.kept for item in specific)} of {len(specific)}",
    )


COMMAND = KeptStudyCommand("validation.plan.study", __doc__, GRID, PART, answer)
main = COMMAND.main


if __name__ == "__main__":
    sys.exit(main())
