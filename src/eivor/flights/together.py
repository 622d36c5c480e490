"""From recordings to a result: every flight by itself, and several together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial
from typing import Any

from eivor.errors import UsageError
from eivor.estimation.methods import TABLE, by_name
from eivor.flights.lag_beside import lags_beside
from eivor.flights.motion import Motion
from eivor.flights.options import FlightOptions
from eivor.flights.pool import check_poolable, without_duplicates
from eivor.flights.prepare import prepare
from eivor.flights.prepared import PreparedFlight
from eivor.flights.recipe import LagsBeside, estimated
from eivor.flights.result import FlightEstimate, FlightRow
from eivor.flights.stages import Progress, Stage, silent
from eivor.flights.terms import check_options
from eivor.flights.told_lag import ToldLag
from eivor.signals.recording import Recording

Window = tuple[float, float] | None


def identified(
    logs: Sequence[Recording],
    motion: Motion[Any],
    options: FlightOptions,
    windows: Sequence[Window],
    others: tuple[Motion[Any], ...] = (),
    told: tuple[ToldLag, ...] = (),
    progress: Progress = silent,
) -> FlightEstimate:
    """Identify a motion from the logs of one or several flights of one vehicle.

    Parameters
    ----------
    logs : sequence of Recording
        Several are pooled: what belongs to the vehicle is shared, what belongs to a flight or a run is
        not. A log given twice is used once.
    motion : Motion
        What to identify.
    options : FlightOptions
        Choices.
    windows : sequence of (start, end) or None
        A window [s] for each log, in place of the options' for those that have one.
    others : tuple of Motion
        Those that `Motion.lag_from` names. Flights of a pool tell their lag together, and need none.
    told : tuple of ToldLag
        What is known of the lag already, in place of what the others would tell of one flight.
    progress : callable
        See `Progress`.

    Raises
    ------
    InputError
        When a channel that is needed is absent.
    UsageError
        For options that do not fit, windows outside a log among them.
    PoolingError
        When the flights are of vehicles with different input maps or parameters.
    """
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
    from eivor.flights.pool_verdict import agreement  # late: most calls are of one flight
    from eivor.flights.pooled import pooled_result

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
