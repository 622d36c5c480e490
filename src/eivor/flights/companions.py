"""Quantities of the same flight that another motion tells, once this one has told the lag.

What turns a vehicle and what carries it are the same actuators, behind one lag. Each motion has rows, sensors
and checks of its own, so that what is wrong with one of them moves nothing of the other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from eivor.errors import InputError
from eivor.flights.companion import Companion
from eivor.flights.estimated import EFFECTIVE_LAG
from eivor.flights.lag_beside import lag_told_by
from eivor.flights.motion import Motion
from eivor.flights.options import FlightOptions
from eivor.flights.quantity import Quantity
from eivor.flights.result import FlightEstimate
from eivor.flights.together import Window, identified
from eivor.signals.recording import Finding, Recording


@dataclass(frozen=True, slots=True)
class _Untold:
    """Why a quantity is not told."""

    why: str


def with_companions(
    result: FlightEstimate,
    motions: Mapping[str, Motion[Any]],
    logs: Sequence[Recording],
    windows: Sequence[Window],
) -> FlightEstimate:
    """Result with the quantities that other motions tell, and a finding for each that none tells.

    Parameters
    ----------
    result : FlightEstimate
        Of a motion with companions.
    motions : mapping of str to Motion
        Those that its companions name.
    logs : sequence of Recording
        Of the flights.
    windows : sequence of (start, end) or None
        A window [s] for each log, in place of the options'.
    """
    if result.fit is None:
        return result
    wording, found, findings = result.motion.wording, dict(result.quantities), list(result.findings)
    for one in result.motion.companions:
        told = _told(one, motions[one.motion], result, logs, windows)
        if isinstance(told, _Untold):
            sentence = f"The {wording[one.called].words} is refused: {told.why}."
            findings.append(Finding(f"no_{one.called}", sentence))
        else:
            found[one.called] = told
    ordered = {name: found[name] for name in wording if name in found}
    return replace(result, quantities=ordered, findings=tuple(findings))


def _told(
    one: Companion,
    motion: Motion[Any],
    result: FlightEstimate,
    logs: Sequence[Recording],
    windows: Sequence[Window],
) -> Quantity | _Untold:
    for words, names in one.needs.items():
        if not all(any(name in log.channels for name in names) for log in logs):
            return _Untold(f"no {words} is logged")
    asked = result.options
    options = FlightOptions(
        window=asked.window,
        max_tilt_deg=asked.max_tilt_deg,
        input=one.input,
        input_map=asked.input_map or one.input_map,
        method=asked.method,
        lag=asked.lag,
    )
    lag = lag_told_by(result.motion, result.quantities[EFFECTIVE_LAG])
    told = () if lag is None or asked.lag is not None else (lag,)
    try:
        other = identified(logs, motion, options, windows, told=told)
    except InputError as error:
        return _Untold(f"{error.expected} is missing")
    here, there = result.motion.wording[one.called].words, motion.wording[one.quantity].words
    found = other.quantities[one.quantity]
    reasons = (replace(why, sentence=why.sentence.replace(there, here)) for why in found.reasons)
    return replace(found, reasons=tuple(reasons))
