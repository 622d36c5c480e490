"""`eivor export`: a result in; a file for an autopilot, a controller or a simulator, or joint draws, out."""

from __future__ import annotations

import io
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eivor.asked.supplied import supplied
from eivor.cli.arguments import STANDARD_OUTPUT, Reads, Writes
from eivor.cli.exit_codes import ExitCode, guarded
from eivor.cli.outputs import write_out, writing
from eivor.cli.terminal import complain
from eivor.errors import NotIdentifiedError, UsageError
from eivor.whole_file import write_whole

if TYPE_CHECKING:
    from eivor.exports.fitted import Exported, Supplied
    from eivor.report.saved_fit import SavedFit

EXIT_CODES = (
    "[bold]Exit codes[/bold]: 0 all that the target has is written; 3 something is not identified: it is a "
    "comment in the file with its reason, or, where the target cannot do without it, there is no file; "
    "2 wrong usage, such as rotor speeds for an autopilot's share of thrust; 1 a file that cannot be read "
    "or written.\n\n"
    "[bold]Targets[/bold]: px4 (.params), ardupilot (.param), statespace (JSON); of simulators, which need a "
    "mass and a vehicle: sih (PX4's, .params), rotorpy (Python), mujoco (MJCF), pybullet (URDF), "
    "gazebo (SDF), drone-models (TOML)."
)


class Delays(StrEnum):
    """At which delays draws are taken."""

    BEST = "best"
    ALL = "all"


@guarded
def export(
    fit: Annotated[
        Path,
        typer.Argument(metavar="FIT.json", help="A result: eivor identify LOG --json FIT.json."),
        Reads(),
    ],
    *,
    to: Annotated[
        str,
        typer.Option("--to", metavar="TARGET", help="What for: see Targets below.", show_default=False),
    ] = "",
    draws: Annotated[
        int | None,
        typer.Option(
            "--draws",
            metavar="N",
            help="N joint draws of the identified parameters: without --to as Parquet, else as the "
            "simulator's randomisation (rotorpy, mujoco, isaaclab).",
            show_default=False,
        ),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", metavar="SEED", help="Of the draws.")] = 0,
    delays: Annotated[
        Delays,
        typer.Option(
            "--delays",
            metavar="best|all",
            help="Of a table of draws: at the delay that fits best, or at all that fit, drawn too.",
        ),
    ] = Delays.BEST,
    mass: Annotated[
        str,
        typer.Option(
            "--mass",
            metavar="KG[:STD]",
            help="Mass with all on board and its standard deviation, such as 1.53:0.02; for simulators and "
            "draws. Without it that of the vehicle.",
            show_default=False,
        ),
    ] = "",
    prior: Annotated[
        list[str] | None,
        typer.Option(
            "--prior",
            metavar="NAME=VALUE[:STD]",
            help="What is known of a quantity that the flight does not tell; several times for several.",
            show_default=False,
        ),
    ] = None,
    vehicle: Annotated[
        str,
        typer.Option(
            "--vehicle",
            metavar="FILE.toml",
            help="Where the rotors are, for simulators: a vehicle file, or the name of a shipped one. "
            "Without it that of the result, when it has one.",
            show_default=False,
        ),
        Reads(),
    ] = "",
    output: Annotated[
        str,
        typer.Option("-o", "--output", metavar="FILE", help="Where to; without it on standard output."),
        Writes(),
    ] = STANDARD_OUTPUT,
) -> ExitCode:
    """Write a result's numbers where they are used, with intervals; only what is identified."""
    if not to and draws is None:
        raise UsageError("--to TARGET, --draws N or both", "neither", "Say what is to be written.")
    if delays is Delays.ALL and (to or draws is None):
        raise UsageError(
            "--delays all with a table of draws",
            f"--to {to}",
            "Simulators have no delay: their draws are at the one that fits best.",
        )
    given = supplied(mass, prior or [], vehicle)
    if not to and output == STANDARD_OUTPUT:
        raise UsageError("a file for the draws", "standard output", "Add -o draws.parquet.")
    from eivor.report.read_fit import load_fit

    result = load_fit(fit)
    try:
        if draws is None or to:
            return _export(result.exported(to, given, draws, seed), output)
        return _draw(result, draws, seed, given, Path(output), delays)
    except NotIdentifiedError as error:
        complain(str(error))
        return ExitCode.NOT_IDENTIFIED


def _export(made: Exported, output: str) -> ExitCode:
    write_out(made.text, output)
    if made.left_out:
        complain(*made.left_out)
    return ExitCode.NOT_IDENTIFIED if made.left_out else ExitCode.IDENTIFIED


def _draw(
    result: SavedFit, count: int, seed: int, supplied: Supplied, path: Path, delays: Delays
) -> ExitCode:
    from eivor.report.draws_table import draws_table

    replace(supplied, mass=None).check_only((), "draws of a table", body=False)
    table = draws_table(result, count, seed, supplied.mass, delays=delays.value)
    buffer = io.BytesIO()
    table.write_parquet(buffer)
    with writing(path):
        write_whole(path, buffer.getvalue())
    left_out = [name for name in result.names if name not in table.columns]
    if left_out:
        complain(f"Not identified, hence no column: {', '.join(left_out)}.")
    return ExitCode.NOT_IDENTIFIED if left_out else ExitCode.IDENTIFIED
