"""Effectiveness and lag from setpoints, against the truth, and the command that finds out.

    python -m validation.rates.study --size full --kept FILE.jsonl [--page docs/studies/rigid-body.md]

Flights are kept as they are done; a run that was interrupted goes on there. The exit code is 0 when every
requirement is met, 3 when one is not, 2 for an input that cannot be used.
"""

from __future__ import annotations

import sys
from pathlib import Path

from validation.kept_study import Answer, KeptStudyCommand
from validation.rates.grid import GRID, read_grid
from validation.rates.page import PART, requirements, tables
from validation.rates.trials import run


def answer(grid_file: Path, size: str, kept: Path) -> Answer:
    """Run what is left, and say what all of it says."""
    grid = read_grid(grid_file)
    completed = run(grid, size, kept)
    return tables(grid, completed), requirements(grid, completed)


main = KeptStudyCommand("validation.rates.study", __doc__, GRID, PART, answer).main


if __name__ == "__main__":
    sys.exit(main())
