"""`eivor inspect`: what a log holds, and whether `identify` would refuse it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from eivor.cli import arguments
from eivor.cli.arguments import STANDARD_OUTPUT, writing
from eivor.cli.exit_codes import ExitCode, guarded
from eivor.cli.identify import check_windows, flight_options, read_logs
from eivor.cli.terminal import show, step, write

EXIT_CODES = (
    "[bold]Exit codes[/bold]: 0 the log can be read, whatever identify would say; 2 wrong usage; 1 a log "
    "that cannot be read, or a file that cannot be written."
)


@guarded
def inspect(
    log: Annotated[
        str,
        typer.Argument(metavar="LOG", help="ULog, CSV or Parquet; LOG@START:END for a window."),
    ],
    *,
    window: Annotated[
        str,
        typer.Option(
            metavar="START:END",
            help="Look at this window for the verdict, in seconds from the log's start.",
            show_default=False,
        ),
    ] = "",
    channel_map: arguments.MapOption = "",
    json: arguments.JsonOption = "",
) -> ExitCode:
    """List what a log holds: channels, flight, references; and what identify would say."""
    given = arguments.log_argument(log)
    if json not in ("", STANDARD_OUTPUT):
        arguments.output_file(json, option="--json", logs=[given])
    options = flight_options(window=window, own_window=given.window)
    recording = read_logs([given], example=False, channel_map=channel_map)[0]
    check_windows([recording], [options.window])

    from eivor.report.inspection import inspection

    with step(f"Inspecting {recording.name}"):
        found = inspection(recording, options)
    if json:
        from eivor.report.inspection_document import inspection_document
        from eivor.report.json_document import json_text

        text = json_text(inspection_document(found))
        if json == STANDARD_OUTPUT:
            write(text)
            return ExitCode.IDENTIFIED
        with writing(Path(json)):
            Path(json).write_text(text, encoding="utf-8")
    from eivor.report.inspection_table import inspection_report

    show(inspection_report(found))
    return ExitCode.IDENTIFIED
