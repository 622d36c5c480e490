"""Commands of `eivor fleet`."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from rich.console import Group, JustifyMethod, RenderableType
from rich.table import Table
from rich.text import Text

from eivor.cli import outputs as cli
from eivor.cli.options import DEFAULT_MODEL, NO_TEXTS, FlightWords
from eivor.cli.parsing import flight_options, named_motions
from eivor.dask_executor import DaskCluster
from eivor.errors import UsageError
from eivor.fleet.analysis import fleet_reports
from eivor.fleet.analysis import query as answer_of
from eivor.fleet.logs import given_covariates, logs_found
from eivor.fleet.report import fleet_document, fleet_json, fleet_page, flight_links
from eivor.fleet.run import FleetRun, compact_fleet, run_fleet
from eivor.fleet.table import COPY, FAILED, FleetOptions, given_maps, read_flights
from eivor.inference.verdict import Status
from eivor.logs.read import is_address, path_of
from eivor.process_pool import InProcess, Limits, LocalThreads, useful_workers
from eivor.report.flight_page import flight_page
from eivor.report.json_document import json_text
from eivor.report.terminal import on_terminal
from eivor.tools import printable

if TYPE_CHECKING:
    import polars as pl


#: Letters of a cell on the terminal; in a CSV cells are whole.
LONGEST_CELL = 160

app = cli.group(
    "fleet", "Whole fleets: thousands of logs, one row for each flight, one answer for each vehicle."
)

FleetArgument = Annotated[str, cli.option("all fleet"), cli.Reads(cli.fleet_paths)]


@cli.command(app, "run")
@cli.with_options(FlightWords, only=("input_channel", "input_map", "max_tilt"))
def run_command(
    logs: Annotated[str, cli.option("fleet run logs"), cli.Reads()],
    *,
    out: Annotated[str, cli.option("fleet run out"), cli.Writes(cli.FLEET_FILES)],
    model: cli.ModelOption = "",
    vehicle: cli.VehicleOption = "",
    channel_map: Annotated[
        list[str],
        cli.option("fleet run channel_map"),
        cli.Reads(lambda text: [Path(text.rpartition("=")[2])]),
    ] = NO_TEXTS,
    vehicle_from: Annotated[str, cli.option("fleet run vehicle_from")] = "",
    workers: cli.WorkersOption = None,
    dask: Annotated[str, cli.option("fleet run dask")] = "",
    reports: Annotated[bool, cli.option("fleet run reports")] = False,
    log_time: Annotated[float, cli.option("fleet run log_time")] = 600.0,
    log_memory: Annotated[float, cli.option("fleet run log_memory")] = 4.0,
    **given: Any,
) -> cli.ExitCode:
    """Identify every log of a folder, or go on where that was interrupted: one row for each flight."""
    if workers is not None and dask:
        raise UsageError("--workers or --dask", "both", "A Dask cluster brings its own workers.")
    motions = named_motions(model or DEFAULT_MODEL, vehicle)
    options = FleetOptions(
        motion=model or DEFAULT_MODEL,
        vehicle_file=vehicle,
        flight=flight_options(motions, FlightWords(**given)),
        maps=given_maps(channel_map),
        vehicle_from=vehicle_from,
        limits=Limits(log_time, log_memory),
    )
    with cli.step(f"Looking for logs in {logs}"):
        result = logs_found(logs)
    cli.keep_inputs(
        f"the logs of {logs}", (Path(log.path) for log in result.logs if not is_address(log.path))
    )
    useful = useful_workers(workers, len(result.logs))
    local = LocalThreads(useful) if useful > 1 else InProcess()
    try:
        with cli.progress_bar("flights") as progress:
            done = run_fleet(
                result,
                path_of(out),
                options,
                executor=DaskCluster(dask) if dask else local,
                shared=bool(dask),
                progress=progress,
                page_of=flight_page if reports else None,
            )
    except KeyboardInterrupt:
        kept = f"Rows that were written are in {out}. Run the same command again to go on."
        cli.complain("interrupted", kept)
        return cli.ExitCode.INTERRUPTED
    cli.show(_report(done, out))
    return cli.ExitCode.IDENTIFIED


def _report(done: FleetRun, out: str) -> RenderableType:
    words = [word for word in (*(status.value for status in Status), FAILED, COPY) if word in done.verdicts]
    several = {word: "copies" if word == COPY and done.verdicts[word] > 1 else word for word in words}
    counts = ", ".join(f"{done.verdicts[word]} {several[word]}" for word in words)
    others = "1 other file is no log" if done.others == 1 else f"{done.others} other files are no logs"
    lines = [
        *([f"{done.before} of the rows were there before"] if done.before else []),
        *([others] if done.others else []),
        *([f"{done.elsewhere} further rows are of logs that are not among these"] if done.elsewhere else []),
        *(f"not looked into: {printable(folder)}" for folder in done.unread_folders),
    ]
    return Group(
        Text(f"{done.logs} logs, each with a row: {counts}", style="bold"),
        *map(Text, lines),
        Text(f"Table: {printable(out.rstrip('/'))}/flights/part-*.parquet", style="dim"),
    )


@cli.command(app)
def query(
    fleet: FleetArgument,
    what: Annotated[str, cli.option("fleet query what")] = "verdicts",
    *,
    csv: Annotated[str, cli.option("fleet query csv"), cli.Writes()] = "",
) -> None:
    """Ask a fleet's table what is asked most often."""
    answer = answer_of(read_flights(path_of(fleet)), what)
    if csv != cli.STANDARD_OUTPUT:
        cli.show(_table(answer))
    if csv:
        cli.write_out(answer.write_csv(), csv)


@cli.command(app)
def compact(fleet: FleetArgument) -> None:
    """Put a fleet's rows into few files with the same columns, as every run does at its end."""
    with cli.step("Putting rows together"):
        rows, files = compact_fleet(path_of(fleet))
    cli.show(Text(f"{rows} rows in {files} {'file' if files == 1 else 'files'}"))


@cli.command(app)
def report(
    fleet: FleetArgument,
    *,
    covariates: Annotated[str, cli.option("fleet report covariates"), cli.Reads()] = "",
    json: cli.JsonOption = "",
    html: Annotated[str, cli.option("fleet report html"), cli.Writes()] = "",
) -> None:
    """Pool flights by vehicle and type: means, what the next flight will be, what changes and deviates."""
    given = given_covariates(Path(covariates)) if covariates else None
    with cli.step("Pooling"):
        reports = fleet_reports(path_of(fleet), given)
    title = path_of(fleet).resolve().name

    def write_page() -> None:
        cli.write_out(fleet_page(reports, title, flight_links(path_of(fleet), Path(html))), html)

    cli.deliver_result(
        lambda: on_terminal(*(fleet_document(report, title) for report in reports)),
        lambda: json_text(fleet_json(reports)),
        json,
        *([write_page] if html else []),
    )


def _table(answer: pl.DataFrame) -> Table:
    if answer["motion"].n_unique() < 2:
        answer = answer.drop("motion")
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    cells = [[printable(_cell(value)) for value in column] for column in answer]
    for name, kind, texts in zip(answer.columns, answer.dtypes, cells, strict=True):
        number = kind.is_numeric()
        side: JustifyMethod = "right" if number else "left"
        least = max(map(len, texts), default=0) if number else None  # words fold, digits are never cut
        table.add_column(
            name.replace("_", " "), justify=side, min_width=least, no_wrap=number, overflow="fold"
        )
    for row in zip(*cells, strict=True):
        table.add_row(*map(Text, row))
    return table


def _cell(value: object) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, datetime):
        return f"{value:%Y-%m-%d %H:%M}"
    text = str(value)
    return text if len(text) <= LONGEST_CELL else f"{text[:LONGEST_CELL].rpartition(' ')[0]} ..."
