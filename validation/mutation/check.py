"""Swap chosen lines one at a time and show that the tests notice every one.

    python -m validation.mutation.check [--sample N] [--only NAME] [--page FILE.md]

Each mutant of mutants.toml is made in a copy of the project, where the tests that it names are run, and no
others; before, they must pass without any mutant. Every line of the table must be found exactly once, those
of mutants that are not tried as well. The exit code is 0 when each named test noticed, else 3.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from validation.mutation.mutants import TABLE, Mutant, MutantError, check_lines, read_mutants, sample
from validation.mutation.page import write_page
from validation.mutation.workspace import FAILED, PASSED, Workspace

ROOT = Path(__file__).resolve().parents[2]
#: Exit code when a mutant is not noticed, or cannot be tried.
UNNOTICED = 3


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a mutant."""

    mutant: Mutant  # The swap
    failed: int  # Tests that failed, over all that it names
    blind: tuple[str, ...]  # Names below which no test failed
    seconds: float  # Time of its tests

    @property
    def noticed(self) -> bool:
        """Every name has a test that failed."""
        return not self.blind


def tried(workspace: Workspace, mutant: Mutant) -> Outcome:
    """Make a mutant and run its tests."""
    with workspace.swapped(mutant):
        run = workspace.tested(mutant.tests)
    if run.code not in {PASSED, FAILED}:
        raise MutantError(f"{mutant.name}: its tests cannot be run:\n{run.text}")
    counts = {test: run.failed_of(test) for test in mutant.tests}
    blind = tuple(test for test, count in counts.items() if not count)
    return Outcome(mutant, sum(counts.values()), blind, run.seconds)


def check_tests(workspace: Workspace, mutants: Sequence[Mutant]) -> None:
    """Refuse tests that fail, or are not there, without any mutant."""
    names = list(dict.fromkeys(test for mutant in mutants for test in mutant.tests))
    run = workspace.tested(names)
    if run.code != PASSED or any(how != "PASSED" for how, _ in run.ended):
        raise MutantError(f"the tests must pass before a line is swapped:\n{run.text}")


def checked(project: Path, mutants: Sequence[Mutant]) -> list[Outcome]:
    """Outcome of each mutant, told as it comes."""
    outcomes = []
    with tempfile.TemporaryDirectory() as folder:
        workspace = Workspace(project, Path(folder))
        check_tests(workspace, mutants)
        for mutant in mutants:
            outcome = tried(workspace, mutant)
            outcomes.append(outcome)
            text = f"noticed by {outcome.failed}" if outcome.noticed else "NOT NOTICED by"
            print(
                " ".join([f"{mutant.name}: {text}", *outcome.blind, f"({outcome.seconds:.1f} s)"]), flush=True
            )
    return outcomes


def main(arguments: Sequence[str] | None = None, *, project: Path = ROOT, table: Path = TABLE) -> int:
    """Run the command; returns its exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m validation.mutation.check",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--sample", type=int, metavar="N", help="N mutants: the first of each area, and so on"
    )
    parser.add_argument("--only", action="append", metavar="NAME", help="this mutant; may be repeated")
    parser.add_argument("--page", type=Path, metavar="FILE.md", help="put the table between the page's marks")
    chosen = parser.parse_args(arguments)
    try:
        mutants = read_mutants(table)
        wrong = check_lines(mutants, project)
        if wrong:
            raise MutantError("\n".join(wrong))
        picked = [mutant for mutant in mutants if not chosen.only or mutant.name in chosen.only]
        if chosen.sample:
            picked = sample(picked, chosen.sample)
        outcomes = checked(project, picked)
    except MutantError as error:
        print(error, file=sys.stderr)
        return UNNOTICED
    noticed = sum(outcome.noticed for outcome in outcomes)
    print(f"{noticed} of {len(outcomes)} noticed")
    if chosen.page:
        write_page(chosen.page, outcomes)
    return 0 if outcomes and noticed == len(outcomes) else UNNOTICED


if __name__ == "__main__":
    sys.exit(main())
