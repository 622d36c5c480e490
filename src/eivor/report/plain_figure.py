"""What figures have in common: a page with a canvas of its own, grids, legends that are never mathematics."""

from __future__ import annotations

from collections.abc import Sized
from typing import Literal

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from eivor.errors import UsageError

DPI = 110
DARK, RED, GREY, BLUE = "#333333", "#d1495b", "#66717e", "#2e86ab"


def page(width: float, height: float, title: str = "") -> Figure:
    """Empty figure of that size [inch]; nothing global is touched."""
    figure = Figure(figsize=(width, height), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    if title:
        figure.suptitle(title, fontsize=11, parse_math=False)
    return figure


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


def legend(axes: Axes, *, size: int = 8, place: Literal["best", "upper right"] = "best") -> None:
    """Legend with its words as they are."""
    for text in axes.legend(fontsize=size, framealpha=0.85, loc=place).get_texts():
        text.set_parse_math(False)
