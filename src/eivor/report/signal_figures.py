"""Figures of signals over time: one panel for each channel, with its unit."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from eivor.report.plain_figure import DARK, GREY, RED, drawable, labelled, legend, page
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
    signals: Signals, channels: tuple[str, ...] = (), *, truth: Signals | None = None, title: str = ""
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
        Of the figure.

    Returns
    -------
    matplotlib.figure.Figure
        With a canvas of its own.

    Raises
    ------
    UsageError
        When there is nothing to draw.
    MissingChannelError
        When a channel is absent.
    """
    names = channels or tuple(signals.channels)
    drawable(names, "channels", "Name some of them.")
    figure = page(WIDTH, PANEL_HEIGHT * len(names) + 0.7, title)
    time = signals.start_s + signals.step_s * np.arange(signals.sample_count)
    shared = None
    for place, name in enumerate(names, start=1):
        axes = figure.add_subplot(len(names), 1, place, sharex=shared)
        shared = shared or axes
        values = signals.channel(name)
        if signals.valid is not None:
            values = np.where(signals.valid, values, np.nan)
        has_truth = truth is not None and name in truth.channels
        axes.plot(time, values, color=GREY if has_truth else DARK, lw=0.7, label="measured")
        if truth is not None and has_truth:
            axes.plot(time, truth.channel(name), color=RED, lw=0.9, label="without noise")
            if place == 1:
                legend(axes, place="upper right")
        last = place == len(names)
        labelled(axes, x="time t [s]" if last else "", y=axis_label(name))
        axes.margins(x=0.005)
        axes.tick_params(labelbottom=last)
    return figure


def axis_label(name: str) -> str:
    """Channel in words with its unit; "[-]" for a channel whose unit is its own."""
    channel = canonical_channel(name)
    unit = (channel.unit if channel else "").replace("^2", "²") or "-"
    return f"{printable(WORDS.get(name, name))} [{unit}]"
