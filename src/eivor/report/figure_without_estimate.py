"""What the figure shows when nothing could be estimated: the flight itself, and the reasons."""

from __future__ import annotations

from functools import partial

import numpy as np
from matplotlib.axes import Axes

from eivor.flights.result import FlightEstimate
from eivor.flights.shown import Panel
from eivor.report.plain_figure import Panels, fitting, page, without_abscissa
from eivor.report.printable import printable
from eivor.shapes import Bool, Float

SIZE_INCHES = (11.0, 8.5)


def flight_panels(result: FlightEstimate) -> Panels:
    """What moves in the first flight and its input, shaded where it counts, and the reasons below."""
    prepared = result.prepared[0]
    level = prepared.signals.family(prepared.input.name).mean(axis=1)
    shown = {_name(panel): panel for panel in result.motion.overview(prepared)}
    shown["input"] = Panel(f"mean of\n{prepared.input.name}", level)
    first = next(iter(shown))
    panels: Panels = {
        name: partial(_draw, shown=panel, result=result, title=_title(result) if name == first else "")
        for name, panel in shown.items()
    }
    panels["reasons"] = partial(_write_reasons, result=result)
    return panels


def page_without_estimate(names: tuple[str, ...]) -> dict[str, Axes]:
    """Axes of these panels, one below the other; the last has words only."""
    figure = page(*SIZE_INCHES)
    panels = figure.subplots(len(names), 1, height_ratios=[*[1.0] * (len(names) - 1), 0.6])
    for panel in panels[1:-1]:
        panel.sharex(panels[0])
    for panel in panels[:-2]:
        without_abscissa(panel)
    return dict(zip(names, panels, strict=True))


def _name(panel: Panel) -> str:
    """Label of a panel in one line, without its unit."""
    return " ".join(panel.label.split()).partition(" [")[0]


def _title(result: FlightEstimate) -> str:
    prepared, where = result.prepared[0], result.motion.words.where
    known = f"shaded where {where}" if prepared.active.mask.any() else f"never {where}"
    return f"{printable(prepared.recording.name)}: {known}, by {prepared.active.rule}"


def _draw(axes: Axes, shown: Panel, result: FlightEstimate, title: str) -> None:
    prepared = result.prepared[0]
    time = prepared.grid.time_s
    axes.plot(time, shown.values, color="#333333", lw=0.9)
    axes.set_ylabel(shown.label, parse_math=False)
    axes.set_xlabel("time from the log's start [s]")
    axes.grid(alpha=0.25)
    axes.margins(x=0.005)
    _shade(axes, time, prepared.active.mask, "#2e86ab")
    _shade(axes, time, prepared.used, "#1b7f3b")
    if title:
        axes.set_title(fitting(axes, title), fontsize=9, parse_math=False)


def _write_reasons(axes: Axes, result: FlightEstimate) -> None:
    axes.set_axis_off()
    lines = [fitting(axes, printable(sentence)) for sentence in result.verdict.sentences]
    axes.text(0.0, 1.0, "\n".join(lines), va="top", fontsize=9, parse_math=False)


def _shade(panel: Axes, time: Float[np.ndarray, " n"], mask: Bool[np.ndarray, " n"], colour: str) -> None:
    if mask.any():
        across = panel.get_xaxis_transform()
        panel.fill_between(time, 0.0, 1.0, where=mask, transform=across, color=colour, alpha=0.12, lw=0)
