"""`eivor simulate`: a log of vertical motion with known parameters, as a scenario file describes it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eivor.cli.arguments import output_file, writing
from eivor.cli.exit_codes import ExitCode, guarded
from eivor.cli.terminal import step, write
from eivor.errors import InputError, ParameterError, UsageError

if TYPE_CHECKING:
    from eivor.models.scenario import Scenario, SimulatedRecord
    from eivor.signals.recording import Recording

SCHEMA = "eivor.simulate/1"
LOG_FORMATS = (".parquet", ".csv")
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
            help="The scenario, or the name of one that comes with Eivor, such as rich.",
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
        bool, typer.Option("--hover", help="Add the input that carries the weight, g / input_gain.")
    ] = False,
) -> ExitCode:
    """Simulate vertical motion with known parameters into a log.

    The log has acceleration_z, velocity_z and input as measured. Under control it has the reference too:
    reference_velocity_z, or reference_position_z beside the measured position_z.
    The input is a deviation from hover; with --hover it is the whole input, as a flight would log it.
    """
    if seed < 0:
        raise UsageError("a seed of zero or more", f"--seed {seed}", "Any such integer will do.")
    log_path = output_file(out, option="--out", logs=[])
    if log_path.suffix not in LOG_FORMATS:
        raise UsageError(
            f"a log that ends in {' or '.join(LOG_FORMATS)}", f"'{out}'", "The ending chooses the format."
        )
    truth_path = output_file(truth, option="--truth", logs=[]) if truth else None
    source = Path(scenario_file)
    for path in (log_path, *((truth_path,) if truth_path else ())):
        if source.exists() and path.exists() and path.samefile(source):
            raise UsageError("files other than the scenario", f"'{path}'", "It would be lost.")
    if truth_path is not None and truth_path.absolute() == log_path.absolute():
        raise UsageError("two files for --out and --truth", f"'{out}' for both", "Choose another name.")
    import numpy as np

    from eivor.logs.written import write_recording
    from eivor.models.simulation import simulate as simulated

    scenario = _scenario(source)
    try:
        with step("Simulating"):
            record = simulated(scenario, np.random.default_rng(seed))
    except ParameterError as error:  # what depends on rate and length shows only here
        raise InputError(error.expected, f"{error.received}, in {source.name}", error.remedy) from error
    hover_input = _hover_input(scenario) if hover else 0.0
    with writing(log_path):
        write_recording(_recording(log_path.name, record, hover_input), log_path)
    if truth_path is not None:
        from eivor.report.json_document import json_text

        with writing(truth_path):
            document = _truth(scenario, record) | {"hover_input": hover_input, "seed": seed}
            truth_path.write_text(json_text(document), encoding="utf-8")
    duration = scenario.samples * scenario.step_s
    write(f"{log_path}: {scenario.samples} samples at {scenario.rate_hz:g} Hz, {duration:g} s\n")
    return ExitCode.IDENTIFIED


def _scenario(source: Path) -> Scenario:
    """Scenario of a file, or of a name when there is no such file."""
    from eivor.studies.scenario_file import read_scenario, shipped_scenario, shipped_scenarios

    if not source.exists() and not source.suffix and source.name == str(source):
        if source.name in shipped_scenarios():
            return shipped_scenario(source.name)
        raise UsageError(
            "a scenario file that ends in .toml, or one of " + ", ".join(shipped_scenarios()),
            f"'{source}'",
            "Check the name.",
        )
    return read_scenario(source)


def _hover_input(scenario: Scenario) -> float:
    """Input whose effect is the weight's."""
    from eivor.models.vertical import GRAVITY

    if scenario.input_gain <= 0.0:
        raise UsageError(
            "an input_gain above zero with --hover", f"{scenario.input_gain}", "Leave --hover out."
        )
    return GRAVITY / scenario.input_gain


def _recording(name: str, record: SimulatedRecord, hover_input: float) -> Recording:
    """Recording of the measured channels; without gravity the response is coordinate acceleration."""
    import numpy as np

    from eivor.logs.canonical import held_by_default
    from eivor.signals.recording import CANONICAL_UNITS, Channel, Recording

    signals = record.signals
    time_s = np.arange(signals.sample_count) * signals.step_s
    channels = {}
    for channel, values in signals.channels.items():
        key = "acceleration_z" if channel == "specific_force_z" else channel
        logged = values + hover_input if key == "input" else values
        channels[key] = Channel(
            key, time_s, logged, CANONICAL_UNITS[key], source="simulation", held=held_by_default(key)
        )
    return Recording(name=name, format="simulation", channels=channels)


def _truth(scenario: Scenario, record: SimulatedRecord) -> dict[str, object]:
    from importlib.metadata import version

    noises = {
        ("acceleration_z" if name == "specific_force_z" else name): {
            "std": noise.std,
            "order": getattr(noise, "order", 0.0),
        }
        for name, noise in record.signals.noise.items()
    }
    return {
        "schema": SCHEMA,
        **record.parameters,
        "units": {"viscous_friction": "1/s", "input_gain": "m/s^2 per unit of input"},
        "noise": noises,
        "disturbance": {
            "route": scenario.route.value,
            "std": float(record.truth.channels["disturbance"].std()),
        },
        "rate_hz": scenario.rate_hz,
        "samples": scenario.samples,
        "provenance": {"version": version("eivor")},
    }
