"""Families of channels: one for each rotor, or one for each axis.

Members are called by the family's name, ``_`` and a rotor's number from 1 on (``rotor_command_1``), or an
axis' letter (``torque_setpoint_x``); where there are numbers, letters are something else.
"""

from __future__ import annotations

from collections.abc import Iterable

#: Letters of the axes, in their order.
AXES = ("x", "y", "z")


def is_member(suffix: str) -> bool:
    """Whether what follows a family's name and ``_`` is a rotor's number or an axis' letter."""
    return suffix.isdecimal() or suffix in AXES


def family_members(name: str, among: Iterable[str]) -> list[str]:
    """Names out of several that are `name`, or members of the family of that name, in their order.

    Parameters
    ----------
    name : str
        Of a channel or of a family; ``_*`` at its end changes nothing.
    among : iterable of str
        Names that there are.
    """
    names = set(among)
    if name in names:
        return [name]
    stem = name.rstrip("*").rstrip("_") + "_"
    suffixes = {one.removeprefix(stem) for one in names if one.startswith(stem)}
    numbers = sorted((suffix for suffix in suffixes if suffix.isdecimal()), key=int)
    return [f"{stem}{member}" for member in numbers or [axis for axis in AXES if axis in suffixes]]
