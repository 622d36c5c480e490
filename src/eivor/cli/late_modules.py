"""What developers of NumPy use is loaded when it is first used, in the process of the command line.

SciPy copies every name of NumPy when it is imported, and thereby loads parts that no command needs: .06 of
the .89 s of processor that `eivor identify` took on a log of 3 MB.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import LazyLoader
from types import ModuleType

#: The reader of Fortran, and what tests are written with, which brings the standard library's own.
LATE = frozenset({"numpy.f2py", "numpy.testing"})


class _Late(MetaPathFinder):
    """Finds the modules of `LATE` where they are, and has each loaded by the first look into it."""

    def find_spec(
        self, fullname: str, path: Iterable[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the specification of one of `LATE`; None of any other module, which others find.

        The folders of a package that has no `__init__.py` are no `Sequence`: they can be iterated over only.
        """
        if fullname not in LATE:
            return None
        found = PathFinder.find_spec(fullname, None if path is None else [*path], target)
        if found is not None and found.loader is not None:
            found.loader = LazyLoader(found.loader)
        return found


def load_late() -> None:
    """Have the modules of `LATE` loaded when they are first used; asked twice, it is as asked once."""
    if not any(isinstance(finder, _Late) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Late())
