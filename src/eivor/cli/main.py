"""The entry point of the command line. Nothing heavy is imported here, so that help answers at once."""

from __future__ import annotations

import os
import sys
import warnings
from typing import Annotated

import typer

from eivor.cli import examples
from eivor.cli.exit_codes import DEBUG_VARIABLE
from eivor.cli.identify import EXIT_CODES, identify
from eivor.cli.inspect import EXIT_CODES as INSPECT_EXIT_CODES
from eivor.cli.inspect import inspect
from eivor.cli.paper import EXIT_CODES as PAPER_EXIT_CODES
from eivor.cli.paper import paper
from eivor.cli.simulate import EXIT_CODES as SIMULATE_EXIT_CODES
from eivor.cli.simulate import simulate
from eivor.cli.study import EXIT_CODES as STUDY_EXIT_CODES
from eivor.cli.study import study

app = typer.Typer(
    name="eivor",
    help="Identify the vertical parameters of a drone from its flight logs, with intervals and a verdict.",
    epilog="Try it: [bold]eivor identify --example[/bold]",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
app.command(epilog=EXIT_CODES)(identify)
app.command(epilog=INSPECT_EXIT_CODES)(inspect)
app.command(epilog=SIMULATE_EXIT_CODES)(simulate)
app.command(epilog=STUDY_EXIT_CODES)(study)
app.command(epilog=PAPER_EXIT_CODES)(paper)
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
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(variable, "1")  # the matrices are small: threads would wait for each other
    if os.environ.get(DEBUG_VARIABLE) != "1":
        warnings.simplefilter("ignore")  # those of libraries; Eivor's own are findings and reasons
    app(prog_name="eivor")
