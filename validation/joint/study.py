"""K of flights in gusts by the rigid body and by the vertical motion, and the command that finds out.

    python -m validation.joint.study --size full --kept FILE.jsonl [--page docs/studies/rigid-body.md]

Flights are kept as they are done; a run that was interrupted goes on there. The exit code is 0 when every
requirement is met, 3 when one is not, 2 for an input that cannot be used.
"""

from __future__ import annotations

import sys
from pathlib import Path

from validation.flight_recipe.grid import read_grid
from validation.joint.page import PART, requirements, tables
from validation.joint.trials import run
from validation.kept_study import Answer, KeptStudyCommand

GRID = Path(__file__).with_name("grid.toml")


def answer(grid_file: Path, size: str, kept: Path) -> Answer:
    """Run what is left, and say what all of it says."""
    grid = read_grid(grid_file)
    completed = run(grid if size == "full" else grid.small(), kept)
    return tables(completed), requirements(completed)


main = KeptStudyCommand("validation.joint.study", __doc__, GRID, PART, answer).main


if __name__ == "__main__":
    sys.exit(main())
