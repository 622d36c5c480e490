"""Arithmetic over the columns of a table, as a channel map may state it.

An expression is made of column names (bare, or in double quotes), numbers, ``+ - * /``, parentheses, and
the functions of `FUNCTIONS`. Everything else is refused: no strings, no keywords, no aggregation.

It is computed in float64 throughout: a number is a float, also where it meets another number only, so that
``1/65535*a`` is ``a/65535``. A value that is missing (NaN) makes every result missing in which it takes part.
"""

from __future__ import annotations

import ast
import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from eivor.errors import ChannelMapError
from eivor.shapes import Float

#: Elementwise functions; how many arguments one has is the ufunc's `nin`.
FUNCTIONS: Mapping[str, np.ufunc] = {
    "abs": np.absolute,
    "sqrt": np.sqrt,
    "exp": np.exp,
    "ln": np.log,
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "asin": np.arcsin,
    "acos": np.arccos,
    "atan": np.arctan,
    "atan2": np.arctan2,
    "pow": np.power,
    "greatest": np.maximum,
    "least": np.minimum,
}
_OPERATORS: Mapping[type[ast.AST], np.ufunc] = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.divide,
}
MAX_LENGTH = 1000
MAX_NESTING = 32
_QUOTED = re.compile(r'"([^"\x00]+)"')


#: One step of a computation on a stack: put a number or a column (by name) on it, or apply a function.
Step = float | str | np.ufunc


@dataclass(frozen=True, slots=True)
class Expression:
    """A checked expression.

    Parameters
    ----------
    text : str
        As it stands in the channel map.
    steps : tuple of float, str or ufunc
        Numbers, names of columns and functions, each function after its arguments.
    columns : tuple of str
        Columns that it uses, at least one.
    """

    text: str
    steps: tuple[Step, ...]
    columns: tuple[str, ...]

    @classmethod
    def of_column(cls, name: str) -> Expression:
        """Return the expression that is a column as it stands."""
        return cls(name, (name,), (name,))

    def evaluate(self, columns: Mapping[str, Float[np.ndarray, " n"]]) -> Float[np.ndarray, " n"]:
        """Return the value for each row [the unit of the expression]; not finite where it is not defined."""
        stack: list[np.ndarray | np.float64] = []
        with np.errstate(all="ignore"):
            for step in self.steps:
                if isinstance(step, np.ufunc):
                    arguments = stack[-step.nin :]
                    del stack[-step.nin :]
                    stack.append(step(*arguments))
                else:
                    stack.append(columns[step] if isinstance(step, str) else np.float64(step))
        return np.asarray(stack.pop(), dtype=np.float64)


def parse_expression(text: str, where: str) -> Expression:
    """Check an expression and name its columns.

    Parameters
    ----------
    text : str
        The expression.
    where : str
        File and key, for messages.

    Raises
    ------
    ChannelMapError
        When the text is anything but elementwise arithmetic over columns.
    """
    if len(text) > MAX_LENGTH:
        raise _refused(where, f"{len(text)} characters")
    compiler = _Compiler(text, where)
    compiler.compile()
    if not compiler.columns:
        raise _refused(where, f"{text!r}, which names no column")
    return Expression(text, tuple(compiler.steps), tuple(compiler.columns))


def tilt_of_quaternion(w: str, x: str, y: str, z: str) -> Expression:
    """Cosine of the tilt from the columns of a quaternion of any norm, from body to world."""
    return _formula("1 - 2 * (x*x + y*y) / (w*w + x*x + y*y + z*z)", {"w": w, "x": x, "y": y, "z": z})


def tilt_of_angles(radians: float, roll: str, pitch: str) -> Expression:
    """Cosine of the tilt from the columns of roll and pitch, whose unit is so many radians."""
    return _formula(f"cos({radians!r} * roll) * cos({radians!r} * pitch)", {"roll": roll, "pitch": pitch})


def _formula(text: str, columns: Mapping[str, str]) -> Expression:
    """Return an expression in which other columns, of any name, stand for those of the text."""
    parsed = parse_expression(text, "formula")
    shown = re.sub("|".join(rf"\b{name}\b" for name in columns), lambda m: f'"{columns[m[0]]}"', text)
    steps = tuple(columns.get(step, step) if isinstance(step, str) else step for step in parsed.steps)
    return Expression(shown, steps, tuple(dict.fromkeys(columns[name] for name in parsed.columns)))


def _refused(where: str, received: str) -> ChannelMapError:
    names = ", ".join(FUNCTIONS)
    return ChannelMapError(
        f"arithmetic over columns, at most {MAX_LENGTH} characters, at {where}",
        received,
        f"Use column names (in double quotes where they are words of Python or hold other characters than "
        f"letters, digits and _), numbers, + - * /, parentheses and {names}.",
    )


class _Compiler:
    """Turns the syntax tree of a text into steps; only the nodes of the white list pass."""

    def __init__(self, text: str, where: str) -> None:
        self.text = text
        self.where = where
        self.source = re.sub(r"\s", " ", text).strip()
        self.steps: list[Step] = []
        self.columns: dict[str, None] = {}

    def compile(self) -> None:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                tree = ast.parse(self.source, mode="eval")
        except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
            place = getattr(error, "offset", None) or 1
            start = self.source[max(place - 1, 0) :][:20] or self.source[-20:]
            raise self._refuse(f"not understood at {start!r}") from None
        if "#" in _QUOTED.sub("", self.source):
            raise self._refuse("with a comment")
        self._add(tree.body, 0)

    def _refuse(self, why: str) -> ChannelMapError:
        return _refused(self.where, f"{self.text!r}, {why}")

    def _add(self, node: ast.expr, depth: int) -> None:
        """Add the steps of a node; chains of one precedence do not count as depth."""
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
            self._add(node, depth + 1)
        else:
            self._atom(node, depth)
        if negative:
            self.steps.append(np.negative)
        for operator, right in reversed(chain):
            self._add(right, depth + 1)
            self.steps.append(operator)

    def _atom(self, node: ast.expr, depth: int) -> None:
        written = ast.get_source_segment(self.source, node) or ""
        value = node.value if isinstance(node, ast.Constant) else None
        if isinstance(value, int | float) and not isinstance(value, bool):
            try:
                number = float(value)
            except OverflowError:
                number = np.inf
            if not np.isfinite(number):
                raise self._refuse(f"where {written} is too large for a number")
            self.steps.append(number)
        elif isinstance(node, ast.Name) or (isinstance(node, ast.Constant) and _QUOTED.fullmatch(written)):
            name = written.strip('"')
            self.columns[name] = None
            self.steps.append(name)
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
            self._call(node, node.func.id, depth)
        else:
            raise self._refuse(f"with {written!r} where a column or a number belongs")

    def _call(self, node: ast.Call, word: str, depth: int) -> None:
        function = FUNCTIONS.get(word.lower())
        if function is None:
            raise self._refuse(f"with the function {word!r}")
        if len(node.args) != function.nin:
            raise self._refuse(f"where {word.lower()} has {len(node.args)} arguments, not {function.nin}")
        for argument in node.args:
            self._add(argument, depth + 1)
        self.steps.append(function)
