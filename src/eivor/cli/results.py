"""Work of the commands identify, report, track, validate and frequency-response."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from eivor.atomic_file import write_atomically
from eivor.cli import outputs
from eivor.cli.options import DEFAULT_MODEL
from eivor.cli.parsing import flight_options, named_motions, parse_window, pooled_result, read_logs, result_of
from eivor.errors import UsageError
from eivor.flights.options import FlightOptions
from eivor.flights.result import LogEstimate
from eivor.flights.track import track as tracked_parameter
from eivor.motions.declaration import load_machine
from eivor.report import frequency_responses
from eivor.report.document import Facts, Section
from eivor.report.figures import save_figure
from eivor.report.flight import log_documents
from eivor.report.flight_figures import flight_figure
from eivor.report.flight_page import flight_page
from eivor.report.json_document import json_text
from eivor.report.other_results import residual_files, track_document, track_figure, track_json
from eivor.report.saved_fit import fit_among, load_fits
from eivor.report.terminal import on_terminal
from eivor.report.validation import validate as validated
from eivor.report.validation import validation_document


def figure_part(path: Path | None, make: Callable[[], Any]) -> Callable[[], None]:
    """Drawing of a figure, where one is wanted."""

    def draw() -> None:
        if path is not None:
            with outputs.step(f"Drawing {path.name}"), outputs.writing(path):
                save_figure(make(), path)

    return draw


def write_page(result: LogEstimate, position: str) -> None:
    """Write the page of a result to a file, or to standard output where the place is "-"."""
    with outputs.step(f"Writing {Path(position).name}"):
        page = flight_page(result)
    outputs.write_out(page, position)


def _write_residuals(result: LogEstimate, folder: Path) -> None:
    with outputs.step("Writing residuals"), outputs.writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in residual_files(result.drawn).items():
            write_atomically(folder / name, text)


def identify(
    *, needs: str, json: str, figure: str, html: str, card: bool, residuals: str, **given: Any
) -> outputs.ExitCode:
    """Do what `eivor.cli.identify.identify` declares."""
    picture = outputs.figure_file(figure)
    result, needed = result_of(given, needs)
    outputs.deliver_result(
        lambda: on_terminal(*log_documents(result, card=card)),
        result.to_json,
        json,
        figure_part(picture, lambda: flight_figure(result.drawn)),
        *([partial(write_page, result, html)] if html else []),
        *([partial(_write_residuals, result, Path(residuals))] if residuals else []),
    )
    return outputs.ExitCode.IDENTIFIED if result.meets(needed) else outputs.ExitCode.NOT_IDENTIFIED


def report(*, needs: str, out: str, **given: Any) -> outputs.ExitCode:
    """Do what `eivor.cli.identify.report` declares."""
    if not out:
        raise UsageError("a file for the page", "none", "Add -o flight.html, for example.")
    result, needed = result_of(given, needs)
    write_page(result, out)
    if out != outputs.STANDARD_OUTPUT:
        facts = Facts((("page", f"{out} ({Path(out).stat().st_size / 1e6:.2f} MB)"),))
        card = replace(log_documents(result)[0], sections=(Section("", (facts,)),))
        outputs.show(on_terminal(card))
    return outputs.ExitCode.IDENTIFIED if result.meets(needed) else outputs.ExitCode.NOT_IDENTIFIED


def track(
    *,
    log: str,
    memory: float | None,
    parameter: str,
    accelerometer_bias: float | None,
    method: str,
    json: str,
    figure: str,
    example: bool,
    channel_map: str,
    machine: str,
    **given: Any,
) -> outputs.ExitCode:
    """Do what `eivor.cli.identify.track` declares."""
    motions = named_motions("" if machine else DEFAULT_MODEL, machine=machine)
    picture = outputs.figure_file(figure)
    options = flight_options(motions, method=method, **given)
    if accelerometer_bias is not None:
        options = replace(options, accelerometer_bias=accelerometer_bias)
    logs = [log] if log else None
    result = pooled_result(motions, options, logs, example=example, channel_map=channel_map)
    with outputs.step("Following it over the log"):
        tracked = tracked_parameter(result.first, memory, parameter)
    outputs.deliver_result(
        lambda: on_terminal(track_document(tracked)),
        lambda: json_text(track_json(tracked)),
        json,
        figure_part(picture, lambda: track_figure(tracked)),
    )
    return outputs.ExitCode.IDENTIFIED if tracked.precise_moments else outputs.ExitCode.NOT_IDENTIFIED


def validate(
    *,
    fit: Path,
    log: str,
    model: str,
    json: str,
    figure: str,
    window: str,
    max_tilt: float | None,
    channel_map: str,
) -> outputs.ExitCode:
    """Do what `eivor.cli.identify.validate` declares."""
    picture = outputs.figure_file(figure)
    options = FlightOptions(window=parse_window(window) if window else None)
    fits = load_fits(fit)
    result = fit_among(fits, model, preferred=tuple(fits))
    others = [name for name, other in fits.items() if other is not result and other.estimated is not None]
    if others and not model:
        outputs.complain(f"compared is the first motion of {fit.name}; others: --model {' or '.join(others)}")
    if result.document.prediction is not None:
        _ = result.motion  # whose channels the log may have
    (recording,), (own_window,) = read_logs([log], options, example=False, channel_map=channel_map)
    with outputs.step(f"Predicting {recording.name}"):
        validation = validated(result, recording, window=own_window or options.window, max_tilt_deg=max_tilt)
    outputs.deliver_result(
        lambda: on_terminal(validation_document(validation)),
        validation.to_json,
        json,
        figure_part(picture, validation.plot),
    )
    return outputs.ExitCode.IDENTIFIED if validation.agrees else outputs.ExitCode.NOT_IDENTIFIED


def frequency_response(
    *,
    axis: str,
    reference: str,
    figure: str,
    json: str,
    logs: list[str] | None,
    example: bool,
    machine: str,
    channel_map: str,
    **given: Any,
) -> outputs.ExitCode:
    """Do what `eivor.cli.identify.frequency_response` declares."""
    picture = outputs.figure_file(figure)
    paths = frequency_responses.response_paths(axis, load_machine(machine) if machine else None)
    options = flight_options(tuple(path.motion for path in paths.values()), **given)
    recordings, windows = read_logs(logs, options, example=example, channel_map=channel_map)
    with outputs.step("Estimating the frequency response"):
        results = frequency_responses.log_responses(recordings, options, windows, paths, reference)
    outputs.deliver_result(
        lambda: on_terminal(*map(frequency_responses.response_document, results)),
        lambda: json_text(frequency_responses.responses_json(results)),
        json,
        figure_part(picture, lambda: frequency_responses.response_figure(results)),
    )
    any_shown = any(item.response.is_shown.any() and not item.response.is_provisional for item in results)
    return outputs.ExitCode.IDENTIFIED if any_shown else outputs.ExitCode.NOT_IDENTIFIED
