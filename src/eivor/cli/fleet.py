"""`eivor fleet`: folders of logs, one row for each flight, and what the rows tell."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eivor.cli.arguments import STANDARD_OUTPUT
from eivor.cli.exit_codes import ExitCode, guarded
from eivor.cli.outputs import output_file, write_out
from eivor.cli.readable_help import ReadableCommand, ReadableGroup
from eivor.cli.terminal import show

if TYPE_CHECKING:
    import polars as pl
    from rich.table import Table

app = typer.Typer(
    name="fleet",
    help="Whole fleets: thousands of logs, one row for each flight, one answer for each vehicle.",
    no_args_is_help=True,
    add_completion=False,
    cls=ReadableGroup,
)

FleetArgument = Annotated[str, typer.Argument(metavar="FLEET", help="Folder of eivor fleet run.")]


@app.command(
    cls=ReadableCommand,
    epilog="[bold]Exit codes[/bold]: 0 done; 2 wrong usage, such as a query that does not exist; 1 a fleet "
    "that cannot be read, or a file that cannot be written.",
)
@guarded
def query(
    fleet: FleetArgument,
    what: Annotated[
        str,
        typer.Argument(
            metavar="[WHAT]",
            help="verdicts, vehicles, failed, refused, copies, or the name of a quantity.",
        ),
    ] = "verdicts",
    *,
    csv: Annotated[
        str,
        typer.Option(
            metavar="FILE", help="Write the answer as CSV; - for standard output.", show_default=False
        ),
    ] = "",
) -> ExitCode:
    """Ask a fleet's table what is asked most often."""
    from eivor.fleets.queries import query as answer_of
    from eivor.fleets.table import read_flights

    place = csv if csv in ("", STANDARD_OUTPUT) else str(output_file(csv, option="--csv"))
    answer = answer_of(read_flights(Path(fleet)), what)
    if csv != STANDARD_OUTPUT:
        show(_table(answer))
    if csv:
        write_out(answer.write_csv(), place)
    return ExitCode.IDENTIFIED


def _table(answer: pl.DataFrame) -> Table:
    """Answer for the terminal; a motion's column only where there are several."""
    from rich.table import Table
    from rich.text import Text

    from eivor.report.printable import printable

    if answer["motion"].n_unique() < 2:
        answer = answer.drop("motion")
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    for name, kind in answer.schema.items():
        is_number = kind.is_numeric()
        table.add_column(
            name.replace("_", " "),
            justify="right" if is_number else "left",
            no_wrap=is_number,
            overflow="fold",
        )
    for row in answer.iter_rows():
        table.add_row(*(Text(printable(_cell(value))) for value in row))
    return table


def _cell(value: object) -> str:
    from datetime import datetime

    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.4g}"
    return f"{value:%Y-%m-%d %H:%M}" if isinstance(value, datetime) else str(value)
