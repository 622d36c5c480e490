"""Commands of `eivor fleet`."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eivor.cli import outputs
from eivor.cli.outputs import (
    STANDARD_OUTPUT,
    ExitCode,
    ReadableCommand,
    ReadableGroup,
    complain,
    console,
    deliver,
    guarded,
    keep_inputs,
    show,
    step,
    write_out,
)
from eivor.cli.parsing import flight_options, named_motion
from eivor.dask_executor import DaskCluster
from eivor.errors import UsageError
from eivor.fleet.analysis import FleetReport, fleet_reports
from eivor.fleet.analysis import query as answer_of
from eivor.fleet.logs import given_covariates, logs_found
from eivor.fleet.report import fleet_document, fleet_json, fleet_page, flight_links
from eivor.fleet.run import FleetRun, Progress, no_progress, run_fleet
from eivor.fleet.table import COPY, FAILED, FleetOptions, PageOf, given_maps, read_flights
from eivor.inference.verdict import Status
from eivor.motions import DEFAULT as DEFAULT_MODEL
from eivor.process_pool import Executor, InProcess, Limits, LocalThreads, begun_in_advance, useful_workers
from eivor.report.document import printable
from eivor.report.flight_page import flight_page
from eivor.report.json_document import json_text
from eivor.report.terminal import on_terminal

if TYPE_CHECKING:
    import polars as pl
    from rich.console import RenderableType
    from rich.table import Table


#: Letters of a cell on the terminal; in a CSV cells are whole.
LONGEST_CELL = 160

app = typer.Typer(
    name="fleet",
    help="Whole fleets: thousands of logs, one row for each flight, one answer for each vehicle.",
    no_args_is_help=True,
    add_completion=False,
    cls=ReadableGroup,
)

FleetArgument = Annotated[
    str,
    typer.Argument(metavar="FLEET", help="Folder of eivor fleet run."),
    outputs.Reads(outputs.fleet_paths),
]


@app.command(
    "run",
    cls=ReadableCommand,
    epilog="[bold]Exit codes[/bold]: 0 every log has a row, also those that could not be identified; 2 wrong "
    "usage, such as a folder that was begun with other options; 1 no logs, a folder that cannot be read or "
    "written, one on which another run works, or a cluster that was lost; 130 interrupted. Rows that were "
    "written are kept: the same command goes on.",
)
@guarded
def run_command(
    logs: Annotated[
        str,
        typer.Argument(
            metavar="FOLDER|GLOB|LIST",
            help="A folder of logs, a pattern such as 'logs/**/*.ulg', or a list: a .txt with a path in each "
            "line, a .csv with a column 'path'.",
        ),
        outputs.Reads(),
    ],
    *,
    out: Annotated[
        str,
        typer.Option("-o", "--out", metavar="FLEET", help="Folder of the fleet, new or begun before."),
        outputs.Writes(outputs.FLEET_FILES),
    ],
    model: outputs.ModelOption = DEFAULT_MODEL,
    vehicle: outputs.VehicleOption = "",
    channel_map: Annotated[
        list[str] | None,
        typer.Option(
            "--map",
            metavar="PATTERN=MAP",
            help="Channel map of the logs whose name fits a pattern, such as 'lab/*.csv=lab.toml'; again for "
            "more. Without, a shipped map whose columns all match.",
            show_default=False,
        ),
        outputs.Reads(outputs.map_paths),
    ] = None,
    vehicle_from: Annotated[
        str,
        typer.Option(
            metavar="PATTERN|COLUMN",
            help="Whose log it is: a pattern of its path such as '{vehicle}/*.ulg' or '{type}/{vehicle}/*', "
            "or a column of the list or of the logs. Default: the board's unique id.",
            show_default=False,
        ),
    ] = "",
    input_channel: outputs.InputOption = "",
    input_map: outputs.InputMapOption = "",
    max_tilt: outputs.MaxTiltOption = None,
    workers: outputs.WorkersOption = None,
    dask: Annotated[
        str,
        typer.Option(
            metavar="ADDRESS",
            help="Use the workers of a Dask scheduler, such as tcp://host:8786; they see the same folders.",
            show_default=False,
        ),
    ] = "",
    reports: Annotated[
        bool,
        typer.Option("--reports", help="Write a page of each flight, to which eivor fleet report links."),
    ] = False,
    log_time: Annotated[
        float, typer.Option(metavar="S", help="Longest time for one log, in seconds.")
    ] = 600.0,
    log_memory: Annotated[float, typer.Option(metavar="GB", help="Most memory for one log, in GB.")] = 4.0,
) -> ExitCode:
    """Identify every log of a folder, or go on where that was interrupted: one row for each flight."""
    if workers is not None and dask:
        raise UsageError("--workers or --dask", "both", "A Dask cluster brings its own workers.")
    # what a process that reads logs loads takes as long as what follows here
    with nullcontext() if dask else begun_in_advance("eivor.fleet.table"):
        motion = named_motion(model, vehicle)
        options = FleetOptions(
            motion=model,
            vehicle_file=vehicle,
            flight=flight_options(
                motion, max_tilt=max_tilt, input_channel=input_channel, input_map=input_map
            ),
            maps=given_maps(tuple(channel_map or ())),
            vehicle_from=vehicle_from,
            limits=Limits(log_time, log_memory),
        )
        with step(f"Looking for logs in {logs}"):
            result = logs_found(logs)
        keep_inputs(f"the logs of {logs}", (Path(log.path) for log in result.logs))
        executor = _executor(workers, dask, len(result.logs))
        try:
            with _bar() as progress:
                done = run_fleet(
                    result,
                    Path(out),
                    options,
                    executor=executor,
                    shared=bool(dask),
                    progress=progress,
                    page_of=_page_of() if reports else None,
                )
        except KeyboardInterrupt:
            complain(
                "interrupted", f"Rows that were written are in {out}. Run the same command again to go on."
            )
            return ExitCode.INTERRUPTED
    show(_report(done, out))
    return ExitCode.IDENTIFIED


def _page_of() -> PageOf:
    return flight_page


def _executor(workers: int | None, dask: str, logs: int) -> Executor:
    if dask:
        return DaskCluster(dask)
    useful = useful_workers(workers, logs)
    return LocalThreads(useful) if useful > 1 else InProcess()


@contextmanager
def _bar() -> Iterator[Progress]:
    """Bar with rate and time left on standard error, when that is a terminal."""
    screen = console(error=True)
    if not screen.is_terminal:
        yield no_progress
        return
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(elapsed_when_finished=True),
    )
    with Progress(*columns, console=screen, transient=True) as bar:
        task = bar.add_task("Hashing", total=None, rate="")

        def update(done: int, total: int) -> None:
            if bar.tasks[0].total is None:  # what was there before says nothing about the rate
                bar.reset(task, total=total, completed=done, description="Flights")
            bar.update(task, completed=done, rate=_rate(bar.tasks[0].speed))

        yield update


def _rate(speed: float | None) -> str:
    """Logs in a second, or in a minute where that is less than one."""
    if not speed:
        return ""
    return f"{speed:.1f} logs/s" if speed >= 1.0 else f"{60.0 * speed:.0f} logs/min"


def _report(done: FleetRun, out: str) -> RenderableType:
    """What a run found, in some lines."""
    from rich.console import Group
    from rich.text import Text

    words = [*(status.value for status in Status), FAILED, COPY]
    plural = {COPY: "copies"}
    counts = [(done.verdicts[word], word) for word in words if word in done.verdicts]
    texts = [f"{count} {plural.get(word, word) if count > 1 else word}" for count, word in counts]
    lines = [
        Text(f"{done.logs} logs, each with a row: {', '.join(texts)}", style="bold"),
        Text(f"{done.before} of the rows were there before") if done.before else None,
        Text(_others(done.others)) if done.others else None,
        Text(f"{done.elsewhere} further rows are of logs that are not among these")
        if done.elsewhere
        else None,
        *(Text(f"not looked into: {printable(unread_folder)}") for unread_folder in done.unread_folders),
        Text(f"Table: {printable(out.rstrip('/'))}/flights/part-*.parquet", style="dim"),
    ]
    return Group(*(line for line in lines if line is not None))


def _others(count: int) -> str:
    return "1 other file is no log" if count == 1 else f"{count} other files are no logs"


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
        outputs.Writes(),
    ] = "",
) -> ExitCode:
    """Ask a fleet's table what is asked most often."""
    answer = answer_of(read_flights(Path(fleet)), what)
    if csv != STANDARD_OUTPUT:
        show(_table(answer))
    if csv:
        buffer = io.StringIO()
        answer.write_csv(buffer)
        write_out(buffer.getvalue(), csv)
    return ExitCode.IDENTIFIED


@app.command(
    cls=ReadableCommand,
    epilog="[bold]Exit codes[/bold]: 0 done; 2 wrong usage; 1 a fleet that cannot be read, or a file that "
    "cannot be written (what was found is printed all the same).\n\n"
    "[bold]JSON[/bold] (schema eivor.fleet_report/1): every vehicle and type with what is pooled, what "
    "changes, and what was left out.",
)
@guarded
def report(
    fleet: FleetArgument,
    *,
    covariates: Annotated[
        str,
        typer.Option(
            metavar="FILE",
            help="What you know of flights and logs do not, a CSV such as name,mass: changes that it "
            "explains are not identified as changes of the vehicle.",
            show_default=False,
        ),
        outputs.Reads(),
    ] = "",
    json: outputs.JsonOption = "",
    html: Annotated[
        str,
        typer.Option(
            metavar="FILE", help="Write one page that opens anywhere, FILE.html.", show_default=False
        ),
        outputs.Writes(),
    ] = "",
) -> ExitCode:
    """Pool flights by vehicle and type: means, what the next flight will be, what changes and deviates."""
    given = given_covariates(Path(covariates)) if covariates else None
    with step("Pooling"):
        reports = fleet_reports(Path(fleet), given)
    title = Path(fleet).resolve().name
    deliver(*_deliveries(reports, Path(fleet), title, json, html))
    return ExitCode.IDENTIFIED


def _deliveries(
    reports: Sequence[FleetReport], fleet: Path, title: str, json: str, html: str
) -> Iterator[Callable[[], None]]:
    if json != STANDARD_OUTPUT:
        yield partial(_print_reports, reports, title)
    if json:
        yield partial(_write_json, reports, json)
    if html:
        yield partial(_write_page, reports, fleet, title, html)


def _print_reports(reports: Sequence[FleetReport], title: str) -> None:
    for item in reports:
        show(on_terminal(fleet_document(item, title)))


def _write_json(reports: Sequence[FleetReport], position: str) -> None:
    write_out(json_text(fleet_json(reports)), position)


def _write_page(reports: Sequence[FleetReport], fleet: Path, title: str, position: str) -> None:
    write_out(fleet_page(reports, title, flight_links(fleet, Path(position))), position)


def _table(answer: pl.DataFrame) -> Table:
    """Answer for the terminal; a motion's column only where there are several."""
    from rich.table import Table
    from rich.text import Text

    if answer["motion"].n_unique() < 2:
        answer = answer.drop("motion")
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    for name, kind in answer.schema.items():
        is_number = kind.is_numeric()
        table.add_column(
            name.replace("_", " "),
            justify="right" if is_number else "left",
            no_wrap=is_number or kind.is_temporal(),
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
    if isinstance(value, datetime):
        return f"{value:%Y-%m-%d %H:%M}"
    text = str(value)
    return text if len(text) <= LONGEST_CELL else f"{text[:LONGEST_CELL].rpartition(' ')[0]} ..."
