"""What figures have in common: a page with a canvas of its own, grids, legends that are never mathematics."""

from __future__ import annotations

from typing import Literal

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

DPI = 110
DARK, RED, GREY, BLUE = "#333333", "#d1495b", "#66717e", "#2e86ab"


def page(width: float, height: float, title: str = "") -> Figure:
    """Empty figure of that size [inch]; nothing global is touched."""
    figure = Figure(figsize=(width, height), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    if title:
        figure.suptitle(title, fontsize=11, parse_math=False)
    return figure


def legend(axes: Axes, *, size: int = 8, place: Literal["best", "upper right"] = "best") -> None:
    """Legend with its words as they are."""
    for text in axes.legend(fontsize=size, framealpha=0.85, loc=place).get_texts():
        text.set_parse_math(False)
