"""What the figure shows when nothing could be estimated: the flight itself, and the reasons."""

from __future__ import annotations

import textwrap

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eivor.flights.motion import Panel
from eivor.flights.result import FlightEstimate
from eivor.report.printable import printable

#: Characters of a line of reasons.
LINE = 110


def draw_flight(figure: Figure, result: FlightEstimate) -> None:
    """What moves in the first flight and its input, shaded where it counts, and the reasons below."""
    prepared = result.prepared[0]
    signals = prepared.signals
    time = prepared.grid.time_s
    level = signals.family(prepared.input.name).mean(axis=1)
    panels = (*result.motion.overview(prepared), Panel(f"mean of\n{prepared.input.name}", level))
    axes = figure.subplots(len(panels) + 1, 1, height_ratios=[*[1.0] * len(panels), 0.6])
    for panel, shown in zip(axes[:-1], panels, strict=True):
        panel.plot(time, shown.values, color="#333333", lw=0.9)
        panel.set_ylabel(shown.label, parse_math=False)
        panel.grid(alpha=0.25)
        panel.margins(x=0.005)
        panel.sharex(axes[0])
        _shade(panel, time, prepared.active.mask, "#2e86ab")
        _shade(panel, time, prepared.used, "#1b7f3b")
    for panel in axes[:-2]:
        panel.tick_params(labelbottom=False)
    axes[-2].set_xlabel("time from the log's start [s]")
    where = result.motion.words.where
    known = f"shaded where {where}" if prepared.active.mask.any() else f"never {where}"
    axes[0].set_title(
        f"{printable(prepared.recording.name)}: {known}, by {prepared.active.rule}",
        fontsize=9,
        parse_math=False,
    )
    axes[-1].set_axis_off()
    lines = [textwrap.fill(printable(sentence), LINE) for sentence in result.verdict.sentences]
    axes[-1].text(0.0, 1.0, "\n".join(lines), va="top", fontsize=9, parse_math=False)


def _shade(panel: Axes, time: Float[np.ndarray, " n"], mask: Bool[np.ndarray, " n"], colour: str) -> None:
    if mask.any():
        across = panel.get_xaxis_transform()
        panel.fill_between(time, 0.0, 1.0, where=mask, transform=across, color=colour, alpha=0.12, lw=0)
