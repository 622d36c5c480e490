"""Work of the commands identify and report."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from eivor.cli.options import LogWords
from eivor.cli.outputs import (
    STANDARD_OUTPUT,
    ExitCode,
    deliver_result,
    figure_file,
    show,
    step,
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
    with_distinct_names,
)
from eivor.errors import UsageError
from eivor.flights.motion import Motion
from eivor.flights.options import FlightOptions
from eivor.flights.result import FlightEstimate
from eivor.inference.verdict import Status
from eivor.logs import read_log
from eivor.logs.read import example_flight
from eivor.report.document import Fact, Facts, Section
from eivor.report.figures import save_figure
from eivor.report.flight import flight_document
from eivor.report.flight_figures import flight_figure
from eivor.report.flight_page import flight_page
from eivor.report.json_document import json_document, json_text
from eivor.report.terminal import on_terminal
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


def result_of(given: dict[str, Any]) -> FlightEstimate:
    """Read logs and identify them, of the options of `LogWords` and `FlightWords`."""
    logs = LogWords(**{name: given.pop(name) for name in LogWords.__struct_fields__ if name in given})
    motion = named_motion(logs.model, logs.vehicle)
    options = flight_options(motion, **given)
    return pooled_result(motion, options, logs.logs, example=logs.example, channel_map=logs.channel_map)


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


def identify(*, json: str, figure: str, html: str, card: bool, **given: Any) -> ExitCode:
    """Do what `eivor.cli.identify.identify` declares."""
    picture = figure_file(figure)
    result = result_of(given)
    deliver_result(
        lambda: on_terminal(flight_document(result, card=card)),
        lambda: json_text(json_document(result)),
        json,
        *figure_parts(picture, lambda: flight_figure(result)),
        *([partial(write_page, result, html)] if html else []),
    )
    return exit_code(result)


# -- Report --


def report(*, out: str, **given: Any) -> ExitCode:
    """Do what `eivor.cli.identify.report` declares."""
    if not out:
        raise UsageError("a file for the page", "none", "Add -o flight.html, for example.")
    result = result_of(given)
    write_page(result, out)
    if out != STANDARD_OUTPUT:
        size = f"{Path(out).stat().st_size / 1e6:.2f} MB"
        where = Section("", (Facts((Fact("page", f"{out} ({size})"),)),))
        show(on_terminal(replace(flight_document(result), sections=(where,))))
    return exit_code(result)
