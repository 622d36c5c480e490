"""Mutants: the table of lines to swap, and where each stands in the source."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

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
    """Mutants of a table, in its order."""
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
