"""Scenarios from TOML.

    viscous_friction = 0.293        # K [1/s]
    input_gain = 0.021              # K_u [m/s^2 per unit of input]
    rate_hz = 5.0                   # optional, as is all that follows: these are the defaults
    samples = 4000
    route = "equation"              # or "dynamics": where the disturbance enters
    intersample = "hold"            # or "linear": the input between samples

    [excitation]                    # default: the paper's
    kind = "paper"
    variance = 0.02

    [control]                       # open loop where left out; else the excitation is the reference
    kind = "altitude"               # or "velocity", which has no altitude_gain
    altitude_gain = 0.2             # velocity setpoint per metre [1/s]
    velocity_gain = 15.0            # input per m/s
    velocity_integral_gain = 4.0    # input per m

    [noise.velocity_z]              # and acceleration_z, input, under altitude control position_z;
                                    # none where left out
    kind = "fractional"
    order = -0.4
    std = 0.01                      # or ratio_to_signal = 0.1

    [disturbance]
    kind = "paper"
    ratio_to_signal = 0.045         # optional: to z''; else as its parameters say

Other kinds, and the keys of each, are those of `eivor.simulation.scenario_files.kinds`. Unknown keys are
errors.
"""

from __future__ import annotations

from enum import Enum
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any, TypeVar

from eivor.errors import EivorError, UsageError
from eivor.simulation.records.control import Control
from eivor.simulation.records.scenario import NOISY_CHANNELS, Scenario
from eivor.simulation.scenario_files.kinds import of_kind
from eivor.simulation.scenario_files.noise_tables import noises, ratio_to_signal
from eivor.simulation.sources.disturbance import Disturbance
from eivor.simulation.sources.excitation import Excitation
from eivor.toml_table import TomlTable, read_toml

#: Most samples of a record that is simulated from a file.
MOST_SAMPLES = 50_000_000

AnyEnum = TypeVar("AnyEnum", bound=Enum)


def read_scenario(path: Path) -> Scenario:
    """Scenario from a file.

    Parameters
    ----------
    path : Path
        TOML, see this module.

    Raises
    ------
    InputError
        When the file cannot be read, or does not describe a scenario; says where and why.
    """
    return scenario_from_table(read_toml(path, "a scenario"))


def shipped_scenarios() -> tuple[str, ...]:
    """Names of the scenarios that come with the package."""
    folder = files("eivor.simulation.scenario_files").joinpath("shipped")
    names = (entry.name for entry in folder.iterdir())
    return tuple(sorted(name.removesuffix(".toml") for name in names if name.endswith(".toml")))


def shipped_scenario(name: str) -> Scenario:
    """Scenario that comes with the package.

    Raises
    ------
    UsageError
        When there is none of that name.
    """
    if name not in shipped_scenarios():
        raise UsageError(
            f"a scenario out of {', '.join(shipped_scenarios())}", f"'{name}'", "Name one of them."
        )
    with as_file(files("eivor.simulation.scenario_files").joinpath("shipped", f"{name}.toml")) as path:
        return read_scenario(path)


def scenario_from_table(table: TomlTable) -> Scenario:
    """Scenario from a table of a TOML file, all of whose keys it takes.

    Parameters
    ----------
    table : TomlTable
        The file's top, or a table in it. It may say ``kind = "vertical"``.

    Raises
    ------
    InputError
        When a key is unknown, a value of the wrong type, or a number out of its range.
    """
    if table.has("kind") and table.text("kind") != "vertical":
        raise table.wrong("kind", "'vertical'", repr(table.values["kind"]))
    noise, ratios = noises(table, NOISY_CHANNELS)
    values: dict[str, Any] = {
        "viscous_friction": table.number("viscous_friction"),
        "input_gain": table.number("input_gain"),
        "rate_hz": table.number("rate_hz", Scenario.rate_hz),
        "samples": sample_count(table, Scenario.samples),
        "route": _choice(table, "route", Scenario.route),
        "intersample": _choice(table, "intersample", Scenario.intersample),
        "noise": noise,
        "noise_to_signal": ratios,
    }
    if table.has("excitation"):
        values["excitation"] = of_kind(table.section("excitation"), Excitation)
    if table.has("control"):
        values["control"] = of_kind(table.section("control"), Control)
    if table.has("disturbance"):
        section = table.section("disturbance")
        values["disturbance_to_signal"] = ratio_to_signal(section)
        values["disturbance"] = of_kind(section, Disturbance)
    table.taken.update({"kind", "excitation", "control", "disturbance", "noise"})
    table.finish()
    try:
        return Scenario(**values)
    except EivorError as error:
        raise table.wrong("", error.expected, error.received, error.remedy) from error


def sample_count(table: TomlTable, default: int) -> int:
    """Samples of a record; default when the table does not say.

    Raises
    ------
    InputError
        When it is no whole number, or more than `MOST_SAMPLES`.
    """
    samples = table.whole("samples", default)
    if samples > MOST_SAMPLES:
        raise table.wrong("samples", f"{MOST_SAMPLES} samples or fewer", f"{samples}", "Ask for fewer.")
    return samples


def _choice(table: TomlTable, key: str, default: AnyEnum) -> AnyEnum:
    words = {member.value: member for member in type(default)}
    word = table.text(key, default.value)
    if word not in words:
        raise table.wrong(key, " or ".join(f"'{name}'" for name in words), f"'{word}'")
    return words[word]
