"""The console script: it begins before anything is imported, so that an interrupt is one line at any time.

Nothing is imported here until `run` is called.
"""

from __future__ import annotations

import sys

#: As `eivor.cli.exit_codes.ExitCode.INTERRUPTED`, which cannot be imported yet.
INTERRUPTED = 130


def run() -> None:
    """Import the command line, run it, and leave with its exit code."""
    try:
        from eivor.cli.main import run as run_command

        run_command()
    except KeyboardInterrupt:
        if sys.stderr is not None:  # closed by the caller, who does not want to know
            sys.stderr.write("eivor: interrupted\n")
        raise SystemExit(INTERRUPTED) from None
