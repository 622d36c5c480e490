"""What regularisation does to the errors of generalized IV, and the command that finds it out.

    python -m validation.efficiency.regularisation [SUITE.toml] [--runs N] [--out FILE] [--page FILE.md]

runs the suite beside this file, or another one, and prints its tables; `--from FILE` makes
them anew from a finished run. Trials are kept in `--folder` as they are done, and a run that was interrupted
goes on there. Nothing is required of the figures: the exit code is 0, or 2 for an input that cannot be used.
"""

from __future__ import annotations

import sys
from pathlib import Path

from eivor.studies.suite_file import Suite, read_suite
from validation.efficiency.regularisation_page import PART, regularisation_tables
from validation.efficiency.table import COLUMNS, efficiency_rows
from validation.suites import SuiteCommand


def regularisation_suite() -> Suite:
    """The suite beside this file."""
    return read_suite(Path(__file__).with_name("regularisation.toml"))


COMMAND = SuiteCommand(
    "validation.efficiency.regularisation",
    __doc__,
    regularisation_suite,
    efficiency_rows,
    COLUMNS,
    "regularisation",
    regularisation_tables,
    PART,
    lambda _: (),
)
main = COMMAND.main


if __name__ == "__main__":
    sys.exit(main())
