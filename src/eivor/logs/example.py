"""The example flight that comes with Eivor."""

from __future__ import annotations

from importlib import resources

from eivor.logs.read import read_log
from eivor.signals.recording import Recording

#: File of the example in the package's data.
EXAMPLE_FLIGHT = "example_flight.parquet"


def example_flight() -> Recording:
    """Return the bundled example: a simulated flight of one minute at 100 Hz, whose truth is known.

    Its friction is 0.180 1/s and its actuators' lag 72 ms; `eivor example truth` prints all of it.
    """
    with resources.as_file(resources.files("eivor.data").joinpath(EXAMPLE_FLIGHT)) as path:
        return read_log(path)
