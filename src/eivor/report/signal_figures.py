"""Figures of signals over time: one panel for each channel, with its unit."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eivor.report.given_axes import GivenAxes, figure_of, given_axes
from eivor.report.plain_figure import DARK, GREY, RED, drawable, labelled, legend, page, without_abscissa
from eivor.report.printable import printable
from eivor.signals.canonical import canonical_channel
from eivor.signals.signals import Signals

WIDTH, PANEL_HEIGHT = 10.0, 2.3
#: How channels are called on an axis; others by their names.
WORDS = {
    "input": "input u",
    "position_z": "height z",
    "velocity_z": "velocity z'",
    "specific_force_z": "specific force z'' + g",
    "acceleration_z": "acceleration z''",
}


def signals_figure(
    signals: Signals,
    channels: tuple[str, ...] = (),
    *,
    truth: Signals | None = None,
    title: str = "",
    axes: GivenAxes | None = None,
) -> Figure:
    """Channels over time, one below the other.

    Parameters
    ----------
    signals : Signals
        What to draw; samples that are not valid leave gaps.
    channels : tuple of str
        Which channels; all for none.
    truth : Signals, optional
        The same channels without noise, drawn above the measured ones.
    title : str
        Of the figure, or of the first panel that is given.
    axes : mapping of str to Axes, or sequence of Axes, optional
        Where to draw: some channels by name, or all in order. Default: a figure of its own.

    Returns
    -------
    matplotlib.figure.Figure
        With a canvas of its own, or that of `axes`.

    Raises
    ------
    UsageError
        When there is nothing to draw, or `axes` do not fit the channels.
    MissingChannelError
        When a channel is absent.
    """
    names = tuple(dict.fromkeys(channels or signals.channels))
    drawable(names, "channels", "Name some of them.")
    panels = _column(names, title) if axes is None else given_axes(axes, names, title)
    time = signals.start_s + signals.step_s * np.arange(signals.sample_count)
    for place, (name, panel) in enumerate(panels.items()):
        values = signals.channel(name)
        if signals.valid is not None:
            values = np.where(signals.valid, values, np.nan)
        has_truth = truth is not None and name in truth.channels
        panel.plot(time, values, color=GREY if has_truth else DARK, lw=0.7, label="measured")
        if truth is not None and has_truth:
            panel.plot(time, truth.channel(name), color=RED, lw=0.9, label="without noise")
            if place == 0:
                legend(panel, place="upper right")
        labelled(panel, x="time t [s]", y=axis_label(name))
        panel.margins(x=0.005)
    return figure_of(*panels.values())


def _column(names: tuple[str, ...], title: str) -> dict[str, Axes]:
    """Panels of a page, one below the other, over one axis of time."""
    figure = page(WIDTH, PANEL_HEIGHT * len(names) + 0.7, title)
    panels: dict[str, Axes] = {}
    for place, name in enumerate(names, start=1):
        panels[name] = figure.add_subplot(len(names), 1, place, sharex=panels.get(names[0]))
        if place < len(names):
            without_abscissa(panels[name])
    return panels


def axis_label(name: str) -> str:
    """Channel in words with its unit; "[-]" for a channel whose unit is its own."""
    channel = canonical_channel(name)
    unit = (channel.unit if channel else "").replace("^2", "²") or "-"
    return f"{printable(WORDS.get(name, name))} [{unit}]"
