"""Recordings of simulated flights: channels on one clock, under their canonical names, z up."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from eivor.shapes import Float
from eivor.signals.canonical import unit_of
from eivor.signals.recording import Channel, Frame, Recording


def simulated_recording(
    name: str,
    *,
    simulator: str,
    time_s: Float[np.ndarray, " n"],
    held: Mapping[str, Float[np.ndarray, " n"]],
    sampled: Mapping[str, Float[np.ndarray, " n"]],
) -> Recording:
    """Log of a simulated flight whose rotors' thrust goes with the square of their state.

    Parameters
    ----------
    name, simulator : str
        What to call the log, and the source of its channels.
    time_s : ndarray, shape (n,)
        Stamps of every channel [s].
    held : mapping of str to ndarray, shape (n,)
        Commands and setpoints, each in force until the next stamp.
    sampled : mapping of str to ndarray, shape (n,)
        Measurements at the stamps.
    """
    channels = {
        key: Channel(key, time_s, values.copy(), unit_of(key), source=simulator, held=key in held)
        for key, values in (dict(held) | dict(sampled)).items()
    }
    return Recording(name=name, format="simulation", channels=channels, frame=Frame.Z_UP, input_map="square")
