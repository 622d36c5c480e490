"""Errors over the Cramer-Rao bound, over a suite of scenarios, and the command that finds them out.

    python -m validation.efficiency.study [SUITE.toml] [--runs N] [--out FILE.parquet] [--page FILE.md]

runs the suite beside this file, or another one, and prints its tables. `--from FILE.parquet` makes them anew
from a finished run, or from several of other scenarios or lengths. Trials are kept in `--folder` as they are
done, and a run that was interrupted goes on there. The exit code is 0 when every requirement is met (by few
runs: as far as they can tell), 3 when one is not, 2 for an input that cannot be used.
"""

from __future__ import annotations

import sys
from pathlib import Path

from validation.efficiency.page import PART, efficiency_tables
from validation.efficiency.requirements import requirements
from validation.efficiency.table import COLUMNS, efficiency_rows
from validation.suite_files import Suite, read_suite
from validation.suites import SuiteCommand


def efficiency_suite() -> Suite:
    """The suite beside this file."""
    return read_suite(Path(__file__).with_name("efficiency.toml"))


COMMAND = SuiteCommand(
    "validation.efficiency.study",
    __doc__,
    efficiency_suite,
    efficiency_rows,
    COLUMNS,
    "efficiency",
    efficiency_tables,
    PART,
    requirements,
)
main = COMMAND.main


if __name__ == "__main__":
    sys.exit(main())
