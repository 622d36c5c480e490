"""Strings that came from a log or from the file system, as they are shown.

Nothing is imported here: an error message needs it too, also while an interrupted import has left half of
the package behind.
"""

from __future__ import annotations

#: Names of logs are cut to so many letters in titles.
LONGEST_NAME = 48


def printable(text: str) -> str:
    r"""`text` with everything that a terminal or a figure would act on made visible.

    Control characters (the escape character, line breaks), marks that turn the reading direction and
    bytes that are no text become backslash escapes; letters of any script stay.
    """
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def short_name(name: str) -> str:
    """Name of a log, cut where it is too long for a title."""
    return name if len(name) <= LONGEST_NAME else f"{name[: LONGEST_NAME - 1]}…"
