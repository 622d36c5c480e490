"""Arithmetic over the columns of a table, as a channel map may state it.

An expression is made of column names (bare, or in double quotes), numbers, ``+ - * /``, parentheses, and
the functions of `FUNCTIONS`. Everything else is refused: no strings, no keywords, no aggregation.

It is computed in float64 throughout: a number is a float, also where it meets another number only, so that
``1/65535*a`` is ``a/65535``. A value that is missing (NaN) makes every result missing in which it takes part.
"""

from __future__ import annotations

import re
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
_OPERATORS: Mapping[str, np.ufunc] = {"+": np.add, "-": np.subtract, "*": np.multiply, "/": np.divide}
MAX_LENGTH = 1000
MAX_NESTING = 32

_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)(?![\w.])"
    r"|(?P<name>[^\W\d]\w*)"
    r'|"(?P<quoted>[^"\x00]+)"'
    r"|(?P<mark>[-+*/(),]))"
)


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
    parser = _Parser(_tokens(text, where), text, where)
    parser.sum(0)
    if parser.tokens:
        raise _refused(where, f"{text!r}, which goes on after its end with {parser.tokens[0][1]!r}")
    if not parser.columns:
        raise _refused(where, f"{text!r}, which names no column")
    return Expression(text, tuple(parser.steps), tuple(parser.columns))


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
        f"Use column names (in double quotes where they hold other characters than letters, digits and _), "
        f"numbers, + - * /, parentheses and {names}.",
    )


def _tokens(text: str, where: str) -> list[tuple[str, str]]:
    tokens = []
    position = 0
    end = len(text.rstrip())
    while position < end:
        match = _TOKEN.match(text, position)
        if match is None or match.lastgroup is None:
            raise _refused(where, f"{text!r}, not understood from {text[position : position + 20]!r} on")
        tokens.append((match.lastgroup, match.group(match.lastgroup)))
        position = match.end()
    return tokens


class _Parser:
    """Recursive descent over the tokens; each method consumes one phrase and adds its steps."""

    def __init__(self, tokens: list[tuple[str, str]], text: str, where: str) -> None:
        self.tokens = tokens
        self.text = text
        self.where = where
        self.steps: list[Step] = []
        self.columns: dict[str, None] = {}

    def _next_is(self, *marks: str) -> bool:
        return bool(self.tokens) and self.tokens[0][0] == "mark" and self.tokens[0][1] in marks

    def _expect(self, mark: str) -> None:
        if not self._next_is(mark):
            got = repr(self.tokens[0][1]) if self.tokens else "its end"
            raise _refused(self.where, f"{self.text!r}, with {got} where {mark!r} belongs")
        self.tokens.pop(0)

    def sum(self, depth: int) -> None:
        """Products, added or subtracted."""
        if depth > MAX_NESTING:
            raise _refused(self.where, f"{self.text!r}, nested deeper than {MAX_NESTING}")
        self._product(depth)
        while self._next_is("+", "-"):
            operator = _OPERATORS[self.tokens.pop(0)[1]]
            self._product(depth)
            self.steps.append(operator)

    def _product(self, depth: int) -> None:
        self._factor(depth)
        while self._next_is("*", "/"):
            operator = _OPERATORS[self.tokens.pop(0)[1]]
            self._factor(depth)
            self.steps.append(operator)

    def _factor(self, depth: int) -> None:
        negative = False
        while self._next_is("+", "-"):
            negative ^= self.tokens.pop(0)[1] == "-"
        self._atom(depth)
        if negative:
            self.steps.append(np.negative)

    def _atom(self, depth: int) -> None:
        if self._next_is("("):
            self.tokens.pop(0)
            self.sum(depth + 1)
            self._expect(")")
            return
        if not self.tokens or self.tokens[0][0] == "mark":
            got = repr(self.tokens[0][1]) if self.tokens else "its end"
            raise _refused(self.where, f"{self.text!r}, with {got} where a column or a number belongs")
        kind, word = self.tokens.pop(0)
        if kind == "number":
            self.steps.append(self._number(word))
        elif kind == "name" and self._next_is("("):
            self._call(word, depth)
        else:
            self.columns[word] = None
            self.steps.append(word)

    def _number(self, word: str) -> float:
        value = float(word)
        if not np.isfinite(value):
            raise _refused(self.where, f"{self.text!r}, where {word} is too large for a number")
        return value

    def _call(self, word: str, depth: int) -> None:
        name = word.lower()
        if name not in FUNCTIONS:
            raise _refused(self.where, f"{self.text!r}, with the function {word!r}")
        self.tokens.pop(0)
        self.sum(depth + 1)
        count = 1
        while self._next_is(","):
            self.tokens.pop(0)
            self.sum(depth + 1)
            count += 1
        self._expect(")")
        function = FUNCTIONS[name]
        if count != function.nin:
            raise _refused(
                self.where, f"{self.text!r}, where {name} has {count} arguments, not {function.nin}"
            )
        self.steps.append(function)
