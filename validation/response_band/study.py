"""Bands of joint draws on flights with known truth, and the command that finds out how often they hold it.

    python -m validation.response_band.study --kept FILE.jsonl [--size small|full] [--page docs/exports.md]

flies the grid beside this file, keeps every flight in the file, and prints its table: at each time after a
step of the command the share of flights whose band of 90 % of the draws holds the true climb rate. A run that
was interrupted goes on. The exit code is 0 when every requirement is met, 3 when one is not, 2 for an input
of no use.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from eivor.lab.experiments import markdown
from eivor.strict_toml import read_toml
from validation.kept_study import Answer, KeptStudyCommand, keep, kept_lines
from validation.requirement import Requirement
from validation.response_band.trials import DRAWS, SEED, TIMES_S, Told, trials
from validation.suites import versions

PART = "response band"
GRID = Path(__file__).with_name("grid.toml")
#: Asked: pointwise coverage of the band of 90 %.
COVERAGE = (0.86, 0.94)
#: Flights that are simulated side by side.
TOGETHER = 25
#: What a kind of flights may differ in.
SETTINGS = ("gust_rms", "delay", "vigour")
HEADER = (
    "flights",
    "how many",
    "identified",
    *(f"{time:g} s" for time in TIMES_S),
    "all times",
    "at the best delay",
)


def answer(grid: Path, size: str, kept: Path) -> Answer:
    """Fly what the file does not have yet, and judge all of it."""
    selected = {(kept_line.name, kept_line.run): kept_line for kept_line in kept_lines(kept, Told)}
    results = []
    for name, settings, item, runs in _parsed(grid, size):
        for trial in trials(name, settings, item, [run for run in runs if (name, run) not in selected]):
            selected[name, trial.run] = trial
            keep(kept, [trial])
        results += [selected[name, run] for run in runs]
    covered = float(np.mean([held for result in results for held in result.held]))
    low, high = COVERAGE
    requirement = Requirement(
        "pointwise coverage of the band of 90 %",
        f"{low:g} to {high:g}",
        f"{covered:.3f}",
        low <= covered <= high,
    )
    return _tables(results, requirement), (requirement,)


def _parsed(grid: Path, size: str) -> list[tuple[str, Mapping[str, float], int, range]]:
    """Flights side by side; kinds take turns, so that a study that is cut short has some of each."""
    root = read_toml(grid, "grid of flights")
    requested: list[tuple[str, Mapping[str, float], int, range]] = []
    for index, kind in enumerate(root.sections("flights")):
        name = kind.text("name")
        settings = {key: kind.number(key) for key in SETTINGS if kind.has(key)}
        runs = {word: kind.whole(word) for word in ("small", "full")}[size]
        kind.finish()
        requested += [
            (name, settings, index, range(first, min(first + TOGETHER, runs)))
            for first in range(0, runs, TOGETHER)
        ]
    root.finish()
    return sorted(requested, key=lambda item: (item[3].start, item[2]))


def _tables(tolds: list[Told], requirement: Requirement) -> str:
    kinds = dict.fromkeys(item.name for item in tolds)
    requested = [
        (requirement.what, requirement.asked, requirement.measured, "yes" if requirement.met else "no")
    ]
    rows = [_line(kind, [item for item in tolds if item.name == kind]) for kind in kinds]
    return "\n\n".join(
        (
            f"Made by `python -m validation.response_band.study` with {versions()}: {len(tolds)} flights of "
            f"a minute, {DRAWS} draws of each, seed {SEED}.",
            markdown(("what", "asked", "measured", "met"), requested),
            markdown(HEADER, [*rows, _line("**all**", tolds)]),
        )
    )


def _line(kind: str, tolds: list[Told]) -> tuple[str, ...]:
    held = np.array([item.held for item in tolds if item.held], dtype=float)
    return (
        kind,
        f"{len(tolds)}",
        f"{sum(item.verdict == 'identified' for item in tolds)}",
        *(f"{share:.2f}" for share in held.mean(axis=0)),
        f"{held.mean():.3f}",
        f"{np.mean([held for item in tolds for held in item.held_at_best]):.3f}",
    )


COMMAND = KeptStudyCommand("validation.response_band.study", __doc__, GRID, PART, answer)
main = COMMAND.main


if __name__ == "__main__":
    sys.exit(main())
