"""Arguments and options that several commands have, and what each declares of files: read or written."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from eivor.asked.words import log_argument

#: The word for standard output, and for standard input.
STANDARD_OUTPUT = "-"
#: Files that are written into the folders of a study and of a fleet, and with the figures of the paper. A
#: part of a fleet's table is named by its content: it replaces no other file, and a run may find it as a log.
STUDY_FILES = ("study.json", "trials.parquet", "shards/*", "nrmse.*", "coverage.*")
FLEET_FILES = ("fleet.json", ".lock", ".run", "reports/*.html")
FLEET_PARTS = "flights/*.parquet"
PAPER_FILES = ("figure-*.svg", "figure-*.png")


def log_paths(text: str) -> Iterable[Path]:
    """Files of a log as typed: of standard input, of a folder, or of LOG@START:END."""
    if text == STANDARD_OUTPUT:
        return [Path("/dev/stdin")]
    from eivor.logs.folders import folder_files

    path = log_argument(text).path
    return folder_files(path) if path.is_dir() else [path]


def map_paths(text: str) -> Iterable[Path]:
    """File of PATTERN=MAP."""
    return [Path(text.rpartition("=")[2])]


def fleet_paths(text: str) -> Iterable[Path]:
    """Files of a fleet's folder."""
    return [path for pattern in (*FLEET_FILES, FLEET_PARTS) for path in Path(text).glob(pattern)]


@dataclass(frozen=True, slots=True)
class Reads:
    """Declares that a parameter names what the command reads: the guard of outputs protects it.

    Parameters
    ----------
    paths : callable
        Takes the text that was typed, gives the files that it names; those that do not exist are ignored.
    default : callable, optional
        Takes the values of all parameters, gives the file where none is typed.
    """

    paths: Callable[[str], Iterable[Path]] = lambda text: [Path(text)]
    default: Callable[[Mapping[str, Any]], str] | None = None


@dataclass(frozen=True, slots=True)
class Writes:
    """Declares that a parameter names a file that the command writes, or a folder of such files.

    Parameters
    ----------
    inside : tuple of str
        Patterns of the files that are written into the folder; empty for a file.
    default : callable, optional
        Takes the values of all parameters, gives the folder where none is typed.
    """

    inside: tuple[str, ...] = ()
    default: Callable[[Mapping[str, Any]], str] | None = None


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
    Reads(log_paths),
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
    Reads(),
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
    Reads(),
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
    Reads(),
]
JsonOption = Annotated[
    str,
    typer.Option(
        "--json",
        metavar="FILE|-",
        help="Write JSON; - prints it instead of the table.",
        show_default=False,
    ),
    Writes(),
]
