"""Results to report on: the example flight, a pool of its halves, a flight that tells nothing."""

from __future__ import annotations

from dataclasses import replace
from importlib import resources

import numpy as np
import pytest

import eivor as ev
import shape_checks
from coarse_search import coarse


@pytest.fixture(scope="session")
def recording():
    """The bundled example flight."""
    with resources.as_file(resources.files("eivor.data").joinpath("example_flight.parquet")) as path:
        return ev.read_log(path)


@pytest.fixture(scope="session")
def fit(recording):
    """Its result."""
    return ev.identify_flight(recording)


@pytest.fixture(scope="session")
def pool(recording):
    """Its two halves as a pool, every method compared."""
    halves = [replace(recording, name=name, sha256=name) for name in ("first", "second")]
    windows = [(0.0, 30.0), (30.0, 60.0)]
    with shape_checks.unchecked(), coarse():  # `fit` is made with all checks and of a full search
        return ev.identify_flight(halves, ev.FlightOptions(compare=True), windows=windows)


@pytest.fixture(scope="session")
def still(recording):
    """A result without an estimate: the input is constant."""
    channels = {
        name: replace(channel, values=np.full_like(channel.values, 1800.0))
        if name.startswith("rotor_command")
        else channel
        for name, channel in recording.channels.items()
    }
    return ev.identify_flight(replace(recording, channels=channels))
