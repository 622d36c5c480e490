"""Studies that keep what they tell as lines of a file, and the commands that run them."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeVar

from eivor.atomic_file import write_atomically
from eivor.errors import EivorError
from eivor.lab.experiments import page_text, page_with
from validation.requirement import Requirement

#: Exit code when a requirement is not met, and for an input that cannot be used.
NOT_MET, WRONG = 3, 2

#: A dataclass: what one identification says.
Told = TypeVar("Told")
#: A study's tables, and what is asked of it.
Answer = tuple[str, Iterable[Requirement]]


def keep(path: Path, record: Iterable[Any]) -> None:
    """Add lines to the file of a study."""
    with path.open("a", encoding="utf-8") as file:
        file.writelines(json.dumps(asdict(item)) + "\n" for item in record)


def kept_lines(path: Path, kind: type[Told]) -> list[Told]:
    """What the file of a study has; nothing where there is none yet."""
    if not path.exists():
        return []
    return [kind(**json.loads(line)) for line in path.read_text(encoding="utf-8").splitlines()]


@dataclass(frozen=True, slots=True)
class KeptStudyCommand:
    """A study whose file goes on where it was interrupted."""

    module: str  # How it is called, and what its help says
    doc: str
    grid: Path  # The published one
    part: str  # Name of the page's part
    # From the grid's file, the size and the study's file to what it says
    answer: Callable[[Path, str, Path], Answer]

    def main(self, arguments: Sequence[str] | None = None) -> int:
        """Run the command; returns its exit code."""
        parser = argparse.ArgumentParser(prog=f"python -m {self.module}", description=self.doc)
        parser.formatter_class = argparse.RawDescriptionHelpFormatter
        parser.add_argument("--grid", type=Path, default=self.grid, help="instead of the published one")
        parser.add_argument("--size", choices=("small", "full"), default="small")
        parser.add_argument(
            "--kept", type=Path, required=True, metavar="FILE.jsonl", help="keep every trial here"
        )
        parser.add_argument("--page", type=Path, metavar="FILE.md", help="put the tables between its marks")
        chosen = parser.parse_args(arguments)
        try:
            return self._run(chosen)
        except EivorError as error:
            sys.stderr.write(f"{error}\n")
            return WRONG

    def _run(self, chosen: argparse.Namespace) -> int:
        page = page_text(chosen.page, self.part) if chosen.page else ""
        tables, requirements = self.answer(chosen.grid, chosen.size, chosen.kept)
        if chosen.page:
            write_atomically(chosen.page, page_with(page, {self.part: tables}))
        sys.stdout.write(tables + "\n")
        return 0 if all(requirement.met for requirement in requirements) else NOT_MET
