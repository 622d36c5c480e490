"""Commands that identify a log: identify, report, track and validate."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

from eivor.cli import outputs, parsing
from eivor.cli.outputs import (
    STANDARD_OUTPUT,
    ExitCode,
    Writes,
    deliver,
    figure_file,
    guarded,
    show,
    step,
    write_out,
    writing,
)
from eivor.cli.parsing import (
    LogArgument,
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
from eivor.flights.track import Track
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
from eivor.report.validation import Validation, validation_document
from eivor.report.validation import validate as validated
from eivor.signals.recording import Recording

# -- Recordings --


@dataclass(frozen=True, slots=True)
class ChosenLogs:
    """What to read."""

    logs: tuple[LogArgument, ...]
    example: bool  # The bundled example instead
    channel_map: str

    def __post_init__(self) -> None:
        if self.example == bool(self.logs):
            raise UsageError(
                "one or more logs, or --example",
                "both" if self.example else "neither",
                "Name a file such as flight.ulg, or try the command with --example.",
            )
        if self.example and self.channel_map:
            raise UsageError(
                "--map with a log",
                f"--example with --map {self.channel_map}",
                "Leave the map out: the example has canonical channels.",
            )

    def read(self, options: FlightOptions) -> tuple[list[Recording], list[Window | None]]:
        """Recordings, and the window of each that has one of its own; those."""
        if self.example:
            recordings = [example_flight()]
        else:
            read = {path: self._recording(path) for path in dict.fromkeys(log.path for log in self.logs)}
            recordings = with_distinct_names(self.logs, [read[log.path] for log in self.logs])
        current = [log.window for log in self.logs] or [None]
        check_windows(recordings, [window or options.window for window in current])
        return recordings, current

    def _recording(self, path: Path) -> Recording:
        with step(f"Reading {path.name}"), named(str(path), several=len(self.logs) > 1):
            return read_log(path, channel_map=self.channel_map or None)


def chosen_logs(texts: list[str] | None, *, example: bool, channel_map: str) -> ChosenLogs:
    """Logs of what was typed, see `ChosenLogs`."""
    return ChosenLogs(tuple(map(log_argument, texts or ())), example, channel_map)


# -- Identify --

IDENTIFY_EXIT_CODES = (
    "[bold]Exit codes[/bold]: 0 identified; 3 weak, provisional or refused (the numbers are printed all the "
    "same); 2 wrong usage; 1 a log that cannot be read, or a file that cannot be written (the numbers are "
    "printed all the same).\n\n"
    "[bold]JSON[/bold] (schema eivor.identify/1): verdict and reasons; parameters and derived quantities, "
    "each with value, unit, std_error, interval and its own verdict; diagnostics, findings and provenance."
)


@dataclass(frozen=True, slots=True)
class Outputs:
    """Where to write."""

    json: str  # File, "-" for standard output, empty for none
    figure: Path | None
    html: str = ""  # File of the page, empty for none
    card: bool = False


@guarded
def identify(
    logs: outputs.LogsArgument = None,
    *,
    example: outputs.ExampleOption = False,
    window: outputs.WindowOption = "",
    max_tilt: outputs.MaxTiltOption = None,
    input_channel: outputs.InputOption = "",
    input_map: outputs.InputMapOption = "",
    accelerometer_bias: outputs.AccelerometerBiasOption = None,
    instruments: outputs.InstrumentsOption = "",
    model: outputs.ModelOption = DEFAULT_MODEL,
    vehicle: outputs.VehicleOption = "",
    method: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="reference_iv, least_squares, whitened_least_squares, total_least_squares, extended_iv, "
            "generalized_iv, generalized_iv_tls, bias_compensated_least_squares, spectral_giv, whittle_ml.",
        ),
    ] = "reference_iv",
    lag: outputs.LagOption = "",
    lag_from: outputs.LagFromOption = "",
    align: Annotated[
        bool, typer.Option("--align", help="Take offset and scale out of sensors that disagree.")
    ] = False,
    pool_friction: outputs.PoolFrictionOption = "auto",
    term: outputs.TermOption = None,
    rotor_radius: outputs.RotorRadiusOption = None,
    noise: outputs.NoiseOption = None,
    compare: Annotated[bool, typer.Option("--compare", help="List every method side by side.")] = False,
    channel_map: outputs.MapOption = "",
    json: outputs.JsonOption = "",
    figure: Annotated[
        str,
        typer.Option(
            metavar="FILE", help="Draw the fit: FILE.png, FILE.svg or FILE.pdf.", show_default=False
        ),
        outputs.Writes(),
    ] = "",
    html: Annotated[
        str,
        typer.Option(
            metavar="FILE", help="Write everything as one page that opens in any browser.", show_default=False
        ),
        outputs.Writes(),
    ] = "",
    card: Annotated[
        bool, typer.Option("--card", help="Print the flight card too: what to fly and to log instead.")
    ] = False,
) -> ExitCode:
    """Identify a motion from logs: the vertical one of a drone, or another with --model."""
    motion = named_motion(model, vehicle)
    chosen = chosen_logs(logs, example=example, channel_map=channel_map)
    outputs = Outputs(json, figure_file(figure) if figure else None, html, card)
    options = flight_options(
        motion,
        window=window,
        max_tilt=max_tilt,
        input_channel=input_channel,
        input_map=input_map,
        accelerometer_bias=accelerometer_bias,
        instruments=instruments,
        method=method,
        compare=compare,
        lag=lag,
        lag_from=lag_from,
        align=align,
        pool_friction=pool_friction,
        terms=term or (),
        rotor_radius=rotor_radius,
        noise=noise or (),
    )
    result = result_of(chosen, motion, options)
    deliver(*deliveries(result, outputs))
    return exit_code(result)


def result_of(chosen: ChosenLogs, motion: Motion[Any], options: FlightOptions) -> FlightEstimate:
    """Read logs and identify them."""
    recordings, windows = chosen.read(options)
    with step("Identifying" + (f" {len(recordings)} flights together" if len(recordings) > 1 else "")):
        return identified(recordings, motion, options, windows)


def deliveries(result: FlightEstimate, outputs: Outputs) -> Iterator[Callable[[], None]]:
    """What is to be done with a result, in order: what is printed comes first."""
    if outputs.json != STANDARD_OUTPUT:
        yield partial(_print_result, result, card=outputs.card)
    if outputs.json:
        yield partial(_write_result_json, result, outputs.json)
    if outputs.figure is not None:
        yield partial(_draw_result, result, outputs.figure)
    if outputs.html:
        yield partial(write_page, result, outputs.html)


def _print_result(result: FlightEstimate, *, card: bool) -> None:
    show(on_terminal(flight_document(result, card=card)))


def _write_result_json(result: FlightEstimate, position: str) -> None:
    write_out(json_text(json_document(result)), position)


def write_page(result: FlightEstimate, position: str) -> None:
    """Write the page of a result to a file, or to standard output where the place is "-"."""
    with step(f"Writing {Path(position).name}"):
        page = flight_page(result)
    write_out(page, position)


def _draw_result(result: FlightEstimate, path: Path) -> None:
    with step(f"Drawing {path.name}"), writing(path):
        save_figure(flight_figure(result), path)


def exit_code(result: FlightEstimate) -> ExitCode:
    """0 when identified, 3 otherwise."""
    return ExitCode.IDENTIFIED if result.verdict.status is Status.IDENTIFIED else ExitCode.NOT_IDENTIFIED


# -- Report --

REPORT_EXIT_CODES = (
    "[bold]Exit codes[/bold]: 0 identified; 3 weak, provisional or refused (the page is written all the "
    "same); 2 wrong usage; 1 a log that cannot be read, or a page that cannot be written.\n\n"
    "The page holds the JSON of `eivor identify --json` too, and saves it."
)

#: What `identify` writes and this command does not.
NOT_HERE = ("json", "figure", "html", "card")

OutOption = Annotated[
    str,
    typer.Option("--out", "-o", metavar="FILE", help="The page, such as flight.html.", show_default=False),
    Writes(),
]


@guarded
def report(*, out: str = "", **asked: Any) -> ExitCode:
    """Write what eivor identify finds as one page to look at and to send: verdict, numbers, pictures."""
    motion = named_motion(asked.pop("model"), asked.pop("vehicle"))
    logs, example, channel_map = (asked.pop(name) for name in ("logs", "example", "channel_map"))
    chosen = chosen_logs(logs, example=example, channel_map=channel_map)
    if not out:
        raise UsageError("a file for the page", "none", "Add -o flight.html, for example.")
    terms, noise = asked.pop("term") or (), asked.pop("noise") or ()
    result = result_of(chosen, motion, flight_options(motion, terms=terms, noise=noise, **asked))
    write_page(result, out)
    if out != STANDARD_OUTPUT:
        flight = flight_report(result)
        size = f"{Path(out).stat().st_size / 1e6:.2f} MB"
        where = Section("", (Facts((Fact("page", f"{out} ({size})"),)),))
        show(on_terminal(Document(", ".join(flight.logs), flight.verdict.status, flight.meaning, (where,))))
    return exit_code(result)


def _signature() -> inspect.Signature:
    """Arguments and options of `identify`, with the page's in place of what that command writes."""
    known = get_type_hints(identify, include_extras=True)
    kept = [
        parameter.replace(annotation=known[name])
        for name, parameter in inspect.signature(identify).parameters.items()
        if name not in NOT_HERE
    ]
    page = inspect.Parameter("out", inspect.Parameter.KEYWORD_ONLY, default="", annotation=OutOption)
    return inspect.Signature([kept[0], page, *kept[1:]])


vars(report)["__signature__"] = _signature()


# -- Track --

TRACK_EXIT_CODES = (
    "[bold]Exit codes[/bold]: 0 the gain is identified somewhere in the flight, changes or not; 3 it "
    "is identified "
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
        outputs.Reads(outputs.log_paths),
    ] = "",
    *,
    example: outputs.ExampleOption = False,
    memory: Annotated[
        float | None,
        typer.Option(
            metavar="S",
            help="Time over which samples are forgotten, in seconds; a step is identified after half of it "
            "(default: 5, or the length of a shorter flight).",
        ),
    ] = None,
    window: outputs.WindowOption = "",
    max_tilt: outputs.MaxTiltOption = None,
    input_channel: outputs.InputOption = "",
    input_map: outputs.InputMapOption = "",
    accelerometer_bias: Annotated[
        float | None,
        typer.Option(
            "--accelerometer-bias",
            metavar="STD",
            help="Standard deviation of what the equation's intercept may be, in m/s^2 (default: 0.1). It "
            "lets hover determine the gain; inf when nothing is known, so that only movement does.",
        ),
    ] = None,
    instruments: outputs.InstrumentsOption = "",
    method: Annotated[
        str, typer.Option(metavar="NAME", help="Method that identifies the flight as a whole, and its lag.")
    ] = "reference_iv",
    lag: outputs.LagOption = "",
    lag_from: outputs.LagFromOption = "",
    channel_map: outputs.MapOption = "",
    json: outputs.JsonOption = "",
    figure: Annotated[
        str,
        typer.Option(metavar="FILE", help="Draw it: FILE.png, FILE.svg or FILE.pdf.", show_default=False),
        outputs.Writes(),
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

    with step("Following it over the flight"):
        results = tracked_parameter(result, memory)
    deliver(*_track_deliveries(results, json, picture))
    return ExitCode.IDENTIFIED if results.precise_moments else ExitCode.NOT_IDENTIFIED


def _track_deliveries(result: Track, json: str, figure: Path | None) -> Iterator[Callable[[], None]]:
    if json != STANDARD_OUTPUT:
        yield partial(_print_track, result)
    if json:
        yield partial(_write_track_json, result, json)
    if figure is not None:
        yield partial(_draw_track, result, figure)


def _print_track(result: Track) -> None:
    show(on_terminal(track_document(result)))


def _write_track_json(result: Track, position: str) -> None:
    write_out(json_text(track_json(result)), position)


def _draw_track(result: Track, path: Path) -> None:
    with step(f"Drawing {path.name}"), writing(path):
        save_figure(track_figure(result), path)


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
def validate(
    fit: Annotated[
        Path,
        typer.Argument(metavar="FIT.json", help="A result: eivor identify LOG --json FIT.json."),
        outputs.Reads(),
    ],
    log: Annotated[
        str,
        typer.Argument(metavar="LOG", help="Another flight of the same vehicle; LOG@START:END for a part."),
        outputs.Reads(outputs.log_paths),
    ],
    *,
    window: outputs.WindowOption = "",
    max_tilt: outputs.MaxTiltOption = None,
    channel_map: outputs.MapOption = "",
    json: outputs.JsonOption = "",
    figure: Annotated[
        str,
        typer.Option(
            metavar="FILE",
            help="Draw measured, predicted and residual: FILE.png, FILE.svg or FILE.pdf.",
            show_default=False,
        ),
        outputs.Writes(),
    ] = "",
) -> ExitCode:
    """Predict another flight by a result, beside simpler models of the flights that it came from."""
    chosen = chosen_logs([log], example=False, channel_map=channel_map)
    outputs = Outputs(json, figure_file(figure) if figure else None)
    options = FlightOptions(window=parsing.parse_window(window) if window else None)
    result = load_fit(fit)
    (recording,), (current,) = chosen.read(options)
    with step(f"Predicting {recording.name}"):
        results = validated(result, recording, window=current or options.window, max_tilt_deg=max_tilt)
    deliver(*_validation_deliveries(results, outputs))
    return ExitCode.IDENTIFIED if results.predicts else ExitCode.NOT_IDENTIFIED


def _validation_deliveries(validation: Validation, outputs: Outputs) -> Iterator[Callable[[], None]]:
    if outputs.json != STANDARD_OUTPUT:
        yield partial(_print_validation, validation)
    if outputs.json:
        yield lambda: write_out(validation.to_json(), outputs.json)
    if outputs.figure is not None:
        yield partial(_draw_validation, validation, outputs.figure)


def _print_validation(validation: Validation) -> None:
    show(on_terminal(validation_document(validation)))


def _draw_validation(validation: Validation, path: Path) -> None:
    with step(f"Drawing {path.name}"), writing(path):
        save_figure(validation.plot(), path)
