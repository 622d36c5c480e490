"""Identification of the flights of a vehicle: preparation, estimate of a flight or of a pool, comparisons."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np

from eivor.errors import InputError, UsageError
from eivor.estimation.linear import OUTPUT_ERROR
from eivor.estimation.methods import TABLE, by_name
from eivor.flights.estimate import FlightState, LagMeasurements, estimated, lag_measured_by, lags_from_rates
from eivor.flights.lag_prior import EFFECTIVE_LAG, LagPrior
from eivor.flights.motion import Motion, for_flights
from eivor.flights.options import FlightOptions
from eivor.flights.pooling import agreement, left_out, pooled_result, with_references
from eivor.flights.prepare import Window, check_options, check_poolable, prepare, without_duplicates
from eivor.flights.quantity import CoupledAxis, Quantity
from eivor.flights.result import FlightEstimate, FlightRow
from eivor.inference.random_effects import homogeneity_p_value
from eivor.signals.recording import Finding, Recording
from eivor.tools import Progress, Stage, no_stage_callback


def identified(
    logs: Sequence[Recording],
    motion: Motion[Any],
    options: FlightOptions,
    windows: Sequence[Window],
    others: tuple[Motion[Any], ...] = (),
    lag_measurements: tuple[LagPrior, ...] = (),
    progress: Progress = no_stage_callback,
    prepared_states: dict[str, FlightState] | None = None,
) -> FlightEstimate:
    """Identify a motion from logs of one vehicle; `prepared_states` of others are used and updated."""
    prepared_states = {} if prepared_states is None else prepared_states
    by_name(options.method)  # unknown names are reported before anything is estimated
    check_options(motion, options)
    if len(windows) != len(logs):
        raise UsageError(
            f"{len(logs)} windows, one for each log", f"{len(windows)}", "Use None for a whole log."
        )
    progress(Stage.PREPARING)
    unique, dropped = without_duplicates(logs, windows)
    state = prepared_states.get(motion.name)
    if state is not None and (len(unique) > 1 or state.options != options or unique[0][1] is not None):
        state = None
    pairs = [(log, options if window is None else replace(options, window=window)) for log, window in unique]
    prepared = tuple(prepare(log, motion, each) for log, each in pairs) if state is None else state.prepared
    check_poolable(prepared, motion, anyway=options.pool_anyway)
    lag_source: LagMeasurements = partial(tuple, lag_measurements)
    if not lag_measurements and len(unique) == 1 and others:
        ((log, window),) = unique
        lag_source = cache(partial(lags_from_rates, others, log, window or options.window, prepared_states))
    state = state or FlightState(for_flights(motion, prepared, options), prepared, options, lag_source)
    progress(Stage.IDENTIFYING)
    if len(prepared) == 1:
        result = estimated(state, progress)
    else:
        single = replace(state, lag_measurements=tuple)
        choice = replace(options, method=by_name(options.method).of_flights)
        by_log = [estimated(replace(single, prepared=(flight,), options=choice)) for flight in prepared]
        over_identification = agreement([item.fit.checks for item in by_log if item.fit is not None])
        shared = with_references(prepared, options)
        state = replace(state, prepared=shared)
        used = [any(item is each for each in shared) for item in prepared]
        pool = pooled_result(single, by_log)
        together = replace(single, prepared=shared, agreement=over_identification)
        result = pool or estimated(together)
        if pool is None:
            omitted = left_out(itertools.compress(prepared, np.logical_not(used)))
            result = replace(result, findings=(*result.findings, *omitted))
        progress(Stage.DIAGNOSING)
        rows = [_row(flight.recording.name, item) for flight, item in zip(prepared, by_log, strict=True)]
        noticed = differences(result, list(itertools.compress(by_log, used)))
        result = replace(result, flights=tuple(rows), findings=(*result.findings, *noticed))
    result = replace(result, findings=(*dropped, *result.findings))
    if options.compare:
        output_error = motion.abilities.prediction.output_error
        names = [name for name in TABLE if name != OUTPUT_ERROR or output_error is not None]
        by_method = {name: replace(options, method=name, compare=False) for name in names}
        rows = [_row(name, estimated(replace(state, options=each))) for name, each in by_method.items()]
        result = replace(result, comparisons=tuple(rows))
    return result


#: A quantity differs among flights where a chi-square test of all has this p-value or less.
DIFFERENCE_P_VALUE = 1e-3


def differences(pool: FlightEstimate, results: Sequence[FlightEstimate]) -> Iterator[Finding]:
    """Quantities in which the single flights of a pool differ, by Cochran's test."""
    if pool.fit is None or pool.fit.pooled is not None:
        return  # its own tests say it
    for name, spec in pool.motion.quantities.items():
        if not spec.headline or spec.of_flight:
            continue
        quantities = [item.quantities[name] for item in results if name in item.quantities]
        numbers = np.array([(item.value, item.std_error) for item in quantities]).reshape(-1, 2)
        values, errors = numbers[np.isfinite(numbers).all(axis=1) & (numbers[:, 1] > 0.0)].T
        if values.size < 2:
            continue
        p_value = homogeneity_p_value(values, errors**2)
        if p_value <= DIFFERENCE_P_VALUE:
            low, high = (spec.scale * end for end in (values.min(), values.max()))
            ends = f"{low:.3g} to {high:.3g} {spec.shown_unit}".rstrip()
            yield Finding(
                "flights_differ",
                f"The flights, each by itself, differ in the {spec.words} by more than chance says (p "
                f"{p_value:.1g}): {ends}.",
            )


def _row(label: str, result: FlightEstimate) -> FlightRow:
    quantities = {
        name: result.quantities[name] for name in result.motion.quantities.rows if result.fit is not None
    }
    return FlightRow(label, result.verdict.status, quantities, result.verdict.sentences)


def with_coupled_axes(
    result: FlightEstimate,
    motions: Mapping[str, Motion[Any]],
    logs: Sequence[Recording],
    windows: Sequence[Window],
    known: Mapping[str, FlightEstimate],
) -> FlightEstimate:
    """Result with coupled quantities of other motions, or findings why they are absent."""
    if result.fit is None:
        return result
    wording, results, findings = result.motion.quantities, dict(result.quantities), list(result.findings)
    for axis in result.motion.abilities.coupled_axes:
        quantity = _coupled(axis, motions[axis.motion], result, logs, windows, known.get(axis.motion))
        if isinstance(quantity, Quantity):
            results[axis.called] = quantity
        else:
            sentence = f"The {wording[axis.called].words} is refused: {quantity}."
            findings.append(Finding(f"no_{axis.called}", sentence))
    ordered = {name: results[name] for name in wording if name in results}
    return replace(result, quantities=ordered, findings=tuple(findings))


def _coupled(
    axis: CoupledAxis,
    motion: Motion[Any],
    result: FlightEstimate,
    logs: Sequence[Recording],
    windows: Sequence[Window],
    coupled: FlightEstimate | None,
) -> Quantity | str:
    """The quantity of another motion, or why it is not identified."""
    for words, names in axis.needs.items():
        if not all(any(name in log.channels for name in names) for log in logs):
            return f"no {words} is logged"
    base = result.options
    options = FlightOptions(base.window, base.max_tilt_deg, axis.input, base.input_map or axis.input_map)
    options = replace(options, method=base.method, lag=base.lag)
    lag = lag_measured_by(result.motion, result.quantities[EFFECTIVE_LAG])
    measured = () if lag is None or base.lag is not None else (lag,)
    input_used = (options.input, options.input_map)
    try:
        if coupled is None or (coupled.prepared[0].input.name, coupled.prepared[0].input_map) != input_used:
            coupled = identified(logs, motion, options, windows, lag_measurements=measured)
    except InputError as error:
        return f"{error.expected} is missing"
    ours, theirs = result.motion.quantities[axis.called].words, motion.quantities[axis.quantity].words
    quantity = coupled.quantities[axis.quantity]
    reasons = (replace(reason, sentence=reason.sentence.replace(theirs, ours)) for reason in quantity.reasons)
    return replace(quantity, reasons=tuple(reasons))
