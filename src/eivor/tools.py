"""Plain text, notebook output, progress messages, and annotations of array shapes."""

from __future__ import annotations

import codecs
import re
import sys
import unicodedata
from collections.abc import Callable, Iterable, Sequence
from enum import StrEnum
from html import escape
from typing import TYPE_CHECKING, Any

# -- Plain text --

#: Name of the way to deal with what an encoding does not have.
ERRORS = "eivor.plain_text"
#: Signs that have no letters to be taken apart into.
SIGNS = {
    **dict.fromkeys("−–—", "-"),
    **dict.fromkeys("‘’", "'"),
    **dict.fromkeys("“”", '"'),
    **dict(zip("±×·√°µ²³", ("+-", "x", "*", "sqrt", "deg", "u", "^2", "^3"), strict=True)),
    **dict(zip("▁▂▃▄▅▆▇█", "_.,-=+*#", strict=True)),
    **dict(zip("≤≥≈→∞•", ("<=", ">=", "~", "->", "inf", "*"), strict=True)),
}
_TWO_BLANKS = re.compile(" {2,}")


#: A symbol, alone or before its value: it stays as it is.
_SYMBOL = re.compile(r"\w{1,2}( [-−–±\d].*)?$|[a-z]_")


def capitalised(words: str) -> str:
    """Words with a capital letter first, but for symbols."""
    return words if _SYMBOL.match(words) else f"{words[:1].upper()}{words[1:]}"


def plain_letter(letter: str) -> str:
    """ASCII form of one letter; a question mark where there is none."""
    if letter in SIGNS:
        return SIGNS[letter]
    name = unicodedata.name(letter, "")
    if name.startswith("GREEK ") and " LETTER " in name:
        word = name.partition(" LETTER ")[2].split()[0].lower()
        return word.capitalize() if " CAPITAL " in name else word
    if name.startswith("BOX DRAWINGS "):
        return "-" if name.endswith("HORIZONTAL") else "|" if name.endswith("VERTICAL") else "+"
    return unicodedata.normalize("NFKD", letter).encode("ascii", "ignore").decode("ascii") or "?"


def plain_text(text: str, encoding: str) -> str:
    """Text that the encoding has; what grows takes from the next two blanks or more, so that columns stay."""
    try:
        text.encode(encoding)
    except UnicodeEncodeError:
        return "\n".join(_plain_line(line, encoding) for line in text.split("\n"))
    return text


def _plain_line(line: str, encoding: str) -> str:
    grown, end, parts = 0, 0, []
    for blanks in _TWO_BLANKS.finditer(line):
        words = _plain(line[end : blanks.start()], encoding)
        grown += len(words) - (blanks.start() - end)
        width = len(blanks.group())
        kept = min(max(width - grown, 1), width)
        grown -= width - kept
        parts += [words, " " * kept]
        end = blanks.end()
    return "".join([*parts, _plain(line[end:], encoding)])


def _plain(words: str, encoding: str) -> str:
    return words.encode(encoding, ERRORS).decode(encoding)


def _replaced_characters(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(map(plain_letter, error.object[error.start : error.end])), error.end


codecs.register_error(ERRORS, _replaced_characters)


def printable(text: str) -> str:
    """`text` with what a terminal or a figure would act on as backslash escapes; letters stay."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


# -- Stages --


class Stage(StrEnum):
    """What an identification is at."""

    PREPARING = "preparing"
    IDENTIFYING = "identifying"
    DIAGNOSING = "diagnosing"


#: Called with each stage when it begins.
Progress = Callable[[Stage], None]


def no_stage_callback(_stage: Stage, /) -> None:
    """Report to no one."""


#: Called with the number of items that are done, and that of all; first with what was done before.
ItemsDone = Callable[[int, int], None]


def no_items_callback(_done: int, _total: int, /) -> None:
    """Report to no one."""


# -- Notebook --


def html_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[str]], note: str = "") -> str:
    """Table in HTML."""
    head = "".join(f"<th>{escape(column)}</th>" for column in columns)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in cells) + "</tr>" for cells in rows)
    below = f"<p>{escape(note)}</p>" if note else ""
    return (
        f"<div><strong>{escape(title)}</strong><table><thead><tr>{head}</tr></thead>"
        f"<tbody>{body}</tbody></table>{below}</div>"
    )


# -- Shapes --

if TYPE_CHECKING or "jaxtyping" in sys.modules:
    from jaxtyping import Bool, Complex, Float, Int
else:

    class _Unchecked:
        def __class_getitem__(cls, kind_and_shape: tuple[Any, str]) -> Any:
            return kind_and_shape[0]

    Bool = Complex = Float = Int = _Unchecked

__all__ = ["Bool", "Complex", "Float", "Int"]
