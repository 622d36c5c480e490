"""Results to report on: the example flight, a pool of its halves, a flight that tells nothing."""

from __future__ import annotations

from dataclasses import replace
from importlib import resources

import numpy as np
import pytest

import shape_checks
from coarse_search import coarse
from eivor.flights.options import FlightOptions
from eivor.flights.result import FlightEstimate
from eivor.logs import read_log
from eivor.motions.identify import identify_flight
from eivor.signals.recording import Recording


@pytest.fixture(scope="session")
def recording() -> Recording:
    """The bundled example flight."""
    with resources.as_file(resources.files("eivor.data").joinpath("example_flight.parquet")) as path:
        return read_log(path)


@pytest.fixture(scope="session")
def fit(recording: Recording) -> FlightEstimate:
    """Its result."""
    return identify_flight(recording)


@pytest.fixture(scope="session")
def pool(recording: Recording) -> FlightEstimate:
    """Its two halves as a pool, every method compared."""
    halves = [replace(recording, name=name, sha256=name) for name in ("first", "second")]
    windows = [(0.0, 30.0), (30.0, 60.0)]
    with shape_checks.unchecked(), coarse():  # `fit` is made with all checks and of a full search
        return identify_flight(halves, FlightOptions(compare=True), windows=windows)


@pytest.fixture(scope="session")
def still(recording: Recording) -> FlightEstimate:
    """A result without an estimate: the input is constant."""
    channels = {
        name: replace(channel, values=np.full_like(channel.values, 1800.0))
        if name.startswith("rotor_command")
        else channel
        for name, channel in recording.channels.items()
    }
    return identify_flight(replace(recording, channels=channels))
