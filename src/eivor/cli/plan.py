"""`eivor plan`: a result, a vehicle's file or rough numbers in; the flight that would tell out."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eivor.asked.planned import check_mission, flight_limits, place_of
from eivor.cli import arguments
from eivor.cli.arguments import STANDARD_OUTPUT
from eivor.cli.exit_codes import ExitCode, guarded
from eivor.cli.outputs import deliver, write_out
from eivor.cli.terminal import complain, show, step
from eivor.errors import UsageError

if TYPE_CHECKING:
    from eivor.planning.plan import FlightPlan
    from eivor.planning.vehicle import VehicleGuess

EXIT_CODES = (
    "[bold]Exit codes[/bold]: 0 planned, and identified in most of its simulated flights; 3 planned, and not "
    "identified in most of them: give it more time, height or speed; 2 wrong usage; 1 a file that cannot be "
    "read or written, or limits that no flight keeps.\n\n"
    "[bold]JSON[/bold] (schema eivor.plan/1): the setpoint in words, the limits, and for friction, gain and "
    "lag the half-width that is expected."
)


@guarded
def plan(
    source: Annotated[
        str,
        typer.Argument(
            metavar="[FIT.json|VEHICLE.toml]",
            help="A result (eivor identify LOG --json FIT.json), refused ones included, or a vehicle's rough "
            "numbers. Without it the options below.",
            show_default=False,
        ),
        arguments.Reads(),
    ] = "",
    *,
    for_what: Annotated[
        str,
        typer.Option(
            "--for",
            metavar="NAME",
            help="friction, gain or lag (default: what the result could not tell).",
            show_default=False,
        ),
    ] = "",
    hover: Annotated[
        float | None,
        typer.Option(metavar="SHARE", help="Input at hover, of full input (0.5).", show_default=False),
    ] = None,
    friction: Annotated[
        float | None, typer.Option(metavar="1/S", help="A guess of the friction (0.3).", show_default=False)
    ] = None,
    lag: Annotated[
        float | None,
        typer.Option(metavar="MS", help="A guess of lag and delay together (50).", show_default=False),
    ] = None,
    gusts: Annotated[
        float | None,
        typer.Option(metavar="M/S", help="Vertical gusts, standard deviation (0.3).", show_default=False),
    ] = None,
    height: Annotated[str, typer.Option(metavar="LOW:HIGH", help="Heights above take-off [m].")] = "3:8",
    speed: Annotated[float, typer.Option(metavar="M/S", help="Largest climb and sink rate.")] = 2.0,
    acceleration: Annotated[
        float, typer.Option(metavar="M/S2", help="Largest acceleration of the setpoint.")
    ] = 3.0,
    tilt: Annotated[float, typer.Option(metavar="DEG", help="Tilt beyond which the flight ends.")] = 20.0,
    time: Annotated[float, typer.Option(metavar="S", help="Length of the flight.")] = 60.0,
    shape: Annotated[
        str,
        typer.Option(
            metavar="KIND", help="multisine or steps (default: the better one).", show_default=False
        ),
    ] = "",
    seed: Annotated[int, typer.Option(metavar="N", help="Of phases, step heights and wind.")] = 0,
    csv: Annotated[
        str,
        typer.Option("--csv", metavar="FILE", help="Write the setpoints as a table.", show_default=False),
        arguments.Writes(),
    ] = "",
    mavsdk: Annotated[
        str,
        typer.Option(
            "--mavsdk", metavar="FILE.py", help="Write a MAVSDK program that flies it.", show_default=False
        ),
        arguments.Writes(),
    ] = "",
    qgc: Annotated[
        str,
        typer.Option(
            "--qgc", metavar="FILE.plan", help="Write a QGroundControl plan; steps only.", show_default=False
        ),
        arguments.Writes(),
    ] = "",
    home: Annotated[
        str,
        typer.Option(metavar="LAT,LON", help="Place of the QGroundControl plan [deg].", show_default=False),
    ] = "",
    rotorpy: Annotated[
        str,
        typer.Option(
            "--rotorpy", metavar="FILE.py", help="Write a trajectory of RotorPy.", show_default=False
        ),
        arguments.Writes(),
    ] = "",
    json: arguments.JsonOption = "",
) -> ExitCode:
    """Plan the flight that would tell what another one could not, and say how well it will."""
    rough = {"hover": hover, "friction": friction, "lag": lag, "gusts": gusts}
    files = {"--csv": csv, "--mavsdk": mavsdk, "--qgc": qgc, "--rotorpy": rotorpy}
    check_mission(qgc, home, shape)
    outputs = {option: Path(text) for option, text in files.items() if text}
    limits = flight_limits(height, speed, acceleration, tilt, time)
    vehicle = _vehicle(source, rough)
    from eivor.report.planned import plan as planned

    with step("Planning"):
        made = planned(
            vehicle, target=for_what, limits=limits, shape=shape or ("steps" if qgc else ""), seed=seed
        )
    texts = _texts(made, outputs, home)
    deliver(*_deliveries(made, json, texts))
    if not made.telling:
        complain(
            "the planned flight is not identified in most of its simulations",
            "Give it more time, height or speed, or wait for calmer air.",
        )
    return ExitCode.IDENTIFIED if made.telling else ExitCode.NOT_IDENTIFIED


def _vehicle(source: str, rough: dict[str, float | None]) -> VehicleGuess | Path:
    """Vehicle of a file or of the numbers that were given; a result stays its path."""
    given = {name: value for name, value in rough.items() if value is not None}
    if source and given:
        raise UsageError(
            "a result or a vehicle's file, or rough numbers as options",
            f"'{source}' and {', '.join(f'--{name}' for name in given)}",
            "Leave out one of them.",
        )
    from eivor.planning.vehicle import read_vehicle, rough_vehicle

    if source.lower().endswith(".toml"):
        return read_vehicle(Path(source))
    return Path(source) if source else rough_vehicle(**given)


def _texts(made: FlightPlan, outputs: dict[str, Path], home: str) -> dict[Path, str]:
    """Text of every file that was asked for."""
    from eivor.planning.written.formats import WRITTEN

    place = place_of(home) if home else None
    written = {name: outputs[f"--{name}"] for name in WRITTEN if f"--{name}" in outputs}
    return {path: WRITTEN[name].text(made, place) for name, path in written.items()}


def _deliveries(made: FlightPlan, json: str, texts: dict[Path, str]) -> Iterator[Callable[[], None]]:
    if json != STANDARD_OUTPUT:
        yield partial(_print_report, made)
    if json:
        yield partial(_write_json, made, json)
    for path, text in texts.items():
        yield partial(write_out, text, str(path))


def _print_report(made: FlightPlan) -> None:
    from eivor.report.planned import plan_document
    from eivor.report.terminal import on_terminal

    show(on_terminal(plan_document(made)))


def _write_json(made: FlightPlan, place: str) -> None:
    from eivor.report.json_document import json_text
    from eivor.report.planned import plan_json

    write_out(json_text(plan_json(made)), place)
