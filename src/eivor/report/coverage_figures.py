"""Figure of coverage: how often intervals held the truth, with what chance leaves open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eivor.errors import UsageError
from eivor.motions import wording_of
from eivor.report.given_axes import figure_of
from eivor.report.plain_figure import BLUE, DARK, GREY, RED, legend, panel
from eivor.report.printable import printable
from eivor.studies.metrics import scores
from eivor.studies.run import StudyResult
from eivor.studies.share import Share

COLOURS = (BLUE, RED, DARK, "#a06a00", "#1b7f3b", "#7b3f9e", GREY)
MARKERS = ("o", "s", "D", "^", "v", "P", "X")
WIDTH, ROW_HEIGHT, LEAST_ROW = 7.6, 0.13, 0.3


@dataclass(frozen=True, slots=True)
class CoverageRow:
    """One share.

    Parameters
    ----------
    label : str
        What intervals were made of: the method or the covariance. Has a colour.
    group : str
        What they were made for: scenario, length, parameter. Has a line.
    hits, count : int
        Intervals that held the truth, and all.
    """

    label: str
    group: str
    hits: int
    count: int


def coverage_figure(
    rows: Sequence[CoverageRow],
    *,
    nominal: float = 0.95,
    band: tuple[float, float] | None = None,
    title: str = "",
    ax: Axes | None = None,
) -> Figure:
    """Shares of intervals that held the truth, as dots with 95 % Wilson intervals.

    Parameters
    ----------
    rows : sequence of CoverageRow
        Groups are drawn from the top and labels beside each other, in the order of their first rows.
    nominal : float
        Level that was asked for: a line.
    band : (float, float), optional
        Shares that are good enough: a band.
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
    drawn = [row for row in rows if row.count]
    if not drawn:
        raise UsageError("intervals that were counted", "none", "Run a study with intervals.")
    groups = list(dict.fromkeys(row.group for row in drawn))
    labels = list(dict.fromkeys(row.label for row in drawn))
    line = max(ROW_HEIGHT * len(labels), LEAST_ROW)
    axes = panel(ax, WIDTH, line * len(groups) + 1.5 + 0.2 * -(-len(labels) // 3), title)
    if band is not None:
        axes.axvspan(100 * band[0], 100 * band[1], color=BLUE, alpha=0.10, lw=0, label="asked for")
    axes.axvline(100 * nominal, color=DARK, lw=1.0, ls="--", label=f"nominal, {100 * nominal:g} %")
    for number, label in enumerate(labels):
        own = [row for row in drawn if row.label == label]
        shift = 0.76 * ((number + 0.5) / len(labels) - 0.5)
        _dots(axes, own, [groups.index(row.group) + shift for row in own], number)
    for edge in range(1, len(groups)):
        axes.axhline(edge - 0.5, color=GREY, lw=0.4, alpha=0.5)
    axes.set_yticks(range(len(groups)), [printable(group) for group in groups], fontsize=8)
    for text in axes.get_yticklabels():
        text.set_parse_math(False)
    axes.set_ylim(len(groups) - 0.5, -0.5)
    axes.set_xlim(min(_lowest(drawn), 100 * nominal - 2.0) - 1.0, 100.5)
    axes.set_xlabel("intervals that hold the truth [%]")
    axes.grid(axis="x", alpha=0.25)
    figure = figure_of(axes)
    if ax is None:
        shown = figure.legend(loc="outside lower center", ncols=3, fontsize=8)
        for text in shown.get_texts():
            text.set_parse_math(False)
    else:
        legend(axes)
    return figure


def study_coverage_figure(
    results: Sequence[StudyResult],
    *,
    band: tuple[float, float] | None = None,
    title: str = "",
    ax: Axes | None = None,
) -> Figure:
    """Coverage of every parameter in one or several studies, methods side by side.

    Parameters
    ----------
    results : sequence of StudyResult
        Finished studies that recorded intervals, of one level.
    band : (float, float), optional
        Shares that are good enough.
    title : str
        Of the figure, or of the panel that is given.
    ax : matplotlib.axes.Axes, optional
        Where to draw; default: a figure of its own.

    Returns
    -------
    matplotlib.figure.Figure
        See `coverage_figure`.

    Raises
    ------
    UsageError
        When no study recorded intervals, their levels differ, or `ax` are no Axes.
    """
    levels = {result.study.level for result in results if result.study.intervals}
    if len(levels) != 1:
        raise UsageError(
            "studies with intervals of one level",
            f"levels {sorted(levels)}" if levels else "none with intervals",
            "Set intervals = true in the study's file; draw levels apart.",
        )
    rows = [
        CoverageRow(one.label, _group(result, score.name, alone=len(results) == 1), hit.hits, hit.count)
        for result in results
        for one in scores(result)
        for score in one.parameters
        if (hit := score.coverage) is not None
    ]
    return coverage_figure(rows, nominal=levels.pop(), band=band, title=title, ax=ax)


def _group(result: StudyResult, name: str, *, alone: bool) -> str:
    wording = wording_of(name)
    words = wording.symbol if wording is not None else name
    return words if alone else f"{result.study.name}: {words}"


def _lowest(rows: Sequence[CoverageRow]) -> float:
    return 100.0 * min(Share(row.hits, row.count).interval[0] for row in rows)


def _dots(axes: Axes, rows: Sequence[CoverageRow], places: Sequence[float], number: int) -> None:
    shares = [Share(row.hits, row.count) for row in rows]
    middle = [100 * share.value for share in shares]
    below = [100 * max(share.value - share.interval[0], 0.0) for share in shares]
    above = [100 * max(share.interval[1] - share.value, 0.0) for share in shares]
    axes.errorbar(
        middle,
        places,
        xerr=[below, above],
        fmt=MARKERS[number % len(MARKERS)],
        color=COLOURS[number % len(COLOURS)],
        ms=4.5,
        lw=1.1,
        capsize=2.0,
        label=rows[0].label,
    )
