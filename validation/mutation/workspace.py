"""A copy of the project in which lines may be swapped and tests run; the project itself is never touched."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from validation.mutation.mutants import Mutant, MutantError

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
    """Tests that were run."""

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
    """A copy of the project."""

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
        """The copy with a mutant's line swapped."""
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
            [*command, "--tb=no", "--no-header", "-m", "", *tests],
            capture_output=True,
            encoding="utf-8",
            check=False,
            cwd=self.root,
            env=os.environ | ENVIRONMENT | {"PYTHONPATH": str(self.root / "src")},
        )
        seconds = time.perf_counter() - start_s
        text = done.stdout + done.stderr
        return Run(done.returncode, tuple(ENDED.findall(done.stdout)), seconds, text)
