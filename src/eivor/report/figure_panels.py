"""Panels of Matplotlib figures."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence, Sized
from dataclasses import dataclass, replace
from functools import partial
from io import BytesIO
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from eivor.errors import MissingReaderError, UsageError
from eivor.estimation.bootstrap import Bootstrap
from eivor.estimation.estimate import Estimate
from eivor.inference.regions import Ellipse
from eivor.inference.verdict import Status
from eivor.motions.table import wording_of
from eivor.report.document import TableOf, shortened
from eivor.tools import Float, printable

if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure

#: Matplotlib's, which is loaded where something is drawn.
Axes: TypeAlias = "matplotlib.axes.Axes"
Figure: TypeAlias = "matplotlib.figure.Figure"
#: What draws each panel of a figure into its Axes, by the panel's name.
Panels: TypeAlias = "dict[str, Callable[[Axes], None]]"
DPI = 110
#: Of nine points.
LETTERS_PER_INCH = 14.0
DARK, RED, GREY, BLUE = "#333333", "#d1495b", "#66717e", "#2e86ab"
STATUS_COLOURS = {
    Status.IDENTIFIED: "#1b7f3b",
    Status.WEAK: "#a06a00",
    Status.PROVISIONAL: GREY,
    Status.REFUSED: GREY,
}


def page(width: float, height: float, title: str = "") -> Figure:
    """Empty figure of that size [inch]; nothing global is touched."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        remedy = "Install it: pip install 'eivor[plot]'."
        received = "an installation without it"
        raise MissingReaderError("Matplotlib, which draws figures", received, remedy) from error
    figure = Figure(figsize=(width, height), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    vars(figure)["_repr_png_"] = partial(_png, figure)  # notebooks show what pyplot does not know
    if title:
        figure.suptitle(title, fontsize=11, parse_math=False)
    return figure


def _png(figure: Figure) -> bytes:
    buffer = BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def drawn(panels: Panels, placed: Mapping[str, Axes]) -> Figure:
    """Figure of panels in their Axes."""
    for name, ax in placed.items():
        panels[name](ax)
    return next(iter(placed.values())).figure.figure


def mosaic(figure: Figure, rows: Sequence[Sequence[str]], **ratios: Any) -> dict[str, Axes]:
    """Axes of a figure by name; a name that is repeated takes all of its places."""
    return dict(figure.subplot_mosaic([list(row) for row in rows], **ratios))


def column_page(
    names: Sequence[str],
    size: tuple[float, float],
    title: str = "",
    *,
    heights: Sequence[float] | None = None,
    shared: int = 0,
) -> dict[str, Axes]:
    """Axes of a page, one below the other; so many in a row share their abscissa, all for zero."""
    panels = mosaic(page(*size, title), [[name] for name in names], height_ratios=heights)
    count = shared or len(names)
    for index, name in enumerate(names):
        first = names[index - index % count]
        if name != first:
            panels[name].sharex(panels[first])
        if (index + 1) % count and index + 1 < len(names):
            without_abscissa(panels[name])
    return panels


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


def headed(axes: Axes, words: str) -> None:
    """Words above a panel, in as many lines as they take."""
    axes.set_title(fitting(axes, words), fontsize=9, parse_math=False)


def drawable(items: Sized, noun: str, remedy: str) -> None:
    """Refuse to draw nothing."""
    if not items:
        raise UsageError(f"{noun} to draw", "none", remedy)


def legend(
    axes: Axes,
    *,
    size: int = 8,
    location: Literal["best", "upper right", "upper left", "lower left"] = "best",
    columns: int = 1,
) -> None:
    """Legend with its words as they are."""
    for text in axes.legend(fontsize=size, framealpha=0.85, loc=location, ncols=columns).get_texts():
        text.set_parse_math(False)


#: Height of a drawing on a page, and what a row of a forest and its axis add to it [inch].
HEIGHT_INCHES, FOREST_ROW_INCHES, FOREST_FOOT_INCHES = 2.7, 0.4, 0.55


@dataclass(frozen=True)
class Line:
    """One series over time."""

    label: str
    look: str
    values: Float[np.ndarray, " n"]  # Not a number where there is none


@dataclass(frozen=True)
class Chart:
    """Series over one time, to zoom into; between two of the look "edge" is a band."""

    group: str
    unit: str
    time_s: Float[np.ndarray, " n"]
    lines: tuple[Line, ...]  # With values at these times
    over_s: tuple[float, float]
    view_s: tuple[float, float]
    omitted_s: tuple[tuple[float, float], ...]
    over_frequency: bool = False  # Times are decadic logarithms of even steps of frequencies [Hz]


@dataclass(frozen=True, slots=True)
class Picture:
    """A plot with its title, its words and its numbers: a panel of a figure, or a picture of a page."""

    title: str
    words: str
    drawn: Chart | Callable[[Axes], None]  # A chart is on pages only
    table: TableOf | None = None
    height: float = HEIGHT_INCHES

    def on(self, axes: Axes) -> None:
        if not isinstance(self.drawn, Chart):
            self.drawn(axes)
        axes.set_title(self.title, fontsize=9, parse_math=False)


#: Pictures that belong together, with their heading, which may be empty: those over time share their axis.
Pictures: TypeAlias = tuple[str, Iterable[Picture]]


#: At most so much of a flight is drawn over time [s].
FIT_SHOWN_S = 40.0
SIZE_INCHES = (11.0, 8.5)


def liveliest(values: Float[np.ndarray, " length"], count: int) -> slice:
    """So many samples in which `values` vary most; all where there are fewer."""
    return of_most_power((values - values.mean()) ** 2, count)


def of_most_power(power: Float[np.ndarray, " length"], count: int) -> slice:
    """So many samples whose power is the largest in sum; all where there are fewer."""
    if power.size <= count:
        return slice(0, power.size)
    sums = np.concatenate([[0.0], np.cumsum(power)])
    first = int(np.argmax(sums[count:] - sums[:-count]))
    return slice(first, first + count)


def banded(
    frequency: Float[np.ndarray, " bins"], amplitude: Float[np.ndarray, " bins"], per_decade: int
) -> tuple[Float[np.ndarray, " bands"], Float[np.ndarray, " bands"]]:
    """Geometric mean frequency and root mean square amplitude of bands of equal ratio."""
    band = np.floor(per_decade * np.log10(frequency / frequency[0])).astype(np.int64)
    _, position = np.unique(band, return_inverse=True)
    count = np.bincount(position)
    centre = np.exp(np.bincount(position, np.log(frequency)) / count)
    return centre, np.sqrt(np.bincount(position, amplitude**2) / count)


PANEL_WIDTH = 3.6
#: Share of a panel's width that is left free at both ends.
MARGIN = 0.12
#: At most so many points of a cloud are drawn.
CLOUD = 4000


@dataclass(frozen=True, slots=True)
class PlottedInterval:
    """One row of a panel, or of a forest."""

    label: str  # Estimate, flight or kind of interval
    value: float  # Point; NaN for none
    pieces: tuple[tuple[float, float], ...]  # The interval, or those of a set: none, or without ends
    numbers: str = ""  # Value and interval as tables show them, in a forest
    status: Status | None = None
    whole: bool = False  # Of a pool or type, in a forest


def estimates_figure(
    estimates: Mapping[str, Estimate | Bootstrap],
    *,
    truth: Mapping[str, float] | None = None,
    title: str = "",
) -> Figure:
    """Parameters of estimates with their 95 % intervals, each in a panel with an axis of its own.

    Parameters
    ----------
    estimates : mapping of str to Estimate or Bootstrap
        By what they are to be called.
    truth : mapping of str to float, optional
        Values to mark by a line.
    """
    drawable(estimates, "intervals", "Give estimates.")
    rows: dict[str, list[PlottedInterval]] = {}
    units: dict[str, str] = {}
    for label, estimate in estimates.items():
        for name, unit, value in zip(estimate.names, estimate.units, estimate.values, strict=True):
            row = PlottedInterval(label, float(value), (estimate.interval(name),))
            rows.setdefault(name, []).append(row)
            units.setdefault(name, unit)
    marked = truth or {}
    panels: Panels = {
        name: partial(draw_forest, rows=of_name, words=axis_words(name, units[name]), truth=marked.get(name))
        for name, of_name in rows.items()
    }
    size = PANEL_WIDTH * len(panels) + 0.4, FOREST_ROW_INCHES * (len(estimates) + 1) + 1.3
    figure = page(*size, title or "estimates and their 95 % intervals")
    return drawn(panels, mosaic(figure, [list(panels)]))


def pair_figure(
    estimate: Estimate,
    name: str,
    other: str,
    *,
    truth: Mapping[str, float] | None = None,
    replicates: Bootstrap | None = None,
    title: str = "",
) -> Figure:
    """Joint 95 % ellipse of two parameters of an estimate, with their intervals.

    Parameters
    ----------
    estimate : Estimate
        With its rows available.
    name, other : str
        The parameters, abscissa first.
    truth : mapping of str to float, optional
        Values of parameters.
    replicates : Bootstrap, optional
        Drawn as a cloud.
    """
    figure = page(6.4, 5.2, title)
    axes = figure.add_subplot()
    if replicates is not None:
        cloud = replicates.replicates[:, [replicates.names.index(item) for item in (name, other)]]
        dots = cloud[:: max(1, -(-len(cloud) // CLOUD))]
        axes.plot(*dots.T, ".", color=GREY, ms=2.5, alpha=0.45, label=f"{len(cloud)} replicates", zorder=1)
    draw_ellipse(axes, estimate.ellipse(name, other), (estimate.interval(name), estimate.interval(other)))
    if truth is not None:
        axes.plot(truth[name], truth[other], "x", color=RED, ms=8, mew=2.0, label="truth", zorder=5)
    units = dict(zip(estimate.names, estimate.units, strict=True))
    labelled(axes, x=axis_words(name, units[name]), y=axis_words(other, units[other]))
    legend(axes)
    return figure


def draw_ellipse(axes: Axes, ellipse: Ellipse, intervals: Sequence[tuple[float, float]]) -> None:
    """Draw an ellipse with its centre, and dashed the rectangle that each parameter's own interval spans."""
    axes.fill(*ellipse.outline().T, color=BLUE, alpha=0.12, lw=0)
    axes.plot(*ellipse.outline().T, color=BLUE, lw=1.6, label="joint 95 % ellipse")
    axes.plot(*ellipse.centre, "+", color=BLUE, ms=9, mew=1.6)
    if intervals:
        (left, right), (low, high) = intervals
        box = np.array([[left, low], [right, low], [right, high], [left, high], [left, low]])
        axes.plot(*box.T, color=DARK, lw=0.9, ls="--", label="intervals one by one")
    axes.margins(0.08)


def axis_words(name: str, unit: str) -> str:
    """Parameter in words with its symbol and unit; "[-]" when it has none."""
    wording = wording_of(name)
    words = f"{wording.words} {wording.own_symbol}".rstrip() if wording else printable(name)
    return f"{words} [{printable(unit).replace('^2', '²') or '-'}]"


def _draw_interval(
    axes: Axes,
    row: PlottedInterval,
    height: float,
    limits: tuple[float, float],
    colour: str,
    mark: str = "o",
    *,
    filled: bool = True,
) -> None:
    low, high = limits
    margin = 0.02 * (high - low)
    for left, right in row.pieces:
        axes.plot(np.clip([left, right], low, high), [height, height], color=colour, lw=2.2)
        for end, mark_at_end in (
            (low + margin, "<") if left < low else (left, "|"),
            (high - margin, ">") if right > high else (right, "|"),
        ):
            axes.plot(end, height, mark_at_end, color=colour, ms=8, mew=1.8)
    if low <= row.value <= high:
        axes.plot(row.value, height, mark, color=colour, ms=5, mfc=colour if filled else "white")


#: Marks of verdicts in a forest: colour is never alone.
FOREST_MARKS = {Status.PROVISIONAL: "s", Status.REFUSED: "x"}
#: Half-widths over so many times the middle one are not what the axis of a forest is made for: they are cut.
WIDEST = 6.0


def draw_forest(axes: Axes, rows: Sequence[PlottedInterval], words: str, truth: float | None = None) -> None:
    """Draw intervals below each other, with labels and numbers above them, and maybe a line at the truth."""
    from matplotlib.ticker import MaxNLocator

    pieces = [(row, piece, piece[1] - piece[0]) for row in rows for piece in row.pieces]
    widths = [width for _, _, width in pieces if math.isfinite(width)]
    widest = WIDEST * float(np.median(widths)) if widths else 0.0
    narrow = [replace(row, pieces=(piece,)) for row, piece, width in pieces if width <= widest]
    ends = [end for row in narrow for piece in row.pieces for end in piece]
    numbers = [*ends, *(row.value for row in narrow), math.nan if truth is None else truth]
    finite = list(filter(math.isfinite, numbers)) or [0.0]
    low, high = min(finite), max(finite)
    margin = MARGIN * (high - low) if high > low else 0.1 * abs(high) or 0.1
    limits = low - margin, high + margin
    inches = axes.figure.bbox.width / axes.figure.dpi / axes.get_gridspec().ncols  # type: ignore[union-attr]
    letters = int(LETTERS_PER_INCH * 9.0 / 8.0 * inches)
    across = axes.get_yaxis_transform()
    for index, row in enumerate(rows):
        colour = DARK if row.status is None or row.whole else STATUS_COLOURS[row.status]
        mark = "D" if row.whole else FOREST_MARKS.get(row.status or Status.IDENTIFIED, "o")
        _draw_interval(axes, row, index, limits, colour, mark, filled=row.status is not Status.WEAK)
        label, room = printable(row.label), max(letters - len(row.numbers) - 2, 2)
        for position, text, side in ((0.0, shortened(label, room), "left"), (1.0, row.numbers, "right")):
            axes.text(position, index - 0.32, text, ha=side, fontsize=8, transform=across, parse_math=False)
    if truth is not None:
        axes.axvline(truth, color=RED, lw=1.2, ls="--", label="truth")
        legend(axes, size=7)
    axes.set_xlim(*limits)
    axes.set_ylim(len(rows) - 0.6, -0.85)
    axes.set_yticks([])
    for side in ("left", "right", "top"):
        axes.spines[side].set_visible(False)
    axes.tick_params(axis="x", labelsize=8)
    axes.xaxis.set_major_locator(MaxNLocator(5))
    labelled(axes, x=words, size=9.0)


def forest_picture(
    title: str, axis: str, rows: Iterable[PlottedInterval], words: str = "", table: TableOf | None = None
) -> Picture:
    """Intervals below each other, with their numbers."""
    intervals = tuple(rows)
    height = FOREST_ROW_INCHES * len(intervals) + FOREST_FOOT_INCHES
    return Picture(title, words, partial(draw_forest, rows=intervals, words=axis), table, height)
