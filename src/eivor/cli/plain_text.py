"""Text for terminals that have no letters but ASCII, or few: a minus is "-" there, and τ is "tau".

Only what the stream's encoding does not have is replaced, as a question mark in an equation says nothing.
"""

from __future__ import annotations

import codecs
import re
import unicodedata

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
    """Text that the encoding has; what grows takes from the next two blanks or more, so that columns stay.

    Parameters
    ----------
    text : str
        Lines of a report.
    encoding : str
        Of the stream that it goes to.
    """
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


def _replaced(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(map(plain_letter, error.object[error.start : error.end])), error.end


codecs.register_error(ERRORS, _replaced)
