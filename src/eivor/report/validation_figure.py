"""The figure of a validation: measured and predicted over time, and what each model leaves."""

from __future__ import annotations

import textwrap
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec

from eivor.report.ahead_figure import ahead_page, ahead_panels
from eivor.report.fit_panels import SHOWN_S
from eivor.report.given_axes import GivenAxes, figure_of, given_axes
from eivor.report.plain_figure import (
    BLUE,
    DARK,
    GREY,
    RED,
    Panels,
    fitting,
    labelled,
    legend,
    page,
    without_abscissa,
)
from eivor.report.printable import printable, short_name
from eivor.report.validation import ModelPrediction, Validation
from eivor.shapes import Float

COLOURS = (RED, BLUE, GREY, "#8a6d3b")
SIZE_INCHES = (11.0, 8.5)
#: Letters of a line of the title.
TITLE_LETTERS = 120


def validation_figure(found: Validation, axes: GivenAxes | None = None) -> Figure:
    """Figure of a validation.

    Parameters
    ----------
    found : Validation
        What was predicted.
    axes : mapping of str to Axes, or sequence of Axes, optional
        Where to draw: panels by name, or all in order. Default: a figure of its own.

    Returns
    -------
    matplotlib.figure.Figure
        With a canvas of its own, or that of `axes`.

    Raises
    ------
    UsageError
        When `axes` do not fit the panels.

    Notes
    -----
    For each quantity a panel of the name of its horizon, "one_step" or "open_loop", with what was measured
    and predicted in the liveliest part of the longest run; and below it "HORIZON residual" with what each
    model leaves there. Of predictions ahead for each quantity a panel of its name, and "QUANTITY by horizon".
    """
    panels: Panels = {} if found.ahead is None else ahead_panels(found.ahead)
    for models in found.by_quantity:
        name = models[0].horizon.value
        panels[name] = partial(_draw_predicted, found=found, models=models)
        panels[f"{name} residual"] = partial(_draw_left, found=found, models=models)
    new_page = _page if found.ahead is None else ahead_page
    placed = new_page(tuple(panels)) if axes is None else given_axes(axes, tuple(panels))
    for name, ax in placed.items():
        panels[name](ax)
    figure = figure_of(*placed.values())
    if axes is None:
        sentence = textwrap.fill(found.sentence, TITLE_LETTERS)
        title = f"{short_name(printable(found.flight.recording.name))}\n{sentence}"
        figure.suptitle(title, fontsize=11, parse_math=False)
    return figure


def _page(names: tuple[str, ...]) -> dict[str, Axes]:
    figure = page(SIZE_INCHES[0], SIZE_INCHES[1] * len(names) / 4.0)
    grid = GridSpec(len(names), 1, figure=figure, height_ratios=(1.6, 1.0) * (len(names) // 2))
    placed: dict[str, Axes] = {}
    for row, (predicted, left) in enumerate(zip(names[::2], names[1::2], strict=True)):
        placed[predicted] = figure.add_subplot(grid[2 * row])
        placed[left] = figure.add_subplot(grid[2 * row + 1], sharex=placed[predicted])
        without_abscissa(placed[predicted])
    return placed


def _draw_predicted(ax: Axes, found: Validation, models: tuple[ModelPrediction, ...]) -> None:
    time, shown = _shown(found, models[0])
    ax.plot(time, models[0].measured[shown], color=DARK, lw=1.2, label="measured")
    limits = _limits(models[0].measured[shown])
    for one, colour in zip(models, COLOURS, strict=False):
        ax.plot(time, one.predicted[shown], color=colour, lw=1.0, label=_label(one))
    first = models[0]
    ax.set_ylim(*limits)
    labelled(ax, y=f"{first.quantity} [{first.unit}]", size=9.0)
    start, end = time[0], time[-1]
    ax.set_title(
        fitting(ax, f"{first.quantity.capitalize()}, {first.horizon.words}, from {start:.0f} to {end:.0f} s"),
        fontsize=9,
        parse_math=False,
    )
    legend(ax, place="upper right")


def _draw_left(ax: Axes, found: Validation, models: tuple[ModelPrediction, ...]) -> None:
    time, shown = _shown(found, models[0])
    left = [(one.measured - one.predicted)[shown] for one in models]
    for values, colour in zip(left, COLOURS, strict=False):
        ax.plot(time, values, color=colour, lw=0.9)
    ax.axhline(0.0, color="black", lw=0.5)
    low, high = _limits(models[0].measured[shown])
    half = min(1.1 * max(float(np.abs(values).max()) for values in left), 0.5 * (high - low))
    ax.set_ylim(-half, half)
    labelled(ax, x="time from the log's start [s]", y=f"left [{models[0].unit}]", size=9.0)


def _label(one: ModelPrediction) -> str:
    return f"{one.words}: RMS error {one.error.rms:.2g} {one.unit}, explains {one.error.explained:.0%}"


def _limits(measured: Float[np.ndarray, " shown"]) -> tuple[float, float]:
    """Room for what was measured, and above it for the legend; what drifts further leaves the panel."""
    low, high = float(measured.min()), float(measured.max())
    height = max(high - low, 1e-9)
    return low - 0.25 * height, high + 0.75 * height


def _shown(found: Validation, first: ModelPrediction) -> tuple[Float[np.ndarray, " shown"], slice]:
    """Time and samples of the liveliest part of the longest run."""
    lengths = [samples.size for samples in found.flight.samples_of_runs]
    longest = int(np.argmax(lengths))
    begin = sum(lengths[:longest])
    count = min(lengths[longest], max(int(SHOWN_S * found.flight.signals.rate_hz), 1))
    values = first.measured[begin : begin + lengths[longest]]
    power = np.concatenate([[0.0], np.cumsum((values - values.mean()) ** 2)])
    start = int(np.argmax(power[count:] - power[: power.size - count]))
    time = found.flight.grid.time_s[found.flight.samples_of_runs[longest]]
    return time[start : start + count], slice(begin + start, begin + start + count)
