"""`eivor identify`: logs in; table, JSON, figure and page out."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from eivor.asked.flights import identified
from eivor.asked.options import flight_options, named_motion
from eivor.cli import arguments
from eivor.cli.arguments import STANDARD_OUTPUT
from eivor.cli.exit_codes import ExitCode, guarded
from eivor.cli.outputs import deliver, figure_file, write_out, writing
from eivor.cli.recordings import ChosenLogs, chosen_logs
from eivor.cli.terminal import show, step
from eivor.motions import DEFAULT as DEFAULT_MODEL

if TYPE_CHECKING:
    from eivor.flights.motion import Motion
    from eivor.flights.options import FlightOptions
    from eivor.flights.result import FlightEstimate

EXIT_CODES = (
    "[bold]Exit codes[/bold]: 0 identified; 3 weak, provisional or refused (the numbers are printed all the "
    "same); 2 wrong usage; 1 a log that cannot be read, or a file that cannot be written (the numbers are "
    "printed all the same).\n\n"
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
    html : str
        File of the page, empty for none.
    card : bool
        Whether the report ends with the flight card.
    """

    json: str
    figure: Path | None
    html: str = ""
    card: bool = False


@guarded
def identify(
    logs: arguments.LogsArgument = None,
    *,
    example: arguments.ExampleOption = False,
    window: arguments.WindowOption = "",
    max_tilt: arguments.MaxTiltOption = None,
    input_channel: arguments.InputOption = "",
    input_map: arguments.InputMapOption = "",
    accelerometer_bias: arguments.AccelerometerBiasOption = None,
    instruments: arguments.InstrumentsOption = "",
    model: arguments.ModelOption = DEFAULT_MODEL,
    vehicle: arguments.VehicleOption = "",
    method: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="reference_iv, least_squares, whitened_least_squares, total_least_squares, extended_iv, "
            "generalized_iv, generalized_iv_tls, bias_compensated_least_squares, spectral_giv, whittle_ml.",
        ),
    ] = "reference_iv",
    lag: arguments.LagOption = "",
    lag_from: arguments.LagFromOption = "",
    align: Annotated[
        bool, typer.Option("--align", help="Take offset and scale out of sensors that disagree.")
    ] = False,
    pool_friction: arguments.PoolFrictionOption = "auto",
    term: arguments.TermOption = None,
    rotor_radius: arguments.RotorRadiusOption = None,
    noise: arguments.NoiseOption = None,
    compare: Annotated[bool, typer.Option("--compare", help="List every method side by side.")] = False,
    channel_map: arguments.MapOption = "",
    json: arguments.JsonOption = "",
    figure: Annotated[
        str,
        typer.Option(
            metavar="FILE", help="Draw the fit: FILE.png, FILE.svg or FILE.pdf.", show_default=False
        ),
        arguments.Writes(),
    ] = "",
    html: Annotated[
        str,
        typer.Option(
            metavar="FILE", help="Write everything as one page that opens in any browser.", show_default=False
        ),
        arguments.Writes(),
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
    """Read logs and identify them.

    Raises
    ------
    EivorError
        When one cannot be read, or lacks what the motion needs.
    """
    recordings, windows = chosen.read(options)
    with step("Identifying" + (f" {len(recordings)} flights together" if len(recordings) > 1 else "")):
        return identified(recordings, motion, options, windows)


def deliveries(result: FlightEstimate, outputs: Outputs) -> Iterator[Callable[[], None]]:
    """What is to be done with a result, in order: what is printed comes first."""
    if outputs.json != STANDARD_OUTPUT:
        yield partial(_print_report, result, card=outputs.card)
    if outputs.json:
        yield partial(_write_json, result, outputs.json)
    if outputs.figure is not None:
        yield partial(_draw, result, outputs.figure)
    if outputs.html:
        yield partial(write_page, result, outputs.html)


def _print_report(result: FlightEstimate, *, card: bool) -> None:
    from eivor.report.flight_document import flight_document
    from eivor.report.terminal import on_terminal

    show(on_terminal(flight_document(result, card=card)))


def _write_json(result: FlightEstimate, place: str) -> None:
    from eivor.report.json_document import json_document, json_text

    write_out(json_text(json_document(result)), place)


def write_page(result: FlightEstimate, place: str) -> None:
    """Write the page of a result to a file, or to standard output where the place is "-".

    Raises
    ------
    InputError
        When the system refuses the file.
    """
    from eivor.report.page.flight_page import flight_page

    with step(f"Writing {Path(place).name}"):
        page = flight_page(result)
    write_out(page, place)


def _draw(result: FlightEstimate, path: Path) -> None:
    from eivor.report.flight_figure import flight_figure, save_figure

    with step(f"Drawing {path.name}"), writing(path):
        save_figure(flight_figure(result), path)


def exit_code(result: FlightEstimate) -> ExitCode:
    """0 when identified, 3 otherwise."""
    from eivor.inference.verdict import Status

    return ExitCode.IDENTIFIED if result.verdict.status is Status.IDENTIFIED else ExitCode.NOT_IDENTIFIED
