"""Commands that identify a log: identify, report, track and validate."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from eivor.cli.outputs import (
    STANDARD_OUTPUT,
    ExitCode,
    JsonOption,
    ModelOption,
    Reads,
    VehicleOption,
    Writes,
    deliver_result,
    figure_file,
    flag,
    guarded,
    log_paths,
    option,
    show,
    step,
    with_options,
    write_out,
    writing,
)
from eivor.cli.parsing import (
    Window,
    check_windows,
    flight_options,
    identified,
    log_argument,
    named,
    named_motion,
    parse_window,
    with_distinct_names,
)
from eivor.errors import UsageError
from eivor.flights.motion import Motion
from eivor.flights.options import FlightOptions
from eivor.flights.result import FlightEstimate
from eivor.flights.track import track as tracked_parameter
from eivor.inference.verdict import Status
from eivor.logs import read_log
from eivor.logs.read import example_flight
from eivor.motions import DEFAULT as DEFAULT_MODEL
from eivor.report.document import Document, Fact, Facts, Section
from eivor.report.figures import flight_figure, save_figure
from eivor.report.flight import flight_document, flight_report
from eivor.report.flight_page import flight_page
from eivor.report.json_document import json_document, json_text
from eivor.report.other_results import track_document, track_figure, track_json
from eivor.report.saved_fit import load_fit
from eivor.report.terminal import on_terminal
from eivor.report.validation import validate as validated
from eivor.report.validation import validation_document
from eivor.signals.recording import Recording

# -- Results --


def read_logs(
    texts: list[str] | None, options: FlightOptions, *, example: bool, channel_map: str
) -> tuple[list[Recording], list[Window | None]]:
    """Recordings of what was typed, and the window of each that has one of its own."""
    logs = [log_argument(text) for text in texts or ()]
    if example == bool(logs):
        raise UsageError(
            "one or more logs, or --example",
            "both" if example else "neither",
            "Name a file such as flight.ulg, or try the command with --example.",
        )
    if example and channel_map:
        raise UsageError(
            "--map with a log",
            f"--example with --map {channel_map}",
            "Leave the map out: the example has canonical channels.",
        )
    if example:
        recordings = [example_flight()]
    else:
        read = {}
        for path in dict.fromkeys(log.path for log in logs):
            with step(f"Reading {path.name}"), named(str(path), several=len(logs) > 1):
                read[path] = read_log(path, channel_map=channel_map or None)
        recordings = with_distinct_names(logs, [read[log.path] for log in logs])
    windows = [log.window for log in logs] or [None]
    check_windows(recordings, [window or options.window for window in windows])
    return recordings, windows


@with_options(flight_options)
def result_of(
    *,
    logs: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="LOG",
            help="ULog, Crazyflie microSD, CSV or Parquet; - is standard input. Several are pooled as "
            "flights of one vehicle. LOG@START:END takes a window of one log.",
            show_default=False,
        ),
        Reads(log_paths),
    ] = None,
    example: Annotated[bool, flag("--example", "Use the example flight that comes with Eivor.")] = False,
    model: ModelOption = DEFAULT_MODEL,
    vehicle: VehicleOption = "",
    channel_map: Annotated[
        str,
        option(
            "FILE.toml",
            "Channel map of a table, a bag or a Crazyflie's log, or the name of a shipped one: "
            "betaflight_csv, crazyflie_csv, inav_csv, nanobench, rotorpy.",
            "--map",
        ),
        Reads(),
    ] = "",
    **given: Any,
) -> FlightEstimate:
    """Read logs and identify them."""
    motion = named_motion(model, vehicle)
    options = flight_options(motion, **given)
    return pooled_result(motion, options, logs, example=example, channel_map=channel_map)


def pooled_result(
    motion: Motion[Any],
    options: FlightOptions,
    logs: list[str] | None,
    *,
    example: bool,
    channel_map: str,
) -> FlightEstimate:
    """Read logs and identify them with options of the library."""
    recordings, windows = read_logs(logs, options, example=example, channel_map=channel_map)
    with step("Identifying" + (f" {len(recordings)} flights together" if len(recordings) > 1 else "")):
        return identified(recordings, motion, options, windows)


def figure_parts(path: Path | None, make: Callable[[], Any]) -> Iterator[Callable[[], None]]:
    """Drawing of a figure, where one is wanted."""

    def draw(path: Path) -> None:
        with step(f"Drawing {path.name}"), writing(path):
            save_figure(make(), path)

    if path is not None:
        yield partial(draw, path)


def write_page(result: FlightEstimate, position: str) -> None:
    """Write the page of a result to a file, or to standard output where the place is "-"."""
    with step(f"Writing {Path(position).name}"):
        page = flight_page(result)
    write_out(page, position)


def exit_code(result: FlightEstimate) -> ExitCode:
    """0 when identified, 3 otherwise."""
    return ExitCode.IDENTIFIED if result.verdict.status is Status.IDENTIFIED else ExitCode.NOT_IDENTIFIED


# -- Identify --

IDENTIFY_EXIT_CODES = (
    "[bold]Exit codes[/bold]: 0 identified; 3 weak, provisional or refused (the numbers are printed all the "
    "same); 2 wrong usage; 1 a log that cannot be read, or a file that cannot be written (the numbers are "
    "printed all the same).\n\n"
    "[bold]JSON[/bold] (schema eivor.identify/1): verdict and reasons; parameters and derived quantities, "
    "each with value, unit, std_error, interval and its own verdict; diagnostics, findings and provenance."
)


@guarded
@with_options(result_of)
def identify(
    *,
    json: JsonOption = "",
    figure: Annotated[str, option("FILE", "Draw the fit: FILE.png, FILE.svg or FILE.pdf."), Writes()] = "",
    html: Annotated[
        str, option("FILE", "Write everything as one page that opens in any browser."), Writes()
    ] = "",
    card: Annotated[
        bool, flag("--card", "Print the flight card too: what to fly and to log instead.")
    ] = False,
    **given: Any,
) -> ExitCode:
    """Identify a motion from logs: the vertical one of a drone, or another with --model."""
    picture = figure_file(figure)
    result = result_of(**given)
    deliver_result(
        lambda: on_terminal(flight_document(result, card=card)),
        lambda: json_text(json_document(result)),
        json,
        *figure_parts(picture, lambda: flight_figure(result)),
        *([partial(write_page, result, html)] if html else []),
    )
    return exit_code(result)


# -- Report --

REPORT_EXIT_CODES = (
    "[bold]Exit codes[/bold]: 0 identified; 3 weak, provisional or refused (the page is written all the "
    "same); 2 wrong usage; 1 a log that cannot be read, or a page that cannot be written.\n\n"
    "The page holds the JSON of `eivor identify --json` too, and saves it."
)


@guarded
@with_options(result_of)
def report(
    *,
    out: Annotated[str, option("FILE", "The page, such as flight.html.", "--out", "-o"), Writes()] = "",
    **given: Any,
) -> ExitCode:
    """Write what eivor identify finds as one page to look at and to send: verdict, numbers, pictures."""
    if not out:
        raise UsageError("a file for the page", "none", "Add -o flight.html, for example.")
    result = result_of(**given)
    write_page(result, out)
    if out != STANDARD_OUTPUT:
        flight = flight_report(result)
        size = f"{Path(out).stat().st_size / 1e6:.2f} MB"
        where = Section("", (Facts((Fact("page", f"{out} ({size})"),)),))
        show(on_terminal(Document(", ".join(flight.logs), flight.verdict.status, flight.meaning, (where,))))
    return exit_code(result)


# -- Track --

TRACK_EXIT_CODES = (
    "[bold]Exit codes[/bold]: 0 the gain is identified somewhere in the flight, changes or not; 3 it "
    "is identified "
    "nowhere; 2 wrong usage; 1 a log that cannot be read, or a file that cannot be written (what was found "
    "is printed all the same).\n\n"
    "[bold]JSON[/bold] (schema eivor.track/1): the gain with its interval at each moment, changes, and what "
    "was taken as known."
)
#: Of `identify`.
TRACK_OPTIONS = (
    *("example", "window", "max_tilt", "input_channel", "input_map", "instruments"),
    *("lag", "lag_from", "channel_map"),
)


@guarded
@with_options(result_of, *TRACK_OPTIONS)
def track(
    log: Annotated[
        str,
        typer.Argument(
            metavar="LOG",
            help="One log, as of eivor identify; LOG@START:END takes a window.",
            show_default=False,
        ),
        Reads(log_paths),
    ] = "",
    *,
    memory: Annotated[
        float | None,
        option(
            "S",
            "Time over which samples are forgotten, in seconds; a step is identified after half of it "
            "(default: 5, or the length of a shorter flight).",
        ),
    ] = None,
    accelerometer_bias: Annotated[
        float | None,
        option(
            "STD",
            "Standard deviation of what the equation's intercept may be, in m/s^2 (default: 0.1). It "
            "lets hover determine the gain; inf when nothing is known, so that only movement does.",
        ),
    ] = None,
    method: Annotated[
        str,
        option("NAME", "Method that identifies the flight as a whole, and its lag.", show_default=True),
    ] = "reference_iv",
    json: JsonOption = "",
    figure: Annotated[str, option("FILE", "Draw it: FILE.png, FILE.svg or FILE.pdf."), Writes()] = "",
    example: bool,
    channel_map: str,
    **given: Any,
) -> ExitCode:
    """Follow the thrust gain K_u over a flight: battery sag, a damaged propeller, wind."""
    motion = named_motion(DEFAULT_MODEL)
    picture = figure_file(figure)
    options = flight_options(motion, method=method, **given)
    if accelerometer_bias is not None:
        options = replace(options, accelerometer_bias=accelerometer_bias)
    result = pooled_result(motion, options, [log] if log else None, example=example, channel_map=channel_map)
    with step("Following it over the flight"):
        tracked = tracked_parameter(result, memory)
    deliver_result(
        lambda: on_terminal(track_document(tracked)),
        lambda: json_text(track_json(tracked)),
        json,
        *figure_parts(picture, lambda: track_figure(tracked)),
    )
    return ExitCode.IDENTIFIED if tracked.precise_moments else ExitCode.NOT_IDENTIFIED


# -- Validate --

VALIDATE_EXIT_CODES = (
    "[bold]Exit codes[/bold]: 0 the fit predicts the flight better than the simpler models do, in open loop "
    "or, of turning and of the rigid body, half a second ahead; 3 it does not (the numbers are printed all "
    "the same); 2 wrong usage, such as a result without an estimate; 1 a file that cannot be read or written "
    "(the numbers are printed all the same).\n\n"
    "[bold]JSON[/bold] (schema eivor.validate/1): for each model and quantity the RMS error and the share "
    "explained, over all runs and in each; of turning and of the rigid body the RMS error after .1 to .5 s."
)


@guarded
@with_options(result_of, "window", "max_tilt", "channel_map")
def validate(
    fit: Annotated[
        Path,
        typer.Argument(metavar="FIT.json", help="A result: eivor identify LOG --json FIT.json."),
        Reads(),
    ],
    log: Annotated[
        str,
        typer.Argument(metavar="LOG", help="Another flight of the same vehicle; LOG@START:END for a part."),
        Reads(log_paths),
    ],
    *,
    json: JsonOption = "",
    figure: Annotated[
        str,
        option("FILE", "Draw measured, predicted and residual: FILE.png, FILE.svg or FILE.pdf."),
        Writes(),
    ] = "",
    window: str,
    max_tilt: float | None,
    channel_map: str,
) -> ExitCode:
    """Predict another flight by a result, beside simpler models of the flights that it came from."""
    picture = figure_file(figure)
    options = FlightOptions(window=parse_window(window) if window else None)
    result = load_fit(fit)
    (recording,), (current,) = read_logs([log], options, example=False, channel_map=channel_map)
    with step(f"Predicting {recording.name}"):
        results = validated(result, recording, window=current or options.window, max_tilt_deg=max_tilt)
    deliver_result(
        lambda: on_terminal(validation_document(results)),
        results.to_json,
        json,
        *figure_parts(picture, results.plot),
    )
    return ExitCode.IDENTIFIED if results.predicts else ExitCode.NOT_IDENTIFIED
