"""Options of an identification, and the commands that have most of them; help loads nothing else."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import wraps
from pkgutil import resolve_name
from types import SimpleNamespace
from typing import Annotated, Any, get_type_hints

import msgspec

from eivor.cli import outputs as cli

#: Default of an option that may be given several times.
NO_TEXTS: list[str] = []
#: What commands with one motion identify: `eivor.motions.table.DEFAULT`, which help does not load.
DEFAULT_MODEL = "vertical"
#: Words of --for: `QuantitySpec.need` of Eivor's own motions.
NEEDS = ("hover", "lag", "gain", "friction", "torque")
#: The names of `eivor.estimation.methods.TABLE`, which help does not load.
METHODS = (
    *("reference_iv", "least_squares", "whitened_least_squares", "total_least_squares", "extended_iv"),
    *("generalized_iv", "generalized_iv_tls", "bias_compensated_least_squares", "spectral_giv", "whittle_ml"),
    "output_error",
)


class FlightWords(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """Choices for the identification of a flight, as they are typed; `eivor.cli.parsing` reads them."""

    window: Annotated[
        str, cli.option("START:END", "Use this window of each log, in seconds from its start.")
    ] = ""
    max_tilt: Annotated[
        float | None, cli.rare_option("DEG", "Leave out what is tilted further (default: 25.8 degrees).")
    ] = None
    input_channel: Annotated[
        str,
        cli.option(
            "CHANNEL", "Channel, or family such as rotor_command, that drives the vehicle.", "--input"
        ),
    ] = ""
    input_map: Annotated[
        str,
        cli.rare_option(
            "MAP",
            "From command to thrust: linear, square, power:EXPONENT, mixed:SHARE; fit finds it out.",
            values=("linear", "square", "power:", "mixed:", "fit"),
        ),
    ] = ""
    accelerometer_bias: Annotated[
        float | None,
        cli.rare_option(
            "STD",
            "Standard deviation of the accelerometer's bias in m/s^2, which --input-map fit rests on "
            "(default: 0.1).",
        ),
    ] = None
    instruments: Annotated[
        str,
        cli.rare_option(
            "NAMES", "references, lags, or channels with commas between them.", values=("references", "lags")
        ),
    ] = ""
    method: Annotated[str, cli.rare_option("NAME", f"{', '.join(METHODS)} (rigid body).", values=METHODS)] = (
        "reference_iv"
    )
    compare: Annotated[bool, cli.rare_flag("--compare", "List every method side by side.")] = False
    lag: Annotated[
        str,
        cli.option(
            "MS:STD",
            "Lag and delay of the actuators together, known from elsewhere. 70:15 is 70 ms with a standard "
            "deviation of 15 ms, 50..90 is anything between, none is neither lag nor delay. typical:CLASS is "
            "what was published of nano, 5in or multirotor.",
            values=("none", "typical:nano", "typical:5in", "typical:multirotor"),
        ),
    ] = ""
    lag_from: Annotated[
        str,
        cli.rare_option("FIT.json", "Take it from another flight of this vehicle, identified with --json."),
        cli.Reads(),
    ] = ""
    align: Annotated[
        bool, cli.rare_flag("--align", "Take offset and scale out of sensors that disagree.")
    ] = False
    pool_friction: Annotated[
        str,
        cli.rare_option(
            "WAY",
            "Of several flights: auto, common (one friction for all) or separate (each its own, and their "
            "mean). auto takes them as common where they agree.",
            values=("auto", "common", "separate"),
        ),
    ] = "auto"
    pool_anyway: Annotated[
        bool, cli.rare_flag("--pool-anyway", "Pool flights whose parameters say that the vehicles differ.")
    ] = False
    terms: Annotated[
        list[str],
        cli.rare_option(
            "NAME",
            "Add an optional term of the motion to its equation, such as quadratic-drag; several times "
            "for several.",
            "--term",
            values=("quadratic-drag", "ground-effect", "voltage"),
        ),
    ] = msgspec.field(default_factory=list)
    rotor_radius: Annotated[
        float | None,
        cli.rare_option(
            "M", "Radius of a rotor in metres, such as 0.12: heights over the ground are reported in radii."
        ),
    ] = None
    controller_rate: Annotated[
        float | None,
        cli.rare_option(
            "HZ",
            "Rate of the controller that issues the commands, such as 400, where the log does not show it: "
            "the lag is known closer then.",
        ),
    ] = None
    order: Annotated[
        str,
        cli.rare_option(
            "N",
            "Order of the response to commands: 1 without a lag, 2 with one, 3 with two in series; auto is "
            "2, and of turning 3 where the flight says so.",
            values=("auto", "1", "2", "3"),
        ),
    ] = "auto"
    noise: Annotated[
        list[str],
        cli.rare_option(
            "NAME=STD",
            "Measurement noise of a channel, for methods that take it out: velocity_z=0.02, with a unit "
            "where it is not SI (2cm/s), or a data sheet's velocity_z=density:0.002,step:0.01. "
            "estimate reads all of them off the log. Several times for several channels.",
            values=("estimate",),
        ),
    ] = msgspec.field(default_factory=list)


class LogWords(msgspec.Struct, kw_only=True):
    """Logs, and what is identified of them."""

    logs: Annotated[
        list[str] | None,
        cli.argument(
            "LOG",
            "PX4 ULog or ulog2csv folder, ArduPilot DataFlash, Betaflight and INAV blackbox, Crazyflie "
            "microSD, ROS 1 bag, ROS 2 bag, MCAP, CSV, Parquet, MATLAB or HDF5. Several are pooled as "
            "flights of one vehicle. LOG@START:END takes a window of one log.",
        ),
        cli.Reads(cli.log_paths),
    ] = None
    example: Annotated[bool, cli.flag("--example", "Use the example flight that comes with Eivor.")] = False
    model: cli.ModelOption = ""
    vehicle: cli.VehicleOption = ""
    machine: cli.MachineOption = ""
    channel_map: Annotated[
        str,
        cli.option(
            "FILE.toml",
            "Channel map of a table, a bag or a Crazyflie's log, or the name of a shipped one: "
            "betaflight_csv, crazyflie_csv, inav_csv, nanobench, rotorpy.",
            "--map",
            values_of="eivor.logs.channel_map:shipped_maps",
        ),
        cli.Reads(),
    ] = ""


def options_schema() -> dict[str, Any]:
    """JSON Schema of the options of an identification."""
    schema = msgspec.json.schema(FlightWords)
    properties = schema["$defs"][FlightWords.__name__]["properties"]
    for name, hint in get_type_hints(FlightWords, include_extras=True).items():
        about = hint.__metadata__[0]
        properties[name] |= {"title": about.metavar or name, "description": about.help}
    return schema


def parse_pair(
    text: str, separator: str = ":", omitted: tuple[float, float] = (-math.inf, math.inf)
) -> tuple[float, float]:
    """Numbers on both sides of a separator, others in place of those left out; NaN where there are none."""
    texts = text.split(separator, 1)
    try:
        first, second = (float(part) if part.strip() else omitted[side] for side, part in enumerate(texts))
    except ValueError:  # also of a text without the separator
        return math.nan, math.nan
    return first, second


# -- Commands --


def declared(
    *sources: type[msgspec.Struct], only: tuple[str, ...] = (), home: str = "tools"
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


@declared(
    LogWords,
    FlightWords,
    only=(
        *("example", "window", "max_tilt", "input_channel", "input_map", "instruments"),
        *("lag", "lag_from", "channel_map", "machine"),
    ),
)
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


@declared(
    FlightWords, LogWords, only=("logs", "example", "window", "input_channel", "machine", "channel_map")
)
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
