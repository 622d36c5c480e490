"""HTML that cannot be broken out of: text becomes HTML in one place only, where it is escaped.

`Markup` is HTML; every string is text. Whatever came from a log is a string, so that it stays text whatever
it says.
"""

from __future__ import annotations

import html
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from eivor.report.printable import printable

#: Elements without an end.
VOID = frozenset({"br", "col", "hr", "link", "meta"})


@dataclass(frozen=True, slots=True)
class Markup:
    """A piece of HTML.

    Parameters
    ----------
    html : str
        Its source, made by `element` and `joined`.
    """

    html: str


#: What goes into an element: HTML, or text that is escaped.
Content = Markup | str


def element(name: str, attributes: Mapping[str, str] | None = None, *content: Content) -> Markup:
    """Element with its attributes and what is in it.

    Parameters
    ----------
    name : str
        Tag.
    attributes : mapping of str to str, optional
        Values are text, and escaped.
    *content : Markup or str
        In order.
    """
    told = "".join(f' {key}="{escaped(value)}"' for key, value in (attributes or {}).items())
    if name in VOID:
        return Markup(f"<{name}{told}>")
    return Markup(f"<{name}{told}>{joined(content).html}</{name}>")


def joined(content: Iterable[Content]) -> Markup:
    """Pieces, one after the other."""
    return Markup("".join(one.html if isinstance(one, Markup) else escaped(one) for one in content))


def escaped(text: str) -> str:
    """Text as HTML source: what a browser would act on is escaped, what it would not show is made visible."""
    return html.escape(printable(text), quote=True)
