"""Arithmetic over the columns of a table, as a channel map may state it.

An expression is a small part of SQL: column names (bare, or in double quotes), numbers, ``+ - * /``,
parentheses, and the functions of `FUNCTIONS`. Everything else is refused before the query engine sees
the text: no strings, no keywords, no aggregation, no table or file functions. Column names reach the
engine quoted and numbers as decimals, so neither can mean anything else there.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eivor.errors import ChannelMapError

#: Elementwise functions and their number of arguments.
FUNCTIONS: Mapping[str, int] = {
    "abs": 1,
    "sqrt": 1,
    "exp": 1,
    "ln": 1,
    "sin": 1,
    "cos": 1,
    "tan": 1,
    "asin": 1,
    "acos": 1,
    "atan": 1,
    "atan2": 2,
    "pow": 2,
    "greatest": 2,
    "least": 2,
}
MAX_LENGTH = 1000
MAX_NESTING = 32

_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)(?![\w.])"
    r"|(?P<name>[^\W\d]\w*)"
    r'|"(?P<quoted>[^"\x00]+)"'
    r"|(?P<mark>[-+*/(),]))"
)


@dataclass(frozen=True, slots=True)
class Expression:
    """A checked expression.

    Parameters
    ----------
    text : str
        As it stands in the channel map.
    sql : str
        As the query engine gets it.
    columns : tuple of str
        Columns that it uses, at least one.
    """

    text: str
    sql: str
    columns: tuple[str, ...]

    def evaluate(self, columns: Mapping[str, Float[np.ndarray, " n"]]) -> Float[np.ndarray, " n"]:
        """Return the value for each row [the unit of the expression]; not finite where it is not defined."""
        import polars as pl

        frame = pl.DataFrame({name: columns[name] for name in self.columns})
        values = frame.select(pl.sql_expr(self.sql).cast(pl.Float64).alias("value"))["value"]
        return np.asarray(values.to_numpy(), dtype=np.float64)


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
    sql = parser.sum(0)
    if parser.tokens:
        raise _refused(where, f"{text!r}, which goes on after its end with {parser.tokens[0][1]!r}")
    if not parser.columns:
        raise _refused(where, f"{text!r}, which names no column")
    return Expression(text, sql, tuple(parser.columns))


def quoted(column: str) -> str:
    """Return a column's name as it stands in an expression."""
    return f'"{column}"'


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
    """Recursive descent over the tokens; each method consumes one phrase and returns it as SQL."""

    def __init__(self, tokens: list[tuple[str, str]], text: str, where: str) -> None:
        self.tokens = tokens
        self.text = text
        self.where = where
        self.columns: dict[str, None] = {}

    def _next_is(self, *marks: str) -> bool:
        return bool(self.tokens) and self.tokens[0][0] == "mark" and self.tokens[0][1] in marks

    def _expect(self, mark: str) -> None:
        if not self._next_is(mark):
            got = repr(self.tokens[0][1]) if self.tokens else "its end"
            raise _refused(self.where, f"{self.text!r}, with {got} where {mark!r} belongs")
        self.tokens.pop(0)

    def sum(self, depth: int) -> str:
        """Products, added or subtracted."""
        if depth > MAX_NESTING:
            raise _refused(self.where, f"{self.text!r}, nested deeper than {MAX_NESTING}")
        parts = [self._product(depth)]
        while self._next_is("+", "-"):
            parts += [self.tokens.pop(0)[1], self._product(depth)]
        return " ".join(parts)

    def _product(self, depth: int) -> str:
        parts = [self._factor(depth)]
        while self._next_is("*", "/"):
            parts += [self.tokens.pop(0)[1], self._factor(depth)]
        return " ".join(parts)

    def _factor(self, depth: int) -> str:
        sign = ""
        while self._next_is("+", "-"):
            sign = "-" if (self.tokens.pop(0)[1] == "-") != (sign == "-") else ""
        return f"(0.0 - {self._atom(depth)})" if sign else self._atom(depth)

    def _atom(self, depth: int) -> str:
        if self._next_is("("):
            self.tokens.pop(0)
            inner = self.sum(depth + 1)
            self._expect(")")
            return f"({inner})"
        if not self.tokens or self.tokens[0][0] == "mark":
            got = repr(self.tokens[0][1]) if self.tokens else "its end"
            raise _refused(self.where, f"{self.text!r}, with {got} where a column or a number belongs")
        kind, word = self.tokens.pop(0)
        if kind == "number":
            return self._number(word)
        if kind == "name" and self._next_is("("):
            return self._call(word, depth)
        self.columns[word] = None
        return quoted(word)

    def _number(self, word: str) -> str:
        value = float(word)
        if not np.isfinite(value):
            raise _refused(self.where, f"{self.text!r}, where {word} is too large for a number")
        digits, _, power = repr(value).partition("e")
        decimal = digits if "." in digits else f"{digits}.0"
        if not power:
            return decimal
        # not every version of the engine reads an exponent
        return f"({decimal} {'/' if power.startswith('-') else '*'} POW(10.0, {abs(int(power))}.0))"

    def _call(self, word: str, depth: int) -> str:
        name = word.lower()
        if name not in FUNCTIONS:
            raise _refused(self.where, f"{self.text!r}, with the function {word!r}")
        self.tokens.pop(0)
        arguments = [self.sum(depth + 1)]
        while self._next_is(","):
            self.tokens.pop(0)
            arguments.append(self.sum(depth + 1))
        self._expect(")")
        if len(arguments) != FUNCTIONS[name]:
            raise _refused(
                self.where,
                f"{self.text!r}, where {name} has {len(arguments)} arguments, not {FUNCTIONS[name]}",
            )
        return f"{name.upper()}({', '.join(arguments)})"
