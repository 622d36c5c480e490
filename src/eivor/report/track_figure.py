"""The figure of a track: a parameter over time with its band, and its changes."""

from __future__ import annotations

from textwrap import fill

import numpy as np
from matplotlib.figure import Figure

from eivor.flights.track import Track
from eivor.report.plain_figure import BLUE, RED, labelled, legend, page
from eivor.report.printable import printable
from eivor.report.track_document import untold

WIDTH, HEIGHT = 10.0, 4.5
#: Letters of a line of words.
LETTERS = 90


def track_figure(track: Track) -> Figure:
    """Value with its 95 % band over time; times at which nothing is told are left out."""
    (flight,) = track.result.prepared
    if not track.told:
        figure = page(WIDTH, HEIGHT, f"{printable(flight.recording.name)}: told at no moment")
        figure.text(
            0.5, 0.5, fill("\n".join(map(printable, untold(track))), LETTERS), ha="center", parse_math=False
        )
        return figure
    wording = track.result.motion.wording[track.name]
    time = np.array([one.time_s for one in track.moments])
    told = np.array([one.told for one in track.moments])
    value, half = (
        np.where(told, wording.scale * np.array(part), np.nan)
        for part in ([one.value for one in track.moments], [one.half_width for one in track.moments])
    )
    figure = page(WIDTH, HEIGHT, f"{printable(flight.recording.name)}: {wording.words} over the flight")
    axes = figure.add_subplot()
    axes.fill_between(time, value - half, value + half, color=BLUE, alpha=0.2, lw=0, label="95 %")
    axes.plot(time, value, color=BLUE, lw=1.3, label=f"memory {track.memory_s:g} s")
    for number, change in enumerate(track.changes):
        axes.axvline(change.time_s, color=RED, lw=1.2, ls="--", label="" if number else "change told")
    labelled(axes, x="time t [s]", y=f"{wording.symbol} [{wording.shown_unit or wording.unit or '-'}]")
    axes.margins(x=0.01)
    legend(axes)
    return figure
