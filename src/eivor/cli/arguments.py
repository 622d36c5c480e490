"""From what is typed to what the library takes: shared options, logs with windows, names."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eivor.errors import EivorError, UsageError

if TYPE_CHECKING:
    from eivor.models.separable import Bounds, Prior

#: The word for standard output.
STANDARD_OUTPUT = "-"

Window = tuple[float, float]

#: Arguments and options that several commands have.
WorkersOption = Annotated[
    int | None,
    typer.Option(
        metavar="N", help="Processes of this computer; default: one for each core.", show_default=False
    ),
]
LogsArgument = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="LOG",
        help="ULog, Crazyflie microSD, CSV or Parquet; - is standard input. Several are pooled as flights of "
        "one vehicle. LOG@START:END takes a window of one log.",
        show_default=False,
    ),
]
ExampleOption = Annotated[
    bool, typer.Option("--example", help="Use the example flight that comes with Eivor.")
]
WindowOption = Annotated[
    str,
    typer.Option(
        "--window",
        metavar="START:END",
        help="Use this window of each log, in seconds from its start.",
        show_default=False,
    ),
]
MaxTiltOption = Annotated[
    float | None,
    typer.Option(
        "--max-tilt",
        metavar="DEG",
        help="Leave out what is tilted further (default: 25.8 degrees).",
        show_default=False,
    ),
]
InputOption = Annotated[
    str,
    typer.Option(
        "--input",
        metavar="CHANNEL",
        help="Channel, or family such as rotor_command, that drives the vehicle.",
        show_default=False,
    ),
]
TermOption = Annotated[
    list[str] | None,
    typer.Option(
        "--term",
        metavar="NAME",
        help="Add an optional term of the motion to its equation, such as quadratic-drag; several times "
        "for several.",
        show_default=False,
    ),
]
RotorRadiusOption = Annotated[
    float | None,
    typer.Option(
        "--rotor-radius",
        metavar="M",
        help="Radius of a rotor in metres, such as 0.12: heights over the ground are told in radii.",
        show_default=False,
    ),
]
InputMapOption = Annotated[
    str,
    typer.Option(
        "--input-map",
        metavar="MAP",
        help="From command to thrust: linear, square, power:EXPONENT, mixed:SHARE; fit finds it out.",
        show_default=False,
    ),
]
AccelerometerBiasOption = Annotated[
    float | None,
    typer.Option(
        "--accelerometer-bias",
        metavar="STD",
        help="Standard deviation of the accelerometer's bias in m/s^2, which --input-map fit rests on "
        "(default: 0.1; inf when nothing is known of it).",
        show_default=False,
    ),
]
InstrumentsOption = Annotated[
    str,
    typer.Option(
        "--instruments",
        metavar="NAMES",
        help="references, lags, or channels with commas between them.",
        show_default=False,
    ),
]
LagOption = Annotated[
    str,
    typer.Option(
        "--lag",
        metavar="MS:STD|LOW..HIGH|none",
        help="Lag and delay of the actuators together, known from elsewhere: 70:15 is 70 ms with a standard "
        "deviation of 15 ms, 50..90 is anything between, none is neither lag nor delay.",
        show_default=False,
    ),
]
LagFromOption = Annotated[
    str,
    typer.Option(
        "--lag-from",
        metavar="FIT.json",
        help="Take it from another flight of this vehicle, identified with --json.",
        show_default=False,
    ),
]
PoolFrictionOption = Annotated[
    str,
    typer.Option(
        "--pool-friction",
        metavar="WAY",
        help="Of several flights: auto, common (one friction for all) or separate (each its own, and their "
        "mean). auto takes them as common where they agree.",
    ),
]
NoiseOption = Annotated[
    list[str] | None,
    typer.Option(
        "--noise",
        metavar="NAME=STD|estimate",
        help="Measurement noise of a channel, for methods that take it out: velocity_z=0.02, with a unit "
        "where it is not SI (2cm/s), or a data sheet's velocity_z=density:0.002,bandwidth:50,step:0.01. "
        "estimate reads all of them off the log. Several times for several channels.",
        show_default=False,
    ),
]
MapOption = Annotated[
    str,
    typer.Option(
        "--map",
        metavar="FILE.toml",
        help="Channel map of a table, a bag or a Crazyflie's log, or the name of a shipped one: "
        "betaflight_csv, crazyflie_csv, inav_csv, nanobench, rotorpy.",
        show_default=False,
    ),
]
ModelOption = Annotated[
    str,
    typer.Option(
        "--model",
        metavar="NAME",
        help="What to identify: vertical, rates, rigid-body, or a motion that another package brings.",
    ),
]
VehicleOption = Annotated[
    str,
    typer.Option(
        "--vehicle",
        metavar="FILE|NAME",
        help="What flies, for --model rigid-body: a vehicle file, or a shipped one (eivor vehicle list). The "
        "vertical motion takes the radius of its rotors.",
        show_default=False,
    ),
]
JsonOption = Annotated[
    str,
    typer.Option(
        "--json",
        metavar="FILE|-",
        help="Write JSON; - prints it instead of the table.",
        show_default=False,
    ),
]


@dataclass(frozen=True, slots=True)
class LogArgument:
    """A log as given on the command line.

    Parameters
    ----------
    path : Path
        The file.
    window : tuple of float or None
        Its own window [s], when one was given as LOG@START:END.
    """

    path: Path
    window: Window | None = None


def log_argument(text: str) -> LogArgument:
    """Log of ``LOG`` or ``LOG@START:END``; a file that exists under the whole name wins.

    Raises
    ------
    UsageError
        When what follows the last @ has a colon and is no window.
    """
    name, at, tail = text.rpartition("@")
    if not at or not name or ":" not in tail or os.path.lexists(text):
        return LogArgument(Path(text))
    return LogArgument(Path(name), window(tail))


def window(text: str) -> Window:
    """Window of ``START:END`` in seconds; an end left out is that of the log.

    Raises
    ------
    UsageError
        When it is not two numbers, or START is not before END.
    """
    start_text, colon, end_text = text.partition(":")
    try:
        start = float(start_text) if start_text.strip() else -math.inf
        end = float(end_text) if end_text.strip() else math.inf
    except ValueError:
        start = end = math.nan
    if not colon or not start < end:
        raise UsageError(
            "a window START:END with START before END",
            f"'{text}'",
            "Give both in seconds from the log's start, such as 4:67; one of them may be left out.",
        )
    return start, end


def lag(text: str) -> Prior | Bounds:
    """What is known of a lag [s], of ``MS:STD``, ``LOW..HIGH`` or ``none``.

    Raises
    ------
    UsageError
        When it is none of them: two numbers above zero, or two that are not below zero, in order.
    """
    from eivor.flights.given_lag import NO_LAG
    from eivor.models.separable import Bounds, Prior

    if text.strip().lower() == "none":
        return NO_LAG
    between = ".." in text
    first_text, _, second_text = text.partition(".." if between else ":")
    try:
        first, second = 1e-3 * float(first_text), 1e-3 * float(second_text)
    except ValueError:
        first = second = math.nan
    if between and 0.0 <= first <= second < math.inf:
        return Bounds(first, second)
    if not between and 0.0 < first < math.inf and 0.0 < second < math.inf:
        return Prior(first, second)
    raise UsageError(
        "a lag MS:STD, mean and standard deviation in milliseconds, both above zero; or bounds LOW..HIGH; or "
        "none",
        f"'{text}'",
        "Give 70:15 or 50..90, for example.",
    )


def names(text: str) -> tuple[str, ...]:
    """Names of a list with commas.

    Raises
    ------
    UsageError
        When the list is empty, or "references" or "lags" stand beside other names.
    """
    found = tuple(name.strip() for name in text.split(",") if name.strip())
    if not found or (len(found) > 1 and {"references", "lags"} & set(found)):
        raise UsageError(
            "instruments: references, lags, or names of channels with commas between them",
            f"'{text}'",
            "Give references or lags alone. `eivor inspect LOG` lists the channels.",
        )
    return found


@contextmanager
def named(name: str, *, several: bool) -> Iterator[None]:
    """Say in an error which of several logs it is about, unless it does so already.

    Raises
    ------
    EivorError
        The same kind that was raised inside.
    """
    try:
        yield
    except EivorError as error:
        if not several or Path(name).name in str(error):
            raise
        raise type(error)(error.expected, f"{error.received}, in {name}", error.remedy) from error
