"""The study of logs as they are, and the command that runs it.

    python -m validation.real_logs.study [--folder FOLDER] [--out FILE.parquet] [--page FILE.md]

flies the published grid (`grid.toml`), identifies every log, and prints the tables. Finished parts are kept
in the folder: a run that was interrupted goes on there, and `--tables` makes the tables of what is done.
`--share` flies only the first flights of each family, `--families` only those whose name holds a word.
`--from FILE.parquet` makes the tables anew from a finished run. The exit code is 0 when every requirement is
met, 3 when one is not, 2 for an input that cannot be used.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from eivor.atomic_file import write_atomically
from eivor.errors import EivorError
from eivor.lab.experiments import page_with
from validation.real_logs.grid import Grid, published_grid
from validation.real_logs.page import PART, study_tables
from validation.real_logs.requirements import requirements
from validation.real_logs.table import folder_of
from validation.real_logs.trials import rows_of
from validation.study_folder import StudyTable, read_study_table

#: Exit code when a requirement is not met, and for an input that cannot be used.
NOT_MET, WRONG = 3, 2


def part_of(grid: Grid, share: float, word: str) -> Grid:
    """First flights of the families whose name holds a word."""
    kept = [family for family in grid.families if word in family.name]
    return replace(
        grid, families=tuple(replace(item, count=max(1, round(share * item.count))) for item in kept)
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit code."""
    parser = argparse.ArgumentParser(prog="python -m validation.real_logs.study", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--folder", type=Path, default=Path("real-logs-study"), help="keeps finished parts")
    parser.add_argument("--tables", action="store_true", help="fly nothing; tables of what is done")
    parser.add_argument("--share", type=float, default=1.0, help="of the flights of each family")
    parser.add_argument("--families", default="", metavar="WORD", help="those with this in their name")
    parser.add_argument("--workers", type=int, metavar="N", help="processes; default: one for each core")
    parser.add_argument("--out", type=Path, metavar="FILE.parquet", help="write every row")
    parser.add_argument("--page", type=Path, metavar="FILE.md", help="put the tables between its marks")
    parser.add_argument("--from", dest="source", type=Path, metavar="FILE.parquet", help="a finished run")
    chosen = parser.parse_args(arguments)
    try:
        return _run(chosen)
    except EivorError as error:
        sys.stderr.write(f"{error}\n")
        return WRONG


def _run(chosen: argparse.Namespace) -> int:
    grid = published_grid()
    table = read_study_table(chosen.source) if chosen.source else _simulated(chosen, grid)
    if chosen.out:
        table.write(chosen.out)
    tables = study_tables(table, grid)
    if chosen.page:
        write_atomically(chosen.page, page_with(chosen.page.read_text(encoding="utf-8"), {PART: tables}))
    sys.stdout.write(tables + "\n")
    return 0 if all(item.met for item in requirements(table.rows, grid)) else NOT_MET


def _simulated(chosen: argparse.Namespace, grid: Grid) -> StudyTable:
    folder = folder_of(chosen.folder, part_of(grid, chosen.share, chosen.families))
    if not chosen.tables:
        folder.run(rows_of, chosen.workers)
    return folder.gathered()


if __name__ == "__main__":
    sys.exit(main())
