"""Recursive identification on records with known truth, and the command that finds out how well it does.

    python -m validation.recursion.study --kept FILE.jsonl [--size small|full] [--page docs/efficiency.md]

runs the grid beside this file, keeps every trial in the file, and prints its table: false alarms and
coverage of records without a change, delays after a parameter drops by a fifth. A run that was interrupted
goes on. The exit code is 0 when every requirement is met, 3 when one is not, 2 for an input of no use.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from eivor.lab.experiments import markdown
from eivor.strict_toml import read_toml
from validation.kept_study import Answer, KeptStudyCommand, keep, kept_lines
from validation.recursion.trials import SEED, Told, trial
from validation.requirement import Requirement
from validation.suites import versions

PART = "recursion"
GRID = Path(__file__).with_name("grid.toml")
#: Asked: share of records of 2,500 samples with a false alarm, median delay [samples], coverage of intervals.
FALSE_ALARMS, DELAY, COVERAGE = 0.10, 150, (0.90, 0.99)
#: What the requirements are asked of.
SCENARIO, PARAMETER = "rich", "input_gain"
NAMES = {"nothing": "nothing", "input_gain": "K_u", "viscous_friction": "K"}
HEADER = (
    "scenario",
    "what drops by a fifth",
    "records",
    "with a false alarm",
    "told within 1,200 samples",
    "delay: median, 90 %",
    "coverage of K / K_u",
    "half-width of K / K_u",
)


def answer(grid: Path, size: str, kept: Path) -> Answer:
    """Run what the file does not have yet, and judge all of it."""
    selected = {
        (kept_line.scenario, kept_line.changed, kept_line.run): kept_line
        for kept_line in kept_lines(kept, Told)
    }
    results = []
    for key in _parsed(grid, size):
        if key not in selected:
            selected[key] = trial(*key)
            keep(kept, [selected[key]])
        results.append(selected[key])
    requirements = tuple(_requirements(results))
    return _tables(results, requirements), requirements


def _parsed(grid: Path, size: str) -> Iterator[tuple[str, str, int]]:
    root = read_toml(grid, "grid of records")
    for records in root.sections("records"):
        scenario, changed = records.text("scenario"), records.choice("changed", tuple(NAMES))
        runs = {name: records.whole(name) for name in ("small", "full")}[size]
        records.finish()
        for run in range(runs):
            yield scenario, changed, run
    root.finish()


def _of(tolds: list[Told], scenario: str, changed: str) -> list[Told]:
    return [item for item in tolds if (item.scenario, item.changed) == (scenario, changed)]


def _requirements(tolds: list[Told]) -> Iterator[Requirement]:
    still = _of(tolds, SCENARIO, "nothing")
    alarms = float(np.mean([item.alarms > 0 for item in still]))
    yield Requirement(
        f"{SCENARIO}: records of 2,500 samples with a false alarm",
        f"at most {FALSE_ALARMS:g}",
        f"{alarms:.3f}",
        alarms <= FALSE_ALARMS,
    )
    delay = float(np.median(_delays(_of(tolds, SCENARIO, PARAMETER))))
    yield Requirement(
        f"{SCENARIO}: median delay after {NAMES[PARAMETER]} drops by a fifth",
        f"at most {DELAY} samples",
        f"{delay:.0f}",
        delay <= DELAY,
    )
    for name in ("viscous_friction", "input_gain"):
        covered = float(np.mean([item.covered[name] for item in still]))
        low, high = COVERAGE
        yield Requirement(
            f"{SCENARIO}: coverage of the intervals of {NAMES[name]}",
            f"{low:g} to {high:g}",
            f"{covered:.3f}",
            low <= covered <= high,
        )


def _delays(tolds: list[Told]) -> list[float]:
    return [float("inf") if item.delay is None else float(item.delay) for item in tolds]


def _tables(tolds: list[Told], requirements: tuple[Requirement, ...]) -> str:
    requested = [
        (requirement.what, requirement.asked, requirement.measured, "yes" if requirement.met else "no")
        for requirement in requirements
    ]
    kinds = dict.fromkeys((item.scenario, item.changed) for item in tolds)
    return "\n\n".join(
        (
            f"Made by `python -m validation.recursion.study` with {versions()}: records of 2,500 samples, "
            f"memory 200, seed {SEED}.",
            markdown(("what", "asked", "measured", "met"), requested),
            markdown(HEADER, [_line(_of(tolds, *kind)) for kind in kinds]),
        )
    )


def _line(tolds: list[Told]) -> tuple[str, ...]:
    first, delays = tolds[0], _delays(tolds)
    changed = first.changed != "nothing"
    middle, late = np.quantile(delays, [0.5, 0.9], method="inverted_cdf")
    names = ("viscous_friction", "input_gain")
    return (
        first.scenario,
        NAMES[first.changed],
        f"{len(tolds)}",
        f"{np.mean([item.alarms > 0 for item in tolds]):.3f}",
        f"{np.mean(np.isfinite(delays)):.3f}" if changed else "-",
        f"{_samples(middle)}, {_samples(late)}" if changed else "-",
        " / ".join(f"{np.mean([item.covered[name] for item in tolds]):.3f}" for name in names),
        " / ".join(f"{100.0 * np.median([item.half_width[name] for item in tolds]):.1f} %" for name in names),
    )


def _samples(delay: float) -> str:
    return f"{delay:.0f}" if np.isfinite(delay) else "never"


COMMAND = KeptStudyCommand("validation.recursion.study", __doc__, GRID, PART, answer)
main = COMMAND.main


if __name__ == "__main__":
    sys.exit(main())
