"""Console script and `python -m eivor`: starts the command line; nothing is imported before `run`."""

from __future__ import annotations

import gc
import sys
from pkgutil import resolve_name

# -- Entry --

#: As `eivor.cli.outputs.ExitCode.INTERRUPTED`, which cannot be imported yet.
INTERRUPTED = 130
#: So many new objects, rather than 700, are waited for before those in cycles are looked for: what a command
#: imports makes 120,000, none of which can go, and looking through them is a twentieth of its time.
OBJECTS_BETWEEN_COLLECTIONS = 200_000


def run() -> None:
    """Import the command line, run it, and leave with its exit code."""
    gc.set_threshold(OBJECTS_BETWEEN_COLLECTIONS)
    try:
        resolve_name("eivor.cli.main:run")()
    except KeyboardInterrupt:
        if sys.stderr is not None:  # closed by the caller, who does not want to know
            sys.stderr.write("eivor: interrupted\n")
        raise SystemExit(INTERRUPTED) from None
    finally:
        gc.freeze()  # the process ends: what it holds is given back at once, not looked through first


# -- Main --

if __name__ == "__main__":
    run()
