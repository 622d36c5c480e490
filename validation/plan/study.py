"""Planned flights against flights, and the command that flies them.

    python -m validation.plan.study --kept FILE.jsonl [--size small|full] [--page docs/studies/plan.md]

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
    told = {(one.vehicle, one.target, one.number): one for one in kept_lines(kept, Outcome)}
    seed, vehicles = _asked(grid, size)
    found = []
    for name, flights in vehicles.items():
        asked = [(target, number) for target in PLANNED_FOR for number in range(flights)]
        missing = [each for each in asked if (name, *each) not in told]
        for one in outcomes(VEHICLES[name], missing, seed):
            told[name, one.target, one.number] = one
            keep(kept, [one])
        found += [told[name, target, number] for target, number in asked]
    requirements = tuple(requirements_of(found))
    return _tables(found, requirements), requirements


def _asked(grid: Path, size: str) -> tuple[int, dict[str, int]]:
    """Seed of the study, and how often each vehicle flies each of its plans."""
    root = read_toml(grid, "grid of planned flights")
    seed = root.whole("seed")
    vehicles = {}
    for one in root.sections("vehicle"):
        name = one.text("name")
        if name not in VEHICLES:
            raise InputError(f"one of {', '.join(VEHICLES)}", f"{name!r}", "Name a vehicle of the study.")
        vehicles[name] = {word: one.whole(word) for word in ("small", "full")}[size]
        one.finish()
    root.finish()
    return seed, vehicles


def requirements_of(found: Sequence[Outcome]) -> Iterator[Requirement]:
    """What is asked of all flights together."""
    for target, (low, high) in RATIOS.items():
        median = float(np.median([one.ratio for one in found if one.target == target]))
        what = f"median of reached over predicted, {TARGETS[target].words}"
        yield Requirement(what, f"{low:g} to {high:g}", f"{median:.2f}", low <= median <= high)
    told, kept = sum(one.identified for one in found), sum(one.kept for one in found)
    yield Requirement(
        "what was planned for is identified",
        f"at least {IDENTIFIED:g}",
        f"{told} of {len(found)}",
        told >= IDENTIFIED * len(found),
    )
    yield Requirement("no limit is left", "every flight", f"{kept} of {len(found)}", kept == len(found))


def table(found: Sequence[Outcome]) -> str:
    """Markdown: for each vehicle and target medians of both half-widths, their ratio, and shares."""
    rows = [
        _row(vehicle, target, [one for one in found if (one.vehicle, one.target) == (vehicle, target)])
        for vehicle, target in dict.fromkeys((one.vehicle, one.target) for one in found)
    ]
    rows += [
        _row("**all**", target, [one for one in found if one.target == target]) for target in PLANNED_FOR
    ]
    return markdown(HEADER, rows)


def _tables(found: Sequence[Outcome], requirements: Sequence[Requirement]) -> str:
    asked = [(one.what, one.asked, one.measured, "yes" if one.met else "no") for one in requirements]
    made = f"Made by `python -m validation.plan.study` with {versions()}: {len(found)} planned flights."
    return "\n\n".join((made, markdown(("what", "asked", "measured", "met"), asked), table(found)))


def _row(vehicle: str, target: str, own: Sequence[Outcome]) -> tuple[str, ...]:
    unit = TARGETS[target].unit
    predicted, reached, ratio = (
        float(np.median([getattr(one, name) for one in own])) for name in ("predicted", "reached", "ratio")
    )
    return (
        vehicle,
        TARGETS[target].words,
        str(len(own)),
        f"{predicted:.2g} {unit}",
        f"{reached:.2g} {unit}",
        f"{ratio:.2f}",
        f"{sum(one.identified for one in own)} of {len(own)}",
        f"{sum(one.kept for one in own)} of {len(own)}",
    )


COMMAND = KeptStudyCommand("validation.plan.study", __doc__, GRID, PART, answer)
main = COMMAND.main


if __name__ == "__main__":
    sys.exit(main())
