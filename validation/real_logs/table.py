"""Rows of the study in a folder: a sealed file for each task, and one table of all that are done."""

from __future__ import annotations

import hashlib
import io
import platform
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path

import polars as pl

from eivor.errors import InputError
from eivor.studies.sealed_table import is_sealed, sealed
from eivor.whole_file import write_whole
from validation.real_logs.grid import Grid
from validation.real_logs.trials import Row, Task, interleaved

#: Packages whose versions bear on the numbers.
PACKAGES = ("eivor", "numpy", "scipy")
#: Files that make tables of rows, and no row.
TABLES_ONLY = frozenset({"page.py", "requirements.py", "study.py", "table.py"})


@dataclass(frozen=True)
class StudyTable:
    """What a run of the study leaves behind.

    Parameters
    ----------
    rows : polars.DataFrame
        One row for each flight.
    origin : mapping of str to str
        The grid's name, how many of its flights were flown, and the versions.
    """

    rows: pl.DataFrame
    origin: Mapping[str, str]

    def write(self, path: Path) -> None:
        """Write one sealed file."""
        narrow = self.rows.with_columns(pl.col(pl.Float64).cast(pl.Float32))
        write_whole(path, sealed(narrow, self.origin))


def read_study_table(path: Path) -> StudyTable:
    """Table from a file that `StudyTable.write` made.

    Raises
    ------
    InputError
        When the file is none of them, or was changed.
    """
    try:
        content = path.read_bytes()
        if not is_sealed(content, {}):
            raise InputError("a table of the study as it was written", f"{path}", "Make one with --out.")
        rows, metadata = pl.read_parquet(io.BytesIO(content)), pl.read_parquet_metadata(io.BytesIO(content))
    except (OSError, pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        raise InputError("a table of the study", f"{path}: {error}", "Make one with --out.") from error
    origin = {key: value for key, value in metadata.items() if key in {"grid", "flights", "made with"}}
    return StudyTable(rows.with_columns(pl.col(pl.Float32).cast(pl.Float64)), origin)


@dataclass(frozen=True)
class StudyFolder:
    """Where the tasks' rows are kept.

    Parameters
    ----------
    folder : Path
        Made when it is not there.
    grid : Grid
        The study's.
    """

    folder: Path
    grid: Grid

    @cached_property
    def tasks(self) -> list[Task]:
        """All tasks, in the order in which they are done."""
        return interleaved(self.grid.families)

    def missing(self) -> list[Task]:
        """Tasks whose file is not there, not whole, or was made by other code."""
        return [task for task in self.tasks if self._content(task) is None]

    def write(self, task: Task, rows: tuple[Row, ...]) -> None:
        """Keep the rows of a task."""
        self.folder.mkdir(parents=True, exist_ok=True)
        write_whole(self._path(task), sealed(pl.DataFrame(list(rows)), self._facts(task)))

    def gathered(self) -> StudyTable:
        """Table of all tasks that are done.

        Raises
        ------
        InputError
            When none is.
        """
        order = {family.name: place for place, family in enumerate(self.grid.families)}
        tasks = sorted(self.tasks, key=lambda task: (order[task.family], task.first))
        done = [pl.read_parquet(io.BytesIO(content)) for content in map(self._content, tasks) if content]
        if not done:
            raise InputError("a folder with finished tasks", f"{self.folder}", "Run the study first.")
        rows = pl.concat(done)
        planned = sum(family.count * family.pool for family in self.grid.families)
        made = ", ".join(f"{package} {version(package)}" for package in PACKAGES)
        origin = {
            "grid": self.grid.name,
            "flights": f"{rows.height} of {planned}",
            "made with": f"{made}, Python {platform.python_version()}",
        }
        return StudyTable(rows, origin)

    def _content(self, task: Task) -> bytes | None:
        try:
            content = self._path(task).read_bytes()
        except OSError:
            return None
        return content if is_sealed(content, self._facts(task)) else None

    def _path(self, task: Task) -> Path:
        place = [family.name for family in self.grid.families].index(task.family)
        return self.folder / f"family-{place + 1:02d}-{task.first:03d}-{task.last:03d}.parquet"

    def _facts(self, task: Task) -> dict[str, str]:
        return {"family": task.family, "flights": f"{task.first} to {task.last - 1}", "code": self._code}

    @cached_property
    def _code(self) -> str:
        """Checksum of the grid and of the code that makes rows: those of different code are never mixed."""
        digest = hashlib.sha256(self.grid.text.encode())
        for package in ("eivor", "validation.real_logs"):
            for path in _sources(Path(str(files(package)))):
                digest.update(path.read_bytes())
        return digest.hexdigest()


def _sources(folder: Path) -> Iterator[Path]:
    yield from (path for path in sorted(folder.rglob("*.py")) if path.name not in TABLES_ONLY)
