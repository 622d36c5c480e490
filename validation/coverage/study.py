"""How often intervals hold the truth, over a suite of scenarios, and the command that finds out.

    python -m validation.coverage.study [SUITE.toml] [--runs N] [--out FILE.parquet] [--page FILE.md]

runs the suite that comes with the package, or another one, and prints its tables. `--from FILE.parquet`
makes them anew from a finished run. Trials are kept in `--folder` as they are done, and a run that was
interrupted goes on there. The method with the label "default" is judged. The exit code is 0 when every
requirement is met (by few runs: as far as they can tell), 3 when one is not, 2 for an input that cannot be
used.
"""

from __future__ import annotations

import sys

from validation.coverage.page import PART, coverage_tables
from validation.coverage.requirements import requirements
from validation.coverage.table import COLUMNS, coverage_rows
from validation.suite_files import coverage_suite
from validation.suites import SuiteCommand

COMMAND = SuiteCommand(
    "validation.coverage.study",
    __doc__,
    coverage_suite,
    coverage_rows,
    COLUMNS,
    "coverage",
    coverage_tables,
    PART,
    requirements,
)
main = COMMAND.main


if __name__ == "__main__":
    sys.exit(main())
