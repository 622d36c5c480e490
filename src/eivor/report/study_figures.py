"""Histograms of a study's NRMSE: the counterparts of the paper's figures 3 to 8."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from eivor.motions import wording_of
from eivor.report.given_axes import GivenAxes, figure_of, given_axes
from eivor.report.plain_figure import BLUE, DARK, RED, drawable, labelled, legend, page
from eivor.report.printable import printable
from eivor.shapes import Float
from eivor.studies.metrics import TOGETHER, Spread, trial_nrmse
from eivor.studies.run import StudyResult

PANEL_WIDTH, PANEL_HEIGHT = 3.6, 2.7
BINS = 20
#: A histogram whose largest value is so many times its median has a logarithmic axis.
LONG_TAIL = 20.0
#: What others published is drawn up to so many widths of the histogram away from it.
FAR = 3.0


def nrmse_figure(
    rows: Mapping[str, Mapping[str, Float[np.ndarray, " _"]]],
    *,
    printed: Mapping[str, Mapping[str, Spread]] | None = None,
    title: str = "",
    axes: GivenAxes | None = None,
) -> Figure:
    """Histograms of NRMSE, a row of panels for each method and a column for each score.

    Parameters
    ----------
    rows : mapping of str to mapping of str to ndarray, shape (trials,)
        For each method in words its scores by name (a parameter's, or "together"), in percent.
    printed : mapping of str to mapping of str to Spread, optional
        Mean and standard deviation that others published, drawn as a line and a band.
    title : str
        Of the figure, or of the first panel that is given.
    axes : mapping of str to Axes, or sequence of Axes, optional
        Where to draw: some panels, called "METHOD: SCORE", or all, row by row. Default: a figure of its own.

    Returns
    -------
    matplotlib.figure.Figure
        With a canvas of its own, or that of `axes`.

    Raises
    ------
    UsageError
        When there is nothing to draw, or `axes` do not fit the panels.
    """
    columns = max((len(scores) for scores in rows.values()), default=0)
    drawable(range(columns), "scores", "Run the study first.")
    cells = {f"{method}: {name}": (method, name) for method, scores in rows.items() for name in scores}
    panels = _table(rows, columns, title) if axes is None else given_axes(axes, tuple(cells), title)
    for called, panel in panels.items():
        method, name = cells[called]
        _draw(panel, rows[method][name], ((printed or {}).get(method) or {}).get(name))
        first = axes is not None or name == next(iter(rows[method]))
        beside = f"{printable(method)}\ntrials [count]" if first else ""
        labelled(panel, x=f"NRMSE of {_words(name)} [%]", y=beside, size=9.0)
    return figure_of(*panels.values())


def _table(rows: Mapping[str, Mapping[str, object]], columns: int, title: str) -> dict[str, Axes]:
    """Panels of a page, a row for each method."""
    figure = page(PANEL_WIDTH * columns, PANEL_HEIGHT * len(rows) + (0.5 if title else 0.1), title)
    return {
        f"{method}: {name}": figure.add_subplot(len(rows), columns, row * columns + column + 1)
        for row, (method, scores) in enumerate(rows.items())
        for column, name in enumerate(scores)
    }


def study_figure(result: StudyResult, *, axes: GivenAxes | None = None) -> Figure:
    """Histograms of NRMSE of every method of a study.

    Parameters
    ----------
    result : StudyResult
        A finished study.
    axes : mapping of str to Axes, or sequence of Axes, optional
        Where to draw, see `nrmse_figure`.

    Returns
    -------
    matplotlib.figure.Figure
        A row for each method, a column for each parameter and one for all together.

    Raises
    ------
    UsageError
        When `axes` do not fit the panels.
    """
    names = (*result.study.parameters, TOGETHER)
    rows = {
        choice.label: {name: trial_nrmse(result, choice.label, name) for name in names}
        for choice in result.study.methods
    }
    title = f"{printable(result.study.name)}: {result.trials.height} trials" if axes is None else ""
    return nrmse_figure(rows, title=title, axes=axes)


def _words(name: str) -> str:
    if name == TOGETHER:
        return "all parameters"
    wording = wording_of(name)
    return wording.symbol if wording is not None else printable(name)


def _draw(axes: Axes, values: Float[np.ndarray, " trials"], printed: Spread | None) -> None:
    values = values[np.isfinite(values)]
    axes.tick_params(labelsize=8)
    if not values.size:
        axes.text(0.5, 0.5, "no estimate\nin any trial", ha="center", va="center", transform=axes.transAxes)
        axes.set_yticks([])
        return
    top, median = float(values.max()), float(np.median(values))
    if median > 0.0 and top > LONG_TAIL * median:
        edges = np.geomspace(max(float(values.min()), 1e-3 * median), 1.001 * top, BINS + 1)
        axes.set_xscale("log")
    else:
        edges = np.linspace(*_range(values), BINS + 1)
    axes.hist(np.clip(values, edges[0], edges[-1]), bins=list(edges), color=BLUE, edgecolor="white", lw=0.4)
    axes.axvline(float(values.mean()), color=DARK, lw=1.2, label=f"mean {values.mean():.3g}")
    if printed is not None:
        _draw_printed(axes, printed, float(edges[0]), float(edges[-1]))
    # room for the legend above the bars
    axes.set_ylim(0.0, 1.6 * axes.get_ylim()[1])
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    legend(axes, size=7)


def _draw_printed(axes: Axes, printed: Spread, low: float, high: float) -> None:
    """Line and band, or words alone when they are so far away that the bars would vanish."""
    reach = FAR * (high - low)
    words = f"printed {printed.mean:.4g} ± {printed.std:.3g}"
    if not low - reach <= printed.mean <= high + reach:
        axes.plot([], [], color=RED, lw=1.2, ls="--", label=f"{words},\noff this axis")
        return
    limits = min(low, printed.mean), max(high, printed.mean)
    margin = 0.05 * (limits[1] - limits[0])
    axes.axvspan(printed.mean - printed.std, printed.mean + printed.std, color=RED, alpha=0.18, lw=0)
    axes.axvline(printed.mean, color=RED, lw=1.2, ls="--", label=words)
    if axes.get_xscale() == "linear":
        axes.set_xlim(limits[0] - margin, limits[1] + margin)


def _range(values: Float[np.ndarray, " trials"]) -> tuple[float, float]:
    """From zero, unless the values keep far away from it; never empty."""
    low, high = float(values.min()), float(values.max())
    low = 0.0 if low < 0.5 * high else low
    return (low, high) if high > low else (low - 0.5, low + 0.5)
