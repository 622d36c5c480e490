"""Canonical channel names: which they are, their units, and which of them hold their value."""

from __future__ import annotations

from eivor.signals.recording import CANONICAL_UNITS

#: Channels that keep their value until the next stamp: commands, setpoints, states.
HELD_STEMS = (
    "input",
    "rotor_command_",
    "actuator_output_",
    "reference_",
    "feedback_reference_",
    "pilot_",
    "landed",
    "ground_contact",
)


def canonical_key(name: str) -> str:
    """Key of `CANONICAL_UNITS` for a channel ("rotor_command_*" for a rotor's); empty when there is none."""
    if name in CANONICAL_UNITS and not name.endswith("*"):
        return name
    stem, _, number = name.rpartition("_")
    numbered = number.isascii() and number.isdecimal() and len(number) <= 3 and not number.startswith("0")
    return f"{stem}_*" if numbered and f"{stem}_*" in CANONICAL_UNITS else ""


def held_by_default(name: str) -> bool:
    """Say whether a channel of this name is one that holds its value."""
    return name.startswith(HELD_STEMS)
