"""The entry point of the command line. Nothing heavy is imported here, so that help answers at once."""

from __future__ import annotations

import io
import os
import sys
import warnings
from contextlib import nullcontext
from typing import Annotated

import typer

from eivor.cli import examples, plain_text
from eivor.cli.exit_codes import DEBUG_VARIABLE, ExitCode
from eivor.cli.identify import EXIT_CODES, identify
from eivor.cli.inspect import EXIT_CODES as INSPECT_EXIT_CODES
from eivor.cli.inspect import inspect
from eivor.cli.interruptible import InterruptibleGroup
from eivor.cli.paper import EXIT_CODES as PAPER_EXIT_CODES
from eivor.cli.paper import paper
from eivor.cli.plan import EXIT_CODES as PLAN_EXIT_CODES
from eivor.cli.plan import plan
from eivor.cli.readable_help import ReadableCommand
from eivor.cli.simulate import EXIT_CODES as SIMULATE_EXIT_CODES
from eivor.cli.simulate import simulate
from eivor.cli.study import EXIT_CODES as STUDY_EXIT_CODES
from eivor.cli.study import study
from eivor.cli.terminal import complain, printing
from eivor.cli.validate import EXIT_CODES as VALIDATE_EXIT_CODES
from eivor.cli.validate import validate
from eivor.errors import InputError

app = typer.Typer(
    name="eivor",
    help="Identify the vertical parameters of a drone from its flight logs, with intervals and a verdict.",
    epilog="Try it: [bold]eivor identify --example[/bold]",
    no_args_is_help=True,
    cls=InterruptibleGroup,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
for command, exit_codes in (
    (identify, EXIT_CODES),
    (inspect, INSPECT_EXIT_CODES),
    (validate, VALIDATE_EXIT_CODES),
    (plan, PLAN_EXIT_CODES),
    (simulate, SIMULATE_EXIT_CODES),
    (study, STUDY_EXIT_CODES),
    (paper, PAPER_EXIT_CODES),
):
    app.command(epilog=exit_codes, cls=ReadableCommand)(command)
app.add_typer(examples.app)


def _print_version(wanted: bool) -> bool:
    if wanted:
        from importlib.metadata import version

        from eivor.cli.terminal import write

        write(f"eivor {version('eivor')}\n")
        raise typer.Exit
    return wanted


@app.callback()
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
            stream.reconfigure(errors=plain_text.ERRORS)
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(variable, "1")  # the matrices are small: threads would wait for each other
    if os.environ.get(DEBUG_VARIABLE) != "1":
        warnings.simplefilter("ignore")  # those of libraries; Eivor's own are findings and reasons
    try:
        with printing() if sys.stdout else nullcontext():
            try:
                app(prog_name="eivor")
            finally:  # what others print, such as help, waits until here for its room
                if sys.stdout:
                    sys.stdout.flush()
    except BrokenPipeError:
        raise SystemExit(ExitCode.FAILED) from None
    except InputError as error:
        complain(str(error))
        raise SystemExit(ExitCode.FAILED) from None
