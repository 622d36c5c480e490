"""Pages of the documentation with generated parts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from eivor.errors import InputError


def markdown(header: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """Markdown table."""
    rows = [header, ["---"] * len(header), *lines]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def page_with(page: str, parts: Mapping[str, str]) -> str:
    """Page with each part between its marks, ``<!-- generated: NAME -->`` and ``<!-- end: NAME -->``."""
    for name, text in parts.items():
        begin, end = marks(name)
        if page.count(begin) != 1 or page.partition(begin)[2].count(end) != 1:
            expected = f"a page with the marks {begin} and {end}"
            raise InputError(expected, "one without both of them", "Put them where it goes.")
        before, _, rest = page.partition(begin)
        page = f"{before}{begin}\n\n{text}\n\n{end}{rest.partition(end)[2]}"
    return page


def page_text(path: Path, part: str) -> str:
    """Text of a page that has the marks of a part."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError("a page that can be read", f"'{path}', unreadable: {reason}", "Check it.") from error
    page_with(text, {part: ""})
    return text


def marks(name: str) -> tuple[str, str]:
    """Marks between which a part goes."""
    return f"<!-- generated: {name} -->", f"<!-- end: {name} -->"
