"""Figures of intervals and joint regions: how far each parameter is known, and how two of them trade off."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from eivor.errors import UsageError
from eivor.estimation.estimate import Estimate
from eivor.inference.resampling.replicates import Bootstrap
from eivor.inference.sets.ellipse import Ellipse
from eivor.motions import wording_of
from eivor.report.given_axes import GivenAxes, figure_of, given_axes
from eivor.report.plain_figure import BLUE, DARK, GREY, RED, legend, page, panel
from eivor.report.printable import printable
from eivor.shapes import Float

PANEL_WIDTH, ROW_HEIGHT = 3.6, 0.34
COLOURS = (BLUE, DARK, "#a06a00", "#1b7f3b", "#7b3f9e")
#: Share of a panel's width that is left free at both ends.
MARGIN = 0.12
#: At most so many points of a cloud are drawn.
CLOUD = 4000


@dataclass(frozen=True, slots=True)
class ShownInterval:
    """One row of a panel.

    Parameters
    ----------
    label : str
        Estimate, method or kind of interval.
    value : float
        Point; NaN for none.
    pieces : tuple of (float, float)
        The interval, or the pieces of a set; ends may be infinite, and there may be none.
    """

    label: str
    value: float
    pieces: tuple[tuple[float, float], ...]


def interval_figure(
    panels: Mapping[str, Sequence[ShownInterval]],
    *,
    units: Mapping[str, str] | None = None,
    truth: Mapping[str, float] | None = None,
    title: str = "",
    axes: GivenAxes | None = None,
) -> Figure:
    """Points and intervals, a panel with an axis of its own for each parameter.

    Parameters
    ----------
    panels : mapping of str to sequence of ShownInterval
        For each parameter its rows, from the top; rows of one label share a colour.
    units : mapping of str to str, optional
        Unit of each parameter.
    truth : mapping of str to float, optional
        Values to mark by a line.
    title : str
        Of the figure, or of the first panel that is given.
    axes : mapping of str to Axes, or sequence of Axes, optional
        Where to draw: some parameters by name, or all in order. Default: a figure of its own.

    Returns
    -------
    matplotlib.figure.Figure
        With a canvas of its own, or that of `axes`. An end without bound is an arrow; an empty set says so.

    Raises
    ------
    UsageError
        When there is nothing to draw, or `axes` do not fit the panels.
    """
    most = max((len(rows) for rows in panels.values()), default=0)
    if not most:
        raise UsageError("intervals to draw", "none", "Give estimates.")
    labels = list(dict.fromkeys(row.label for rows in panels.values() for row in rows))
    names = tuple(panels)
    drawn = _row(names, most, title) if axes is None else given_axes(axes, names, title)
    for place, (name, axis) in enumerate(drawn.items()):
        _panel(axis, panels[name], labels, (truth or {}).get(name))
        if axes is None and place:
            axis.tick_params(labelleft=False)
        axis.set_xlabel(axis_words(name, (units or {}).get(name, "")), fontsize=9, parse_math=False)
    return figure_of(*drawn.values())


def _row(names: tuple[str, ...], most: int, title: str) -> dict[str, Axes]:
    """Panels of a page, side by side, for so many intervals in each."""
    figure = page(PANEL_WIDTH * len(names) + 1.2, ROW_HEIGHT * (most + 1) + 1.3, title)
    return {name: figure.add_subplot(1, len(names), place) for place, name in enumerate(names, start=1)}


def estimates_figure(
    estimates: Mapping[str, Estimate | Bootstrap],
    *,
    level: float = 0.95,
    truth: Mapping[str, float] | None = None,
    title: str = "",
    axes: GivenAxes | None = None,
) -> Figure:
    """Parameters of one or several estimates side by side, with their intervals.

    Parameters
    ----------
    estimates : mapping of str to Estimate or Bootstrap
        By what they are to be called.
    level : float
        Confidence level.
    truth : mapping of str to float, optional
        Values to mark by a line.
    title : str
        Of the figure, or of the first panel that is given; default: the level, on a figure of its own.
    axes : mapping of str to Axes, or sequence of Axes, optional
        Where to draw: some parameters by name, or all in order. Default: a figure of its own.

    Returns
    -------
    matplotlib.figure.Figure
        A panel for each parameter, in its unit.

    Raises
    ------
    UsageError
        When there is nothing to draw, `axes` do not fit the panels, or the level is not between 0 and 1.
    """
    panels: dict[str, list[ShownInterval]] = {}
    units: dict[str, str] = {}
    for label, found in estimates.items():
        values = found.values if isinstance(found, Bootstrap) else found.best.values
        for name, unit, value in zip(found.names, found.units, values, strict=True):
            row = ShownInterval(label, float(value), (found.interval(name, level),))
            panels.setdefault(name, []).append(row)
            units.setdefault(name, unit)
    if axes is None:
        title = title or f"estimates and their {100 * level:g} % intervals"
    return interval_figure(panels, units=units, truth=truth, title=title, axes=axes)


def ellipse_figure(
    ellipses: Mapping[str, Ellipse],
    *,
    names: tuple[str, str],
    units: tuple[str, str] = ("", ""),
    intervals: tuple[tuple[float, float], tuple[float, float]] | None = None,
    truth: tuple[float, float] | None = None,
    cloud: Float[np.ndarray, "k 2"] | None = None,
    regions: Mapping[str, Sequence[Float[np.ndarray, "corners 2"]]] | None = None,
    title: str = "",
    ax: Axes | None = None,
) -> Figure:
    """Joint confidence ellipses of a pair, and what else is known of it.

    Parameters
    ----------
    ellipses : mapping of str to Ellipse
        By what they are to be called; drawn with their centres.
    names, units : tuple of str
        Of the two, abscissa first.
    intervals : pair of (float, float), optional
        Each parameter's own interval: the rectangle they span is dashed.
    truth : tuple of float, optional
        A point to mark.
    cloud : ndarray, shape (k, 2), optional
        Replicates.
    regions : mapping of str to sequence of ndarray, shape (corners, 2), optional
        Other regions by the polygons of their outlines.
    title : str
        Of the figure, or of the panel that is given.
    ax : matplotlib.axes.Axes, optional
        Where to draw; default: a figure of its own.

    Returns
    -------
    matplotlib.figure.Figure
        With a canvas of its own, or that of `ax`.

    Raises
    ------
    UsageError
        When there is nothing to draw, or `ax` are no Axes.
    """
    if not ellipses and not regions:
        raise UsageError("an ellipse or a region to draw", "none", "Give one by its name.")
    axes = panel(ax, 6.4, 5.2, title)
    if cloud is not None:
        dots = cloud[:: max(1, -(-len(cloud) // CLOUD))]
        axes.plot(*dots.T, ".", color=GREY, ms=2.5, alpha=0.45, label=f"{len(cloud)} replicates", zorder=1)
    for place, (label, ellipse) in enumerate(ellipses.items()):
        colour = COLOURS[place % len(COLOURS)]
        axes.fill(*ellipse.outline().T, color=colour, alpha=0.12, lw=0)
        axes.plot(*ellipse.outline().T, color=colour, lw=1.6, label=label)
        axes.plot(*ellipse.centre, "+", color=colour, ms=9, mew=1.6)
    for place, (label, polygons) in enumerate((regions or {}).items(), start=len(ellipses)):
        colour = COLOURS[place % len(COLOURS)]
        for number, corners in enumerate(polygons):
            axes.plot(*corners.T, color=colour, lw=1.3, ls="-.", label="_" if number else label)
    if intervals is not None:
        (left, right), (low, high) = intervals
        box = np.array([[left, low], [right, low], [right, high], [left, high], [left, low]])
        axes.plot(*box.T, color=DARK, lw=0.9, ls="--", label="intervals one by one")
    if truth is not None:
        axes.plot(*truth, "x", color=RED, ms=8, mew=2.0, label="truth", zorder=5)
    axes.set_xlabel(axis_words(names[0], units[0]), parse_math=False)
    axes.set_ylabel(axis_words(names[1], units[1]), parse_math=False)
    axes.margins(0.08)
    axes.grid(alpha=0.25)
    legend(axes)
    return figure_of(axes)


def pair_figure(
    estimate: Estimate,
    name: str,
    other: str,
    *,
    level: float = 0.95,
    truth: Mapping[str, float] | None = None,
    replicates: Bootstrap | None = None,
    title: str = "",
    ax: Axes | None = None,
) -> Figure:
    """Joint ellipse of two parameters of an estimate, with their intervals.

    Parameters
    ----------
    estimate : Estimate
        With its rows at hand.
    name, other : str
        The parameters, abscissa first.
    level : float
        Confidence level.
    truth : mapping of str to float, optional
        Values of parameters.
    replicates : Bootstrap, optional
        Drawn as a cloud.
    title : str
        Of the figure, or of the panel that is given.
    ax : matplotlib.axes.Axes, optional
        Where to draw; default: a figure of its own.

    Returns
    -------
    matplotlib.figure.Figure
        See `ellipse_figure`.

    Raises
    ------
    UsageError
        When a parameter is unknown, the level is not between 0 and 1, or `ax` are no Axes.
    """
    unit = dict(zip(estimate.names, estimate.units, strict=True))
    ellipse = estimate.ellipse(name, other, level)
    cloud = None
    if replicates is not None:
        cloud = replicates.replicates[:, [replicates.names.index(one) for one in (name, other)]]
    return ellipse_figure(
        {f"joint {100 * level:g} % ellipse": ellipse},
        names=(name, other),
        units=(unit[name], unit[other]),
        intervals=(estimate.interval(name, level), estimate.interval(other, level)),
        truth=None if truth is None else (truth[name], truth[other]),
        cloud=cloud,
        title=title,
        ax=ax,
    )


def axis_words(name: str, unit: str) -> str:
    """Parameter in words with its symbol and unit; "[-]" when it has none."""
    known = wording_of(name)
    words = f"{known.words} {known.symbol}" if known else printable(name)
    return f"{words} [{printable(unit).replace('^2', '²') or '-'}]"


def _panel(axes: Axes, rows: Sequence[ShownInterval], labels: Sequence[str], truth: float | None) -> None:
    low, high = _limits(rows, truth)
    axes.set_xlim(low, high)
    for place, row in enumerate(rows):
        colour = COLOURS[labels.index(row.label) % len(COLOURS)]
        for left, right in row.pieces:
            axes.plot([max(left, low), min(right, high)], [place, place], color=colour, lw=2.2)
            inside = 0.02 * (high - low)
            for end, arrow, mark in ((left, low + inside, "<"), (right, high - inside, ">")):
                unbounded = math.isinf(end)
                at = arrow if unbounded else end
                axes.plot(at, place, mark if unbounded else "|", color=colour, ms=8, mew=1.8)
        if not row.pieces:
            axes.text(0.5 * (low + high), place, "empty set", ha="center", va="center", fontsize=8)
        if math.isfinite(row.value):
            axes.plot(row.value, place, "o", color=colour, ms=5)
    if truth is not None:
        axes.axvline(truth, color=RED, lw=1.2, ls="--", label="truth")
        legend(axes, size=7)
    axes.set_yticks(range(len(rows)), [printable(row.label) for row in rows], fontsize=9)
    for text in axes.get_yticklabels():
        text.set_parse_math(False)
    axes.set_ylim(len(rows) - 0.4, -0.6 - 0.5 * (truth is not None))
    axes.tick_params(axis="x", labelsize=8)
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.grid(alpha=0.25)


def _limits(rows: Sequence[ShownInterval], truth: float | None) -> tuple[float, float]:
    """Range of all finite numbers, with a margin; never empty."""
    numbers = [end for row in rows for piece in row.pieces for end in piece] + [row.value for row in rows]
    finite = [x for x in [*numbers, *([] if truth is None else [truth])] if math.isfinite(x)] or [0.0]
    low, high = min(finite), max(finite)
    margin = MARGIN * (high - low) if high > low else 0.1 * abs(high) or 0.1
    return low - margin, high + margin
