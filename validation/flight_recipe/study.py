"""The study that validates the flight recipe on simulated truth, and the command that runs it.

    python -m validation.flight_recipe.study [--size small|full] [--out FILE.parquet] [--page FILE.md]

flies the published grid (`flight_grid.toml`), runs the recipe and its controls on every flight, and
prints the tables. `--from FILE.parquet` makes them anew from a finished run. The exit code is 0 when
every requirement is met, 3 when one is not, 2 for an input that cannot be used. A full run takes about
half an hour on one core, a small one half a minute; `--workers` says how many are used.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from eivor.atomic_file import write_atomically
from eivor.errors import EivorError
from eivor.lab.experiments import page_with
from eivor.process_pool import local_executor
from validation.flight_recipe.grid import FlightGrid, published_grid
from validation.flight_recipe.page import PART, study_tables
from validation.flight_recipe.requirements import requirements
from validation.flight_recipe.trial_table import TrialTable, read_trial_table, trial_table
from validation.flight_recipe.trials import FlightTrial, flown_together, run_trials

SIZES = ("small", "full")
#: Exit code when a requirement is not met, and for an input that cannot be used.
NOT_MET, WRONG = 3, 2


def run_grid(size: str, workers: int | None = None) -> TrialTable:
    """Run the published grid at one of its sizes."""
    grid = published_grid() if size == "full" else published_grid().small()
    executor = local_executor(workers, len(flown_together(grid)))
    return trial_table(_displayed(run_trials(grid, executor), grid), grid=grid.name, size=size)


def _displayed(trials: Iterable[FlightTrial], grid: FlightGrid) -> Iterator[FlightTrial]:
    """Trials as they are done, with a bar on standard error when that is a terminal."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    with Progress(console=console, disable=not console.is_terminal) as progress:
        task = progress.add_task("flights", total=len(grid.cases))
        for trial in trials:
            yield trial
            progress.advance(task)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit code."""
    parser = argparse.ArgumentParser(prog="python -m validation.flight_recipe.study", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--size", choices=SIZES, default="full", help="small is a published part of the grid")
    parser.add_argument("--workers", type=int, metavar="N", help="processes; default: one for each core")
    parser.add_argument("--out", type=Path, metavar="FILE.parquet", help="write every trial")
    parser.add_argument(
        "--page", type=Path, metavar="FILE.md", help="put the tables between the page's marks"
    )
    parser.add_argument(
        "--from", dest="source", type=Path, metavar="FILE.parquet", help="tables of a finished run"
    )
    chosen = parser.parse_args(arguments)
    try:
        return _run(chosen)
    except EivorError as error:
        sys.stderr.write(f"{error}\n")
        return WRONG


def _run(chosen: argparse.Namespace) -> int:
    table = read_trial_table(chosen.source) if chosen.source else run_grid(chosen.size, chosen.workers)
    if chosen.out:
        table.write(chosen.out)
    tables = study_tables(table)
    if chosen.page:
        page = page_with(chosen.page.read_text(encoding="utf-8"), {PART: tables})
        write_atomically(chosen.page, page)
    sys.stdout.write(tables + "\n")
    small = table.origin["size"] != "full"
    return 0 if all(item.met for item in requirements(table.rows, allow_chance=small)) else NOT_MET


if __name__ == "__main__":
    sys.exit(main())
