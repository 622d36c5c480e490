"""`eivor vehicle`: files of what is known of a vehicle, to begin with and to look at."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from eivor.cli.arguments import STANDARD_OUTPUT, Reads, Writes
from eivor.cli.exit_codes import ExitCode, guarded
from eivor.cli.outputs import write_out
from eivor.cli.readable_help import ReadableCommand, ReadableGroup
from eivor.cli.terminal import show, write
from eivor.errors import UsageError

app = typer.Typer(
    name="vehicle",
    help="Vehicle files: what is known of a vehicle before its flight is identified.",
    no_args_is_help=True,
    add_completion=False,
    cls=ReadableGroup,
)


@app.command(
    cls=ReadableCommand,
    epilog="[bold]Exit codes[/bold]: 0 written; 2 wrong usage, such as a file that exists; 1 a file that "
    "cannot be written.",
)
@guarded
def new(
    file: Annotated[
        str,
        typer.Argument(
            metavar="[FILE.toml]", help="Where to; without it, it is printed.", show_default=False
        ),
        Writes(),
    ] = STANDARD_OUTPUT,
) -> ExitCode:
    """Write a vehicle file to begin with: every key, with what it means."""
    from eivor.motions.rigid_body.vehicle_file import ENDING, vehicle_template

    if file != STANDARD_OUTPUT:
        path = Path(file)
        if path.suffix != ENDING:
            raise UsageError(f"a vehicle file that ends in {ENDING}", f"'{file}'", "Add the ending.")
        if os.path.lexists(path):
            raise UsageError(
                "a file that does not exist yet", f"'{file}', which would be lost", "Choose another name."
            )
    write_out(vehicle_template(), file)
    if file != STANDARD_OUTPUT:
        write(f"{file}: fill in what you know\n")
    return ExitCode.IDENTIFIED


@app.command("list", cls=ReadableCommand, epilog="[bold]Exit codes[/bold]: 0 done; 2 wrong usage.")
@guarded
def list_vehicles() -> ExitCode:
    """List the vehicles that come with Eivor."""
    from rich.table import Table
    from rich.text import Text

    from eivor.motions.rigid_body.vehicle_file import load_vehicle, shipped_vehicles

    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    for title in ("name", "what it is"):
        table.add_column(title, overflow="fold")
    for name in shipped_vehicles():
        table.add_row(Text(name, style="bold"), Text(load_vehicle(name).name))
    show(table)
    return ExitCode.IDENTIFIED


@app.command(
    "show",
    cls=ReadableCommand,
    epilog="[bold]Exit codes[/bold]: 0 done; 2 wrong usage; 1 a vehicle that is not known, or a file with "
    "something wrong in it.",
)
@guarded
def show_vehicle(
    vehicle: Annotated[
        str,
        typer.Argument(metavar="NAME|FILE.toml", help="A name out of eivor vehicle list, or a file."),
        Reads(),
    ],
) -> ExitCode:
    """Check a vehicle's file, and print it."""
    from eivor.motions.rigid_body.vehicle_file import load_vehicle, vehicle_text

    load_vehicle(vehicle)
    write(vehicle_text(vehicle))
    return ExitCode.IDENTIFIED
