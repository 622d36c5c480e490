"""Swap chosen lines one at a time and show that the tests notice every one.

    python -m validation.mutation.check [--sample N] [--only NAME] [--page FILE.md]

Each mutant of mutants.toml is made in a copy of the project, where the tests that it names are run, and no
others; before, they must pass without any mutant. Every line of the table must be found exactly once, those
of mutants that are not tried as well. The exit code is 0 when each named test noticed, else 3.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from validation.pages import markdown, page_with

TABLE = Path(__file__).with_name("mutants.toml")


class MutantError(Exception):
    """A mutant that cannot be tried: its line is not there, or its tests are not."""


@dataclass(frozen=True, slots=True)
class Mutant:
    """One line and what it is swapped for."""

    name: str  # Short and unique
    area: str  # What kind of line it is
    what: str  # What the swap does, for people
    file: str  # Path from the root of the project
    line: str  # The line as it stands, without its indentation, and what takes its place
    replacement: str
    tests: tuple[str, ...]  # Pytest's names of files, classes or tests; each must have a test that fails

    def applied(self, text: str) -> str:
        """Text of the file with the line swapped, its indentation kept."""
        lines = text.splitlines(keepends=True)
        positions = [j for j, line in enumerate(lines) if line.strip() == self.line]
        if len(positions) != 1:
            raise MutantError(
                f"{self.name}: the line `{self.line}` was found {len(positions)} times in {self.file}; "
                f"bring {TABLE.name} up to date"
            )
        if self.line == self.replacement:
            raise MutantError(f"{self.name}: the line is swapped for itself")
        position = positions[0]
        lines[position] = lines[position].replace(self.line, self.replacement)
        return "".join(lines)


def read_mutants(path: Path = TABLE) -> tuple[Mutant, ...]:
    entries = tomllib.loads(path.read_text(encoding="utf-8"))["mutant"]
    result = tuple(Mutant(**entry | {"tests": tuple(entry["tests"])}) for entry in entries)
    names = [mutant.name for mutant in result]
    for mutant in result:
        if names.count(mutant.name) > 1:
            raise MutantError(f"{mutant.name}: two mutants have this name")
        if not mutant.tests:
            raise MutantError(f"{mutant.name}: names no test")
    return result


def check_lines(mutants: Sequence[Mutant], root: Path) -> list[str]:
    """What is wrong with the mutants' places; nothing when every line is found exactly once."""
    wrong = []
    for mutant in mutants:
        path = root / mutant.file
        try:
            if not path.is_file():
                raise MutantError(f"{mutant.name}: there is no {mutant.file}; bring {TABLE.name} up to date")
            mutant.applied(path.read_text(encoding="utf-8"))
            for test in mutant.tests:
                if not (root / test.partition("::")[0]).exists():
                    raise MutantError(f"{mutant.name}: there is no test {test}")
        except MutantError as error:
            others = [
                item.relative_to(root).as_posix()
                for item in sorted((root / "src").rglob("*.py"))
                if item != path and mutant.line in map(str.strip, item.read_text("utf-8").splitlines())
            ]
            wrong.append(f"{error} (it is in {', '.join(others)})" if others else str(error))
    return wrong


def sample(mutants: Sequence[Mutant], count: int) -> list[Mutant]:
    """The first of each area, then the second of each, until there are `count`."""
    ranks: dict[str, int] = {}
    ranked = []
    for index, mutant in enumerate(mutants):
        ranks[mutant.area] = ranks.get(mutant.area, 0) + 1
        ranked.append((ranks[mutant.area], index, mutant))
    return [mutant for _, _, mutant in sorted(ranked, key=lambda entry: entry[:2])[:count]]


#: What tests of the package need of the project.
COPIED = ("src", "tests", "validation", "pyproject.toml")
#: What the tests find in their environment, beside the copy.
ENVIRONMENT = {"PYTHONDONTWRITEBYTECODE": "1", "EIVOR_SHAPE_CHECKS": "0", "CI": "1"}
#: Pytest's exit codes: all passed, some failed.
PASSED, FAILED = 0, 1
#: A line of pytest's summary: how a test ended, and its name.
ENDED = re.compile(r"^(PASSED|FAILED|ERROR|SKIPPED|XFAIL|XPASS) (\S+::\S.*?)(?: - .*)?$", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Run:
    code: int  # Pytest's exit code
    ended: tuple[tuple[str, str], ...]  # How each test ended, and its name
    seconds: float  # Wall time
    text: str  # What pytest printed

    def failed_of(self, test: str) -> int:
        """Number of tests below a name that did not pass."""
        return sum(
            how in {"FAILED", "ERROR"} and (name == test or name.startswith((f"{test}::", f"{test}[")))
            for how, name in self.ended
        )


class Workspace:
    def __init__(self, project: Path, folder: Path) -> None:
        self.root = folder
        for name in COPIED:
            source = project / name
            if source.is_dir():
                shutil.copytree(source, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
            elif source.exists():
                shutil.copy2(source, folder / name)

    @contextmanager
    def swapped(self, mutant: Mutant) -> Iterator[None]:
        path = self.root / mutant.file
        before = path.read_text(encoding="utf-8")
        after = mutant.applied(before)
        try:
            compile(after, mutant.file, "exec")
        except SyntaxError as error:
            raise MutantError(f"{mutant.name}: no Python any more: {error}") from error
        path.write_text(after, encoding="utf-8")
        try:
            yield
        finally:
            path.write_text(before, encoding="utf-8")

    def tested(self, tests: Sequence[str]) -> Run:
        """Run tests in the copy, in one process, without the checks of shapes, which take longer."""
        command = [sys.executable, "-m", "pytest", "-q", "-rA", "-n", "0", "-p", "no:cacheprovider"]
        start_s = time.perf_counter()
        done = subprocess.run(
            [*command, "--hypothesis-profile=mutation", "--tb=no", "--no-header", "-m", "", *tests],
            capture_output=True,
            encoding="utf-8",
            check=False,
            cwd=self.root,
            env=os.environ | ENVIRONMENT | {"PYTHONPATH": str(self.root / "src")},
        )
        seconds = time.perf_counter() - start_s
        text = done.stdout + done.stderr
        return Run(done.returncode, tuple(ENDED.findall(done.stdout)), seconds, text)


ROOT = Path(__file__).resolve().parents[2]
#: Exit code when a mutant is not noticed, or cannot be tried.
UNNOTICED = 3


@dataclass(frozen=True, slots=True)
class Outcome:
    mutant: Mutant  # The swap
    failed: int  # Tests that failed, over all that it names
    blind: tuple[str, ...]  # Names below which no test failed
    seconds: float  # Time of its tests

    @property
    def noticed(self) -> bool:
        return not self.blind


def tried(workspace: Workspace, mutant: Mutant) -> Outcome:
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
        text = chosen.page.read_text(encoding="utf-8")
        page = page_with(text, {PART: "\n\n".join(parts(outcomes))})
        chosen.page.write_text(page, encoding="utf-8")
    return 0 if outcomes and noticed == len(outcomes) else UNNOTICED


#: The part of the page that is generated.
PART = "mutants"


def parts(outcomes: Sequence[Outcome]) -> Iterator[str]:
    """How many were noticed, and a table for each area."""
    noticed = sum(outcome.noticed for outcome in outcomes)
    yield f"{noticed} of {len(outcomes)} swapped lines were noticed."
    areas = list(dict.fromkeys(outcome.mutant.area for outcome in outcomes))
    for area in areas:
        here = [outcome for outcome in outcomes if outcome.mutant.area == area]
        yield f"## {area.capitalize()}"
        yield markdown(("what the swap does", "line", "becomes", "noticed by"), map(_row, here))


def _row(outcome: Outcome) -> tuple[str, ...]:
    mutant = outcome.mutant
    tests = (test.removeprefix("tests/") for test in mutant.tests)
    by = f"{outcome.failed} of " if outcome.noticed else "**not by** "
    where = mutant.file.removeprefix("src/eivor/")
    return (
        f"{mutant.what}<br>`{where}`".replace("|", "\\|"),
        _code(mutant.line),
        _code(mutant.replacement),
        by + "<br>".join(map(_code, tests)),
    )


def _code(text: str) -> str:
    return f"`{text}`".replace("|", "\\|")


if __name__ == "__main__":
    sys.exit(main())
