"""`eivor track`: a parameter over a flight, with its band and the times at which it changed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eivor.asked.options import flight_options, named_motion
from eivor.cli import arguments
from eivor.cli.arguments import STANDARD_OUTPUT
from eivor.cli.exit_codes import ExitCode, guarded
from eivor.cli.identify import result_of
from eivor.cli.outputs import deliver, figure_file, write_out, writing
from eivor.cli.recordings import chosen_logs
from eivor.cli.terminal import show, step
from eivor.motions import DEFAULT as DEFAULT_MODEL

if TYPE_CHECKING:
    from eivor.flights.track import Track

EXIT_CODES = (
    "[bold]Exit codes[/bold]: 0 the gain is told somewhere in the flight, changes or not; 3 it is told "
    "nowhere; 2 wrong usage; 1 a log that cannot be read, or a file that cannot be written (what was found "
    "is printed all the same).\n\n"
    "[bold]JSON[/bold] (schema eivor.track/1): the gain with its interval at each moment, changes, and what "
    "was taken as known."
)


@guarded
def track(
    log: Annotated[
        str,
        typer.Argument(
            metavar="LOG",
            help="One log, as of eivor identify; LOG@START:END takes a window.",
            show_default=False,
        ),
        arguments.Reads(arguments.log_paths),
    ] = "",
    *,
    example: arguments.ExampleOption = False,
    memory: Annotated[
        float | None,
        typer.Option(
            metavar="S",
            help="Time over which samples are forgotten, in seconds; a step is told after half of it "
            "(default: 5, or the length of a shorter flight).",
        ),
    ] = None,
    window: arguments.WindowOption = "",
    max_tilt: arguments.MaxTiltOption = None,
    input_channel: arguments.InputOption = "",
    input_map: arguments.InputMapOption = "",
    accelerometer_bias: Annotated[
        float | None,
        typer.Option(
            "--accelerometer-bias",
            metavar="STD",
            help="Standard deviation of what the equation's intercept may be, in m/s^2 (default: 0.1). It "
            "lets hover tell the gain; inf when nothing is known, so that only movement does.",
        ),
    ] = None,
    instruments: arguments.InstrumentsOption = "",
    method: Annotated[
        str, typer.Option(metavar="NAME", help="Method that identifies the flight as a whole, and its lag.")
    ] = "reference_iv",
    lag: arguments.LagOption = "",
    lag_from: arguments.LagFromOption = "",
    channel_map: arguments.MapOption = "",
    json: arguments.JsonOption = "",
    figure: Annotated[
        str,
        typer.Option(metavar="FILE", help="Draw it: FILE.png, FILE.svg or FILE.pdf.", show_default=False),
        arguments.Writes(),
    ] = "",
) -> ExitCode:
    """Follow the thrust gain K_u over a flight: battery sag, a damaged propeller, wind."""
    motion = named_motion(DEFAULT_MODEL)
    chosen = chosen_logs([log] if log else None, example=example, channel_map=channel_map)
    picture = figure_file(figure) if figure else None
    options = flight_options(
        motion,
        window=window,
        max_tilt=max_tilt,
        input_channel=input_channel,
        input_map=input_map,
        instruments=instruments,
        method=method,
        lag=lag,
        lag_from=lag_from,
    )
    if accelerometer_bias is not None:
        options = replace(options, accelerometer_bias=accelerometer_bias)
    result = result_of(chosen, motion, options)

    from eivor.flights.track import track as followed

    with step("Following it over the flight"):
        found = followed(result, memory)
    deliver(*_deliveries(found, json, picture))
    return ExitCode.IDENTIFIED if found.told else ExitCode.NOT_IDENTIFIED


def _deliveries(found: Track, json: str, figure: Path | None) -> Iterator[Callable[[], None]]:
    if json != STANDARD_OUTPUT:
        yield partial(_print_report, found)
    if json:
        yield partial(_write_json, found, json)
    if figure is not None:
        yield partial(_draw, found, figure)


def _print_report(found: Track) -> None:
    from eivor.report.terminal import on_terminal
    from eivor.report.track_document import track_document

    show(on_terminal(track_document(found)))


def _write_json(found: Track, place: str) -> None:
    from eivor.report.json_document import json_text
    from eivor.report.json_track import track_json

    write_out(json_text(track_json(found)), place)


def _draw(found: Track, path: Path) -> None:
    from eivor.report.flight_figure import save_figure
    from eivor.report.track_figure import track_figure

    with step(f"Drawing {path.name}"), writing(path):
        save_figure(track_figure(found), path)
