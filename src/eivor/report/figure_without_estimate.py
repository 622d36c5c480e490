"""What the figure shows when nothing could be estimated: the flight itself, and the reasons."""

from __future__ import annotations

import textwrap

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eivor.flights.grid import Grid, on_grid
from eivor.flights.result import FlightEstimate
from eivor.report.wording import printable

#: Characters of a line of reasons.
LINE = 110


def draw_flight(figure: Figure, result: FlightEstimate) -> None:
    """Height, velocity and input of the first flight, with what was in the air, and the reasons below."""
    prepared = result.prepared[0]
    flight = prepared.flight
    time = flight.signals.start_s + flight.signals.step_s * np.arange(flight.signals.sample_count)
    panels: list[tuple[str, Float[np.ndarray, " n"]]] = []
    if "position_z" in prepared.recording.channels:
        panels.append(("height [m]", _height(result, time)))
    panels.append(("climb rate\n[m/s]", flight.velocity))
    level = flight.signals.family(flight.input).mean(axis=1)
    panels.append((f"mean of\n{flight.input}", level))
    axes = figure.subplots(len(panels) + 1, 1, height_ratios=[*[1.0] * len(panels), 0.6])
    for panel, (label, values) in zip(axes[:-1], panels, strict=True):
        panel.plot(time, values, color="#333333", lw=0.9)
        panel.set_ylabel(label, parse_math=False)
        panel.grid(alpha=0.25)
        panel.margins(x=0.005)
        panel.sharex(axes[0])
        _shade(panel, time, prepared.airborne.mask, "#2e86ab")
        _shade(panel, time, prepared.used, "#1b7f3b")
    for panel in axes[:-2]:
        panel.tick_params(labelbottom=False)
    axes[-2].set_xlabel("time from the log's start [s]")
    known = "shaded where in the air" if prepared.airborne.mask.any() else "never in the air"
    axes[0].set_title(
        f"{printable(prepared.recording.name)}: {known}, by {prepared.airborne.rule}",
        fontsize=9,
        parse_math=False,
    )
    axes[-1].set_axis_off()
    lines = [textwrap.fill(printable(sentence), LINE) for sentence in result.verdict.sentences]
    axes[-1].text(0.0, 1.0, "\n".join(lines), va="top", fontsize=9, parse_math=False)


def _height(result: FlightEstimate, time: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Height on the flight's grid."""
    prepared = result.prepared[0]
    signals = prepared.flight.signals
    grid = Grid(signals.start_s, signals.step_s, time.size)
    return on_grid(prepared.recording.channel("position_z"), grid)[0]


def _shade(panel: Axes, time: Float[np.ndarray, " n"], mask: Bool[np.ndarray, " n"], colour: str) -> None:
    if mask.any():
        across = panel.get_xaxis_transform()
        panel.fill_between(time, 0.0, 1.0, where=mask, transform=across, color=colour, alpha=0.12, lw=0)
