"""Declarations of identify, report, track, validate and frequency-response; help loads nothing else."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from pkgutil import resolve_name
from types import SimpleNamespace
from typing import Annotated, Any

from msgspec import Struct

from eivor.cli import outputs as cli
from eivor.cli.options import METHODS, NEEDS, FlightWords, LogWords


def declared(
    *sources: type[Struct], only: tuple[str, ...] = (), home: str = "tools"
) -> Callable[[Callable[cli.P, None]], Callable[cli.P, None]]:
    """A command done by the function of its name in another module, which help does not load."""

    def made(command: Callable[cli.P, None]) -> Callable[cli.P, None]:
        @wraps(cli.with_options(*sources, only=only)(command))
        def done(*_: cli.P.args, **typed: cli.P.kwargs) -> cli.ExitCode:
            return resolve_name(f"eivor.cli.{home}:{command.__name__}")(SimpleNamespace(**typed))

        return cli.guarded(done)

    return made


NeedsOption = Annotated[
    str,
    cli.rare_option(
        "NAMES",
        f"What must be identified for exit code 0: {', '.join(NEEDS)} (of roll and pitch), or names of "
        "quantities, with commas between them. Default: any of them.",
        "--for",
        values=NEEDS,
    ),
]


@declared(LogWords, FlightWords, home="results")
def identify(
    *,
    needs: NeedsOption = "",
    json: cli.JsonOption = "",
    figure: Annotated[
        str, cli.option("FILE", "Draw the first fit: FILE.png, FILE.svg or FILE.pdf."), cli.Writes()
    ] = "",
    html: Annotated[
        str, cli.option("FILE", "Write everything as one page that opens in any browser."), cli.Writes()
    ] = "",
    card: Annotated[
        bool, cli.rare_flag("--card", "Print the flight card too: what to fly and to log instead.")
    ] = False,
    residuals: Annotated[
        str,
        cli.rare_option(
            "FOLDER",
            "Write residuals of the first fit, with layouts of PlotJuggler and Foxglove that draw them.",
        ),
        cli.Writes(cli.RESIDUAL_FILES),
    ] = "",
    **given: Any,
) -> None:
    """Identify what logs support: vertical motion, turning, and the rigid body of a --vehicle."""


@declared(LogWords, FlightWords, home="results")
def report(
    *,
    needs: NeedsOption = "",
    out: Annotated[
        str, cli.option("FILE", "The page, such as flight.html.", "--out", "-o"), cli.Writes()
    ] = "",
    **given: Any,
) -> None:
    """Write what eivor identify finds as one page to look at and to send: verdict, numbers, pictures."""


#: Of `identify`.
TRACK_OPTIONS = (
    *("example", "window", "max_tilt", "input_channel", "input_map", "instruments"),
    *("lag", "lag_from", "channel_map", "machine"),
)


@declared(LogWords, FlightWords, only=TRACK_OPTIONS)
def track(
    log: Annotated[
        str,
        cli.argument("LOG", "One log, as of eivor identify; LOG@START:END takes a window."),
        cli.Reads(cli.log_paths),
    ] = "",
    *,
    memory: Annotated[
        float | None,
        cli.option(
            "S",
            "Time over which samples are forgotten, in seconds; a step is identified after half of it "
            "(default: 5, or the length of a shorter flight).",
        ),
    ] = None,
    parameter: Annotated[
        str, cli.option("NAME", "What is followed (default: the gain of the input); of a machine any term.")
    ] = "",
    accelerometer_bias: Annotated[
        float | None,
        cli.rare_option(
            "STD",
            "Standard deviation of what the equation's intercept may be, in m/s^2 (default: 0.1). It "
            "lets hover determine the gain; inf when nothing is known, so that only movement does.",
        ),
    ] = None,
    method: Annotated[
        str,
        cli.rare_option("NAME", "Method that identifies the flight as a whole, and its lag.", values=METHODS),
    ] = "reference_iv",
    json: cli.JsonOption = "",
    figure: Annotated[str, cli.option("FILE", "Draw it: FILE.png, FILE.svg or FILE.pdf."), cli.Writes()] = "",
    **given: Any,
) -> None:
    """Follow a parameter over a log: the thrust gain, which a worn propeller lowers, or any of a machine."""


@declared(LogWords, FlightWords, only=("window", "max_tilt", "channel_map"))
def validate(
    fit: cli.FitArgument,
    log: Annotated[
        str,
        cli.argument("LOG", "Another flight of the same vehicle; LOG@START:END for a part."),
        cli.Reads(cli.log_paths),
    ],
    *,
    model: cli.FitModelOption = "",
    json: cli.JsonOption = "",
    figure: Annotated[
        str,
        cli.option("FILE", "Draw measured, predicted and residual: FILE.png, FILE.svg or FILE.pdf."),
        cli.Writes(),
    ] = "",
    **given: Any,
) -> None:
    """Predict another flight by a result, beside simpler models of the flights that it came from."""


#: Of `identify`.
RESPONSE_OPTIONS = ("logs", "example", "window", "input_channel", "machine", "channel_map")


@declared(FlightWords, LogWords, only=RESPONSE_OPTIONS)
def frequency_response(
    *,
    axis: Annotated[
        str,
        cli.option(
            "NAME",
            "roll, pitch, yaw or vertical (default: all that turns), or an equation of a --machine.",
            values=("roll", "pitch", "yaw", "vertical"),
        ),
    ] = "",
    reference: Annotated[
        str, cli.option("CHANNEL", "What moves the input and does not answer the vehicle (default: by rule).")
    ] = "",
    figure: Annotated[str, cli.option("FILE", "Draw it: FILE.png, FILE.svg or FILE.pdf."), cli.Writes()] = "",
    json: cli.JsonOption = "",
    **given: Any,
) -> None:
    """Estimate the response from torque setpoint to rate, thrust to force, or a machine's input to state.

    Also the models of order 1 to 4 that fit it, and controllers to be test-flown, which are never applied.
    """
