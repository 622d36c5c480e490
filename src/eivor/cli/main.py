"""The entry point of the command line. Nothing heavy is imported here, so that help answers at once."""

from __future__ import annotations

import io
import os
import sys
import warnings
from contextlib import nullcontext
from importlib import import_module
from typing import TYPE_CHECKING, Annotated, Any

import typer

from eivor.cli import plain_text
from eivor.cli.arguments import Reads
from eivor.cli.empty_options import refuse_empty_options
from eivor.cli.exit_codes import DEBUG_VARIABLE, ExitCode
from eivor.cli.interruptible import InterruptibleGroup
from eivor.cli.late_modules import load_late
from eivor.cli.readable_help import ReadableCommand
from eivor.cli.repeated_options import FILE, read_repeated_options
from eivor.cli.terminal import complain, printing
from eivor.errors import InputError

if TYPE_CHECKING:
    app: typer.Typer

#: Each is a module beside this one, with a function of the same name and its exit codes.
COMMANDS = (
    "identify",
    "report",
    "serve",
    "inspect",
    "track",
    "validate",
    "export",
    "plan",
    "simulate",
    "study",
    "paper",
)
#: Groups of commands, each a module with an `app`.
GROUPS = ("fleet", "vehicle", "example")


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
        module = import_module(f"eivor.cli.{name}")
        made.command(epilog=module.EXIT_CODES, cls=ReadableCommand)(getattr(module, name))
    if not names:
        from eivor.cli import examples, fleet, vehicle

        for group in (fleet, vehicle, examples):
            made.add_typer(group.app)
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

        from eivor.cli.terminal import write

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
            stream.reconfigure(errors=plain_text.ERRORS)
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
