"""`eivor identify`: logs in; table, JSON and figure out."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eivor.cli import arguments
from eivor.cli.arguments import STANDARD_OUTPUT, LogArgument, named, writing
from eivor.cli.exit_codes import ExitCode, guarded
from eivor.cli.terminal import show, step, write
from eivor.errors import MissingChannelError, UsageError

if TYPE_CHECKING:
    from eivor.flights.options import FlightOptions
    from eivor.flights.result import FlightEstimate
    from eivor.signals.recording import Recording

EXIT_CODES = (
    "[bold]Exit codes[/bold]: 0 identified; 3 weak, provisional or refused (the numbers are printed all the "
    "same); 2 wrong usage; 1 a log that cannot be read, or a file that cannot be written.\n\n"
    "[bold]JSON[/bold] (schema eivor.identify/1): verdict and reasons; parameters and derived quantities, "
    "each with value, unit, std_error, interval and its own verdict; diagnostics, findings and provenance."
)


@dataclass(frozen=True, slots=True)
class Outputs:
    """Where to write.

    Parameters
    ----------
    json : str
        File, "-" for standard output, empty for none.
    figure : Path or None
        File.
    """

    json: str
    figure: Path | None


@guarded
def identify(
    logs: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="LOG",
            help="ULog, CSV or Parquet. Several are pooled as flights of one vehicle. LOG@START:END takes a "
            "window of one log.",
            show_default=False,
        ),
    ] = None,
    *,
    example: Annotated[
        bool, typer.Option("--example", help="Use the example flight that comes with Eivor.")
    ] = False,
    window: Annotated[
        str,
        typer.Option(
            metavar="START:END",
            help="Use this window of each log, in seconds from its start.",
            show_default=False,
        ),
    ] = "",
    max_tilt: Annotated[
        float | None,
        typer.Option(
            metavar="DEG",
            help="Leave out what is tilted further (default: 25.8 degrees).",
            show_default=False,
        ),
    ] = None,
    input_channel: Annotated[
        str,
        typer.Option(
            "--input",
            metavar="CHANNEL",
            help="Channel, or family such as rotor_command, that drives the vehicle.",
            show_default=False,
        ),
    ] = "",
    input_map: Annotated[
        str,
        typer.Option(
            metavar="MAP",
            help="From command to thrust: linear, square, power:EXPONENT, mixed:SHARE.",
            show_default=False,
        ),
    ] = "",
    instruments: Annotated[
        str,
        typer.Option(
            metavar="NAMES",
            help="references, lags, or channels with commas between them.",
            show_default=False,
        ),
    ] = "",
    method: Annotated[
        str,
        typer.Option(metavar="NAME", help="reference_iv, least_squares, total_least_squares, extended_iv."),
    ] = "reference_iv",
    compare: Annotated[bool, typer.Option("--compare", help="List every method side by side.")] = False,
    channel_map: arguments.MapOption = "",
    json: arguments.JsonOption = "",
    figure: Annotated[
        str,
        typer.Option(
            metavar="FILE", help="Draw the fit: FILE.png, FILE.svg or FILE.pdf.", show_default=False
        ),
    ] = "",
) -> ExitCode:
    """Identify the vertical motion of a drone from flight logs."""
    given = [arguments.log_argument(text) for text in logs or []]
    outputs = Outputs(
        json
        if json in ("", STANDARD_OUTPUT)
        else str(arguments.output_file(json, option="--json", logs=given)),
        arguments.figure_file(figure, logs=given) if figure else None,
    )
    options = flight_options(
        window=window,
        max_tilt=max_tilt,
        input_channel=input_channel,
        input_map=input_map,
        instruments=instruments,
        method=method,
        compare=compare,
    )
    recordings = read_logs(given, example=example, channel_map=channel_map)
    windows = [log.window for log in given] or [None] * len(recordings)
    check_windows(recordings, [own or options.window for own in windows])
    check_instruments(recordings, options.instruments)
    result = identified(recordings, options, windows)
    deliver(result, outputs)
    return exit_code(result)


def flight_options(
    *,
    window: str = "",
    max_tilt: float | None = None,
    input_channel: str = "",
    input_map: str = "",
    instruments: str = "",
    method: str = "reference_iv",
    compare: bool = False,
    own_window: arguments.Window | None = None,
) -> FlightOptions:
    """Options of the library, checked before any log is read.

    Raises
    ------
    UsageError
        When one of them does not exist or makes no sense.
    """
    from eivor.estimation.methods import by_name
    from eivor.flights.options import FlightOptions
    from eivor.models.input_map import input_map as named_input_map

    by_name(method)
    if input_map:
        named_input_map(input_map)
    if max_tilt is not None and not math.isfinite(max_tilt):
        max_tilt = 0.0  # refused below, in the library's words
    options = FlightOptions(
        window=own_window or (arguments.window(window) if window else None),
        input=input_channel,
        input_map=input_map,
        instruments=arguments.names(instruments) if instruments else (),
        method=method,
        compare=compare,
    )
    return options if max_tilt is None else replace(options, max_tilt_deg=max_tilt)


def read_logs(given: list[LogArgument], *, example: bool, channel_map: str) -> list[Recording]:
    """Recordings of the logs, or of the bundled example; logs of the same file name are told by their paths.

    Raises
    ------
    UsageError
        When there is nothing to read, or both logs and the example.
    InputError
        With the name of the log that cannot be read.
    """
    if example == bool(given):
        raise UsageError(
            "one or more logs, or --example",
            "both" if example else "neither",
            "Try: eivor identify flight.ulg, or: eivor identify --example",
        )
    if example:
        from eivor.cli.examples import example_recording

        return [example_recording()]
    from eivor.logs import read_log

    recordings = []
    for log in given:
        with step(f"Reading {log.path.name}"), named(str(log.path), several=len(given) > 1):
            recordings.append(read_log(log.path, channel_map=channel_map or None))
    return told_apart(given, recordings)


def told_apart(given: list[LogArgument], recordings: list[Recording]) -> list[Recording]:
    """Recordings of one file name renamed: to their paths, and to path and window for parts of one log."""
    paths: dict[str, set[Path]] = {}
    parts: Counter[Path] = Counter()
    for log, recording in zip(given, recordings, strict=True):
        paths.setdefault(recording.name, set()).add(log.path)
        parts[log.path] += 1
    renamed = []
    for log, recording in zip(given, recordings, strict=True):
        name = str(log.path) if len(paths[recording.name]) > 1 else recording.name
        if parts[log.path] > 1 and log.window is not None:
            name += f"@{log.window[0]:g}:{log.window[1]:g}"
        renamed.append(recording if name == recording.name else replace(recording, name=name))
    return renamed


def check_windows(recordings: list[Recording], windows: list[tuple[float, float] | None]) -> None:
    """Refuse windows outside their logs, and name the log.

    Raises
    ------
    UsageError
        For the first one.
    """
    from eivor.signals.recording import interval_within

    for recording, window in zip(recordings, windows, strict=True):
        if window is not None:
            with named(recording.name, several=len(recordings) > 1):
                interval_within(window, recording.span_s)


def check_instruments(recordings: list[Recording], wanted: tuple[str, ...]) -> None:
    """Refuse instruments that a log does not have.

    Raises
    ------
    UsageError
        With the channels that there are.
    """
    for recording in recordings:
        absent = [name for name in wanted if name not in {"references", "lags", *recording.channels}]
        if absent:
            raise UsageError(
                f"channels of {recording.name} as instruments: {', '.join(sorted(recording.channels))}",
                ", ".join(f"'{name}'" for name in absent),
                "Name those, or references, or lags.",
            )


def identified(
    recordings: list[Recording], options: FlightOptions, windows: list[tuple[float, float] | None]
) -> FlightEstimate:
    """Result of the logs.

    Raises
    ------
    MissingChannelError
        With what to log so that the channel is there.
    """
    from eivor.flights.recipe import identify_flight

    try:
        with step("Identifying" + (f" {len(recordings)} flights together" if len(recordings) > 1 else "")):
            return identify_flight(recordings, options, windows=windows)
    except MissingChannelError as error:
        raise MissingChannelError(
            error.expected, error.received, " ".join((error.remedy, *_advice(recordings)))
        ) from error


def _advice(recordings: list[Recording]) -> tuple[str, ...]:
    from eivor.report.card import logging_advice_for, missing_channels

    sentences = [
        sentence
        for recording in recordings
        for channel in missing_channels(recording)
        for sentence in logging_advice_for(recording, channel)
    ]
    return tuple(dict.fromkeys(sentences))


def deliver(result: FlightEstimate, outputs: Outputs) -> None:
    """Write the files, then print.

    Raises
    ------
    InputError
        When a file cannot be written.
    """
    if outputs.figure is not None:
        from eivor.report.flight_figure import flight_figure, save_figure

        with step(f"Drawing {outputs.figure.name}"), writing(outputs.figure):
            save_figure(flight_figure(result), outputs.figure)
    text = ""
    if outputs.json:
        from eivor.report.json_document import json_document, json_text

        text = json_text(json_document(result))
    if outputs.json == STANDARD_OUTPUT:
        write(text)
        return
    if outputs.json:
        with writing(Path(outputs.json)):
            Path(outputs.json).write_text(text, encoding="utf-8")
    from eivor.report.table import identification_report

    show(identification_report(result))


def exit_code(result: FlightEstimate) -> ExitCode:
    """0 when identified, 3 otherwise."""
    from eivor.inference.verdict import Status

    return ExitCode.IDENTIFIED if result.verdict.status is Status.IDENTIFIED else ExitCode.NOT_IDENTIFIED
