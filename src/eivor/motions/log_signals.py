"""A log on one grid: the `Signals` that its flight is identified from."""

from __future__ import annotations

from dataclasses import replace
from typing import Unpack

from eivor import checks
from eivor.errors import UsageError
from eivor.flights.options import FlightOptions
from eivor.flights.prepare import prepare
from eivor.flights.prepared import mask_of
from eivor.motions import DEFAULT, motion_by_name
from eivor.motions.identify import Choices
from eivor.signals.recording import Recording
from eivor.signals.signals import Signals


def log_signals(
    log: Recording,
    *,
    actuator_lag: float = 0.0,
    delay: float = 0.0,
    model: str = DEFAULT,
    **choices: Unpack[Choices],
) -> Signals:
    """Signals of a log, see `Recording.signals`."""
    for name, value in {"actuator_lag": actuator_lag, "delay": delay}.items():
        checks.number(name, value)
        if not 0.0 <= value <= 1.0:
            raise UsageError(f"a {name} between 0 and 1 s", f"{value:g}", "Give it in seconds.")
    motion = motion_by_name(model)
    flight = prepare(log, motion, FlightOptions(**choices))
    used = mask_of(flight.runs, flight.usable.size) & flight.usable
    return replace(motion.signals(flight, actuator_lag, delay), valid=used)
