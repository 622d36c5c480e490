"""Rows of a study in a folder: a sealed file for each task, and one table of all that are done."""

from __future__ import annotations

import hashlib
import io
import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Generic, Protocol, TypeVar, runtime_checkable

import polars as pl

from eivor.atomic_file import write_atomically
from eivor.errors import InputError
from eivor.lab.study_run import is_sealed, sealed
from eivor.process_pool import local_executor

#: Packages whose versions bear on the numbers.
PACKAGES = ("eivor", "numpy", "scipy")
#: Files that make tables of rows, and no row.
TABLES_ONLY = frozenset({"page.py", "requirements.py", "study.py", "table.py"})

Row = Mapping[str, str | float | int | bool]


@runtime_checkable
class StudyTask(Protocol):
    """Some flights of a study, whose rows are kept in one file."""

    @property
    def file_name(self) -> str:
        """Name of the file, without its ending."""
        ...

    @property
    def facts(self) -> Mapping[str, str]:
        """What the file is sealed with: whose flights, and which."""
        ...

    @property
    def flights(self) -> int:
        """Number of flights."""
        ...


Task = TypeVar("Task", bound=StudyTask)


@dataclass(frozen=True)
class StudyTable:
    """What a run of the study leaves behind."""

    rows: pl.DataFrame  # One row for each flight
    origin: Mapping[str, str]  # The grid's name, how many of its flights were flown, and the versions

    def write(self, path: Path) -> None:
        """Write one sealed file."""
        narrow = self.rows.with_columns(pl.col(pl.Float64).cast(pl.Float32))
        write_atomically(path, sealed(narrow, self.origin))


def read_study_table(path: Path) -> StudyTable:
    """Table from a file that `StudyTable.write` made."""
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
class StudyFolder(Generic[Task]):
    """Where the tasks' rows are kept."""

    folder: Path  # Made when it is not there
    tasks: Sequence[Task]  # In the order in which they are done
    name: str  # Of the study's grid
    text: str
    package: str  # The study's own, whose code makes rows beside Eivor's
    planned: int  # Flights of the whole study

    def missing(self) -> list[Task]:
        """Tasks whose file is not there, not whole, or was made by other code."""
        return [task for task in self.tasks if self._content(task) is None]

    def write(self, task: Task, rows: Sequence[Row]) -> None:
        """Keep the rows of a task."""
        self.folder.mkdir(parents=True, exist_ok=True)
        write_atomically(self._path(task), sealed(pl.DataFrame(list(rows)), self._facts(task)))

    def run(self, rows_of: Callable[[Task], Sequence[Row]], workers: int | None = None) -> None:
        """Do what is left of the study."""
        from rich.console import Console
        from rich.progress import Progress

        missing = self.missing()
        console = Console(stderr=True)
        with Progress(console=console, disable=not console.is_terminal) as bar:
            task = bar.add_task("tasks", total=len(missing))
            if missing:
                with closing(local_executor(workers, len(missing)).map(rows_of, missing)) as results:
                    for item, rows in results:
                        self.write(missing[item], rows)
                        bar.advance(task)

    def gathered(self) -> StudyTable:
        """Table of all tasks that are done, in the order of their files' names."""
        contents = {task: self._content(task) for task in sorted(self.tasks, key=lambda task: task.file_name)}
        done = {task: pl.read_parquet(io.BytesIO(content)) for task, content in contents.items() if content}
        if not done:
            raise InputError("a folder with finished tasks", f"{self.folder}", "Run the study first.")
        rows = pl.concat(done.values())
        made = ", ".join(f"{package} {version(package)}" for package in PACKAGES)
        origin = {
            "grid": self.name,
            "flights": f"{sum(task.flights for task in done)} of {self.planned}",
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
        return self.folder / f"{task.file_name}.parquet"

    def _facts(self, task: Task) -> Mapping[str, str]:
        return {**task.facts, "code": self._code}

    @cached_property
    def _code(self) -> str:
        """Checksum of the grid and of the code that makes rows: those of different code are never mixed."""
        digest = hashlib.sha256(self.text.encode())
        for package in ("eivor", self.package):
            for path in _sources(Path(str(files(package)))):
                digest.update(path.read_bytes())
        return digest.hexdigest()


def _sources(folder: Path) -> Iterator[Path]:
    yield from (path for path in sorted(folder.rglob("*.py")) if path.name not in TABLES_ONLY)
