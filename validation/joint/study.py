"""K of flights in gusts by the rigid body and by the vertical motion, and the command that finds out.

    python -m validation.joint.study --size full --kept FILE.jsonl [--page docs/studies/joint.md]

Flights are kept as they are done; a run that was interrupted goes on there. The exit code is 0 when every
requirement is met, 3 when one is not, 2 for an input that cannot be used.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from eivor.errors import EivorError
from eivor.studies.generated_page import page_text, page_with
from eivor.whole_file import write_whole
from validation.flight_recipe.grid import read_grid
from validation.joint.page import PART, requirements, tables
from validation.joint.trials import run

GRID = Path(__file__).with_name("grid.toml")
#: Exit code when a requirement is not met, and for an input that cannot be used.
NOT_MET, WRONG = 3, 2


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit code."""
    parser = argparse.ArgumentParser(prog="python -m validation.joint.study", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--grid", type=Path, default=GRID, help="instead of the published one")
    parser.add_argument("--size", choices=("small", "full"), default="small")
    parser.add_argument(
        "--kept", type=Path, required=True, metavar="FILE.jsonl", help="keep every trial here"
    )
    parser.add_argument("--page", type=Path, metavar="FILE.md", help="put the tables between its marks")
    chosen = parser.parse_args(arguments)
    try:
        return _run(chosen)
    except EivorError as error:
        sys.stderr.write(f"{error}\n")
        return WRONG


def _run(chosen: argparse.Namespace) -> int:
    grid = read_grid(chosen.grid)
    page = page_text(chosen.page, PART) if chosen.page else ""
    found = run(grid if chosen.size == "full" else grid.small(), chosen.kept)
    told = tables(found)
    if chosen.page:
        write_whole(chosen.page, page_with(page, {PART: told}))
    sys.stdout.write(told + "\n")
    return 0 if all(one.met for one in requirements(found)) else NOT_MET


if __name__ == "__main__":
    sys.exit(main())
