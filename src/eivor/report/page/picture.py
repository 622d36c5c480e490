"""A picture of a page: what is drawn, what is said of it, and the same numbers as a table."""

from __future__ import annotations

from dataclasses import dataclass

from eivor.report.document import TableOf
from eivor.report.page.chart import Chart
from eivor.report.page.forest import Forest
from eivor.report.page.plot import Plot


@dataclass(frozen=True, slots=True)
class Picture:
    """One picture.

    Parameters
    ----------
    title : str
        What it shows.
    words : str
        How to read it.
    drawn : Chart, Plot or Forest
        Series over time to zoom into, a drawing, or intervals side by side.
    table : TableOf or None
        Its numbers; None where they stand beside it in any case.
    """

    title: str
    words: str
    drawn: Chart | Plot | Forest
    table: TableOf | None


@dataclass(frozen=True, slots=True)
class Pictures:
    """Pictures that belong together: those over time share their axis.

    Parameters
    ----------
    heading : str
        May be empty.
    pictures : tuple of Picture
        In their order.
    """

    heading: str
    pictures: tuple[Picture, ...]
