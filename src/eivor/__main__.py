"""Console script and `python -m eivor`: starts the command line; nothing is imported before `run`."""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterable
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import LazyLoader
from pkgutil import resolve_name
from types import ModuleType

#: The reader of Fortran, what tests are written with, and rotations, which SciPy's searches bring.
LATE = frozenset({"numpy.f2py", "numpy.testing", "scipy.spatial.transform"})


class _Late(MetaPathFinder):
    """Finds the modules of `LATE` where they are, and has each loaded by the first look into it."""

    def find_spec(
        self, fullname: str, path: Iterable[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the specification of one of `LATE`; None of any other module, which others find."""
        if fullname not in LATE:
            return None
        spec = PathFinder.find_spec(fullname, None if path is None else [*path], target)
        if spec is not None and spec.loader is not None:
            spec.loader = LazyLoader(spec.loader)
        return spec


def load_late() -> None:
    """Have the modules of `LATE` loaded when they are first used; asked twice, it is as asked once."""
    if not any(isinstance(finder, _Late) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Late())


#: As `eivor.cli.outputs.ExitCode.INTERRUPTED`, which cannot be imported yet.
INTERRUPTED = 130
#: So many new objects, rather than 700, are waited for before those in cycles are looked for: what a command
#: imports makes 120,000, none of which can go, and looking through them is a twentieth of its time.
OBJECTS_BETWEEN_COLLECTIONS = 200_000


def run() -> None:
    """Import the command line, run it, and leave with its exit code."""
    gc.set_threshold(OBJECTS_BETWEEN_COLLECTIONS)
    load_late()
    try:
        resolve_name("eivor.cli.main:run")()
    except KeyboardInterrupt:
        if sys.stderr is not None:  # closed by the caller, who does not want to know
            sys.stderr.write("eivor: interrupted\n")
        raise SystemExit(INTERRUPTED) from None
    finally:
        gc.freeze()  # the process ends: what it holds is given back at once, not looked through first


if __name__ == "__main__":
    run()
