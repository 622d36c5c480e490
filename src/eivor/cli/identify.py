"""Commands that identify logs: identify and report."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from eivor.cli.options import FlightWords, LogWords
from eivor.cli.outputs import (
    STANDARD_OUTPUT,
    ExitCode,
    JsonOption,
    Writes,
    deliver_result,
    figure_file,
    flag,
    guarded,
    option,
    show,
    step,
    with_options,
    write_out,
    writing,
)
from eivor.cli.parsing import result_of
from eivor.errors import UsageError
from eivor.flights.result import FlightEstimate
from eivor.inference.verdict import Status
from eivor.report.document import Facts, Section
from eivor.report.figures import save_figure
from eivor.report.flight import flight_document
from eivor.report.flight_figures import flight_figure
from eivor.report.flight_page import flight_page
from eivor.report.json_document import json_document, json_text
from eivor.report.terminal import on_terminal


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
    "[bold]Exit codes[/bold]: 0 identified. 3 weak, provisional or refused (the numbers are printed all the "
    "same). 2 wrong usage. 1 a log that cannot be read, or a file that cannot be written (the numbers are "
    "printed all the same).\n\n"
    "[bold]JSON[/bold] (schema eivor.identify/1): verdict and reasons; parameters and derived quantities, "
    "each with value, unit, std_error, interval and its own verdict; diagnostics, findings and provenance."
)


@guarded
@with_options(FlightWords, LogWords)
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

REPORT_EXIT_CODES = (
    "[bold]Exit codes[/bold]: 0 identified. 3 weak, provisional or refused (the page is written all the "
    "same). 2 wrong usage. 1 a log that cannot be read, or a page that cannot be written.\n\n"
    "The page holds the JSON of `eivor identify --json` too, and saves it."
)


@guarded
@with_options(FlightWords, LogWords)
def report(
    *,
    out: Annotated[str, option("FILE", "The page, such as flight.html.", "--out", "-o"), Writes()] = "",
    **given: Any,
) -> ExitCode:
    """Write what eivor identify finds as one page to look at and to send: verdict, numbers, pictures."""
    if not out:
        raise UsageError("a file for the page", "none", "Add -o flight.html, for example.")
    result = result_of(given)
    write_page(result, out)
    if out != STANDARD_OUTPUT:
        size = f"{Path(out).stat().st_size / 1e6:.2f} MB"
        where = Section("", (Facts((("page", f"{out} ({size})"),)),))
        show(on_terminal(replace(flight_document(result), sections=(where,))))
    return exit_code(result)
