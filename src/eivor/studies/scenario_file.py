"""Scenarios from TOML.

    viscous_friction = 0.293        # K [1/s]
    input_gain = 0.021              # K_u [m/s^2 per unit of input]
    rate_hz = 5.0                   # optional, as is all that follows: these are the defaults
    samples = 4000
    route = "equation"              # or "dynamics": where the disturbance enters
    intersample = "hold"            # or "linear": the input between samples
    velocity_gain = 0.0             # PI control of the velocity; the excitation is then its reference
    velocity_integral_gain = 0.0

    [excitation]                    # default: the paper's
    kind = "paper"
    variance = 0.02

    [noise.velocity_z]              # and specific_force_z, input; none where left out
    kind = "fractional"
    order = -0.4
    std = 0.01                      # or ratio_to_signal = 0.1

    [disturbance]
    kind = "paper"
    ratio_to_signal = 0.045         # optional: to z''; else as its parameters say

Other kinds, and the keys of each, are those of `eivor.studies.scenario_kinds`. Unknown keys are errors.
"""

from __future__ import annotations

from enum import Enum
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any, TypeVar

from eivor.errors import EivorError, UsageError
from eivor.models.scenario import NOISY_CHANNELS, Scenario
from eivor.signals.disturbance import Disturbance
from eivor.signals.excitation import Excitation
from eivor.signals.noise import MeasurementNoise
from eivor.studies.scenario_kinds import of_kind
from eivor.studies.toml_table import TomlTable, read_toml

#: Key of a noise or a disturbance whose size is a share of a signal's.
RATIO = "ratio_to_signal"
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
    folder = files("eivor.studies").joinpath("scenarios")
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
    with as_file(files("eivor.studies").joinpath("scenarios", f"{name}.toml")) as path:
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
    noise, ratios = _noises(table)
    values: dict[str, Any] = {
        "viscous_friction": table.number("viscous_friction"),
        "input_gain": table.number("input_gain"),
        "rate_hz": table.number("rate_hz", Scenario.rate_hz),
        "samples": _samples(table),
        "route": _choice(table, "route", Scenario.route),
        "intersample": _choice(table, "intersample", Scenario.intersample),
        "velocity_gain": table.number("velocity_gain", Scenario.velocity_gain),
        "velocity_integral_gain": table.number("velocity_integral_gain", Scenario.velocity_integral_gain),
        "noise": noise,
        "noise_to_signal": ratios,
    }
    if table.has("excitation"):
        values["excitation"] = of_kind(table.section("excitation"), Excitation)
    if table.has("disturbance"):
        section = table.section("disturbance")
        values["disturbance_to_signal"] = _ratio(section)
        values["disturbance"] = of_kind(section, Disturbance)
    table.taken.update({"kind", "excitation", "disturbance", "noise"})
    table.finish()
    try:
        return Scenario(**values)
    except EivorError as error:
        raise table.wrong("", error.expected, error.received, error.remedy) from error


def _noises(table: TomlTable) -> tuple[dict[str, MeasurementNoise], dict[str, float]]:
    """Noise of each channel, and the ratio of those that are measured by their signal."""
    noise: dict[str, MeasurementNoise] = {}
    ratios: dict[str, float] = {}
    if not table.has("noise"):
        return noise, ratios
    sections = table.section("noise")
    for name in NOISY_CHANNELS:
        if not sections.has(name):
            sections.taken.add(name)
            continue
        section = sections.section(name)
        ratio = _ratio(section)
        if (ratio is None) != section.has("std"):
            given = "both" if section.has("std") else "neither"
            raise section.wrong("", f"std or {RATIO}", given, "Give one of them.")
        if ratio is None:
            noise[name] = of_kind(section, MeasurementNoise)
        else:
            # Its std follows from the signal; until then any will do.
            noise[name], ratios[name] = of_kind(section, MeasurementNoise, std=1.0), ratio
    sections.finish()
    return noise, ratios


def _ratio(table: TomlTable) -> float | None:
    table.taken.add(RATIO)
    if not table.has(RATIO):
        return None
    ratio = table.number(RATIO)
    if ratio < 0.0:
        raise table.wrong(RATIO, "a ratio of zero or more", f"{ratio}")
    return ratio


def _samples(table: TomlTable) -> int:
    samples = table.whole("samples", Scenario.samples)
    if samples > MOST_SAMPLES:
        raise table.wrong("samples", f"{MOST_SAMPLES} samples or fewer", f"{samples}", "Ask for fewer.")
    return samples


def _choice(table: TomlTable, key: str, default: AnyEnum) -> AnyEnum:
    words = {member.value: member for member in type(default)}
    word = table.text(key, default.value)
    if word not in words:
        raise table.wrong(key, " or ".join(f"'{name}'" for name in words), f"'{word}'")
    return words[word]
