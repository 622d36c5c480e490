"""Channel maps: which column of a table is which canonical channel, in TOML.

A map states::

    name = "mycopter"               # required
    description = "..."             # optional
    frame = "z_up"                  # or "ned"; z_up by default
    input_map = "square"            # optional, see the input maps of `eivor.models`

    [time]
    column = "t"
    unit = "s"                      # s, ms, us, ns

    [columns.motor_1]               # optional: the range that a column's values can have
    valid = [0, 65535]              # outside: overflow, becomes missing
    saturates = "upper"             # bounds that mean saturation: "lower", "upper", "both" (default), "none"

    [channels.velocity_z]
    column = "vz"                   # or expression = "vz_raw / 100"
    unit = "m/s"                    # as logged; SI by default
    sign = -1                       # optional
    scale = 1.0                     # optional
    held = false                    # optional; commands and setpoints are held by default
    optional = false                # optional: true when some tables lack the column

    [channels.cos_tilt]
    quaternion = ["qw", "qx", "qy", "qz"]      # or roll_pitch = ["roll", "pitch"], with unit = "deg"

Axes are as the table has them, `frame` says which way they point; `input` is positive up in either frame.
Every key is checked. A shipped map is used by itself when a table has all columns of its channels that
are not optional.
"""

from __future__ import annotations

import math
import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

from eivor.errors import ChannelMapError
from eivor.logs.canonical import canonical_key, held_by_default
from eivor.logs.expressions import Expression, parse_expression, quoted
from eivor.logs.units import TIME_UNITS, UNITS, unit_fits
from eivor.signals.recording import CANONICAL_UNITS, Frame

MAX_MAP_BYTES = 1 << 20
SATURATING = ("none", "lower", "upper", "both")


@dataclass(frozen=True, slots=True)
class ValidRange:
    """Values that a column can have, and which of the two bounds mean saturation."""

    low: float
    high: float
    saturates: str = "both"


@dataclass(frozen=True, slots=True)
class ChannelRule:
    """How one channel is made of columns.

    Parameters
    ----------
    name : str
        Canonical name.
    expression : Expression
        What is computed from the columns; one column's name most often.
    factor : float
        From the logged unit to SI, with sign and scale.
    held : bool
        True for commands, setpoints and states.
    optional : bool
        True when the channel is left out of tables that lack its columns.
    angles : tuple of str
        Columns of roll and pitch, when the channel is computed from these.
    angle_unit : str
        Their unit, "rad" or "deg".
    """

    name: str
    expression: Expression
    factor: float = 1.0
    held: bool = False
    optional: bool = False
    angles: tuple[str, ...] = ()
    angle_unit: str = ""


@dataclass(frozen=True, slots=True)
class ChannelMap:
    """A checked channel map.

    Parameters
    ----------
    name : str
        Name of the map.
    time_column : str
        Column of the stamps.
    time_unit : str
        Unit of the stamps: "s", "ms", "us" or "ns".
    rules : tuple of ChannelRule
        One for each channel.
    frame : Frame
        Which way z points.
    input_map : str
        Name of the vehicle's input map, empty when the map does not state one.
    ranges : mapping of str to ValidRange
        By column.
    origin : str
        File of the map, for messages.
    """

    name: str
    time_column: str
    time_unit: str
    rules: tuple[ChannelRule, ...]
    frame: Frame
    input_map: str
    ranges: Mapping[str, ValidRange]
    origin: str

    @property
    def required_columns(self) -> tuple[str, ...]:
        """Columns without which the map does not fit a table."""
        needed = {self.time_column: None}
        for rule in self.rules:
            if not rule.optional:
                needed |= dict.fromkeys(rule.expression.columns)
        return tuple(needed)


def shipped_maps() -> tuple[str, ...]:
    """Names of the maps that come with Eivor."""
    folder = resources.files("eivor.logs") / "maps"
    return tuple(
        sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml"))
    )


def load_channel_map(source: str | os.PathLike[str]) -> ChannelMap:
    """Load a map by the name of a shipped one or by its path, and check every key of it.

    Raises
    ------
    ChannelMapError
        With file, key, what was expected and what stands there.
    """
    if isinstance(source, str) and source in shipped_maps():
        text = (resources.files("eivor.logs") / "maps" / f"{source}.toml").read_text(encoding="utf-8")
        return parse_channel_map(text, f"{source}.toml")
    path = Path(source)
    expected = f"a channel map: a TOML file, or one of the shipped maps {', '.join(shipped_maps())}"
    try:
        if not path.is_file():
            raise ChannelMapError(expected, f"'{path}', which is no file", "Check the name of the map.")
        if path.stat().st_size > MAX_MAP_BYTES:
            raise ChannelMapError(
                expected,
                f"'{path}', larger than {MAX_MAP_BYTES} bytes",
                "Give the map, not the log, as the map.",
            )
        text = path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise ChannelMapError(expected, f"'{path}', unreadable: {error}", "Check the file.") from error
    return parse_channel_map(text, path.name)


def parse_channel_map(text: str, origin: str) -> ChannelMap:
    """Parse and check the text of a map.

    Parameters
    ----------
    text : str
        TOML.
    origin : str
        File of the map, for messages.

    Raises
    ------
    ChannelMapError
        With file, key, what was expected and what stands there.
    """
    try:
        content = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise ChannelMapError(
            f"TOML in {origin}", f"text that is not: {error}", "Correct the syntax."
        ) from error
    top = _Keys(content, origin, "")
    name = top.text("name")
    top.text("description", "")
    frame = top.choice("frame", ("z_up", "ned"), "z_up")
    input_map = top.text("input_map", "")
    time = top.section("time")
    time_column = time.text("column")
    time_unit = time.choice("unit", tuple(TIME_UNITS), "s")
    time.finish()
    ranges = {key: _range(section) for key, section in top.sections("columns", required=False).items()}
    rules = tuple(_rule(key, section) for key, section in top.sections("channels", required=True).items())
    top.finish()
    chosen = {"z_up": Frame.Z_UP, "ned": Frame.NED}[frame]
    return ChannelMap(name, time_column, time_unit, rules, chosen, input_map, ranges, origin)


def _range(section: _Keys) -> ValidRange:
    low, high = section.pair("valid")
    saturates = section.choice("saturates", SATURATING, "both")
    section.finish()
    return ValidRange(low, high, saturates)


def _rule(name: str, section: _Keys) -> ChannelRule:
    key = canonical_key(name)
    if not key:
        known = ", ".join(CANONICAL_UNITS)
        raise section.wrong("", f"a canonical channel name ({known})", f"'{name}'", "Rename the channel.")
    ways = [way for way in ("column", "expression", "quaternion", "roll_pitch") if way in section.values]
    if len(ways) != 1:
        received = " and ".join(ways) or "none of them"
        raise section.wrong(
            "", "exactly one of column, expression, quaternion, roll_pitch", received, "State one source."
        )
    unit = section.choice("unit", tuple(UNITS), "rad" if ways[0] == "roll_pitch" else CANONICAL_UNITS[key])
    si_unit, to_si = UNITS[unit]
    expression, derived = _expression(section, ways[0], si_unit, to_si)
    if not derived and not unit_fits(name, CANONICAL_UNITS[key], si_unit):
        raise section.wrong(
            "unit",
            f"a unit of the kind '{CANONICAL_UNITS[key]}'" if CANONICAL_UNITS[key] else "no unit",
            f"'{unit}'",
            "Give the unit in which the column is logged.",
        )
    if derived and key != "cos_tilt":
        raise section.wrong(
            ways[0], "this key for cos_tilt only", f"it in {name}", "Use column or expression."
        )
    factor = section.number("sign", 1.0, (-1.0, 1.0)) * section.number("scale", 1.0)
    rule = ChannelRule(
        name,
        expression,
        factor if derived else factor * to_si,
        section.flag("held", default=held_by_default(name)),
        section.flag("optional", default=False),
        expression.columns if ways[0] == "roll_pitch" else (),
        unit if ways[0] == "roll_pitch" else "",
    )
    section.finish()
    return rule


def _expression(section: _Keys, way: str, si_unit: str, to_si: float) -> tuple[Expression, bool]:
    """Expression of a rule, and whether it is one of the derived quantities."""
    where = f"{section.origin}, key {section.path}.{way}"
    if way == "column":
        column = section.text("column")
        return Expression(column, quoted(column), (column,)), False
    if way == "expression":
        return parse_expression(section.text("expression"), where), False
    if way == "quaternion":
        w, x, y, z = (quoted(column) for column in section.columns("quaternion", 4))
        text = f"1 - 2 * ({x}*{x} + {y}*{y}) / ({w}*{w} + {x}*{x} + {y}*{y} + {z}*{z})"
        return parse_expression(text, where), True
    if si_unit != "rad":
        raise section.wrong(
            "unit", "rad or deg", f"a unit of {si_unit or 'pure numbers'}", "State the angle's unit."
        )
    roll, pitch = (quoted(column) for column in section.columns("roll_pitch", 2))
    return parse_expression(f"cos({to_si!r} * {roll}) * cos({to_si!r} * {pitch})", where), True


class _Keys:
    """A TOML table whose keys are taken one by one; what is left in the end is unknown."""

    def __init__(self, values: dict[str, Any], origin: str, path: str) -> None:
        self.values = values
        self.origin = origin
        self.path = path
        self.taken: set[str] = set()

    def wrong(self, key: str, expected: str, received: str, remedy: str) -> ChannelMapError:
        """Return the error for a key."""
        path = ".".join(part for part in (self.path, key) if part) or "(top level)"
        return ChannelMapError(f"{expected} at {self.origin}, key {path}", received, remedy)

    def _take(self, key: str, default: Any, expected: str) -> Any:
        self.taken.add(key)
        if key not in self.values and default is None:
            raise self.wrong(key, expected, "nothing", "Add the key.")
        return self.values.get(key, default)

    def text(self, key: str, default: str | None = None) -> str:
        """Return a non-empty string (or the default)."""
        value = self._take(key, default, "a text")
        if (
            not isinstance(value, str)
            or (not value and default is None)
            or ('"' in value and key == "column")
        ):
            raise self.wrong(key, "a text", repr(value), "Write it in quotes; it must not be empty.")
        return value

    def choice(self, key: str, among: tuple[str, ...], default: str) -> str:
        """Return one of some words."""
        value = self._take(key, default, "a word")
        if value not in among:
            raise self.wrong(key, f"one of {', '.join(map(repr, among))}", repr(value), "Choose one of them.")
        return str(value)

    def number(self, key: str, default: float, among: tuple[float, ...] = ()) -> float:
        """Return a finite number that is not zero."""
        value = self._take(key, default, "a number")
        if not _is_number(value) or value == 0 or (among and float(value) not in among):
            expected = f"one of {among}" if among else "a finite number other than 0"
            raise self.wrong(key, expected, repr(value), "Correct the number.")
        return float(value)

    def flag(self, key: str, *, default: bool) -> bool:
        """Return true or false."""
        value = self._take(key, default, "true or false")
        if not isinstance(value, bool):
            raise self.wrong(key, "true or false", repr(value), "Write it without quotes.")
        return value

    def pair(self, key: str) -> tuple[float, float]:
        """Return two increasing numbers."""
        value = self._take(key, None, "[low, high]")
        if (
            not isinstance(value, list)
            or len(value) != 2
            or not all(map(_is_number, value))
            or value[0] >= value[1]
        ):
            raise self.wrong(key, "[low, high] with low < high", repr(value), "Correct the range.")
        return float(value[0]), float(value[1])

    def columns(self, key: str, count: int) -> list[str]:
        """Return the names of `count` columns."""
        value = self._take(key, None, f"a list of {count} columns")
        names = value if isinstance(value, list) else []
        if len(names) != count or not all(
            isinstance(name, str) and name and '"' not in name for name in names
        ):
            raise self.wrong(key, f"a list of {count} column names", repr(value), "Correct the list.")
        return names

    def section(self, key: str) -> _Keys:
        """Return a table."""
        value = self._take(key, None, "a table")
        if not isinstance(value, dict):
            raise self.wrong(key, "a table", repr(value), f"Write [{key}] and its keys below.")
        return _Keys(value, self.origin, ".".join(part for part in (self.path, key) if part))

    def sections(self, key: str, *, required: bool) -> dict[str, _Keys]:
        """Return a table of tables."""
        if not required and key not in self.values:
            return {}
        outer = self.section(key)
        if required and not outer.values:
            raise self.wrong(key, "at least one channel", "none", "Add a table [channels.velocity_z].")
        return {name: outer.section(name) for name in outer.values}

    def finish(self) -> None:
        """Refuse what has not been taken."""
        unknown = sorted(set(self.values) - self.taken)
        if unknown:
            known = ", ".join(sorted(self.taken))
            raise self.wrong(
                unknown[0],
                f"one of the keys {known}",
                f"the unknown key '{unknown[0]}'",
                "Correct or remove it.",
            )


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
