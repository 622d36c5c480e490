"""`eivor simulate`: a log of motion with known parameters, as a scenario file describes it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from eivor.cli.arguments import Reads, Writes
from eivor.cli.exit_codes import ExitCode, guarded
from eivor.cli.outputs import keep_inputs, write_out, writing
from eivor.cli.terminal import complain, step, write
from eivor.errors import InputError, ParameterError, UsageError, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Callable

    from eivor.simulation.flights.known_log import KnownLog
    from eivor.simulation.flights.vertical_flight_spec import VerticalFlightSpec
    from eivor.simulation.records.scenario import Scenario
    from eivor.simulation.rigid_body.spec import RigidBodyFlightSpec
    from eivor.toml_table import TomlTable

    #: Whatever a file may describe.
    Simulated: TypeAlias = Scenario | VerticalFlightSpec | RigidBodyFlightSpec

LOG_FORMATS = (".parquet", ".csv")
#: Logs of flights that are slower are not identified.
FLIGHT_RATE_HZ = 50.0
EXIT_CODES = (
    "[bold]Exit codes[/bold]: 0 written; 2 wrong usage; 1 a scenario that cannot be read or is not one, or a "
    "file that cannot be written."
)


@guarded
def simulate(
    scenario_file: Annotated[
        str,
        typer.Argument(
            metavar="SCENARIO.toml",
            help="The scenario, or the name of one that comes with Eivor, such as flight or rich.",
        ),
        Reads(),
    ],
    *,
    out: Annotated[
        str,
        typer.Option("--out", "-o", metavar="FILE", help="The log, which ends in .parquet or .csv."),
        Writes(),
    ],
    seed: Annotated[
        int, typer.Option(metavar="N", help="Of all randomness: the same gives the same log.")
    ] = 0,
    truth: Annotated[
        str,
        typer.Option(
            metavar="FILE.json",
            help="Write the parameters and the noises that were added.",
            show_default=False,
        ),
        Writes(),
    ] = "",
    vehicle: Annotated[
        str,
        typer.Option(
            metavar="FILE.toml",
            help="Write the vehicle file that `eivor identify --model rigid-body` asks for.",
            show_default=False,
        ),
        Writes(),
    ] = "",
    hover: Annotated[
        bool, typer.Option("--hover", help="Add the input that carries the weight, g / K_u.")
    ] = False,
) -> ExitCode:
    """Simulate motion with known parameters into a log.

    The scenario 'flight', and a file with kind = "flight", give a log as an autopilot keeps it: 100 Hz,
    commands that the rotors follow with a lag, and the altitude that was asked for.

    'crazyflie' and 'quadrotor', and a file with kind = "rigid-body", fly all axes of a vehicle: its log has
    body rates, attitude and the controller's setpoints too. What sensors log at several rates needs .parquet.

    Other scenarios move about hover. Their log has acceleration_z, velocity_z and input as measured, and
    under control the reference too: reference_velocity_z, or reference_position_z beside position_z.
    Their input is a deviation from hover; with --hover it is the whole input.
    """
    if seed < 0:
        raise UsageError("a seed of zero or more", f"--seed {seed}", "Any such integer will do.")
    log_path = Path(out)
    if log_path.suffix not in LOG_FORMATS:
        raise UsageError(
            f"a log that ends in {' or '.join(LOG_FORMATS)}", f"'{out}'", "The ending chooses the format."
        )
    source = Path(scenario_file)
    scenario, files = _scenario(source)
    vehicle_file = _vehicle_text(scenario, source.stem) if vehicle else ""
    keep_inputs(source.name, files)
    from eivor.logs.table.written import write_recording

    try:
        with step("Simulating"):
            made = _simulated(scenario, seed, hover=hover)
    except ParameterError as error:  # what depends on rate and length shows only here
        raise InputError(error.expected, f"{error.received}, in {source.name}", error.remedy) from error
    with writing(log_path):
        write_recording(replace(made.recording, name=log_path.name), log_path)
    if truth:
        from eivor.report.json_document import json_text

        write_out(json_text(made.truth), truth)
    if vehicle:
        write_out(vehicle_file, vehicle)
    duration = made.samples / made.rate_hz
    write(f"{log_path}: {made.samples} samples at {made.rate_hz:g} Hz, {duration:g} s\n")
    if hover and made.rate_hz < FLIGHT_RATE_HZ:
        complain(
            f"{made.rate_hz:g} Hz is too slow for `eivor identify`, which cannot tell the rotors' lag from "
            f"the friction below {FLIGHT_RATE_HZ:g} Hz",
            "Raise rate_hz, or take 'flight', a scenario like a flight.",
        )
    return ExitCode.IDENTIFIED


def _scenario(source: Path) -> tuple[Simulated, set[Path]]:
    """Scenario of a file with the files that were read, or of a name when there is no such file."""
    from eivor.simulation.scenario_files.flight_file import KIND, flight_from_table
    from eivor.simulation.scenario_files.rigid_body_file import KIND as RIGID_BODY
    from eivor.simulation.scenario_files.rigid_body_file import rigid_body_flight_from_table
    from eivor.simulation.scenario_files.scenario_file import scenario_from_table
    from eivor.toml_table import read_toml

    if not source.exists() and not source.suffix and source.name == str(source):
        return _shipped(source.name), set()
    table = read_toml(source, "a scenario")
    readers: dict[str, Callable[[TomlTable], Simulated]] = {
        "vertical": scenario_from_table,
        KIND: flight_from_table,
        RIGID_BODY: rigid_body_flight_from_table,
    }
    kind = table.choice("kind", tuple(readers)) if table.has("kind") else "vertical"
    return readers[kind](table), table.files


def _shipped(name: str) -> Simulated:
    """Scenario that comes with Eivor."""
    from eivor.simulation.scenario_files.flight_file import KIND, shipped_flight
    from eivor.simulation.scenario_files.rigid_body_file import SHIPPED, shipped_rigid_body_flight
    from eivor.simulation.scenario_files.scenario_file import shipped_scenario, shipped_scenarios

    if name == KIND:
        return shipped_flight()
    if name in SHIPPED:
        return shipped_rigid_body_flight(name)
    if name in shipped_scenarios():
        return shipped_scenario(name)
    known = (*shipped_scenarios(), KIND, *SHIPPED)
    raise UsageError(
        "a scenario file that ends in .toml, or one of " + ", ".join(sorted(known)),
        f"'{name}'",
        did_you_mean(name, known, "Check the name."),
    )


def _vehicle_text(scenario: Simulated, name: str) -> str:
    """Vehicle file of a flight of a whole vehicle."""
    from eivor.simulation.rigid_body.spec import RigidBodyFlightSpec
    from eivor.simulation.rigid_body.vehicle_text import vehicle_text

    if not isinstance(scenario, RigidBodyFlightSpec):
        raise UsageError(
            "--vehicle with a flight of a whole vehicle, such as crazyflie",
            f"'{name}', whose rotors are nowhere",
            "Leave --vehicle out.",
        )
    return vehicle_text(scenario, name)


def _simulated(scenario: Simulated, seed: int, *, hover: bool) -> KnownLog:
    from eivor.simulation.flights.known_log import log_about_hover, log_of_flight
    from eivor.simulation.records.scenario import Scenario
    from eivor.simulation.rigid_body.known_log import log_of_rigid_body_flight
    from eivor.simulation.rigid_body.spec import RigidBodyFlightSpec

    if isinstance(scenario, Scenario):
        return log_about_hover(scenario, seed, hover=hover)
    if hover:
        raise UsageError(
            "--hover with a scenario about hover",
            "a flight, whose log has the whole input",
            "Leave --hover out.",
        )
    if isinstance(scenario, RigidBodyFlightSpec):
        return log_of_rigid_body_flight(replace(scenario, seed=seed))
    return log_of_flight(replace(scenario, seed=seed))
