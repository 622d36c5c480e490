"""Gaps in what a Crazyflie logged at a fixed frequency: records that did not reach the card."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from eivor.logs.crazyflie.records import Event
from eivor.signals.recording import Finding

#: A step of so many usual ones is a gap: three records or more are missing.
GAP = 3.5
#: Events of which so many steps are within half of the usual one are of a fixed frequency.
REGULAR_SHARE = 0.9


def gap_findings(events: Iterable[Event]) -> list[Finding]:
    """Say how many gaps there are in the events of a fixed frequency, and how long they are."""
    told = [sentence for event in events if (sentence := _told(event))]
    return [Finding("dropouts", f"Records are missing in {'; '.join(told)}.")] if told else []


def _told(event: Event) -> str:
    steps = np.diff(event.time_s)
    if steps.size < 3:
        return ""
    usual = float(np.median(steps))
    if usual <= 0.0 or np.mean(np.abs(steps - usual) <= 0.5 * usual) < REGULAR_SHARE:
        return ""
    gaps = 1e3 * steps[steps > GAP * usual]
    if not gaps.size:
        return ""
    length = f"{gaps.min():.3g} to {gaps.max():.3g} ms" if gaps.size > 1 else f"{gaps[0]:.3g} ms"
    word = "gaps" if gaps.size > 1 else "gap"
    return f"'{event.name[:60]}' ({gaps.size} {word} of {length}, steps of {1e3 * usual:.3g} ms otherwise)"
