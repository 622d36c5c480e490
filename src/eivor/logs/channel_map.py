"""Channel maps: files that name columns, units and expressions."""

from __future__ import annotations

import ast
import os
import re
import sys
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import msgspec
import numpy as np

from eivor.errors import ChannelMapError, UsageError, did_you_mean, nearest_names
from eivor.logs.common import TIME_UNITS, UNITS, unit_fits
from eivor.signals.channels import CurveSide, canonical_channel, canonical_channels
from eivor.signals.filters import lagged_between_stamps, time_derivative
from eivor.signals.recording import DataSheet, Frame
from eivor.signals.thrust_map import input_map
from eivor.strict_toml import Text, TomlFiles, TomlTable
from eivor.tools import Float

#: Elementwise functions; how many arguments one has is the ufunc's `nin`.
FUNCTIONS: Mapping[str, np.ufunc] = {
    name: getattr(np, {"ln": "log", "greatest": "maximum", "least": "minimum"}.get(name, name))
    for name in (
        *("abs", "sign", "sqrt", "exp", "ln", "sin", "cos", "tan", "tanh", "asin", "acos", "atan", "atan2"),
        *("hypot", "pow", "greatest", "least"),
    )
}
_OPERATORS: Mapping[type[ast.AST], np.ufunc] = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.divide,
}
#: What is one where it holds, and zero elsewhere; of a missing value it is missing.
CONDITIONS: Mapping[type[ast.AST], np.ufunc] = {
    ast.Lt: np.less,
    ast.LtE: np.less_equal,
    ast.Gt: np.greater,
    ast.GtE: np.greater_equal,
    ast.And: np.logical_and,
    ast.Or: np.logical_or,
    ast.Not: np.logical_not,
}
_CONDITIONS = frozenset(CONDITIONS.values())
MAX_LENGTH = 1000
MAX_NESTING = 32
MAX_EXPONENT = 8.0
_QUOTED = re.compile(r'"([^"\x00]+)"')


class InTime(msgspec.Struct, frozen=True):
    """A step over the whole series: its derivative, or the series behind a first-order lag."""

    lag_s: float | None = None  # None for the derivative
    nin: ClassVar[int] = 1

    def __call__(self, values: np.ndarray | float, time: np.ndarray | float | None) -> np.ndarray | float:
        """The series at even steps [s], or at stamps; a number alone does not change."""
        if np.ndim(values) == 0:
            return 0.0 if self.lag_s is None else values
        series, stamps = np.asarray(values), np.asarray(time)
        if time is None:
            expected = "an expression of one moment, without ddt and lag"
            raise UsageError(expected, "one of a series in time", "Give a channel that holds it.")
        if self.lag_s is None:
            if series.size < 2:
                return np.full(series.shape, np.nan)
            return np.gradient(series, stamps) if stamps.ndim else time_derivative(series, float(stamps))
        known, stamps = np.isfinite(series), stamps if stamps.ndim else np.arange(series.size) * stamps
        result = np.full(series.shape, np.nan)
        result[known] = lagged_between_stamps(series[known], stamps[known], self.lag_s)
        return result


#: One step of a computation on a stack: put a number or a column (by name) on it, or apply a function.
Step = float | str | np.ufunc | InTime


@dataclass(frozen=True, slots=True)
class Expression:
    """A checked expression."""

    text: str
    steps: tuple[Step, ...]

    @classmethod
    def of_column(cls, name: str) -> Expression:
        return cls(name, (name,))

    @property
    def columns(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(step for step in self.steps if isinstance(step, str)))

    @property
    def of_moments(self) -> bool:
        """Whether a row needs no other row."""
        return not any(isinstance(step, InTime) for step in self.steps)

    def evaluate(
        self, columns: Mapping[str, np.ndarray | float], time: Float[np.ndarray, " n"] | float | None = None
    ) -> np.ndarray:
        """Value for each row, at stamps or even steps [s] for `ddt` and `lag`; not finite where undefined."""
        stack: list[np.ndarray | float] = []
        with np.errstate(all="ignore"):
            for step in self.steps:
                if isinstance(step, str):
                    stack.append(columns[step])
                elif isinstance(step, np.ufunc):
                    arguments = stack[-step.nin :]
                    del stack[-step.nin :]
                    value = step(*arguments)
                    if step in _CONDITIONS:
                        value = np.where(np.isnan(sum(arguments)), np.nan, value)
                    stack.append(value)
                else:
                    stack.append(step(stack.pop(), time) if isinstance(step, InTime) else np.float64(step))
        return np.asarray(stack.pop(), dtype=np.float64)


def parse_expression(text: str, where: str, *, constant: bool = False) -> Expression:
    """Check an expression and name its columns; without any where a constant may be one."""
    if len(text) > MAX_LENGTH:
        raise _refused(where, f"{len(text)} characters")
    parsed = Expression(text, tuple(_Compiler(text, where).steps()))
    if not (parsed.columns or constant):
        raise _refused(where, f"{text!r}, which names no column")
    return parsed


def tilt_of_angles(radians: float, roll: str, pitch: str) -> Expression:
    """Cosine of the tilt from the columns of roll and pitch, whose unit is so many radians."""
    return _formula(f"cos({radians!r} * roll) * cos({radians!r} * pitch)", {"roll": roll, "pitch": pitch})


def _formula(text: str, columns: Mapping[str, str]) -> Expression:
    """Return an expression in which other columns, of any name, stand for those of the text."""
    parsed = parse_expression(text, "formula")
    quoted = re.sub("|".join(rf"\b{name}\b" for name in columns), lambda m: f'"{columns[m[0]]}"', text)
    steps = tuple(columns.get(step, step) if isinstance(step, str) else step for step in parsed.steps)
    return Expression(quoted, steps)


def _refused(where: str, received: str, meant: str = "") -> ChannelMapError:
    names = ", ".join(FUNCTIONS)
    return ChannelMapError(
        f"arithmetic over columns, at most {MAX_LENGTH} characters, at {where}",
        received,
        f"{meant}Use column names, numbers, + - * / **, parentheses, < > <= >=, and, or, not, {names}, "
        "ddt(x) and lag(x, SECONDS). Words of Python, and names of other characters than letters, digits "
        "and _, need double quotes.",
    )


class _Compiler:
    """Turns the syntax tree of a text into steps; only the nodes of the white list pass."""

    def __init__(self, text: str, where: str) -> None:
        self.text, self.where = text, where
        self.source = re.sub(r"\s", " ", text).strip()

    def steps(self) -> Iterator[Step]:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                tree = ast.parse(self.source, mode="eval")
        except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
            position = getattr(error, "offset", None) or 1
            start = self.source[max(position - 1, 0) :][:20] or self.source[-20:]
            raise self._refuse(f"not understood at {start!r}") from None
        if "#" in _QUOTED.sub("", self.source):
            raise self._refuse("with a comment")
        yield from self._steps(tree.body, 0)

    def _refuse(self, why: str, meant: str = "") -> ChannelMapError:
        return _refused(self.where, f"{self.text!r}, {why}", meant)

    def _steps(self, node: ast.expr, depth: int) -> Iterator[Step]:
        """Steps of a node; chains of one precedence do not count as depth."""
        if depth > MAX_NESTING:
            raise self._refuse(f"nested deeper than {MAX_NESTING}")
        chain: list[tuple[np.ufunc, ast.expr]] = []
        while isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
            chain.append((_OPERATORS[type(node.op)], node.right))
            node = node.left
        negative = False
        while isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
            negative ^= isinstance(node.op, ast.USub)
            node = node.operand
        if isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
            yield from self._steps(node, depth + 1)
        else:
            yield from self._atom(node, depth)
        if negative:
            yield np.negative
        for operator, right in reversed(chain):
            yield from self._steps(right, depth + 1)
            yield operator

    def _atom(self, node: ast.expr, depth: int) -> Iterator[Step]:
        text = ast.get_source_segment(self.source, node) or ""
        match node:
            case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
                if abs(value) > sys.float_info.max:
                    raise self._refuse(f"where {text} is too large for a number")
                yield float(value)
            case ast.Name() | ast.Constant() if isinstance(node, ast.Name) or _QUOTED.fullmatch(text):
                yield text.strip('"')
            case ast.BinOp(left=left, op=ast.Pow(), right=right):
                exponent = _number(right)
                if exponent is None or abs(exponent) > MAX_EXPONENT:
                    limit = f"{MAX_EXPONENT:g}"
                    raise self._refuse(f"with an exponent that is no number from -{limit} to {limit}")
                yield from self._steps(left, depth + 1)
                yield from (exponent, np.power)
            case ast.Compare(left=left, ops=[operator, *more], comparators=[right, *_]):
                yield from self._condition(node if more else operator, [left, right], text, depth)
            case ast.BoolOp(op=operator, values=parts):
                yield from self._condition(operator, parts, text, depth)
            case ast.UnaryOp(op=ast.Not() as operator, operand=operand):
                yield from self._condition(operator, [operand], text, depth)
            case ast.Call(func=ast.Name(id=word), keywords=[]):
                yield from self._call(node, word, depth)
            case _:
                raise self._refuse(f"with {text!r} where a column or a number belongs")

    def _condition(
        self, operator: ast.AST, parts: Sequence[ast.expr], text: str, depth: int
    ) -> Iterator[Step]:
        if type(operator) not in CONDITIONS:
            raise self._refuse(f"with {text!r}: write 0 < a and a < 1, and >= with <= for equality")
        for number, part in enumerate(parts):
            yield from self._steps(part, depth + 1)
            if number or len(parts) == 1:
                yield CONDITIONS[type(operator)]

    def _call(self, node: ast.Call, word: str, depth: int) -> Iterator[Step]:
        lag_s = _number(node.args[1]) if word == "lag" and len(node.args) == 2 else None
        if (word == "ddt" and len(node.args) == 1) or (lag_s is not None and lag_s > 0.0):
            yield from self._steps(node.args[0], depth + 1)
            yield InTime(lag_s)
            return
        if word in ("ddt", "lag"):
            raise self._refuse("where ddt(x) or lag(x, SECONDS) with a number of seconds above zero belongs")
        function = FUNCTIONS.get(word.lower())
        if function is None:
            near = nearest_names(word.lower(), list(FUNCTIONS))
            raise self._refuse(f"with the function {word!r}", f"Did you mean '{near[0]}'? " if near else "")
        if len(node.args) != function.nin:
            raise self._refuse(f"where {word.lower()} has {len(node.args)} arguments, not {function.nin}")
        for argument in node.args:
            yield from self._steps(argument, depth + 1)
        yield function


def _number(node: ast.expr) -> float | None:
    """Value of a node that is a number, maybe with a sign."""
    sign = 1.0
    while isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        sign, node = -sign if isinstance(node.op, ast.USub) else sign, node.operand
    value = node.value if isinstance(node, ast.Constant) else None
    if isinstance(value, bool) or not isinstance(value, int | float) or abs(value) > sys.float_info.max:
        return None
    return sign * float(value)


ESTIMATOR = "estimator"
SOURCES = ("sensor", ESTIMATOR)
#: No sensor is later, and no clock earlier, by more than this [s].
LONGEST_DELAY_S = 1.0
#: More elements than a cell of a log has.
LONGEST_LIST = 100_000
#: Channels, or families of them, that stand on one side of a thrust curve.
COMMANDS = ("input", "rotor_command", "rotor_speed", "actuator_output")
EXPRESSIONS = ("column", "expression", "quaternion", "roll_pitch")
_FRAMES = {"z_up": Frame.Z_UP, "ned": Frame.NED}

#: Least and largest value that a column can have, and which of the two bounds mean saturation.
ValidRange = tuple[float, float, str]


@dataclass(frozen=True, slots=True)
class ChannelRule:
    """Rule by which one channel is computed from columns."""

    name: str
    expression: Expression
    factor: float = 1.0
    held: bool = False  # True for commands, setpoints and states
    optional: bool = False
    angles: tuple[str, ...] = ()  # Columns of roll and pitch, when the channel is computed from these
    angle_unit: str = ""  # Their unit, "rad" or "deg"
    #: True when an estimator makes the values, False when a sensor does; None where nothing is said
    estimated: bool | None = None
    delay_s: float = 0.0
    noise: float | DataSheet | None = None  # Measurement noise of a sample in SI units, see `Channel`
    curve_side: CurveSide = CurveSide.UNKNOWN


def columns_of(rules: Iterable[ChannelRule]) -> dict[str, None]:
    """Columns that rules need, each once."""
    return dict.fromkeys(column for rule in rules for column in rule.expression.columns)


@dataclass(frozen=True, slots=True)
class ChannelMap:
    """A checked channel map."""

    name: str
    time_column: str
    time_unit: str
    rules: tuple[ChannelRule, ...]
    frame: Frame
    input_map: str
    ranges: Mapping[str, ValidRange]
    origin: str  # File of the map, for messages
    airframe: str = ""

    def needed_by(self, rules: Iterable[ChannelRule]) -> tuple[str, ...]:
        """Columns of some rules, behind that of the time."""
        return tuple(dict.fromkeys((self.time_column, *columns_of(rules))))


MAPS = TomlFiles("eivor.logs", "maps", "a channel map", "Check the name of the map.", ChannelMapError)
shipped_maps = MAPS.names


def load_channel_map(source: str | os.PathLike[str]) -> ChannelMap:
    """Load a map by the name of a shipped one or by its path, and check every key of it."""
    return _channel_map(MAPS.table(source))


class _Time(msgspec.Struct, forbid_unknown_fields=True):
    column: Text
    unit: str = "s"


class _MapFile(msgspec.Struct, forbid_unknown_fields=True):
    name: Text
    time: _Time
    description: str = ""
    airframe: str | None = None
    frame: str = "z_up"
    source: str | None = None
    input_map: str = ""
    columns: dict[str, Any] = {}
    channels: dict[str, Any] = {}


class _ColumnTable(msgspec.Struct, forbid_unknown_fields=True):
    valid: list[float]
    saturates: str | None = None


class _ChannelTable(msgspec.Struct, forbid_unknown_fields=True):
    column: Text | None = None
    index: int | None = None
    expression: Text | None = None
    quaternion: list[Text] | None = None
    roll_pitch: list[Text] | None = None
    unit: str | None = None
    sign: float = 1.0
    scale: float = 1.0
    held: bool | None = None
    optional: bool = False
    source: str | None = None
    delay_ms: float = 0.0
    noise: float | None = None
    noise_density: float | None = None
    noise_bandwidth_hz: float | None = None
    quantisation: float | None = None
    curve_side: str | None = None


def _channel_map(top: TomlTable) -> ChannelMap:
    table = top.convert(_MapFile)
    frame = _FRAMES[top.choose("frame", table.frame, tuple(_FRAMES))]
    time_unit = top.part("time").choose("unit", table.time.unit, tuple(TIME_UNITS))
    source = table.source and top.choose("source", table.source, SOURCES)
    ranges = {key: _range(section) for key, section in top.parts("columns").items()}
    rules = tuple(_rule(key, section, source) for key, section in top.parts("channels").items())
    if not rules:
        raise top.wrong("channels", "at least one channel", "none", "Add a table [channels.velocity_z].")
    try:
        name_of_map = input_map(table.input_map).name if table.input_map else ""
    except UsageError as error:
        raise top.wrong("input_map", error.expected, error.received, error.remedy) from error
    airframe = table.name if table.airframe is None else table.airframe
    return ChannelMap(
        table.name, table.time.column, time_unit, rules, frame, name_of_map, ranges, top.file, airframe
    )


def _require(section: TomlTable, sound: bool, key: str, expected: str, received: str, remedy: str) -> None:
    if not sound:
        raise section.wrong(key, expected, received, remedy)


def _range(section: TomlTable) -> ValidRange:
    table = section.convert(_ColumnTable)
    bounds = table.valid
    sound = len(bounds) == 2 and bounds[0] < bounds[1]
    _require(section, sound, "valid", "[low, high] with low < high", f"{bounds}", "Correct the range.")
    # nothing is below zero for a motor that stands still, which is no saturation
    saturates = table.saturates or ("upper" if bounds[0] == 0.0 else "both")
    return bounds[0], bounds[1], section.choose("saturates", saturates, ("none", "lower", "upper", "both"))


def _rule(name: str, section: TomlTable, source: str | None) -> ChannelRule:
    table = section.convert(_ChannelTable)
    channel, names = canonical_channel(name), canonical_channels()
    if channel is None:
        remedy = did_you_mean(name, names, f"The names are {', '.join(names)}.")
        raise section.wrong("", "a canonical channel name", f"'{name}'", remedy)
    kinds = [kind for kind in EXPRESSIONS if getattr(table, kind) is not None]
    sources, received = f"exactly one of {', '.join(EXPRESSIONS)}", " and ".join(kinds) or "none of them"
    _require(section, len(kinds) == 1, "", sources, received, "State one source.")
    kind, is_turned = kinds[0], kinds[0] == "roll_pitch"
    default = "rad" if is_turned else channel.unit
    unit = table.unit if table.unit is not None else default
    section.choose("unit", unit, tuple(dict.fromkeys((*UNITS, default))))
    si_unit, to_si = UNITS.get(unit, (unit, 1.0))
    expression = _expression(section, table, kind, si_unit, to_si)
    of_tilt = kind in ("quaternion", "roll_pitch")
    if of_tilt:
        remedy = "Use column or expression."
        _require(section, name == "cos_tilt", kind, "this key for cos_tilt only", f"it in {name}", remedy)
    else:
        expected = f"a unit of the kind '{channel.unit}'" if channel.unit else "no unit"
        remedy = "Give the unit in which the column is logged."
        _require(section, unit_fits(channel, si_unit), "unit", expected, f"'{unit}'", remedy)
    remedy = "A factor of another size is `scale`."
    _require(section, abs(table.sign) == 1.0, "sign", "1 or -1", f"{table.sign:g}", remedy)
    remedy = "Leave the channel out instead."
    _require(section, table.scale != 0.0, "scale", "a finite number other than 0", "0", remedy)
    declared = table.source or source
    return ChannelRule(
        name,
        expression,
        table.sign * table.scale * (1.0 if of_tilt else to_si),
        channel.held if table.held is None else table.held,
        table.optional,
        expression.columns if is_turned else (),
        unit if is_turned else "",
        section.choose("source", declared, SOURCES) == ESTIMATOR if declared else None,
        _delay_s(section, table),
        _noise(section, table, to_si),
        _curve_side(name, section, table),
    )


def _curve_side(name: str, section: TomlTable, table: _ChannelTable) -> CurveSide:
    if table.curve_side is None:
        return CurveSide.UNKNOWN
    is_command = name.rstrip("0123456789").rstrip("_") in COMMANDS
    commands = f"this key for commands only ({', '.join(COMMANDS)})"
    _require(section, is_command, "curve_side", commands, f"it in {name}", "Leave it out.")
    sides = (CurveSide.BEFORE.value, CurveSide.BEHIND.value)
    return CurveSide(section.choose("curve_side", table.curve_side, sides))


def _delay_s(section: TomlTable, table: _ChannelTable) -> float:
    delay_s, longest = 1e-3 * table.delay_ms, 1e3 * LONGEST_DELAY_S
    remedy = "Give how long before its stamp a value was true; below zero for after it."
    expected = f"milliseconds between {-longest:g} and {longest:g}"
    _require(section, abs(delay_s) <= LONGEST_DELAY_S, "delay_ms", expected, f"{1e3 * delay_s:g}", remedy)
    return delay_s


def _noise(section: TomlTable, table: _ChannelTable, to_si: float) -> float | DataSheet | None:
    keys = ("noise_density", "noise_bandwidth_hz", "quantisation")
    sheet = [key for key in keys if getattr(table, key) is not None]
    if table.noise is not None:
        std, remedy = table.noise, "Give the noise of a sample in the channel's unit."
        expected = "a standard deviation of zero or more, or the keys of a data sheet"
        received = " and ".join((f"{std:g}", *sheet))
        _require(section, std >= 0.0 and not sheet, "noise", expected, received, remedy)
        return std * to_si
    if not sheet:
        return None
    density, step = table.noise_density or 0.0, table.quantisation or 0.0
    try:
        return DataSheet(density * to_si, table.noise_bandwidth_hz, step * to_si)
    except UsageError as error:
        raise section.wrong(sheet[0], error.expected, error.received, error.remedy) from error


def _expression(
    section: TomlTable, table: _ChannelTable, kind: str, si_unit: str, to_si: float
) -> Expression:
    index, count = table.index, {"quaternion": 4, "roll_pitch": 2}.get(kind, 0)
    if index is not None:
        _require(section, kind == "column", "index", "this key with column", f"it with {kind}", "Remove it.")
        expected = f"a place from 0 to {LONGEST_LIST - 1}"
        _require(section, 0 <= index < LONGEST_LIST, "index", expected, f"{index}", "The first is 0.")
    if table.column is not None:
        return Expression.of_column(table.column if index is None else f"{table.column}[{index}]")
    if table.expression is not None:
        return parse_expression(table.expression, f"{section.path}.expression of {section.file}")
    names = table.quaternion or table.roll_pitch or []
    expected = f"a list of {count} column names"
    _require(section, len(names) == count, kind, expected, f"{names}", "Correct the list.")
    if kind == "quaternion":
        tilt = "1 - 2 * (x*x + y*y) / (w*w + x*x + y*y + z*z)"
        return _formula(tilt, dict(zip("wxyz", names, strict=True)))
    received = f"a unit of {si_unit or 'pure numbers'}"
    _require(section, si_unit == "rad", "unit", "rad or deg", received, "State the angle's unit.")
    return tilt_of_angles(to_si, *names)
