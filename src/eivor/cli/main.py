"""Command line application: commands, global options and the exit code."""

from __future__ import annotations

import io
import os
import sys
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, nullcontext
from importlib import import_module
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import LazyLoader
from types import ModuleType
from typing import TYPE_CHECKING, Annotated, Any

import typer

from eivor import tools
from eivor.cli.outputs import (
    DEBUG_VARIABLE,
    FILE,
    ExitCode,
    ReadableCommand,
    ReadableGroup,
    Reads,
    complain,
    printing,
    read_repeated_options,
    refuse_empty_options,
)
from eivor.errors import InputError

# -- Interruptible --


class InterruptibleGroup(ReadableGroup):
    """Commands whose interrupt is one line, also where the arguments' reader leaves without words."""

    def make_context(self, *args: Any, **kwargs: Any) -> Any:
        """Read the arguments of the group."""
        with _interrupts_told():
            return super().make_context(*args, **kwargs)

    def invoke(self, ctx: Any) -> Any:
        """Read the arguments of a command, and run it."""
        with _interrupts_told():
            return super().invoke(ctx)


@contextmanager
def _interrupts_told() -> Iterator[None]:
    try:
        yield
    except KeyboardInterrupt:
        complain("interrupted")
        raise typer.Exit(code=int(ExitCode.INTERRUPTED)) from None


# -- Late modules --

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


# -- Main --

if TYPE_CHECKING:
    app: typer.Typer

#: Module of each command, which holds a function of that name and NAME_EXIT_CODES.
COMMANDS = {
    "identify": "eivor.cli.identify",
    "report": "eivor.cli.identify",
    "serve": "eivor.serve.cli",
    "inspect": "eivor.cli.tools",
    "track": "eivor.cli.identify",
    "validate": "eivor.cli.identify",
    "export": "eivor.cli.tools",
    "plan": "eivor.cli.tools",
    "simulate": "eivor.lab.cli",
    "study": "eivor.lab.cli",
    "paper": "eivor.lab.cli",
}
#: Module of each group of commands, and the name of its application there.
GROUPS = {
    "fleet": ("eivor.fleet.cli", "app"),
    "vehicle": ("eivor.cli.tools", "vehicle_app"),
    "example": ("eivor.cli.tools", "example_app"),
}


class _Commands(InterruptibleGroup):
    """All commands, with the options that repeat."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command that is asked for."""
        refuse_empty_options(ctx)
        try:
            read_repeated_options(ctx, ctx.params["config"], (*COMMANDS, *GROUPS))
        except InputError as error:
            complain(str(error))
            raise typer.Exit(int(ExitCode.FAILED)) from None
        return super().invoke(ctx)


def application(*names: str) -> typer.Typer:
    """Return the command line; with some of its commands only, when they are named."""
    made = typer.Typer(
        name="eivor",
        help="Identify the vertical parameters of a drone from its flight logs, "
        "with intervals and a verdict.",
        epilog="Try it: [bold]eivor identify --example[/bold]",
        no_args_is_help=True,
        cls=_Commands,
        pretty_exceptions_enable=False,
        rich_markup_mode="rich",
    )
    made.callback()(_eivor)
    for name in names or COMMANDS:
        module = import_module(COMMANDS[name])
        exit_codes = getattr(module, f"{name.upper()}_EXIT_CODES")
        made.command(epilog=exit_codes, cls=ReadableCommand)(getattr(module, name))
    if not names:
        for home, group in GROUPS.values():
            made.add_typer(getattr(import_module(home), group))
    return made


def __getattr__(name: str) -> object:
    """Return `app`, the command line with all commands, made when it is first asked for."""
    if name != "app":
        raise AttributeError(f"module 'eivor.cli.main' has no attribute '{name}'")
    made = globals()[name] = application()
    return made


def _print_version(wanted: bool) -> bool:
    if wanted:
        from importlib.metadata import version

        from eivor.cli.outputs import write

        write(f"eivor {version('eivor')}\n")
        raise typer.Exit
    return wanted


def _eivor(
    *,
    config: Annotated[
        str,
        typer.Option(
            metavar="FILE.toml",
            help=f"Options that repeat, by command (default: {FILE}, where the working directory has one).",
            show_default=False,
        ),
        Reads(default=lambda _values: FILE),
    ] = "",
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version and leave."
        ),
    ] = False,
) -> None:
    pass


def run() -> None:
    """Run the command line with the arguments of the process and leave with its exit code."""
    if sys.stderr is None:  # closed by the caller, who does not want to know
        sys.stderr = io.StringIO()
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors=tools.ERRORS)
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(variable, "1")  # the matrices are small: threads would wait for each other
    load_late()
    if os.environ.get(DEBUG_VARIABLE) != "1":
        warnings.simplefilter("ignore")  # those of libraries; Eivor's own are findings and reasons
    try:
        with printing() if sys.stdout else nullcontext():
            try:
                _asked_for(sys.argv[1:])(prog_name="eivor")
            finally:  # what others print, such as help, waits until here for its room
                if sys.stdout:
                    sys.stdout.flush()
    except BrokenPipeError:
        raise SystemExit(ExitCode.FAILED) from None
    except InputError as error:
        complain(str(error))
        raise SystemExit(ExitCode.FAILED) from None


def _asked_for(arguments: list[str]) -> typer.Typer:
    """Return the command line of the one command that is named first, which is loaded sooner; or of all."""
    named = [name for name in arguments[:1] if name in COMMANDS]
    return application(*named)
