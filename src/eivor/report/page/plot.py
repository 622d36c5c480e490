"""Drawings of a page: curves, dots, stems, bands and rules between two axes, as SVG.

How marks look stands in the page's style, by their words; light or dark, on a screen or on paper. Every look
has a dash or a shape of its own, so that none is told by its colour alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eivor.report.page.markup import Markup, element, joined
from eivor.report.page.scale import Scale
from eivor.shapes import Float

#: Size of a drawing, and of what is left for words around it; it is shown at most at this width.
WIDTH, HEIGHT = 440.0, 300.0
TOP, RIGHT, BOTTOM = 30.0, 14.0, 46.0
#: Width of a letter, and height above the line of what is written at an axis.
LETTER, RISE = 7.4, 4.5
MOST_TICKS = 6


@dataclass(frozen=True)
class Points:
    """Places in a drawing.

    Parameters
    ----------
    label, look : str
        What they are, empty for what the legend leaves out, and how they look.
    x, y : ndarray, shape (n,)
        Where.
    """

    label: str
    look: str
    x: Float[np.ndarray, " n"]
    y: Float[np.ndarray, " n"]


class Curve(Points):
    """A line through points."""


class Dots(Points):
    """Points."""


class Stems(Points):
    """Points with lines to zero."""


@dataclass(frozen=True)
class Band:
    """A range of one axis, over all of the other.

    Parameters
    ----------
    label, look : str
        See `Points`.
    low, high : float
        Its ends.
    upright : bool
        Whether it is a range of the abscissa.
    """

    label: str
    look: str
    low: float
    high: float
    upright: bool


@dataclass(frozen=True)
class Rule:
    """One value of an axis, over all of the other.

    Parameters
    ----------
    label, look : str
        See `Points`.
    at : float
        The value.
    upright : bool
        Whether it is one of the abscissa.
    """

    label: str
    look: str
    at: float
    upright: bool


Mark = Curve | Dots | Stems | Band | Rule


@dataclass(frozen=True)
class Plot:
    """A drawing.

    Parameters
    ----------
    x, y : Scale
        Its axes.
    marks : tuple of Curve, Dots, Stems, Band or Rule
        From the back to the front.
    """

    x: Scale
    y: Scale
    marks: tuple[Mark, ...]

    def drawn(self, name: str, title: str) -> Markup:
        """SVG, with identifiers that begin with a name of its own."""
        return _Frame(self).svg(name, title)


class _Frame:
    """Where the axes of a plot stand on the paper."""

    def __init__(self, plot: Plot) -> None:
        self.plot = plot
        self.y_ticks = plot.y.ticks(MOST_TICKS)
        longest = max((len(tick.words) for tick in self.y_ticks), default=1)
        self.left = 14.0 + LETTER * longest
        self.right, self.bottom = WIDTH - RIGHT, HEIGHT - BOTTOM

    def across(self, values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        return self.left + (self.right - self.left) * self.plot.x.share(np.asarray(values, dtype=np.float64))

    def up(self, values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        return self.bottom - (self.bottom - TOP) * self.plot.y.share(np.asarray(values, dtype=np.float64))

    def svg(self, name: str, title: str) -> Markup:
        heading = element("title", {"id": f"{name}-title"}, title)
        marks = [self._mark(mark) for mark in self.plot.marks]
        box = {"viewBox": f"0 0 {WIDTH:g} {HEIGHT:g}", "class": "plot", "role": "img"}
        content = (heading, *self._grid(), *marks, *self._words())
        return element("svg", {**box, "aria-labelledby": f"{name}-title"}, *content)

    def _grid(self) -> list[Markup]:
        """Lines at the ticks, and the ticks' words, those left out that would touch."""
        pieces = []
        for tick in self.y_ticks:
            height = float(self.up(np.array([tick.at]))[0])
            pieces.append(_line("grid", self.left, height, self.right, height))
            place = {"x": f"{self.left - 7:.1f}", "y": f"{height + RISE:.1f}", "class": "tick end"}
            pieces.append(element("text", place, tick.words))
        free = 0.0
        for tick in self.plot.x.ticks(MOST_TICKS):
            at = float(self.across(np.array([tick.at]))[0])
            pieces.append(_line("grid", at, TOP, at, self.bottom))
            half = 0.5 * LETTER * len(tick.words)
            if at - half >= free and at + half <= WIDTH:
                place = {"x": f"{at:.1f}", "y": f"{self.bottom + 18:.1f}", "class": "tick middle"}
                pieces.append(element("text", place, tick.words))
                free = at + half + LETTER
        return pieces

    def _words(self) -> list[Markup]:
        middle = 0.5 * (self.left + self.right)
        below = {"x": f"{middle:.1f}", "y": f"{HEIGHT - 8:.1f}", "class": "axis middle"}
        above = {"x": "4", "y": "16", "class": "axis"}
        return [element("text", below, self.plot.x.words), element("text", above, self.plot.y.words)]

    def _mark(self, mark: Mark) -> Markup:
        match mark:
            case Curve():
                return element("path", {"d": self._path(mark.x, mark.y), "class": f"curve {mark.look}"})
            case Dots():
                return joined(self._dots(mark.x, mark.y, mark.look))
            case Stems():
                foot = float(self.up(np.zeros(1))[0])
                at = zip(self.across(mark.x).tolist(), self.up(mark.y).tolist(), strict=True)
                stems = [_line(f"stem {mark.look}", x, foot, x, y) for x, y in at]
                return joined([*stems, *self._dots(mark.x, mark.y, mark.look)])
            case Band():
                return self._band(mark)
            case Rule():
                return self._rule(mark)

    def _path(self, x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]) -> str:
        there = np.isfinite(x) & np.isfinite(y)
        pieces, begun = [], False
        for across, up, known in zip(
            self.across(x).tolist(), self.up(y).tolist(), there.tolist(), strict=True
        ):
            if known:
                pieces.append(f"{'L' if begun else 'M'}{across:.1f} {up:.1f}")
            begun = known
        return "".join(pieces)

    def _dots(self, x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"], look: str) -> list[Markup]:
        at = zip(self.across(x).tolist(), self.up(y).tolist(), strict=True)
        return [
            element("circle", {"cx": f"{across:.1f}", "cy": f"{up:.1f}", "r": "3", "class": f"dot {look}"})
            for across, up in at
            if np.isfinite(across) and np.isfinite(up)
        ]

    def _band(self, band: Band) -> Markup:
        ends = np.array([band.low, band.high])
        if band.upright:
            first, last = self.across(ends).tolist()
            box = (first, TOP, last - first, self.bottom - TOP)
        else:
            low, high = self.up(ends).tolist()
            box = (self.left, high, self.right - self.left, low - high)
        keys = ("x", "y", "width", "height")
        sides = {key: f"{value:.1f}" for key, value in zip(keys, box, strict=True)}
        return element("rect", {**sides, "class": f"band {band.look}"})

    def _rule(self, rule: Rule) -> Markup:
        at = np.array([rule.at])
        if rule.upright:
            x = float(self.across(at)[0])
            return _line(f"rule {rule.look}", x, TOP, x, self.bottom)
        y = float(self.up(at)[0])
        return _line(f"rule {rule.look}", self.left, y, self.right, y)


def _line(look: str, *ends: float) -> Markup:
    keys = ("x1", "y1", "x2", "y2")
    places = {key: f"{value:.1f}" for key, value in zip(keys, ends, strict=True)}
    return element("line", {**places, "class": look})
