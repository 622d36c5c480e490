"""How often intervals hold the truth, over a suite of scenarios, and the command that finds out.

    python -m validation.coverage.study [SUITE.toml] [--runs N] [--out FILE.parquet] [--page FILE.md]

runs the suite that comes with the package, or another one, and prints its tables. `--from FILE.parquet`
makes them anew from a finished run. Trials are kept in `--folder` as they are done, and a run that was
interrupted goes on there. The method with the label "default" is judged. The exit code is 0 when every
requirement is met (by few runs: as far as they can tell), 3 when one is not, 2 for an input that cannot be
used.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path

import polars as pl

from eivor.errors import EivorError, InputError
from eivor.studies.executors import check_workers, local_executor
from eivor.studies.generated_page import page_text, page_with
from eivor.studies.run import run_study
from eivor.studies.suite_file import Suite, coverage_suite, read_suite
from eivor.studies.trial_shards import SHARD_TRIALS
from eivor.whole_file import write_whole
from validation.coverage.page import PART, coverage_tables
from validation.coverage.requirements import requirements
from validation.coverage.table import coverage_rows, read_coverage, write_coverage

#: Exit code when a requirement is not met, and for an input that cannot be used.
NOT_MET, WRONG = 3, 2


def run_suite(suite: Suite, folder: Path, workers: int | None = None) -> pl.DataFrame:
    """Run what is left of a suite and gather its coverage.

    Parameters
    ----------
    suite : Suite
        What to run.
    folder : Path
        Each study keeps its trials in a folder of its own in there.
    workers : int, optional
        Processes; default one for each core.

    Returns
    -------
    polars.DataFrame
        See `validation.coverage.table`.
    """
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    rows: list[dict[str, str | int | float]] = []
    with Progress(console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task("studies", total=len(suite.studies))
        for one in suite.studies:
            executor = local_executor(workers, tasks=-(-one.study.runs // SHARD_TRIALS))
            result = run_study(one.study, folder / f"{one.scenario}-{one.samples}", executor=executor)
            rows.extend(coverage_rows(one, result))
            bar.advance(task)
    return pl.DataFrame(rows)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit code."""
    parser = argparse.ArgumentParser(prog="python -m validation.coverage.study", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("suite", type=Path, nargs="?", help="a suite file; default: the package's")
    parser.add_argument("--runs", type=int, help="instead of the suite's")
    parser.add_argument("--folder", type=Path, help="keep every trial here")
    parser.add_argument("--workers", type=int, help="processes; default: one for each core")
    parser.add_argument("--out", type=Path, metavar="FILE.parquet", help="write the coverage")
    parser.add_argument("--page", type=Path, metavar="FILE.md", help="put the tables between its marks")
    parser.add_argument("--from", dest="source", type=Path, metavar="FILE.parquet", help="of a finished run")
    chosen = parser.parse_args(arguments)
    try:
        return _run(chosen)
    except EivorError as error:
        sys.stderr.write(f"{error}\n")
        return WRONG


def _run(chosen: argparse.Namespace) -> int:
    page = page_text(chosen.page, PART) if chosen.page else ""
    if chosen.workers is not None:
        check_workers(chosen.workers)
    if chosen.out and not chosen.out.parent.is_dir():
        raise InputError("a folder that exists", f"{chosen.out.parent}", "Make it first.")
    if chosen.source:
        rows = read_coverage(chosen.source)
    else:
        suite = read_suite(chosen.suite) if chosen.suite else coverage_suite()
        if chosen.runs is not None:
            suite = suite.reduced(chosen.runs)
        kept = nullcontext(str(chosen.folder)) if chosen.folder else tempfile.TemporaryDirectory()
        with kept as folder:
            rows = run_suite(suite, Path(folder), chosen.workers)
    if chosen.out:
        write_coverage(rows, chosen.out)
    tables = coverage_tables(rows)
    if chosen.page:
        write_whole(chosen.page, page_with(page, {PART: tables}))
    sys.stdout.write(tables + "\n")
    return 0 if all(item.met for item in requirements(rows)) else NOT_MET


if __name__ == "__main__":
    sys.exit(main())
