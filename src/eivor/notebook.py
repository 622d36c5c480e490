"""Tables for notebooks. Whatever a log brought along is escaped: nothing of it is markup."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape


def html_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[str]], note: str = "") -> str:
    """Table in HTML.

    Parameters
    ----------
    title : str
        Above it.
    columns : sequence of str
        Headings.
    rows : iterable of sequence of str
        Cells.
    note : str
        Below it; may be empty.
    """
    head = "".join(f"<th>{escape(column)}</th>" for column in columns)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in cells) + "</tr>" for cells in rows)
    below = f"<p>{escape(note)}</p>" if note else ""
    return (
        f"<div><strong>{escape(title)}</strong><table><thead><tr>{head}</tr></thead>"
        f"<tbody>{body}</tbody></table>{below}</div>"
    )
