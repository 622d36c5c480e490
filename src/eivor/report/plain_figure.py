"""What figures have in common: a page with a canvas of its own, grids, legends that are never mathematics."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Sized
from typing import Literal

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from eivor.errors import UsageError
from eivor.report.given_axes import given_panel

#: What draws each panel of a figure into its Axes, by the panel's name.
Panels = dict[str, Callable[[Axes], None]]

DPI = 110
#: Of nine points.
LETTERS_PER_INCH = 14.0
DARK, RED, GREY, BLUE = "#333333", "#d1495b", "#66717e", "#2e86ab"


def page(width: float, height: float, title: str = "") -> Figure:
    """Empty figure of that size [inch]; nothing global is touched."""
    figure = Figure(figsize=(width, height), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    if title:
        figure.suptitle(title, fontsize=11, parse_math=False)
    return figure


def panel(ax: Axes | None, width: float, height: float, title: str = "") -> Axes:
    """Axes to draw the only panel into: the caller's, or those of a page of that size [inch].

    Raises
    ------
    UsageError
        When what is given are no Axes.
    """
    if ax is None:
        return page(width, height, title).add_subplot()
    return given_panel(ax, title)


def without_abscissa(axes: Axes) -> None:
    """Leave the numbers and the words of the abscissa to the panel below, which shares it."""
    axes.tick_params(labelbottom=False)
    axes.xaxis.label.set_visible(False)


def fitting(axes: Axes, words: str) -> str:
    """Words of nine points in lines that are no longer than a panel is wide."""
    return textwrap.fill(words, max(1, int(LETTERS_PER_INCH * axes.bbox.width / axes.figure.dpi)))


def labelled(axes: Axes, *, x: str = "", y: str = "", size: float = 10.0) -> None:
    """Words at the axes, as they are, and a grid; an axis without words keeps what it has."""
    if x:
        axes.set_xlabel(x, fontsize=size, parse_math=False)
    if y:
        axes.set_ylabel(y, fontsize=size, parse_math=False)
    axes.grid(alpha=0.25)


def drawable(things: Sized, what: str, remedy: str) -> None:
    """Refuse to draw nothing.

    Raises
    ------
    UsageError
        When there is none of what is to be drawn.
    """
    if not things:
        raise UsageError(f"{what} to draw", "none", remedy)


def legend(
    axes: Axes,
    *,
    size: int = 8,
    place: Literal["best", "upper right", "upper left", "lower left"] = "best",
    columns: int = 1,
) -> None:
    """Legend with its words as they are."""
    for text in axes.legend(fontsize=size, framealpha=0.85, loc=place, ncols=columns).get_texts():
        text.set_parse_math(False)
