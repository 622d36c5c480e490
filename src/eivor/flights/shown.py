"""Series that reports show of a flight: what was measured beside what is predicted, and what to look at."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from eivor.shapes import Float


@dataclass(frozen=True)
class Trace:
    """One axis over the samples of all runs, run after run: what was measured and what the model says.

    Parameters
    ----------
    axis : str
        What is measured, in words.
    unit : str
        As it is shown.
    model, drive : str
        The prediction, and the part of it that the input makes, in symbols.
    measured, predicted, driven : ndarray, shape (samples,)
        In that unit; the mean of each run may be missing from them.
    band_hz : tuple of float, optional
        Band that they are of, where it is another than that of the flights.
    """

    axis: str
    unit: str
    model: str
    drive: str
    measured: Float[np.ndarray, " samples"]
    predicted: Float[np.ndarray, " samples"]
    driven: Float[np.ndarray, " samples"]
    band_hz: tuple[float, float] | None = None


def joined(traces: tuple[Trace, ...]) -> Trace:
    """Traces of one axis of several flights, one after the other."""
    return replace(
        traces[0],
        measured=np.concatenate([trace.measured for trace in traces]),
        predicted=np.concatenate([trace.predicted for trace in traces]),
        driven=np.concatenate([trace.driven for trace in traces]),
    )


@dataclass(frozen=True)
class Panel:
    """A series of a flight to look at, whether or not something could be estimated.

    Parameters
    ----------
    label : str
        With its unit.
    values : ndarray, shape (n,)
        On the flight's grid.
    asked : ndarray, shape (n,), optional
        What the vehicle was asked for, in the same unit.
    """

    label: str
    values: Float[np.ndarray, " n"]
    asked: Float[np.ndarray, " n"] | None = None
