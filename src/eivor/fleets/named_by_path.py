"""Whose log it is, by its path: patterns such as ``{vehicle}/*.ulg``."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

from eivor.errors import UsageError

#: What a pattern may ask of a path, by the name of the table's column.
KEYS = ("vehicle", "type")
_TOKENS = re.compile(r"\{(\w+)\}|(\*\*/?)|(\*)|(\?)|([^*?{]+|\{)")


def is_pattern(text: str) -> bool:
    """Whether a text is a pattern, and not the name of a column."""
    return "{" in text


@dataclass(frozen=True, slots=True)
class PathPattern:
    """A pattern of paths that says whose log one is.

    Parameters
    ----------
    text : str
        A path from the folder of the logs, with ``{vehicle}`` and ``{type}`` where these stand in it;
        ``*`` and ``?`` stay within a folder, ``**/`` is any number of folders. A pattern without a
        folder is looked for in the file's name alone.

    Raises
    ------
    UsageError
        When it asks for nothing, for something else, or for one thing twice.
    """

    text: str

    def __post_init__(self) -> None:
        asked = re.findall(r"\{(\w*)\}", self.text)
        if not asked or set(asked) - set(KEYS) or len(set(asked)) < len(asked):
            raise UsageError(
                "a pattern with {vehicle}, and {type} where the path has it, each once",
                f"'{self.text}'",
                "Write one such as '{vehicle}/*.ulg' or '**/{type}_{vehicle}_*.csv'.",
            )

    def told(self, name: str) -> Mapping[str, str]:
        """What a path says, by `KEYS`; nothing when it does not match."""
        found = _compiled(self.text).fullmatch(name if "/" in self.text else name.rpartition("/")[2])
        return {key: text for key, text in found.groupdict().items() if text} if found else {}


@cache
def _compiled(text: str) -> re.Pattern[str]:
    parts: list[str] = []
    for key, deep, star, mark, plain in _TOKENS.findall(text):
        if key:
            parts.append(f"(?P<{key}>[^/]+?)")
        elif deep:
            parts.append("(?:.*/)?" if deep.endswith("/") else ".*")
        elif star or mark:
            parts.append("[^/]*" if star else "[^/]")
        else:
            parts.append(re.escape(plain))
    return re.compile("".join(parts))
