"""Figures and tables of studies and of the paper."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from eivor.errors import UsageError
from eivor.lab import paper
from eivor.lab.experiments import stream
from eivor.lab.study import TOGETHER, Share, Spread, StudyResult, scores, trial_nrmse
from eivor.motions.table import wording_of
from eivor.report import figure_panels as plots
from eivor.report.figures import signals_figure
from eivor.report.terminal import heading
from eivor.signals.signals import Signals
from eivor.tools import Float, printable

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


COLOURS = (plots.BLUE, plots.RED, plots.DARK, "#a06a00", "#1b7f3b", "#7b3f9e", plots.GREY)
MARKERS = ("o", "s", "D", "^", "v", "P", "X")
WIDTH, ROW_HEIGHT, LEAST_ROW = 7.6, 0.13, 0.3


def coverage_figure(
    shares: Mapping[str, Mapping[str, Share]], *, nominal: float = 0.95, title: str = ""
) -> Figure:
    """Shares of intervals that held the truth, a colour for each label and a line for each of its groups."""
    drawn = {label: {group: x for group, x in of.items() if x.count} for label, of in shares.items()}
    drawn = {label: of for label, of in drawn.items() if of}
    groups = list(dict.fromkeys(group for of in drawn.values() for group in of))
    if not groups:
        raise UsageError("intervals that were counted", "none", "Run a study with intervals.")
    line = max(ROW_HEIGHT * len(drawn), LEAST_ROW)
    figure = plots.page(WIDTH, line * len(groups) + 1.5 + 0.2 * -(-len(drawn) // 3), title)
    axes = figure.add_subplot()
    axes.axvline(100 * nominal, color=plots.DARK, lw=1.0, ls="--", label=f"nominal, {100 * nominal:g} %")
    lowest = 100 * nominal - 2.0
    for index, (label, of) in enumerate(drawn.items()):
        shift = 0.76 * ((index + 0.5) / len(drawn) - 0.5)
        middle = 100.0 * np.array([share.value for share in of.values()])
        low, high = 100.0 * np.array([share.interval for share in of.values()]).T
        lowest = min(lowest, float(low.min()))
        axes.errorbar(
            middle,
            [groups.index(group) + shift for group in of],
            xerr=np.maximum([middle - low, high - middle], 0.0),
            fmt=MARKERS[index % len(MARKERS)],
            color=COLOURS[index % len(COLOURS)],
            ms=4.5,
            lw=1.1,
            capsize=2.0,
            label=label,
        )
    for edge in range(1, len(groups)):
        axes.axhline(edge - 0.5, color=plots.GREY, lw=0.4, alpha=0.5)
    axes.set_yticks(range(len(groups)), [printable(group) for group in groups], fontsize=8)
    axes.set_ylim(len(groups) - 0.5, -0.5)
    axes.set_xlim(lowest - 1.0, 100.5)
    axes.set_xlabel("intervals that hold the truth [%]")
    axes.grid(axis="x", alpha=0.25)
    drawn_legend = figure.legend(loc="outside lower center", ncols=3, fontsize=8)
    for text in (*axes.get_yticklabels(), *drawn_legend.get_texts()):
        text.set_parse_math(False)
    return figure


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
) -> Figure:
    """Histograms of NRMSE, a row of panels for each method and a column for each score."""
    columns = max((len(scores) for scores in rows.values()), default=0)
    plots.drawable(range(columns), "scores", "Run the study first.")
    figure = plots.page(PANEL_WIDTH * columns, PANEL_HEIGHT * len(rows) + (0.5 if title else 0.1), title)
    for row, (method, by_score) in enumerate(rows.items()):
        for column, (name, values) in enumerate(by_score.items()):
            axes = figure.add_subplot(len(rows), columns, row * columns + column + 1)
            _draw(axes, values, ((printed or {}).get(method) or {}).get(name))
            text = f"{printable(method)}\ntrials [count]" if column == 0 else ""
            plots.labelled(axes, x=f"NRMSE of {_words(name)} [%]", y=text, size=9.0)
    return figure


def study_figures(result: StudyResult) -> Iterator[tuple[str, Figure]]:
    """Histograms of NRMSE and, where intervals were recorded, their coverage."""
    names = (*result.study.parameters, TOGETHER)
    rows = {
        choice.label: {name: trial_nrmse(result, choice.label, name) for name in names}
        for choice in result.study.methods
    }
    title = f"{printable(result.study.name)}: {result.trials.height} trials"
    yield "nrmse", nrmse_figure(rows, title=title)
    if result.study.intervals:
        shares = {
            item.label: {_words(score.name): score.coverage for score in item.parameters if score.coverage}
            for item in scores(result)
        }
        level, title = result.study.level, f"Coverage: {result.study.name}"
        yield "coverage", coverage_figure(shares, nominal=level, title=title)


def _words(name: str) -> str:
    wording = wording_of(name)
    words = wording.symbol if wording is not None else printable(name)
    return "all parameters" if name == TOGETHER else words


def _draw(axes: Axes, values: Float[np.ndarray, " trials"], printed: Spread | None) -> None:
    from matplotlib.ticker import MaxNLocator

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
    axes.hist(
        np.clip(values, edges[0], edges[-1]), bins=list(edges), color=plots.BLUE, edgecolor="white", lw=0.4
    )
    axes.axvline(float(values.mean()), color=plots.DARK, lw=1.2, label=f"mean {values.mean():.3g}")
    if printed is not None:
        _draw_printed(axes, printed, float(edges[0]), float(edges[-1]))
    # room for the legend above the bars
    axes.set_ylim(0.0, 1.6 * axes.get_ylim()[1])
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    plots.legend(axes, size=7)


def _draw_printed(axes: Axes, printed: Spread, low: float, high: float) -> None:
    """Line and band, or words alone when they are so far away that the bars would vanish."""
    span = FAR * (high - low)
    words = f"printed {printed.mean:.4g} ± {printed.std:.3g}"
    if not low - span <= printed.mean <= high + span:
        axes.plot([], [], color=plots.RED, lw=1.2, ls="--", label=f"{words},\noff this axis")
        return
    limits = min(low, printed.mean), max(high, printed.mean)
    margin = 0.05 * (limits[1] - limits[0])
    axes.axvspan(printed.mean - printed.std, printed.mean + printed.std, color=plots.RED, alpha=0.18, lw=0)
    axes.axvline(printed.mean, color=plots.RED, lw=1.2, ls="--", label=words)
    if axes.get_xscale() == "linear":
        axes.set_xlim(limits[0] - margin, limits[1] + margin)


def _range(values: Float[np.ndarray, " trials"]) -> tuple[float, float]:
    """From zero, unless the values keep far away from it; never empty."""
    low, high = float(values.min()), float(values.max())
    low = 0.0 if low < 0.5 * high else low
    return (low, high) if high > low else (low - 0.5, low + 0.5)


FORMATS = ("svg", "png")
PAPER_FIGURES = tuple(f"figure-{number}" for number in range(2, 9))
#: What the columns of the printed tables are called in figures.
WORDS = {"LS": "least squares", "IV": "extended IV", "GIV": "generalized IV"}


def figure_files(folder: Path, *names: str) -> tuple[Path, ...]:
    """Files of the figures of these names; without names, of those of the paper."""
    return tuple(folder / f"{name}.{ending}" for name in names or PAPER_FIGURES for ending in FORMATS)


def paper_figures(results: Sequence[paper.PaperResult]) -> Iterator[tuple[str, Figure]]:
    """Figures 2 to 8 by name."""
    yield "figure-2", signal_figure(results[0].reading, results[0].example)
    for number, (result, column) in enumerate(product(results, paper.PRINTED_METHODS), start=3):
        yield f"figure-{number}", histogram_figure(result, column)


def signal_figure(reading: paper.PaperReading, example: paper.Example) -> Figure:
    """Input u(t) and height z(t) of the first run, without noise: the paper's figure 2."""
    truth = paper.record(replace(reading, motion="solution"), example, stream(paper.SEED, 0)).truth
    drive, velocity = truth.channels["input"], truth.channels["velocity_z"]
    height = paper.integrated_height(velocity, drive, intersample=reading.intersample)
    signals = Signals(truth.rate_hz, {"input": drive, "position_z": height})
    return signals_figure(signals, title=f"Reading {reading.name}: input and height of the first run")


def histogram_figure(result: paper.PaperResult, column: str) -> Figure:
    """Histograms of NRMSE of one column of the printed tables: the paper's figures 3 to 8."""
    method = paper.PRINTED_METHODS[column]
    scores = result.nrmse(method)
    words = WORDS[column]
    printed = dict(zip(paper.SCORES, result.example.printed[method], strict=True))
    title = (
        f"Example {result.example.number}, {words}, reading {result.reading.name} "
        f"({len(result.estimates)} runs; red: printed mean ± SD)"
    )
    rows = {words: {name: scores[:, index] for index, name in enumerate(paper.SCORES)}}
    return nrmse_figure(rows, printed={words: printed}, title=title)


SCORE_WORDS = ("δθ1 (K)", "δθ2 (K_u)", "δθ")
#: What a table says where a method gives no estimate.
NO_ESTIMATE = "none"


def spread_text(spread: Spread) -> str:
    """Mean and SD to three significant digits."""
    if not (math.isfinite(spread.mean) and math.isfinite(spread.std)):
        return NO_ESTIMATE
    return f"{_digits(spread.mean)} ± {_digits(spread.std)}"


def _digits(value: float) -> str:
    if value >= 1e5:
        return f"{value:.1e}"
    return f"{value:.{max(0, 2 - math.floor(math.log10(value)))}f}" if value > 0.0 else "0"


def by_reading(results: Iterable[paper.PaperResult]) -> dict[str, list[paper.PaperResult]]:
    """Results of each reading, in the order in which they came."""
    groups: dict[str, list[paper.PaperResult]] = {}
    for result in results:
        groups.setdefault(result.reading.name, []).append(result)
    return groups


def nearest(results: Sequence[paper.PaperResult]) -> str:
    """Name of the allowed reading whose means are nearest to the printed ones; of any if none is allowed."""
    groups = by_reading(results)
    allowed = {name: group for name, group in groups.items() if group[0].reading.allowed} or groups
    return min(allowed, key=lambda name: paper.nearness(allowed[name]).means)


def reading_report(results: Sequence[paper.PaperResult]) -> Iterator[RenderableType]:
    """Measured beside printed for one reading."""
    reading = results[0].reading
    yield heading(reading.name)
    yield Text(reading.sentence)
    for result in results:
        table = _bare_table(f"example {result.example.number}: NRMSE [%]", *SCORE_WORDS)
        for method in paper.METHODS:
            table.add_row(paper.METHOD_WORDS[method], *map(spread_text, result.spreads(method)))
            if method in result.example.printed:
                printed = map(printed_text, result.example.printed[method])
                table.add_row(*(Text(cell, style="dim") for cell in ("    printed", *printed)))
        yield table
        counts = {words: result.weak_runs(method) for words, method in paper.PRINTED_METHODS.items()}
        runs = len(result.weak)
        weak = [f"of {words} in {count} of {runs} runs" for words, count in counts.items() if count]
        if weak:
            yield Text(f"Weak instruments (first-stage F below 10): {', '.join(weak)}.")


def overview_report(results: Sequence[paper.PaperResult]) -> Iterator[RenderableType]:
    """How far every reading is from the printed tables, and which is nearest."""
    yield heading("How far from the printed tables")
    table = _bare_table("reading", "means off by", "SDs off by", "printed means met")
    for name, group in by_reading(results).items():
        table.add_row(name, *nearness_cells(paper.nearness(group)))
    yield table
    yield Text(verdict_sentence(results))


def verdict_sentence(results: Sequence[paper.PaperResult]) -> str:
    """Whether any reading gives the printed tables."""
    readings = {name: paper.nearness(group) for name, group in by_reading(results).items()}
    matching = [name for name, result in readings.items() if result.agreeing == result.printed]
    if matching:
        return f"Every printed mean is met by: {', '.join(matching)}."
    name = nearest(results)
    result = readings[name]
    return (
        f"No reading gives the printed tables. Nearest is {name}: its means are off by a factor of "
        f"{factor_text(result.means)}, and {result.agreeing} of {result.printed} are met."
    )


def nearness_cells(result: paper.Nearness) -> tuple[str, str, str]:
    """How far a reading is from the printed tables, in a table."""
    return factor_text(result.means), factor_text(result.spreads), f"{result.agreeing} of {result.printed}"


def factor_text(value: float) -> str:
    """A factor to three digits."""
    return f"{value:.3g}" if math.isfinite(value) else NO_ESTIMATE


def printed_text(spread: Spread) -> str:
    """Mean and SD as short as they are printed."""
    return f"{spread.mean:.4g} ± {spread.std:.4g}"


def _bare_table(*columns: str) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    for column in columns:
        table.add_column(Text(column), no_wrap=True)
    return table
