"""Command line application: commands, global options and the exit code."""

from __future__ import annotations

import io
import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

import eivor
from eivor.cli import outputs as cli
from eivor.errors import InputError, UsageError, did_you_mean

#: What the reader of arguments raises; its module is not the same in all versions of Typer.
WrongUsage: Any = typer.BadParameter.__base__
if TYPE_CHECKING:
    app: typer.Typer

#: Commands in the order of help; see the file.
COMMANDS = {name: row for name, row in cli.COMMANDS.items() if "heading" in row}
#: Group of the entry points by which the rooms `lab`, `fleet` and `serve` add their commands.
ENTRY_POINTS = "eivor.commands"


def _added() -> dict[str, str]:
    from importlib.metadata import entry_points  # with what reads mail, which Eivor's own commands do without

    return {point.name: point.value for point in entry_points(group=ENTRY_POINTS)}


@cache
def _targets(*names: str) -> dict[str, str]:
    modules = {name: row.get("module") for name, row in COMMANDS.items()}
    listed = {name: module and f"eivor.cli.{module}:{name}" for name, module in modules.items()}
    added = {} if names and all(map(listed.get, names)) else _added()
    return {name: target.replace("-", "_") for name, target in (listed | added).items() if target}


@contextmanager
def _readable_errors() -> Iterator[None]:
    """Say in a line what was interrupted or is missing, and what a misspelt option may be."""
    try:
        yield
    except KeyboardInterrupt:
        cli.complain("interrupted")
        raise typer.Exit(code=int(cli.ExitCode.INTERRUPTED)) from None
    except WrongUsage as error:
        context, parameter = getattr(error, "ctx", None), getattr(error, "param", None)
        if context is not None and hasattr(error, "option_name") and hasattr(error, "possibilities"):
            known = [name for item in context.command.params for name in item.opts if not item.hidden]
            error.possibilities = None
            remedy = did_you_mean(error.option_name, (*known, "--help"), "--help lists them.")
            error.message = f"No such option: {error.option_name}. {remedy}"
        elif context is not None and hasattr(error, "param_type") and parameter is not None:
            name = parameter.metavar or parameter.name
            if parameter.param_type_name == "option":
                name = f"{max(parameter.opts, key=len)} {name}"
            command = context.command_path.partition(" ")[2]
            example = f"For example: eivor {command} {cli.COMMANDS.get(command, {}).get('example', name)}"
            about = f"{name} ({parameter.help[0].lower()}{parameter.help[1:].rstrip('.')})"
            raise typer.Exit(int(cli.reported(UsageError(about, "none", example)))) from None
        raise


class Commands(TyperGroup):
    """All commands; what is wrong in them is said in one line."""

    def make_context(self, *args: Any, **kwargs: Any) -> Any:
        with _readable_errors():
            return super().make_context(*args, **kwargs)

    def invoke(self, ctx: Any) -> Any:
        with _readable_errors():
            return super().invoke(ctx)


def application(*names: str, loaded: bool = True) -> typer.Typer:
    """Return the command line; commands that are not among the names, if any, have their help alone."""
    made = typer.Typer(
        name="eivor",
        help="Identify how a drone moves from its flight logs: thrust, drag, lags and torques, with "
        "intervals and a verdict.",
        epilog="Try it: [bold]eivor identify --example[/bold]",
        no_args_is_help=True,
        cls=Commands,
        pretty_exceptions_enable=False,
        rich_markup_mode="rich",
    )
    made.callback()(_eivor)
    targets = _targets(*names)
    for name in names or targets:
        row = COMMANDS.get(name, {})
        if loaded:
            _add(made, name, targets[name], row.get("heading"))
        else:
            made.command(name, help=row.get("about"), rich_help_panel=row.get("heading"))(lambda: None)
    return made


def _add(made: typer.Typer, name: str, target: str, panel: str | None) -> None:
    home, _, attribute = target.partition(":")
    try:
        module = import_module(home)
    except ModuleNotFoundError as error:
        if name != "serve" or (error.name or "").startswith("eivor"):
            raise
        remedy = f"Install them: pip install 'eivor[{name}]'."
        raise InputError(f"the packages of eivor {name}", f"no package '{error.name}'", remedy) from error
    command = getattr(module, attribute)
    if isinstance(command, typer.Typer):
        made.add_typer(command, rich_help_panel=panel)
    else:
        made.command(epilog=cli.exit_codes(name), cls=cli.ReadableCommand, rich_help_panel=panel)(command)


def __getattr__(name: str) -> object:
    """Return `app`, the command line with all commands, made at its first use."""
    if name != "app":
        raise AttributeError(f"module 'eivor.cli.main' has no attribute '{name}'")
    made = globals()[name] = application()
    return made


def _print_version(wanted: bool) -> bool:
    if wanted:
        cli.write(f"eivor {eivor.__version__}\n")
        raise typer.Exit
    return wanted


def _eivor(
    *,
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
            stream.reconfigure(errors="replace")  # letters that it lacks
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(variable, "1")  # the matrices are small: threads would wait for each other
    if os.environ.get(cli.DEBUG_VARIABLE) != "1":
        warnings.simplefilter("ignore")  # those of libraries; Eivor's own are findings and reasons
    try:
        with cli.printing() if sys.stdout else nullcontext():
            try:
                _requested_command(sys.argv[1:])(prog_name="eivor")
            finally:  # what others print, such as help, waits until here for its room
                if sys.stdout:
                    sys.stdout.flush()
    except BrokenPipeError:
        raise SystemExit(cli.ExitCode.FAILED) from None
    except InputError as error:
        cli.complain(str(error))
        raise SystemExit(cli.ExitCode.FAILED) from None


def _requested_command(arguments: list[str]) -> typer.Typer:
    """Return the command line of the command that is named first; help alone loads none."""
    if any(name.startswith("_EIVOR") for name in os.environ):  # a shell completes words
        arguments = (os.environ.get("_TYPER_COMPLETE_ARGS") or os.environ.get("COMP_WORDS", "")).split()[1:]
        return (
            application(*arguments[:1])
            if arguments[:1] and arguments[0] in _targets()
            else application(loaded=False)
        )
    if not arguments or arguments[0] in {"--help", "--version"}:
        return application(loaded=False)
    named = [name for name in arguments[:1] if name in _targets(name)]
    # a misspelt one is answered without the packages of others
    return application(*named, loaded=bool(named))
