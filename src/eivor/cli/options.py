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

    window: Annotated[str, cli.option("flight window")] = ""
    max_tilt: Annotated[float | None, cli.option("flight max_tilt")] = None
    input_channel: Annotated[str, cli.option("flight input_channel")] = ""
    input_map: Annotated[str, cli.option("flight input_map")] = ""
    accelerometer_bias: Annotated[float | None, cli.option("flight accelerometer_bias")] = None
    instruments: Annotated[str, cli.option("flight instruments")] = ""
    method: Annotated[str, cli.option("flight method", METHODS)] = "reference_iv"
    compare: Annotated[bool, cli.option("flight compare")] = False
    lag: Annotated[str, cli.option("flight lag")] = ""
    lag_from: Annotated[str, cli.option("flight lag_from"), cli.Reads()] = ""
    align: Annotated[bool, cli.option("flight align")] = False
    pool_friction: Annotated[str, cli.option("flight pool_friction")] = "auto"
    pool_anyway: Annotated[bool, cli.option("flight pool_anyway")] = False
    terms: Annotated[list[str], cli.option("flight terms")] = msgspec.field(default_factory=list)
    rotor_radius: Annotated[float | None, cli.option("flight rotor_radius")] = None
    controller_rate: Annotated[float | None, cli.option("flight controller_rate")] = None
    order: Annotated[str, cli.option("flight order")] = "auto"
    noise: Annotated[list[str], cli.option("flight noise")] = msgspec.field(default_factory=list)


class LogWords(msgspec.Struct, kw_only=True):
    """Logs, and what is identified of them."""

    logs: Annotated[list[str] | None, cli.option("log logs"), cli.Reads(cli.log_paths)] = None
    example: Annotated[bool, cli.option("log example")] = False
    model: cli.ModelOption = ""
    vehicle: cli.VehicleOption = ""
    machine: cli.MachineOption = ""
    channel_map: Annotated[str, cli.option("log channel_map"), cli.Reads()] = ""


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


NeedsOption = Annotated[str, cli.option("all needs", NEEDS)]


@declared(LogWords, FlightWords, home="results")
def identify(
    *,
    needs: NeedsOption = "",
    json: cli.JsonOption = "",
    figure: Annotated[str, cli.option("identify figure"), cli.Writes()] = "",
    html: Annotated[str, cli.option("identify html"), cli.Writes()] = "",
    card: Annotated[bool, cli.option("identify card")] = False,
    residuals: Annotated[str, cli.option("identify residuals"), cli.Writes(cli.RESIDUAL_FILES)] = "",
    **given: Any,
) -> None:
    """Identify what logs support: vertical motion, turning, and the rigid body of a --vehicle."""


@declared(LogWords, FlightWords, home="results")
def report(
    *, needs: NeedsOption = "", out: Annotated[str, cli.option("report out"), cli.Writes()] = "", **given: Any
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
    log: Annotated[str, cli.option("track log"), cli.Reads(cli.log_paths)] = "",
    *,
    memory: Annotated[float | None, cli.option("track memory")] = None,
    parameter: Annotated[str, cli.option("track parameter")] = "",
    accelerometer_bias: Annotated[float | None, cli.option("track accelerometer_bias")] = None,
    method: Annotated[str, cli.option("track method", METHODS)] = "reference_iv",
    json: cli.JsonOption = "",
    figure: Annotated[str, cli.option("track figure"), cli.Writes()] = "",
    **given: Any,
) -> None:
    """Follow a parameter over a log: the thrust gain, which a worn propeller lowers, or any of a machine."""


@declared(LogWords, FlightWords, only=("window", "max_tilt", "channel_map"))
def validate(
    fit: cli.FitArgument,
    log: Annotated[str, cli.option("validate log"), cli.Reads(cli.log_paths)],
    *,
    model: cli.FitModelOption = "",
    json: cli.JsonOption = "",
    figure: Annotated[str, cli.option("validate figure"), cli.Writes()] = "",
    **given: Any,
) -> None:
    """Predict another flight by a result, beside simpler models of the flights that it came from."""


@declared(
    FlightWords, LogWords, only=("logs", "example", "window", "input_channel", "machine", "channel_map")
)
def frequency_response(
    *,
    axis: Annotated[str, cli.option("frequency-response axis")] = "",
    reference: Annotated[str, cli.option("frequency-response reference")] = "",
    figure: Annotated[str, cli.option("frequency-response figure"), cli.Writes()] = "",
    json: cli.JsonOption = "",
    **given: Any,
) -> None:
    """Estimate the response from torque setpoint to rate, thrust to force, or a machine's input to state.

    Also the models of order 1 to 4 that fit it, and controllers to be test-flown, which are never applied.
    """
