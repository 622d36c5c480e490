"""What studies share: their commands, what is asked of them, and how their rows are kept."""

from __future__ import annotations

import argparse
import hashlib
import io
import json
import sys
import tempfile
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, nullcontext
from dataclasses import asdict, dataclass
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from typing import Any, Generic, TypeVar

import msgspec
import polars as pl

from eivor.atomic_file import atomic_write, is_sealed, sealed, write_atomically
from eivor.errors import EivorError, InputError
from eivor.inference.distributions import normal_quantile
from eivor.lab.study import Share, StudyResult, run_study, study_executor
from eivor.process_pool import check_workers, local_executor
from validation.pages import markdown, page_text, page_with
from validation.suite_files import Suite, SuiteStudy, read_suite, versions

#: Exit code when a requirement is not met, and for an input that cannot be used.
NOT_MET, WRONG = 3, 2
EXIT_CODES = "The exit code is 0 when every requirement is met, 3 when one is not, 2 for an input of no use."
#: What names a row of a run.
KEYS = ("scenario", "samples", "method", "parameter")

Row = Mapping[str, str | int | float]
#: A dataclass that is kept as a line of a file, what names its trial, and what a grid's file holds.
Line = TypeVar("Line")
Key = TypeVar("Key", bound=Hashable)
Settings = TypeVar("Settings")
Item = TypeVar("Item")


@dataclass(frozen=True, slots=True)
class Requirement:
    """One thing that must hold, in words and numbers."""

    what: str
    asked: str
    measured: str
    met: bool

    @classmethod
    def within(cls, what: str, value: float, bounds: tuple[float, float], form: str = ".3f") -> Requirement:
        low, high = bounds
        return cls(what, f"{low:g} to {high:g}", f"{value:{form}}", low <= value <= high)

    @classmethod
    def at_most(cls, what: str, value: float, most: float, form: str = ".3f") -> Requirement:
        return cls(what, f"at most {most:g}", f"{value:{form}}", value <= most)

    @classmethod
    def at_least(cls, what: str, value: float, least: float, form: str = ".3f") -> Requirement:
        return cls(what, f"at least {least:g}", f"{value:{form}}", value >= least)

    @classmethod
    def by_all(
        cls, what: str, asked: str, measured: str, missed: Sequence[str], mark: str = "; "
    ) -> Requirement:
        """What several numbers must hold, with those that do not."""
        more = f"; missed by {mark.join(missed)}" if missed else ""
        return cls(what, asked, measured + more, not missed)


#: A study's tables (of one part of the page, or of several by name), and what is asked of it.
Answer = tuple[str | Mapping[str, str], Iterable[Requirement]]
#: Settings of an option, as argparse takes them.
Option = Mapping[str, Any]
SIZE: Option = {"choices": ("small", "full"), "default": "small"}
WORKERS: Option = {"type": int, "metavar": "N", "help": "processes; default: one for each core"}
OUT: Option = {"type": Path, "metavar": "FILE.parquet", "help": "write every row"}
FINISHED: Option = {"dest": "source", "type": Path, "metavar": "FILE.parquet", "help": "a finished run"}
KEPT: Option = {"type": Path, "required": True, "metavar": "FILE.jsonl", "help": "keep every trial here"}


@dataclass(frozen=True, slots=True)
class StudyCommand:
    """A study as a command that prints its tables and puts them into a page."""

    module: str  # How it is called, and what its help says
    doc: str | None
    part: str | Callable[[argparse.Namespace], str]  # Name of the page's part
    answer: Callable[[argparse.Namespace], Answer]
    options: Mapping[str, Option]

    def main(self, arguments: Sequence[str] | None = None) -> int:
        parser = argparse.ArgumentParser(
            prog=f"python -m {self.module}",
            description=self.doc,
            epilog=EXIT_CODES,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        for name, settings in self.options.items():
            parser.add_argument(name, **settings)
        parser.add_argument("--page", type=Path, metavar="FILE.md", help="put the tables between its marks")
        chosen = parser.parse_args(arguments)
        try:
            part = self.part if isinstance(self.part, str) else self.part(chosen)
            page = page_text(chosen.page, part) if chosen.page else ""
            tables, requirements = self.answer(chosen)
            parts = {part: tables} if isinstance(tables, str) else tables
            if chosen.page:
                write_atomically(chosen.page, page_with(page, parts))
        except EivorError as error:
            sys.stderr.write(f"{error}\n")
            return WRONG
        sys.stdout.write("\n\n".join(parts.values()) + "\n")
        return 0 if all(requirement.met for requirement in requirements) else NOT_MET


def requirement_table(requirements: Iterable[Requirement], what: str = "what", *, not_met: str = "no") -> str:
    lines = [(item.what, item.asked, item.measured, "yes" if item.met else not_met) for item in requirements]
    return markdown((what, "asked", "measured", "met"), lines)


def table_of(columns: Mapping[str, str | Callable[[Item], str]], items: Iterable[Item]) -> str:
    """Markdown: a row for each item, of formats of its fields or of functions."""
    rows = [
        [cell.format(item) if isinstance(cell, str) else cell(item) for cell in columns.values()]
        for item in items
    ]
    return markdown(tuple(columns), rows)


def share_text(share: Share, digits: int = 3) -> str:
    low, high = share.interval
    if not share.count:
        return "-"
    return f"{share.value:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}] of {share.count}"


def may_be_within(share: float, count: int, bounds: tuple[float, float], level: float) -> bool:
    """Whether a share is between bounds, or may be but for chance."""
    low, high = (normal_quantile(level) * (bound * (1.0 - bound) / max(count, 1)) ** 0.5 for bound in bounds)
    return bounds[0] - low <= share <= bounds[1] + high


def with_bar(items: Iterable[Item], name: str, total: int) -> Iterator[Item]:
    """Items as they come, with a bar on standard error when that is a terminal."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    with Progress(console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task(name, total=total)
        for item in items:
            yield item
            bar.advance(task)


def read_as(kind: Callable[..., Item], path: Path, text: str | None = None) -> Item:
    """Grid of a TOML file, or of its text, as a struct."""
    try:
        return msgspec.toml.decode(path.read_bytes() if text is None else text, type=kind)
    except (OSError, ValueError) as error:  # also those of msgspec
        raise InputError("a grid of the study", f"{path}: {error}", "Correct the file.") from error


class GridStruct(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Keys of a table of a grid."""


# -- studies that keep every trial as a line of a file --

#: Trials that are made together, and how: each result is the lines of one trial, which are kept at once.
Group = tuple[Sequence[Key], Callable[[list[Key]], Iterable[Sequence[Line]]]]


def keep(path: Path, lines: Iterable[Any]) -> None:
    with path.open("a", encoding="utf-8") as file:
        file.writelines(json.dumps(asdict(line)) + "\n" for line in lines)


def kept_lines(path: Path, kind: type[Line]) -> list[Line]:
    """What the file of a study has; nothing where there is none yet."""
    if not path.exists():
        return []
    return [kind(**json.loads(line)) for line in path.read_text(encoding="utf-8").splitlines()]


def alone(trials: Mapping[Key, Callable[[], Line]]) -> list[Group[Key, Line]]:
    """Groups of one trial each, which makes one line."""

    def group(key: Key, trial: Callable[[], Line]) -> Group[Key, Line]:
        return [key], lambda _: [[trial()]]

    return [group(key, trial) for key, trial in trials.items()]


def completed(
    path: Path, kind: type[Line], groups: Iterable[Group[Key, Line]], key_of: Callable[[Line], Key]
) -> list[Line]:
    """Lines of all trials, in their order; what the file does not have yet is made and kept."""
    done: dict[Key, list[Line]] = {}
    for line in kept_lines(path, kind):
        done.setdefault(key_of(line), []).append(line)
    result = []
    for keys, made in groups:
        missing = [key for key in keys if key not in done]
        for lines in made(missing) if missing else ():
            keep(path, lines)
            done[key_of(lines[0])] = list(lines)
        result += [line for key in keys for line in done[key]]
    return result


@dataclass(frozen=True)
class KeptRun(Generic[Settings, Line]):
    """What there is of a study when its tables are made."""

    grid: Settings
    size: str  # "small" or "full"
    kept: Path  # The file of lines
    lines: Sequence[Line]


@dataclass(frozen=True)
class KeptStudy(Generic[Settings, Line]):
    """A study of the grid beside its file, whose command goes on where it was interrupted."""

    module: str  # Below `validation`
    doc: str | None
    part: str  # Of the page
    settings: Callable[..., Settings]  # What the grid's file holds
    line: type[Line]
    key: tuple[str, ...]  # Fields that name a trial among the others
    groups: Callable[[Settings, str, Path], Iterable[Group[Any, Line]]]  # Of grid, size, and file of lines
    requirements: Callable[[KeptRun[Settings, Line]], Iterable[Requirement]]
    # What stands behind the command's name, and what below the requirements
    tables: Callable[[KeptRun[Settings, Line]], Iterable[str]]
    heading: str = "what"  # Of the requirements
    file: str = "grid.toml"  # The published grid

    @property
    def grid(self) -> Path:
        return Path(__file__).parent.joinpath(*self.module.split(".")[:-1], self.file)

    def answer(self, grid: Path, size: str, kept: Path) -> Answer:
        """Make what the file does not have yet, and judge all of it."""
        settings = read_as(self.settings, grid)
        lines = completed(
            kept,
            self.line,
            self.groups(settings, size, kept),
            lambda line: tuple(getattr(line, name) for name in self.key),
        )
        run = KeptRun(settings, size, kept, lines)
        requirements = tuple(self.requirements(run))
        made, *tables = self.tables(run)
        command = f"Made by `python -m validation.{self.module}`{made}"
        return "\n\n".join([command, requirement_table(requirements, self.heading), *tables]), requirements

    def main(self, arguments: Sequence[str] | None = None) -> int:
        options: Mapping[str, Option] = {
            "--grid": {"type": Path, "default": self.grid, "help": "instead of the published one"},
            "--size": SIZE,
            "--kept": KEPT,
        }

        def answer(chosen: argparse.Namespace) -> Answer:
            return self.answer(chosen.grid, chosen.size, chosen.kept)

        return StudyCommand(f"validation.{self.module}", self.doc, self.part, answer, options).main(arguments)


# -- studies that are a suite of scenarios --


def suite_command(
    module: str,
    doc: str | None,
    part: str,
    suite: Callable[[], Suite],  # the one that is run when no other is named
    rows_of: Callable[[SuiteStudy, StudyResult], Iterable[Row]],
    columns: tuple[str, ...],
    kind: str,  # what the table of these rows is called
    answer: Callable[[pl.DataFrame], Answer],
) -> StudyCommand:

    def rows(chosen: argparse.Namespace) -> pl.DataFrame:
        if chosen.sources:
            return joined([read_rows(source, columns, kind) for source in chosen.sources])
        selected = read_suite(chosen.suite) if chosen.suite else suite()
        if chosen.runs is not None:
            selected = selected.reduced(chosen.runs)
        kept = nullcontext(str(chosen.folder)) if chosen.folder else tempfile.TemporaryDirectory()
        with kept as folder:
            return run_suite(selected, Path(folder), rows_of, chosen.workers)

    def made(chosen: argparse.Namespace) -> Answer:
        if chosen.workers is not None:
            check_workers(chosen.workers)
        if chosen.out and not chosen.out.parent.is_dir():
            raise InputError("a folder that exists", f"{chosen.out.parent}", "Make it first.")
        table = rows(chosen)
        if chosen.out:
            write_rows(table, chosen.out)
        return answer(table)

    finished = "a finished run; given again, one of other rows: of one that both have, more records win"
    options: Mapping[str, Option] = {
        "suite": {"type": Path, "nargs": "?", "help": "a suite file; default: the package's"},
        "--runs": {"type": int, "help": "instead of the suite's"},
        "--folder": {"type": Path, "help": "keep every trial here"},
        "--workers": WORKERS,
        "--out": OUT,
        "--from": {**FINISHED, "dest": "sources", "action": "append", "help": finished},
    }
    return StudyCommand(module, doc, part, made, options)


def run_suite(
    suite: Suite,
    folder: Path,
    rows_of: Callable[[SuiteStudy, StudyResult], Iterable[Row]],
    workers: int | None = None,
) -> pl.DataFrame:
    """Run what is left of a suite and gather its rows."""
    rows: list[Row] = []
    for study in with_bar(suite.studies, "studies", len(suite.studies)):
        executor = study_executor(study.study, workers)
        result = run_study(study.study, folder / f"{study.scenario}-{study.samples}", executor=executor)
        rows.extend(rows_of(study, result))
    return pl.DataFrame(rows)


def joined(tables: Sequence[pl.DataFrame]) -> pl.DataFrame:
    """Rows of several runs, in the order in which they are first met."""
    rows = pl.concat(tables)
    most = rows.group_by(*KEYS, maintain_order=True).agg(pl.all().sort_by("runs").last())
    return most.select(rows.columns)


def write_rows(rows: pl.DataFrame, path: Path) -> None:
    try:
        with atomic_write(path) as file:
            rows.write_parquet(file, compression="zstd", statistics=False)
    except OSError as error:
        raise InputError("a file that can be written", f"{path}: {error}", "Choose another.") from error


def read_rows(path: Path, columns: tuple[str, ...], kind: str) -> pl.DataFrame:
    try:
        rows = pl.read_parquet(path)
    except (OSError, pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        raise InputError(f"a table of {kind}", f"{path}: {error}", "Make one with --out.") from error
    if tuple(rows.columns) != columns:
        raise InputError(f"a table of {kind}", f"{path}, which is another table", "Make one with --out.")
    return rows


# -- studies whose tasks are sealed files of a folder --

#: Files that make tables of rows, and no row.
TABLES_ONLY = frozenset({"study.py"})


@dataclass(frozen=True, slots=True)
class Task:
    """Some flights of a study, whose rows are kept in one file."""

    of: tuple[str, ...]  # Family, or scenario and vehicle
    first: int  # First flight, and the one after the last; of pools likewise
    last: int
    file_name: str  # Without its ending
    flights: int  # How many
    share: float  # Of all flights those before


def tasks_of(of: tuple[str, ...], place: str, count: int, together: int, pool: int = 1) -> Iterator[Task]:
    """Tasks of so many flights, or pools, together."""
    for first in range(0, count, together):
        last = min(first + together, count)
        yield Task(of, first, last, f"{place}-{first:03d}-{last:03d}", (last - first) * pool, first / count)


@dataclass(frozen=True)
class StudyTable:
    """What a run of the study leaves behind."""

    rows: pl.DataFrame  # One row for each flight
    origin: Mapping[str, str]  # The grid's name, how many of its flights were flown, and the versions

    def write(self, path: Path) -> None:
        narrow = self.rows.with_columns(pl.col(pl.Float64).cast(pl.Float32))
        write_atomically(path, sealed(narrow, self.origin))


def read_study_table(path: Path) -> StudyTable:
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
    """Where the tasks' rows are kept."""

    folder: Path  # Made when it is not there
    tasks: Sequence[Task]
    name: str  # Of the study's grid
    text: str
    package: str  # The study's own, whose code makes rows beside Eivor's
    planned: int  # Flights of the whole study
    rows_of: Callable[[Task], Sequence[Row]]  # Flies a task

    def missing(self) -> list[Task]:
        """Tasks whose file is not there, not whole, or was made by other code."""
        missing = [task for task in self.tasks if self._content(task) is None]
        # a run that is cut short has flown the same share of each kind
        return sorted(missing, key=lambda task: task.share)

    def write(self, task: Task, rows: Sequence[Row]) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        write_atomically(self._path(task), sealed(pl.DataFrame(list(rows)), self._facts(task)))

    def run(self, workers: int | None = None) -> None:
        missing = self.missing()
        if missing:
            with closing(local_executor(workers, len(missing)).map(self.rows_of, missing)) as results:
                for item, rows in with_bar(results, "tasks", len(missing)):
                    self.write(missing[item], rows)

    def gathered(self) -> StudyTable:
        """Table of all tasks that are done, in the order of their files' names."""
        contents = {task: self._content(task) for task in sorted(self.tasks, key=lambda task: task.file_name)}
        done = {task: pl.read_parquet(io.BytesIO(content)) for task, content in contents.items() if content}
        if not done:
            raise InputError("a folder with finished tasks", f"{self.folder}", "Run the study first.")
        rows = pl.concat(done.values())
        origin = {
            "grid": self.name,
            "flights": f"{sum(task.flights for task in done)} of {self.planned}",
            "made with": versions(),
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
        return {"part": task.file_name, "code": self._code}

    @cached_property
    def _code(self) -> str:
        """Checksum of the grid and of the code that makes rows: those of different code are never mixed."""
        digest = hashlib.sha256(self.text.encode())
        for package in ("eivor", self.package):
            for path in sorted(Path(str(files(package))).rglob("*.py")):
                if path.name not in TABLES_ONLY:
                    digest.update(path.read_bytes())
        return digest.hexdigest()


def folder_command(
    module: str,
    doc: str | None,
    part: str,
    word: str,  # option that names what is flown
    folder_of: Callable[[argparse.Namespace], StudyFolder],
    answer: Callable[[StudyTable], Answer],
) -> StudyCommand:

    def made(chosen: argparse.Namespace) -> Answer:
        if chosen.source:
            table = read_study_table(chosen.source)
        else:
            folder = folder_of(chosen)
            if not chosen.tables:
                folder.run(chosen.workers)
            table = folder.gathered()
        if chosen.out:
            table.write(chosen.out)
        return answer(table)

    name = module.removeprefix("validation.").replace(".", "-").replace("_", "-")
    options: Mapping[str, Option] = {
        "--folder": {"type": Path, "default": Path(name), "help": "keeps finished parts"},
        "--tables": {"action": "store_true", "help": "fly nothing; tables of what is done"},
        "--share": {"type": float, "default": 1.0, "help": "only the first flights of each"},
        word: {"dest": "word", "default": "", "metavar": "WORD", "help": "those with this in their name"},
        "--workers": WORKERS,
        "--out": OUT,
        "--from": FINISHED,
    }
    return StudyCommand(module, doc, part, made, options)
