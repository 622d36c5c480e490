"""Forest of intervals: a row for each flight, method or kind of interval, over one axis.

The words of a row stand above its interval, and its numbers beside them, so that rows stay legible on a
telephone and under long names.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from eivor.inference.verdict import Status
from eivor.report.page.markup import Markup, element
from eivor.report.page.plot import LETTER, WIDTH
from eivor.report.page.scale import Linear, margined

ROW, FOOT, SIDE = 44.0, 44.0, 14.0
#: Letters of eleven pixels.
SMALL_LETTER = 7.4
#: Half-widths over so many times the middle one are not what the scale is made for: they are cut.
WIDEST = 6.0


@dataclass(frozen=True)
class ForestRow:
    """One row.

    Parameters
    ----------
    label : str
        What it is.
    numbers : str
        Value and interval as tables show them.
    value : float
        The point; not a number for none.
    pieces : tuple of (float, float)
        The interval, or the pieces of a set; ends may be infinite.
    status : Status or None
        Its verdict.
    whole : bool
        Whether it is what the other rows are part of, such as a pool.
    """

    label: str
    numbers: str
    value: float
    pieces: tuple[tuple[float, float], ...]
    status: Status | None = None
    whole: bool = False


@dataclass(frozen=True)
class Forest:
    """Rows over one axis.

    Parameters
    ----------
    words : str
        What the axis shows, with its unit.
    rows : tuple of ForestRow
        From the top.
    """

    words: str
    rows: tuple[ForestRow, ...]

    def drawn(self, name: str, title: str) -> Markup:
        """SVG, with identifiers that begin with a name of its own."""
        height = ROW * len(self.rows) + FOOT
        scale = self._scale()
        box = {"viewBox": f"0 0 {WIDTH:g} {height:g}", "class": "plot forest", "role": "img"}
        content = [element("title", {"id": f"{name}-title"}, title)]
        content += _axis(scale, ROW * len(self.rows) + 4.0)
        for place, row in enumerate(self.rows):
            content += _row(row, scale, ROW * place)
        return element("svg", {**box, "aria-labelledby": f"{name}-title"}, *content)

    def _scale(self) -> Linear:
        """Scale over what is estimated well; the rest is cut, and its cut ends are arrows."""
        halves = [
            0.5 * (high - low) for row in self.rows for low, high in row.pieces if math.isfinite(high - low)
        ]
        middle = float(np.median(halves)) if halves else 0.0
        ends = [
            end
            for row in self.rows
            for piece in row.pieces
            if 0.5 * (piece[1] - piece[0]) <= WIDEST * middle
            for end in (*piece, row.value)
        ]
        return margined(self.words, np.array(ends or [0.0]))


def _across(scale: Linear, value: float) -> float:
    return SIDE + (WIDTH - 2.0 * SIDE) * float(scale.share(np.array([value]))[0])


def _axis(scale: Linear, top: float) -> list[Markup]:
    pieces, free = [], 0.0
    for tick in scale.ticks(5):
        at = f"{_across(scale, tick.at):.1f}"
        pieces.append(element("line", {"x1": at, "y1": "0", "x2": at, "y2": f"{top:.1f}", "class": "grid"}))
        half = 0.5 * LETTER * len(tick.words)
        if float(at) - half >= free and float(at) + half <= WIDTH:
            pieces.append(
                element("text", {"x": at, "y": f"{top + 16:.1f}", "class": "tick middle"}, tick.words)
            )
            free = float(at) + half + LETTER
    middle = {"x": f"{WIDTH / 2:.1f}", "y": f"{top + 35:.1f}", "class": "axis middle"}
    return [*pieces, element("text", middle, scale.words)]


def _row(row: ForestRow, scale: Linear, top: float) -> list[Markup]:
    room = int((WIDTH - 2.0 * SIDE - SMALL_LETTER * (len(row.numbers) + 2)) / SMALL_LETTER)
    label = row.label if len(row.label) <= room else f"{row.label[: max(room - 1, 1)]}…"
    look = "whole" if row.whole else row.status.value if row.status is not None else "plain"
    words = {"x": f"{SIDE:g}", "y": f"{top + 15:.1f}", "class": "row"}
    numbers = {"x": f"{WIDTH - SIDE:g}", "y": f"{top + 15:.1f}", "class": "row end numbers"}
    height = top + 30.0
    pieces = [element("text", words, label), element("text", numbers, row.numbers)]
    for low, high in row.pieces:
        pieces += _whisker(scale, (low, high), height, look)
    if math.isfinite(row.value) and scale.low <= row.value <= scale.high:
        pieces.append(_point(_across(scale, row.value), height, look))
    return pieces


def _whisker(scale: Linear, ends: tuple[float, float], y: float, look: str) -> list[Markup]:
    """Interval with caps at its ends, and arrows where it goes on beyond the scale."""
    low, high = ends
    left, right = _across(scale, low), _across(scale, high)
    places = {"x1": f"{left:.1f}", "y1": f"{y:.1f}", "x2": f"{right:.1f}", "y2": f"{y:.1f}"}
    pieces = [element("line", {**places, "class": f"whisker {look}"})]
    for at, beyond, turn in ((left, low < scale.low, -1.0), (right, high > scale.high, 1.0)):
        path = f"M{at - 6 * turn:.1f} {y - 5:.1f}L{at:.1f} {y:.1f}L{at - 6 * turn:.1f} {y + 5:.1f}"
        path = path if beyond else f"M{at:.1f} {y - 5:.1f}L{at:.1f} {y + 5:.1f}"
        pieces.append(element("path", {"d": path, "class": f"whisker {look}"}))
    return pieces


def _point(x: float, y: float, look: str) -> Markup:
    """A shape for each verdict, so that colour is not alone, and a diamond for a whole."""
    shapes = {
        "whole": f"M{x - 7:.1f} {y:.1f}L{x:.1f} {y - 6:.1f}L{x + 7:.1f} {y:.1f}L{x:.1f} {y + 6:.1f}Z",
        "provisional": f"M{x - 4:.1f} {y - 4:.1f}h8v8h-8Z",
        "refused": f"M{x - 4:.1f} {y - 4:.1f}l8 8M{x + 4:.1f} {y - 4:.1f}l-8 8",
    }
    if look in shapes:
        return element("path", {"d": shapes[look], "class": f"point {look}"})
    return element("circle", {"cx": f"{x:.1f}", "cy": f"{y:.1f}", "r": "4.5", "class": f"point {look}"})
