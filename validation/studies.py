"""What a study must reach, and what a run of it says."""

from __future__ import annotations

import argparse
import hashlib
import io
import json
import platform
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, nullcontext
from dataclasses import asdict, dataclass
from functools import cached_property
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar, runtime_checkable

import polars as pl

from eivor.atomic_file import atomic_write, write_atomically
from eivor.errors import EivorError, InputError
from eivor.lab.experiments import page_text, page_with
from eivor.lab.study_files import Suite, SuiteStudy, read_suite
from eivor.lab.study_run import SHARD_TRIALS, StudyResult, is_sealed, run_study, sealed
from eivor.process_pool import check_workers, local_executor


@dataclass(frozen=True, slots=True)
class Requirement:
    """One thing that must hold."""

    what: str  # In words and numbers
    asked: str
    measured: str
    met: bool  # Whether it holds


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


#: Exit code when a requirement is not met, and for an input that cannot be used.
NOT_MET, WRONG = 3, 2
PACKAGES = ("eivor", "numpy", "scipy")
#: What names a row of a run.
KEYS = ("scenario", "samples", "method", "parameter")

Row = Mapping[str, str | int | float]


@dataclass(frozen=True, slots=True)
class SuiteCommand:
    """A study that is a suite."""

    module: str  # How it is called, and what its help says
    doc: str
    suite: Callable[[], Suite]  # Gives the suite that is run when no other is named
    rows_of: Callable[[SuiteStudy, StudyResult], Iterable[Row]]  # Rows of one of its studies
    columns: tuple[str, ...]  # Of these rows
    kind: str  # What their table is called
    tables: Callable[[pl.DataFrame], str]  # The page's part, of all rows
    part: str  # Name of that part
    requirements: Callable[[pl.DataFrame], Iterable[Requirement]]  # What rows are judged by

    def main(self, arguments: Sequence[str] | None = None) -> int:
        """Run the command; returns its exit code."""
        parser = argparse.ArgumentParser(prog=f"python -m {self.module}", description=self.doc)
        parser.formatter_class = argparse.RawDescriptionHelpFormatter
        parser.add_argument("suite", type=Path, nargs="?", help="a suite file; default: the package's")
        parser.add_argument("--runs", type=int, help="instead of the suite's")
        parser.add_argument("--folder", type=Path, help="keep every trial here")
        parser.add_argument("--workers", type=int, help="processes; default: one for each core")
        parser.add_argument("--out", type=Path, metavar="FILE.parquet", help=f"write the {self.kind}")
        parser.add_argument("--page", type=Path, metavar="FILE.md", help="put the tables between its marks")
        parser.add_argument(
            "--from",
            dest="sources",
            type=Path,
            action="append",
            metavar="FILE.parquet",
            help="a finished run; given again, one of other rows: of one that both have, more records win",
        )
        chosen = parser.parse_args(arguments)
        try:
            return self._run(chosen)
        except EivorError as error:
            sys.stderr.write(f"{error}\n")
            return WRONG

    def _run(self, chosen: argparse.Namespace) -> int:
        page = page_text(chosen.page, self.part) if chosen.page else ""
        if chosen.workers is not None:
            check_workers(chosen.workers)
        if chosen.out and not chosen.out.parent.is_dir():
            raise InputError("a folder that exists", f"{chosen.out.parent}", "Make it first.")
        if chosen.sources:
            rows = joined([read_rows(source, self.columns, self.kind) for source in chosen.sources])
        else:
            suite = read_suite(chosen.suite) if chosen.suite else self.suite()
            if chosen.runs is not None:
                suite = suite.reduced(chosen.runs)
            kept = nullcontext(str(chosen.folder)) if chosen.folder else tempfile.TemporaryDirectory()
            with kept as folder:
                rows = run_suite(suite, Path(folder), self.rows_of, chosen.workers)
        if chosen.out:
            write_rows(rows, chosen.out)
        tables = self.tables(rows)
        if chosen.page:
            write_atomically(chosen.page, page_with(page, {self.part: tables}))
        sys.stdout.write(tables + "\n")
        return 0 if all(item.met for item in self.requirements(rows)) else NOT_MET


def run_suite(
    suite: Suite,
    folder: Path,
    rows_of: Callable[[SuiteStudy, StudyResult], Iterable[Row]],
    workers: int | None = None,
) -> pl.DataFrame:
    """Run what is left of a suite and gather its rows."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    rows: list[Row] = []
    with Progress(console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task("studies", total=len(suite.studies))
        for study in suite.studies:
            executor = local_executor(workers, tasks=-(-study.study.runs // SHARD_TRIALS))
            result = run_study(study.study, folder / f"{study.scenario}-{study.samples}", executor=executor)
            rows.extend(rows_of(study, result))
            bar.advance(task)
    return pl.DataFrame(rows)


def joined(tables: Sequence[pl.DataFrame]) -> pl.DataFrame:
    """Rows of several runs, in the order in which they are first met."""
    rows = pl.concat(tables)
    most = rows.group_by(*KEYS, maintain_order=True).agg(pl.all().sort_by("runs").last())
    return most.select(rows.columns)


def versions() -> str:
    """What a table was made with."""
    packages = ", ".join(f"{package} {version(package)}" for package in PACKAGES)
    return f"{packages}, Python {platform.python_version()}"


def write_rows(rows: pl.DataFrame, path: Path) -> None:
    """Write a table as Parquet."""
    try:
        with atomic_write(path) as file:
            rows.write_parquet(file, compression="zstd", statistics=False)
    except OSError as error:
        raise InputError("a file that can be written", f"{path}: {error}", "Choose another.") from error


def read_rows(path: Path, columns: tuple[str, ...], kind: str) -> pl.DataFrame:
    """Table from a file that `write_rows` made."""
    try:
        rows = pl.read_parquet(path)
    except (OSError, pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        raise InputError(f"a table of {kind}", f"{path}: {error}", "Make one with --out.") from error
    if tuple(rows.columns) != columns:
        raise InputError(f"a table of {kind}", f"{path}, which is another table", "Make one with --out.")
    return rows


#: Files that make tables of rows, and no row.
TABLES_ONLY = frozenset({"study.py"})


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
