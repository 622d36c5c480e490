"""The figure of predictions some tenths of a second ahead: errors by horizon, and over the flight.

A row for each quantity. On the left, what was measured and predicted after the last horizon, of quantities
that are one number, and the size of the error of others; on the right the error by horizon.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec

from eivor.flights.ahead import UNCHANGED, Ahead, AheadError
from eivor.report.ahead_parts import shown_in
from eivor.report.plain_figure import BLUE, DARK, GREY, RED, Panels, fitting, labelled, legend, page
from eivor.shapes import Bool, Float

COLOURS = (RED, BLUE, "#8a6d3b")
WIDTH_INCHES, ROW_INCHES = 11.0, 2.3
#: So much of a flight is drawn over time [s].
SHOWN_S = 20.0
#: A line is broken where so many times the usual step passes without a start.
BROKEN_AFTER = 3.0


def ahead_panels(ahead: Ahead) -> Panels:
    """Panels by name: each quantity, and "QUANTITY by horizon" beside it."""
    panels: Panels = {}
    shown = _liveliest(ahead)
    for number, models in enumerate(ahead.by_quantity):
        name = models[0].quantity
        panels[name] = partial(_over_time, ahead=ahead, models=models, shown=shown, first=number == 0)
        panels[f"{name} by horizon"] = partial(_by_horizon, ahead=ahead, models=models, first=number == 0)
    return panels


def ahead_page(names: tuple[str, ...]) -> dict[str, Axes]:
    """A page with two panels in a row."""
    rows = len(names) // 2
    figure: Figure = page(WIDTH_INCHES, ROW_INCHES * rows + 1.2)
    grid = GridSpec(rows, 2, figure=figure, width_ratios=(2.2, 1.0))
    return {name: figure.add_subplot(grid[place // 2, place % 2]) for place, name in enumerate(names)}


def _over_time(
    ax: Axes, ahead: Ahead, models: tuple[AheadError, ...], shown: Bool[np.ndarray, " starts"], *, first: bool
) -> None:
    unit, times = shown_in(models[0].unit)
    after = ahead.horizons_s[-1]
    time = ahead.start_s[shown] + after
    quantity = models[0].quantity
    if models[0].series is not None:
        ax.plot(*_unbroken(time, times * models[0].series[shown, 0]), color=DARK, lw=2.6, alpha=0.4)
        words = f"{quantity} [{unit}]"
    else:
        words = f"error of {quantity} [{unit}]"
    for one, colour in _coloured(models):
        if one.series is None:
            ax.plot(*_unbroken(time, times * one.left[shown, -1]), color=colour, lw=1.0)
        elif one.model != UNCHANGED:
            ax.plot(*_unbroken(time, times * one.series[shown, 1]), color=colour, lw=1.0)
    labelled(ax, x="time [s]", y=words, size=9.0)
    ax.margins(x=0.005)
    if first:
        title = f"After {after:g} s, in the liveliest {time[-1] - time[0]:.0f} s of the flight"
        ax.set_title(fitting(ax, title), fontsize=9, parse_math=False)


def _by_horizon(ax: Axes, ahead: Ahead, models: tuple[AheadError, ...], *, first: bool) -> None:
    unit, times = shown_in(models[0].unit)
    for one, colour in _coloured(models):
        errors = times * np.array(one.rms)
        ax.plot(ahead.horizons_s, errors, "o-", color=colour, ms=3.5, lw=1.2, label=one.words)
    most = times * max(max(one.rms) for one in models)
    ax.set_ylim(0.0, (1.75 if first else 1.1) * most or 1.0)
    labelled(ax, x="predicted so far ahead [s]", y=f"RMS error [{unit}]", size=9.0)
    if first:
        ax.set_title("By horizon", fontsize=9)
        ax.plot([], [], color=DARK, lw=2.6, alpha=0.4, label="measured")
        legend(ax, size=7, place="upper left")


def _coloured(models: tuple[AheadError, ...]) -> list[tuple[AheadError, str]]:
    """Models, the fit drawn last and so on top."""
    parametric = [one for one in models if one.model != UNCHANGED]
    colours = dict(zip((one.model for one in parametric), COLOURS, strict=False))
    return [(one, colours.get(one.model, GREY)) for one in reversed(models)]


def _liveliest(ahead: Ahead) -> Bool[np.ndarray, " starts"]:
    """Starts within the part of a flight in which most happens that does not stay as it is."""
    time = ahead.start_s
    ends = np.flatnonzero(np.diff(time, append=-np.inf) < 0.0) + 1
    begin, best, found = 0, -np.inf, slice(0, time.size)
    stayed = [models[-1] for models in ahead.by_quantity]
    moved = sum(
        (np.nan_to_num(one.left[:, -1] / (one.rms[-1] or 1.0)) ** 2 for one in stayed), np.zeros(time.size)
    )
    for end in ends.tolist():
        power = np.concatenate([[0.0], np.cumsum(moved[begin:end])])
        last = np.searchsorted(time[begin:end], time[begin:end] + SHOWN_S, side="right")
        inside = power[last] - power[: end - begin]
        start = int(np.argmax(inside))
        if inside[start] > best:
            best, found = float(inside[start]), slice(begin + start, begin + int(last[start]))
        begin = end
    mask = np.zeros(time.size, dtype=np.bool_)
    mask[found] = True
    return mask


def _unbroken(
    time: Float[np.ndarray, " n"], values: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Time and values, without a line over stretches in which nothing starts."""
    if time.size < 2:
        return time, values
    steps = np.diff(time, prepend=time[0])
    shown = np.where(steps > BROKEN_AFTER * float(np.median(np.diff(time))), np.nan, values)
    return time, shown
