"""`eivor validate`: a result and another log in; errors of its predictions, JSON and figure out."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eivor.asked import words
from eivor.cli import arguments
from eivor.cli.arguments import STANDARD_OUTPUT
from eivor.cli.exit_codes import ExitCode, guarded
from eivor.cli.identify import Outputs
from eivor.cli.outputs import deliver, figure_file, write_out, writing
from eivor.cli.recordings import chosen_logs
from eivor.cli.terminal import show, step

if TYPE_CHECKING:
    from eivor.report.validation import Validation

EXIT_CODES = (
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
        arguments.Reads(),
    ],
    log: Annotated[
        str,
        typer.Argument(metavar="LOG", help="Another flight of the same vehicle; LOG@START:END for a part."),
        arguments.Reads(arguments.log_paths),
    ],
    *,
    window: arguments.WindowOption = "",
    max_tilt: arguments.MaxTiltOption = None,
    channel_map: arguments.MapOption = "",
    json: arguments.JsonOption = "",
    figure: Annotated[
        str,
        typer.Option(
            metavar="FILE",
            help="Draw measured, predicted and residual: FILE.png, FILE.svg or FILE.pdf.",
            show_default=False,
        ),
        arguments.Writes(),
    ] = "",
) -> ExitCode:
    """Predict another flight by a result, beside simpler models of the flights that it came from."""
    from eivor.flights.options import FlightOptions

    chosen = chosen_logs([log], example=False, channel_map=channel_map)
    outputs = Outputs(json, figure_file(figure) if figure else None)
    options = FlightOptions(window=words.window(window) if window else None)
    from eivor.report.read_fit import load_fit

    result = load_fit(fit)
    (recording,), (own,) = chosen.read(options)
    from eivor.report.validation import validate as validated

    with step(f"Predicting {recording.name}"):
        found = validated(result, recording, window=own or options.window, max_tilt_deg=max_tilt)
    deliver(*_deliveries(found, outputs))
    return ExitCode.IDENTIFIED if found.predicts else ExitCode.NOT_IDENTIFIED


def _deliveries(found: Validation, outputs: Outputs) -> Iterator[Callable[[], None]]:
    if outputs.json != STANDARD_OUTPUT:
        yield partial(_print_report, found)
    if outputs.json:
        yield lambda: write_out(found.to_json(), outputs.json)
    if outputs.figure is not None:
        yield partial(_draw, found, outputs.figure)


def _print_report(found: Validation) -> None:
    from eivor.report.terminal import on_terminal
    from eivor.report.validation_document import validation_document

    show(on_terminal(validation_document(found)))


def _draw(found: Validation, path: Path) -> None:
    from eivor.report.flight_figure import save_figure

    with step(f"Drawing {path.name}"), writing(path):
        save_figure(found.plot(), path)
