"""Work of the commands track and validate, and the options of a plan."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

from eivor.cli.options import DEFAULT_MODEL, parse_pair
from eivor.cli.outputs import ExitCode, deliver_result, figure_file, step
from eivor.cli.parsing import flight_options, named_motion, parse_window
from eivor.cli.results import figure_parts, pooled_result, read_logs
from eivor.errors import UsageError
from eivor.flights.options import FlightOptions
from eivor.flights.track import track as tracked_parameter
from eivor.planning.plan import Location
from eivor.planning.vehicle import FlightLimits
from eivor.report.json_document import json_text
from eivor.report.other_results import track_document, track_figure, track_json
from eivor.report.saved_fit import load_fit
from eivor.report.terminal import on_terminal
from eivor.report.validation import validate as validated
from eivor.report.validation import validation_document

# -- Track --


def track(
    *,
    log: str,
    memory: float | None,
    accelerometer_bias: float | None,
    method: str,
    json: str,
    figure: str,
    example: bool,
    channel_map: str,
    **given: Any,
) -> ExitCode:
    """Do what `eivor.cli.identify.track` declares."""
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


def validate(
    *, fit: Path, log: str, json: str, figure: str, window: str, max_tilt: float | None, channel_map: str
) -> ExitCode:
    """Do what `eivor.cli.identify.validate` declares."""
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
    return ExitCode.IDENTIFIED if validation.predicts else ExitCode.NOT_IDENTIFIED


# -- Options of a plan --


def check_mission(qgc: str, home: str, shape: str) -> None:
    """Refuse a mission without a place, a place without a mission."""
    if bool(qgc) != bool(home):
        raise UsageError(
            "--qgc FILE.plan together with --home LAT,LON",
            "one without the other",
            "A mission of QGroundControl is at a place: --qgc flight.plan --home 47.3977,8.5456.",
        )
    if qgc and shape not in ("", "steps"):
        raise UsageError("--shape steps with --qgc", f"--shape {shape}", "A mission has levels only.")


def position_of(text: str) -> Location:
    """Place of ``LAT,LON`` [deg]."""
    place = parse_pair(text, ",", (math.nan, math.nan))
    if any(map(math.isnan, place)):
        raise UsageError("--home LAT,LON in degrees", f"'{text}'", "Such as 47.3977,8.5456.")
    return place


def flight_limits(
    height: str = "3:8", speed: float = 2.0, acceleration: float = 3.0, tilt: float = 20.0, time: float = 60.0
) -> FlightLimits:
    """Limits of a planned flight, with heights as ``LOW:HIGH`` [m]."""
    low, high = parse_pair(height)
    if not -math.inf < low < high < math.inf:
        expected = "--height LOW:HIGH with both ends, LOW below HIGH"
        raise UsageError(expected, f"'{height}'", "Such as 3:8, in metres above the place of take-off.")
    return FlightLimits((low, high), speed, acceleration, tilt, time)
