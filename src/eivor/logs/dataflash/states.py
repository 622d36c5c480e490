"""Who flies, whether a loop acts on the thrust, the pilot's throttle, and when the vehicle is landed."""

from __future__ import annotations

import numpy as np

from eivor.logs.dataflash.reading import Reading
from eivor.logs.dataflash.sources import (
    ATTITUDE_MODES,
    LANDED_EVENTS,
    OPEN_LOOP_MODES,
    PILOT_MODES,
    RATE_MODES,
)

_BY_MODE = {
    "pilot_in_control": PILOT_MODES,
    "input_open_loop": OPEN_LOOP_MODES,
    "pilot_sets_attitude": (*ATTITUDE_MODES, *RATE_MODES),
}


def add_states(reading: Reading) -> None:
    """Add what modes, events and sticks say."""
    modes = reading.tables.get("MODE")
    column = next((name for name in ("ModeNum", "Mode") if modes is not None and modes.has(name)), "")
    if modes is not None and column and modes.clock:
        for name, known in _BY_MODE.items():
            within = np.isin(modes.values(column), reading.with_sweeps(known)).astype(np.float64)
            reading.add(name, modes, within, f"MODE.{column}")
    _add_landed(reading)
    _add_throttle(reading)


def _add_landed(reading: Reading) -> None:
    events, arming = reading.tables.get("EV"), reading.tables.get("ARM")
    if events is not None and events.has("Id") and events.clock:
        numbers = events.values("Id")
        known = np.isin(numbers, list(LANDED_EVENTS))
        if known.any():
            values = np.array([LANDED_EVENTS[int(number)] for number in numbers[known].tolist()])
            reading.add("landed", events.where(known), values, "EV.Id")
    if "landed" not in reading.channels and arming is not None and arming.has("ArmState") and arming.clock:
        reading.add("landed", arming, (arming.values("ArmState") == 0.0).astype(np.float64), "ARM.ArmState")


def _add_throttle(reading: Reading) -> None:
    """Add the pilot's throttle as a share of its range."""
    sticks = reading.tables.get("RCIN")
    number = int(reading.parameters.get("RCMAP_THROTTLE", 3.0))
    column = next(
        (name for name in (f"C{number}", f"Ch{number}") if sticks is not None and sticks.has(name)), ""
    )
    if sticks is None or not column or not sticks.clock:
        return
    low, high = (
        reading.parameters.get(f"RC{number}_{end}", default) for end, default in (("MIN", 1e3), ("MAX", 2e3))
    )
    if not low < high:
        return
    widths = sticks.values(column)
    shares = np.where(widths > 0.0, np.clip((widths - low) / (high - low), 0.0, 1.0), np.nan)
    reading.add("pilot_throttle", sticks, shares, f"RCIN.{column}")
