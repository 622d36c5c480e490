"""Measurement noises of a scenario's channels from TOML tables [noise.CHANNEL]."""

from __future__ import annotations

from eivor.signals.noise import MeasurementNoise
from eivor.simulation.records.scenario import ABOUT_HOVER
from eivor.simulation.scenario_files.kinds import of_kind
from eivor.toml_table import TomlTable

#: Key of a noise or a disturbance whose size is a share of a signal's.
RATIO = "ratio_to_signal"


def noises(
    table: TomlTable, channels: tuple[str, ...]
) -> tuple[dict[str, MeasurementNoise], dict[str, float]]:
    """Noise of each channel, and the ratio of those that are measured by their signal.

    Parameters
    ----------
    table : TomlTable
        Of a scenario; its table [noise] is taken when there is one.
    channels : tuple of str
        What may have a noise.

    Raises
    ------
    InputError
        When a channel is none of these, or its noise is not described by its kind and one size.
    """
    noise: dict[str, MeasurementNoise] = {}
    ratios: dict[str, float] = {}
    if not table.has("noise"):
        return noise, ratios
    sections = table.section("noise")
    for name in channels:
        sections.taken.add(name)
        if not sections.has(name):
            continue
        section = sections.section(name)
        ratio = ratio_to_signal(section)
        if (ratio is None) != section.has("std"):
            given = "both" if section.has("std") else "neither"
            raise section.wrong("", f"std or {RATIO}", given, "Give one of them.")
        if ratio is None:
            noise[name] = of_kind(section, MeasurementNoise)
        else:
            # Its std follows from the signal; until then any will do.
            noise[name], ratios[name] = of_kind(section, MeasurementNoise, std=1.0), ratio
    if sections.has("specific_force_z") and "acceleration_z" in channels:
        raise sections.wrong(
            "", f"noise of {', '.join(channels)}", "noise of 'specific_force_z'", ABOUT_HOVER
        )
    sections.finish()
    return noise, ratios


def ratio_to_signal(table: TomlTable) -> float | None:
    """Ratio that a table gives, None when it gives none.

    Raises
    ------
    InputError
        When it is negative.
    """
    table.taken.add(RATIO)
    if not table.has(RATIO):
        return None
    ratio = table.number(RATIO)
    if ratio < 0.0:
        raise table.wrong(RATIO, "a ratio of zero or more", f"{ratio}")
    return ratio
