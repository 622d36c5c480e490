"""Commands that follow and test a result: track and validate."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from eivor.cli.identify import figure_parts
from eivor.cli.options import DEFAULT_MODEL, FlightWords, LogWords
from eivor.cli.outputs import (
    ExitCode,
    JsonOption,
    Reads,
    Writes,
    deliver_result,
    figure_file,
    guarded,
    log_paths,
    option,
    step,
    with_options,
)
from eivor.cli.parsing import flight_options, named_motion, parse_window, pooled_result, read_logs
from eivor.flights.options import FlightOptions
from eivor.flights.track import track as tracked_parameter
from eivor.report.json_document import json_text
from eivor.report.other_results import track_document, track_figure, track_json
from eivor.report.saved_fit import load_fit
from eivor.report.terminal import on_terminal
from eivor.report.validation import validate as validated
from eivor.report.validation import validation_document

# -- Track --

TRACK_EXIT_CODES = (
    "[bold]Exit codes[/bold]: 0 the gain is identified somewhere in the flight, changes or not. 3 it "
    "is identified nowhere. 2 wrong usage. 1 a log that cannot be read, or a file that cannot be written "
    "(what was found is printed all the same).\n\n"
    "[bold]JSON[/bold] (schema eivor.track/1): the gain with its interval at each moment, changes, and what "
    "was taken as known."
)
#: Of `identify`.
TRACK_OPTIONS = (
    *("example", "window", "max_tilt", "input_channel", "input_map", "instruments"),
    *("lag", "lag_from", "channel_map"),
)


@guarded
@with_options(FlightWords, LogWords, only=TRACK_OPTIONS)
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
    "[bold]Exit codes[/bold]: 0 the fit predicts the flight better than the simpler models do, and the "
    "flight by itself contradicts no quantity. 3 otherwise (the numbers are printed all the same). 2 wrong "
    "usage, such as a result without an estimate. 1 a file that cannot be read or written (the numbers are "
    "printed all the same). Predictions are in open loop; of turning and of the rigid body they are half a "
    "second ahead.\n\n"
    "[bold]JSON[/bold] (schema eivor.validate/1): for each model and quantity the RMS error and the share "
    "explained, over all runs and in each; quantities of fit and flight with p-values. Of turning and of "
    "the rigid body the RMS error after .1 to .5 s."
)


@guarded
@with_options(FlightWords, LogWords, only=("window", "max_tilt", "channel_map"))
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
    (recording,), (own_window,) = read_logs([log], options, example=False, channel_map=channel_map)
    with step(f"Predicting {recording.name}"):
        validation = validated(result, recording, window=own_window or options.window, max_tilt_deg=max_tilt)
    deliver_result(
        lambda: on_terminal(validation_document(validation)),
        validation.to_json,
        json,
        *figure_parts(picture, validation.plot),
    )
    return ExitCode.IDENTIFIED if validation.agrees else ExitCode.NOT_IDENTIFIED
