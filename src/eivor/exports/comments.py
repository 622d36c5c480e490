"""Sentences and names as comments: whatever a log is called, each stays one line of plain letters."""

from __future__ import annotations

from collections.abc import Iterable

#: Longer strings are cut: some readers of parameters have lines of bounded length.
LONGEST = 400


def one_line(text: str) -> str:
    """`text` in printable ASCII: control characters, line breaks and other letters as backslash escapes."""
    shown = "".join(
        c if " " <= c <= "~" else c.encode("unicode_escape", "surrogatepass").decode("ascii") for c in text
    )
    return shown if len(shown) <= LONGEST else f"{shown[: LONGEST - 3]}..."


def hash_comments(lines: Iterable[str]) -> list[str]:
    """Lines that begin with ``#``."""
    return [f"# {one_line(line)}".rstrip() for line in lines]


def xml_comments(lines: Iterable[str]) -> list[str]:
    """Comments of XML, which hold no two hyphens in a row."""
    return [f"<!-- {one_line(line).replace('--', '- -').rstrip('-')} -->" for line in lines]
