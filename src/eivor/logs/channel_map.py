"""Channel maps: which column of a table is which canonical channel, in TOML.

A map states::

    name = "mycopter"               # required
    description = "..."             # optional
    frame = "z_up"                  # or "ned"; z_up by default
    input_map = "square"            # optional: linear, square, power:EXPONENT, mixed:SHARE
    source = "sensor"               # or "estimator": where the channels come from; "sensor" by default

    [time]
    column = "t"
    unit = "s"                      # s, ms, us, ns

    [columns.motor_1]               # optional: the range that a column's values can have
    valid = [0, 65535]              # outside: overflow, becomes missing
    saturates = "upper"             # bounds that mean saturation: "lower", "upper", "both", "none";
                                    # by default both, but "upper" where low is 0

    [channels.velocity_z]
    column = "vz"                   # or expression = "vz_raw / 100"
    index = 2                       # optional: which element, where the cells of the column are lists
    unit = "m/s"                    # as logged; SI by default
    sign = -1                       # optional
    scale = 1.0                     # optional
    held = false                    # optional; commands and setpoints are held by default
    optional = false                # optional: true when some tables lack the column
    source = "estimator"            # optional: where this channel comes from; the map's by default
    delay_ms = 8                    # optional: the sensor tells what was so long before its stamp
    noise = 0.02                    # optional: standard deviation of its measurement noise, in `unit`; or,
                                    # of a data sheet, noise_density (in `unit` per root hertz),
                                    # noise_bandwidth_hz and quantisation (the step, in `unit`)

    [channels.rotor_command_1]
    column = "motor1"
    curve_side = "behind"           # optional, of commands: "before" or "behind" the thrust curve that the
                                    # autopilot inverts (THR_MDL_FAC, MOT_THST_EXPO); unknown by default

    [channels.cos_tilt]
    quaternion = ["qw", "qx", "qy", "qz"]      # or roll_pitch = ["roll", "pitch"], with unit = "deg"

Axes are as the table has them, `frame` says which way they point; `input` is positive up in either frame.
Every key is checked. A shipped map is used by itself when a table has all columns of its channels that
are not optional.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

from eivor.errors import ChannelMapError, UsageError, did_you_mean
from eivor.logs.elements import element_name
from eivor.logs.expressions import Expression, parse_expression, tilt_of_angles, tilt_of_quaternion
from eivor.logs.units import TIME_UNITS, UNITS, unit_fits
from eivor.signals.canonical import CurveSide, canonical_channel, canonical_channels
from eivor.signals.data_sheet import DataSheet
from eivor.signals.input_map import input_map
from eivor.signals.recording import Frame
from eivor.toml_table import TomlTable, read_toml, toml_table

ESTIMATOR = "estimator"
SOURCES = ("sensor", ESTIMATOR)
#: No sensor is later, and no clock earlier, by more than this [s].
LONGEST_DELAY_S = 1.0
#: More elements than a cell of a log has.
LONGEST_LIST = 100_000
#: Channels, or families of them, that stand on one side of a thrust curve.
COMMANDS = ("input", "rotor_command", "rotor_speed", "actuator_output")
SATURATING = ("none", "lower", "upper", "both")
_FRAMES = {"z_up": Frame.Z_UP, "ned": Frame.NED}


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
    estimated : bool
        True when an estimator makes the values.
    delay_s : float
        The sensor's own delay [s]: a value is of so long before its stamp; below zero, of after it.
    noise : float or DataSheet, optional
        Measurement noise of a sample in SI units, see `Channel`.
    curve_side : CurveSide
        Of a command, see `Channel`.
    """

    name: str
    expression: Expression
    factor: float = 1.0
    held: bool = False
    optional: bool = False
    angles: tuple[str, ...] = ()
    angle_unit: str = ""
    estimated: bool = False
    delay_s: float = 0.0
    noise: float | DataSheet | None = None
    curve_side: CurveSide = CurveSide.UNKNOWN


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
    airframe : str
        Which kind of vehicle the logs are of; empty when nothing is known.
    """

    name: str
    time_column: str
    time_unit: str
    rules: tuple[ChannelRule, ...]
    frame: Frame
    input_map: str
    ranges: Mapping[str, ValidRange]
    origin: str
    airframe: str = ""

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
    if not os.path.isfile(path):  # noqa: PTH113 - Path.is_file raises for names that are too long
        raise ChannelMapError(
            f"a channel map: a TOML file, or one of the shipped maps {', '.join(shipped_maps())}",
            f"'{path}', which is no file",
            did_you_mean(str(source), shipped_maps(), "Check the name of the map."),
        )
    return _channel_map(read_toml(path, "a channel map", ChannelMapError))


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
    return _channel_map(toml_table(text, Path(origin), "a channel map", ChannelMapError))


def _channel_map(top: TomlTable) -> ChannelMap:
    name = top.text("name")
    top.text("description", "")
    frame = top.choice("frame", tuple(_FRAMES), "z_up")
    time = top.section("time")
    time_column = time.text("column")
    time_unit = time.choice("unit", tuple(TIME_UNITS), "s")
    time.finish()
    source = top.choice("source", SOURCES, SOURCES[0])
    ranges = {key: _range(section) for key, section in top.named_sections("columns").items()}
    rules = tuple(_rule(key, section, source) for key, section in top.named_sections("channels").items())
    if not rules:
        raise top.wrong("channels", "at least one channel", "none", "Add a table [channels.velocity_z].")
    map_of_input = _input_map(top)
    airframe = top.text("airframe", name)
    top.finish()
    return ChannelMap(
        name, time_column, time_unit, rules, _FRAMES[frame], map_of_input, ranges, top.file, airframe
    )


def _input_map(top: TomlTable) -> str:
    """Name of the vehicle's input map, empty when the map does not state one."""
    name = top.text("input_map", "")
    try:
        return input_map(name).name if name else ""
    except UsageError as error:
        raise top.wrong("input_map", error.expected, error.received, error.remedy) from error


def _range(section: TomlTable) -> ValidRange:
    bounds = section.numbers("valid")
    if len(bounds) != 2 or bounds[0] >= bounds[1]:
        raise section.wrong("valid", "[low, high] with low < high", f"{list(bounds)}", "Correct the range.")
    # nothing is below zero for a motor that stands still, which is no saturation
    saturates = section.choice("saturates", SATURATING, "upper" if bounds[0] == 0.0 else "both")
    section.finish()
    return ValidRange(*bounds, saturates)


def _rule(name: str, section: TomlTable, source: str) -> ChannelRule:
    channel = canonical_channel(name)
    if channel is None:
        known = canonical_channels()
        raise section.wrong(
            "",
            f"a canonical channel name ({', '.join(known)})",
            f"'{name}'",
            did_you_mean(name, known, "Rename the channel."),
        )
    ways = [way for way in ("column", "expression", "quaternion", "roll_pitch") if section.has(way)]
    if len(ways) != 1:
        received = " and ".join(ways) or "none of them"
        raise section.wrong(
            "", "exactly one of column, expression, quaternion, roll_pitch", received, "State one source."
        )
    own = "rad" if ways[0] == "roll_pitch" else channel.unit
    unit = section.choice("unit", tuple(dict.fromkeys((*UNITS, own))), own)
    si_unit, to_si = UNITS.get(unit, (unit, 1.0))
    expression, derived = _expression(section, ways[0], si_unit, to_si)
    if not derived and not unit_fits(channel, si_unit):
        raise section.wrong(
            "unit",
            f"a unit of the kind '{channel.unit}'" if channel.unit else "no unit",
            f"'{unit}'",
            "Give the unit in which the column is logged.",
        )
    if derived and name != "cos_tilt":
        raise section.wrong(
            ways[0], "this key for cos_tilt only", f"it in {name}", "Use column or expression."
        )
    factor = _sign(section) * _scale(section)
    rule = ChannelRule(
        name,
        expression,
        factor if derived else factor * to_si,
        section.flag("held", default=channel.held),
        section.flag("optional", default=False),
        expression.columns if ways[0] == "roll_pitch" else (),
        unit if ways[0] == "roll_pitch" else "",
        section.choice("source", SOURCES, source) == ESTIMATOR,
        _delay_s(section),
        _noise(section, to_si),
        _curve_side(name, section),
    )
    section.finish()
    return rule


def _curve_side(name: str, section: TomlTable) -> CurveSide:
    """Side of the thrust curve that the map states; unknown where it states none."""
    if not section.has("curve_side"):
        return CurveSide.UNKNOWN
    if name.rstrip("0123456789").rstrip("_") not in COMMANDS:
        raise section.wrong(
            "curve_side",
            f"this key for commands only ({', '.join(COMMANDS)})",
            f"it in {name}",
            "Leave it out.",
        )
    sides = (CurveSide.BEFORE.value, CurveSide.BEHIND.value)
    return CurveSide(section.choice("curve_side", sides, sides[0]))


def _sign(section: TomlTable) -> float:
    sign = section.number("sign", 1.0)
    if abs(sign) != 1.0:
        raise section.wrong("sign", "1 or -1", f"{sign:g}", "A factor of another size is `scale`.")
    return sign


def _delay_s(section: TomlTable) -> float:
    delay_s = 1e-3 * section.number("delay_ms", 0.0)
    if not abs(delay_s) <= LONGEST_DELAY_S:
        raise section.wrong(
            "delay_ms",
            f"milliseconds between {-1e3 * LONGEST_DELAY_S:g} and {1e3 * LONGEST_DELAY_S:g}",
            f"{1e3 * delay_s:g}",
            "Give how long before its stamp a value was true; below zero for after it.",
        )
    return delay_s


def _noise(section: TomlTable, to_si: float) -> float | DataSheet | None:
    """What the map states of the measurement noise, in SI units."""
    keys = ("noise_density", "noise_bandwidth_hz", "quantisation")
    sheet = [key for key in keys if section.has(key)]
    if not section.has("noise"):
        if not sheet:
            return None
        density, step = section.number(keys[0], 0.0), section.number(keys[2], 0.0)
        bandwidth = section.number(keys[1]) if keys[1] in sheet else None
        try:
            return DataSheet(density * to_si, bandwidth, step * to_si)
        except UsageError as error:
            raise section.wrong(sheet[0], error.expected, error.received, error.remedy) from error
    std = section.number("noise")
    if sheet or std < 0.0:
        raise section.wrong(
            "noise",
            "a standard deviation of zero or more, or the keys of a data sheet",
            f"{std:g}" + (f" and {' and '.join(sheet)}" if sheet else ""),
            "Give the noise of a sample in the channel's unit.",
        )
    return std * to_si


def _scale(section: TomlTable) -> float:
    scale = section.number("scale", 1.0)
    if scale == 0.0:
        raise section.wrong("scale", "a finite number other than 0", "0", "Leave the channel out instead.")
    return scale


def _expression(section: TomlTable, way: str, si_unit: str, to_si: float) -> tuple[Expression, bool]:
    """Expression of a rule, and whether it is one of the derived quantities."""
    if way == "column":
        column = section.text("column")
        return Expression.of_column(
            element_name(column, _index(section)) if section.has("index") else column
        ), False
    if way == "expression":
        where = f"{section.path}.expression of {section.file}"
        return parse_expression(section.text("expression"), where), False
    if way == "quaternion":
        return tilt_of_quaternion(*_columns(section, "quaternion", 4)), True
    if si_unit != "rad":
        raise section.wrong(
            "unit", "rad or deg", f"a unit of {si_unit or 'pure numbers'}", "State the angle's unit."
        )
    return tilt_of_angles(to_si, *_columns(section, "roll_pitch", 2)), True


def _index(section: TomlTable) -> int:
    index = section.whole("index")
    if not 0 <= index < LONGEST_LIST:
        raise section.wrong("index", f"a place from 0 to {LONGEST_LIST - 1}", f"{index}", "The first is 0.")
    return index


def _columns(section: TomlTable, key: str, count: int) -> tuple[str, ...]:
    """Names of `count` columns."""
    names = section.texts(key)
    if len(names) != count:
        raise section.wrong(key, f"a list of {count} column names", f"{list(names)}", "Correct the list.")
    return names
