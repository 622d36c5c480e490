"""`eivor simulate`: a log of vertical motion with known parameters, as a scenario file describes it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eivor.cli.exit_codes import ExitCode, guarded
from eivor.cli.outputs import keep_apart, output_file, write_out, writing
from eivor.cli.terminal import complain, step, write
from eivor.errors import InputError, ParameterError, UsageError, did_you_mean

if TYPE_CHECKING:
    from eivor.simulation.flights.known_log import KnownLog
    from eivor.simulation.flights.vertical_flight_spec import VerticalFlightSpec
    from eivor.simulation.records.scenario import Scenario

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
    ],
    *,
    out: Annotated[
        str, typer.Option("--out", "-o", metavar="FILE", help="The log, which ends in .parquet or .csv.")
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
    ] = "",
    hover: Annotated[
        bool, typer.Option("--hover", help="Add the input that carries the weight, g / K_u.")
    ] = False,
) -> ExitCode:
    """Simulate vertical motion with known parameters into a log.

    The scenario 'flight', and a file with kind = "flight", give a log as an autopilot keeps it: 100 Hz,
    commands that the rotors follow with a lag, and the altitude that was asked for.

    Other scenarios move about hover. Their log has acceleration_z, velocity_z and input as measured, and
    under control the reference too: reference_velocity_z, or reference_position_z beside position_z.
    Their input is a deviation from hover; with --hover it is the whole input.
    """
    if seed < 0:
        raise UsageError("a seed of zero or more", f"--seed {seed}", "Any such integer will do.")
    log_path = output_file(out, option="--out")
    if log_path.suffix not in LOG_FORMATS:
        raise UsageError(
            f"a log that ends in {' or '.join(LOG_FORMATS)}", f"'{out}'", "The ending chooses the format."
        )
    outputs = {"--out": log_path} | ({"--truth": output_file(truth, option="--truth")} if truth else {})
    source = Path(scenario_file)
    scenario, files = _scenario(source)
    keep_apart(outputs, {"the scenario's files": files})
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
    duration = made.samples / made.rate_hz
    write(f"{log_path}: {made.samples} samples at {made.rate_hz:g} Hz, {duration:g} s\n")
    if hover and made.rate_hz < FLIGHT_RATE_HZ:
        complain(
            f"{made.rate_hz:g} Hz is too slow for `eivor identify`, which cannot tell the rotors' lag from "
            f"the friction below {FLIGHT_RATE_HZ:g} Hz",
            "Raise rate_hz, or take 'flight', a scenario like a flight.",
        )
    return ExitCode.IDENTIFIED


def _scenario(source: Path) -> tuple[Scenario | VerticalFlightSpec, set[Path]]:
    """Scenario of a file with the files that were read, or of a name when there is no such file."""
    from eivor.simulation.scenario_files.flight_file import KIND, flight_from_table, shipped_flight
    from eivor.simulation.scenario_files.scenario_file import (
        scenario_from_table,
        shipped_scenario,
        shipped_scenarios,
    )
    from eivor.toml_table import read_toml

    if not source.exists() and not source.suffix and source.name == str(source):
        if source.name == KIND:
            return shipped_flight(), set()
        if source.name in shipped_scenarios():
            return shipped_scenario(source.name), set()
        known = (*shipped_scenarios(), KIND)
        raise UsageError(
            "a scenario file that ends in .toml, or one of " + ", ".join(sorted(known)),
            f"'{source}'",
            did_you_mean(source.name, known, "Check the name."),
        )
    table = read_toml(source, "a scenario")
    flight = table.has("kind") and table.choice("kind", ("vertical", KIND)) == KIND
    return (flight_from_table if flight else scenario_from_table)(table), table.files


def _simulated(scenario: Scenario | VerticalFlightSpec, seed: int, *, hover: bool) -> KnownLog:
    from eivor.simulation.flights.known_log import log_about_hover, log_of_flight
    from eivor.simulation.flights.vertical_flight_spec import VerticalFlightSpec

    if not isinstance(scenario, VerticalFlightSpec):
        return log_about_hover(scenario, seed, hover=hover)
    if hover:
        raise UsageError(
            "--hover with a scenario about hover",
            "a flight, whose log has the whole input",
            "Leave --hover out.",
        )
    return log_of_flight(replace(scenario, seed=seed))
