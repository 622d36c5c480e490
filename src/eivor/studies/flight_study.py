"""The study that validates the flight recipe on simulated truth, and the command that runs it.

    python -m eivor.studies.flight_study [--size small|full] [--out FILE.parquet] [--page FILE.md]

flies the published grid (`flight_grid.toml`), runs the recipe and its controls on every flight, and
prints the tables. `--from FILE.parquet` makes them anew from a finished run. The exit code is 0 when
every requirement is met, 3 when one is not. A full run takes about half an hour on one core, a small one
half a minute.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from eivor.studies.flight_grid import FlightGrid, published_grid
from eivor.studies.flight_page import PART, study_tables
from eivor.studies.flight_requirements import requirements
from eivor.studies.flight_trials import FlightTrial, run_trials
from eivor.studies.generated_page import page_with
from eivor.studies.trial_table import TrialTable, read_trial_table, trial_table

SIZES = ("small", "full")
#: Exit code when a requirement is not met.
NOT_MET = 3


def run_study(size: str) -> TrialTable:
    """Run the published grid at one of its sizes.

    Parameters
    ----------
    size : str
        "small" or "full". On a terminal the progress is shown.
    """
    grid = published_grid() if size == "full" else published_grid().small()
    return trial_table(_shown(run_trials(grid), grid), grid=grid.name, size=size)


def _shown(trials: Iterable[FlightTrial], grid: FlightGrid) -> Iterator[FlightTrial]:
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
    parser = argparse.ArgumentParser(prog="python -m eivor.studies.flight_study", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--size", choices=SIZES, default="full", help="small is a published part of the grid")
    parser.add_argument("--out", type=Path, metavar="FILE.parquet", help="write every trial")
    parser.add_argument(
        "--page", type=Path, metavar="FILE.md", help="put the tables between the page's marks"
    )
    parser.add_argument(
        "--from", dest="source", type=Path, metavar="FILE.parquet", help="tables of a finished run"
    )
    chosen = parser.parse_args(arguments)
    table = read_trial_table(chosen.source) if chosen.source else run_study(chosen.size)
    if chosen.out:
        table.write(chosen.out)
    tables = study_tables(table)
    if chosen.page:
        page = page_with(chosen.page.read_text(encoding="utf-8"), {PART: tables})
        chosen.page.write_text(page, encoding="utf-8")
    sys.stdout.write(tables + "\n")
    small = table.origin["size"] != "full"
    return 0 if all(item.met for item in requirements(table.rows, allow_chance=small)) else NOT_MET


if __name__ == "__main__":
    sys.exit(main())
