"""Commands that run a suite of scenarios, keep its rows as a table, and put them into a page."""

from __future__ import annotations

import argparse
import platform
import sys
import tempfile
from collections.abc import Callable, Iterable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import polars as pl

from eivor.atomic_file import atomic_write, write_atomically
from eivor.errors import EivorError, InputError
from eivor.lab.experiments import page_text, page_with
from eivor.lab.study_files import Suite, SuiteStudy, read_suite
from eivor.lab.study_run import SHARD_TRIALS, StudyResult, run_study
from eivor.process_pool import check_workers, local_executor
from validation.requirement import Requirement

#: Exit code when a requirement is not met, and for an input that cannot be used.
NOT_MET, WRONG = 3, 2
PACKAGES = ("eivor", "numpy", "scipy")
#: What names a row of a run.
KEYS = ("scenario", "samples", "method", "parameter")

Row = dict[str, str | int | float]


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
