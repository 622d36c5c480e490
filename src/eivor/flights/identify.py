"""Identification of the flights of a vehicle: preparation, estimate of a flight or of a pool, comparisons."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

from eivor.errors import InputError, UsageError
from eivor.estimation.methods import TABLE, by_name
from eivor.flights.estimate import LagsBeside, Window, estimated, lag_told_by, lags_beside
from eivor.flights.lag_prior import (
    EFFECTIVE_LAG,
    ToldLag,
)
from eivor.flights.motion import Motion
from eivor.flights.options import FlightOptions
from eivor.flights.pooling import agreement, pooled_result
from eivor.flights.prepare import check_options, check_poolable, prepare, without_duplicates
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import Companion, Quantity
from eivor.flights.result import (
    FlightEstimate,
    FlightRow,
)
from eivor.signals.recording import Finding, Recording
from eivor.tools import Progress, Stage, silent


def identified(
    logs: Sequence[Recording],
    motion: Motion[Any],
    options: FlightOptions,
    windows: Sequence[Window],
    others: tuple[Motion[Any], ...] = (),
    told: tuple[ToldLag, ...] = (),
    progress: Progress = silent,
) -> FlightEstimate:
    """Identify a motion from the logs of one or several flights of one vehicle."""
    by_name(options.method)  # unknown names are told before anything is estimated
    check_options(motion, options)
    if len(windows) != len(logs):
        raise UsageError(
            f"{len(logs)} windows, one for each log", f"{len(windows)}", "Use None for a whole log."
        )
    progress(Stage.PREPARING)
    kept, dropped = without_duplicates(logs, windows)
    prepared = tuple(
        prepare(log, motion, options if window is None else replace(options, window=window))
        for log, window in kept
    )
    check_poolable(prepared, motion)
    motion = motion.for_flights(prepared, options)
    beside: LagsBeside = tuple
    if told:
        beside = cache(lambda: told)
    elif len(kept) == 1 and others:
        ((log, window),) = kept
        beside = cache(partial(lags_beside, others, log, window or options.window))
    progress(Stage.IDENTIFYING)
    result = _together(motion, prepared, options, beside, progress)
    result = replace(result, findings=(*dropped, *result.findings))
    if options.compare:
        rows = [
            _row(
                name, estimated(motion, prepared, replace(options, method=name, compare=False), beside=beside)
            )
            for name in TABLE
        ]
        result = replace(result, comparisons=tuple(rows))
    return result


def _together(
    motion: Motion[Any],
    prepared: tuple[PreparedFlight, ...],
    options: FlightOptions,
    beside: LagsBeside,
    progress: Progress,
) -> FlightEstimate:
    """One flight; or several, with each flight's own result beside them."""
    if len(prepared) == 1:
        return estimated(motion, prepared, options, beside=beside, progress=progress)
    alone = [estimated(motion, (flight,), options) for flight in prepared]
    result = pooled_result(motion, prepared, options, alone)
    if result is None:
        own = agreement([one.fit.checks for one in alone if one.fit is not None])
        result = estimated(motion, prepared, options, own)
    progress(Stage.DIAGNOSING)
    rows = [_row(flight.recording.name, own) for flight, own in zip(prepared, alone, strict=True)]
    return replace(result, flights=tuple(rows))


def _row(label: str, result: FlightEstimate) -> FlightRow:
    shown = {name: result.quantities[name] for name in result.motion.rows if result.fit is not None}
    return FlightRow(label, result.verdict.status, shown, result.verdict.sentences)


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
    """Result with the quantities that other motions tell, and a finding for each that none tells."""
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
