"""Strings that came from a log or from the file system, as they are shown.

Nothing is imported here: an error message needs it too, also while an interrupted import has left half of
the package behind.
"""

from __future__ import annotations


def printable(text: str) -> str:
    r"""`text` with everything that a terminal or a figure would act on made visible.

    Control characters (the escape character, line breaks), marks that turn the reading direction and
    bytes that are no text become backslash escapes; letters of any script stay.
    """
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)
