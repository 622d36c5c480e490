"""Console script and `python -m eivor`: starts the command line; nothing is imported before `run`."""

from __future__ import annotations

import dataclasses
import gc
import sys
from collections.abc import Callable, Iterable
from functools import cache, partial
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import LazyLoader
from pkgutil import resolve_name
from types import ModuleType
from typing import Any

#: The reader of Fortran, what tests are written with, and rotations, which SciPy's searches bring.
LATE = frozenset({"numpy.f2py", "numpy.testing", "scipy.spatial.transform"})
#: Its decorator writes a table into the documentation of 260 functions, which no command reads.
TABLES = "scipy._lib._array_api"


def _without_tables(load: Callable[[ModuleType], None], module: ModuleType) -> None:
    load(module)
    vars(module)["xp_capabilities"] = lambda *_, **__: lambda function: function


class _Late(MetaPathFinder):
    """Finds modules where they are; those of `LATE` are loaded by the first look into them."""

    def find_spec(
        self, fullname: str, path: Iterable[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the specification of one of these; None of any other module, which others find."""
        if fullname not in {*LATE, TABLES}:
            return None
        spec = PathFinder.find_spec(fullname, None if path is None else [*path], target)
        if spec is not None and spec.loader is not None:
            if fullname == TABLES:
                vars(spec.loader)["exec_module"] = partial(_without_tables, spec.loader.exec_module)
                return spec
            spec.loader = LazyLoader(spec.loader)
        return spec


def load_late() -> None:
    """Have what a command may not need made at its first use; asked twice, it is as asked once."""
    if any(isinstance(finder, _Late) for finder in sys.meta_path):
        return
    sys.meta_path.insert(0, _Late())
    create = getattr(dataclasses, "_create_fn", None)
    if create is not None:  # before Python 3.13, which compiles the methods of a class together
        vars(dataclasses)["_create_fn"] = partial(_compiled_late, create)


def _compiled_late(create: Callable[..., Any], name: str, *args: Any, **options: Any) -> Callable[..., Any]:
    """A method of a data class; all but `__init__` are compiled when they are first called."""
    if name == "__init__":
        return create(name, *args, **options)
    compiled = cache(lambda: create(name, *args, **options))

    def method(self: object, *values: object) -> object:
        return compiled()(self, *values)

    method.__name__ = name
    return method


#: As `eivor.cli.outputs.ExitCode.INTERRUPTED`, which cannot be imported yet.
INTERRUPTED = 130
#: New objects before garbage is looked for: what a command imports makes 120,000, none of which can go.
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
