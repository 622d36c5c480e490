"""The page that a browser gets."""

from __future__ import annotations

from eivor.report.page.markup import element
from eivor.report.page.shell import whole_page


def page_text() -> str:
    """Text of the page: HTML without anything to fetch."""
    return whole_page("Eivor", element("h1", None, "Eivor"), {})
