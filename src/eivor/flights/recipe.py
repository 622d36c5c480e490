"""The recipe: recordings in, parameters with intervals and a verdict out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from eivor.errors import EstimationError, UsageError
from eivor.estimation.estimate import Estimate
from eivor.estimation.fit import identify
from eivor.estimation.methods import TABLE, by_name
from eivor.flights.diagnostics import diagnostics, findings
from eivor.flights.options import FlightOptions
from eivor.flights.pool import check_poolable, without_duplicates
from eivor.flights.prepare import PreparedFlight, contains_feedback, prepare
from eivor.flights.quantities import all_quantities, judged, nothing_estimated, segment_intercepts
from eivor.flights.result import FlightEstimate, FlightRow
from eivor.flights.rule import FLY, Circumstances
from eivor.inference.verdict import Reason, Status, verdict
from eivor.models.input_map import input_map
from eivor.models.instruments import InstrumentRule, LaggedInputs, LaggedReferences, NoInstruments
from eivor.models.vertical import VerticalMotion
from eivor.models.vertical_flights import VerticalFlights
from eivor.signals.recording import CANONICAL_UNITS, Recording

#: What a row of a pool or of a comparison shows.
ROW_QUANTITIES = ("viscous_friction", "input_gain", "effective_lag", "hover_input")
#: Method that serves when no instrument is at hand.
FALLBACK = "least_squares"


def identify_flight(
    recordings: Recording | Sequence[Recording],
    options: FlightOptions | None = None,
    *,
    windows: Sequence[tuple[float, float] | None] | None = None,
) -> FlightEstimate:
    """Identify the vertical motion of a flight, or of several flights of one vehicle together.

    Parameters
    ----------
    recordings : Recording or sequence of Recording
        From `read_log`. Several are pooled: friction, gain and lag are shared, intercepts are not.
        A log given twice is used once.
    options : FlightOptions, optional
        Default: the recipe's.
    windows : sequence of (start, end) or None, optional
        A window [s] for each recording, in place of the options' for those that have one.

    Returns
    -------
    FlightEstimate
        Also when the flight cannot tell: see its verdict.

    Raises
    ------
    InputError
        When a channel that is needed is absent.
    UsageError
        For options that do not fit, windows outside a log among them.
    PoolingError
        When the flights are of vehicles with different input maps or parameters.
    """
    logs = [recordings] if isinstance(recordings, Recording) else list(recordings)
    if not all(isinstance(log, Recording) for log in logs):
        raise UsageError(
            "recordings",
            ", ".join(sorted({type(log).__name__ for log in logs})),
            'Read the file first: ev.identify_flight(ev.read_log("flight.ulg")).',
        )
    if not logs:
        raise UsageError("at least one recording", "none", "Give one or several.")
    chosen = options or FlightOptions()
    by_name(chosen.method)  # unknown names are told before anything is estimated
    if chosen.input_map:
        input_map(chosen.input_map)
    spans = list(windows) if windows is not None else [None] * len(logs)
    if len(spans) != len(logs):
        raise UsageError(
            f"{len(logs)} windows, one for each log", f"{len(spans)}", "Use None for a whole log."
        )
    kept, dropped = without_duplicates(logs, spans)
    prepared = tuple(
        prepare(log, chosen if span is None else replace(chosen, window=span)) for log, span in kept
    )
    check_poolable(prepared)
    result = _identified(prepared, chosen)
    result = replace(result, findings=(*dropped, *result.findings))
    if len(prepared) > 1:
        rows = [_row(flight.recording.name, _identified((flight,), chosen)) for flight in prepared]
        result = replace(result, flights=tuple(rows))
    if chosen.compare:
        rows = [
            _row(name, _identified(prepared, replace(chosen, method=name, compare=False))) for name in TABLE
        ]
        result = replace(result, comparisons=tuple(rows))
    return result


def _identified(prepared: tuple[PreparedFlight, ...], options: FlightOptions) -> FlightEstimate:
    """Estimate with the method asked for, or with the fallback when it has no instruments."""
    flying = tuple(flight for flight in prepared if flight.flight.runs)
    if not flying:
        return _without_estimate(prepared, options, _grounded(prepared))
    if all(flight.constant_input for flight in flying):
        reason = Reason(Status.REFUSED, "The input is constant: it tells nothing about the vehicle.", FLY)
        return _without_estimate(prepared, options, reason)
    method = by_name(options.method)
    rule, at = _instruments(flying, options, needed=method.assembler.needs_instruments)
    if method.assembler.needs_instruments and isinstance(rule, NoInstruments):
        method = by_name(FALLBACK)
    try:
        problem = VerticalFlights(
            tuple(flight.flight for flight in flying), VerticalMotion(input_map(flying[0].input_map)), rule
        )
        estimate = identify(problem, method)
        return _with_estimate(prepared, options, problem, estimate, at)
    except EstimationError as error:
        return _without_estimate(prepared, options, Reason(Status.REFUSED, str(error), FLY))


def _with_estimate(
    prepared: tuple[PreparedFlight, ...],
    options: FlightOptions,
    problem: VerticalFlights,
    estimate: Estimate,
    at: Circumstances,
) -> FlightEstimate:
    overall, quantities = judged(estimate, all_quantities(problem, estimate), at)
    return FlightEstimate(
        options,
        prepared,
        problem,
        estimate,
        problem.rule.label,
        overall,
        quantities,
        segment_intercepts(problem, estimate),
        diagnostics(prepared, problem, estimate),
        findings(prepared, quantities["hover_input"].value),
    )


def _without_estimate(
    prepared: tuple[PreparedFlight, ...], options: FlightOptions, reason: Reason
) -> FlightEstimate:
    hover = float("nan")
    flying = [flight for flight in prepared if flight.flight.runs]
    if flying:
        means = [flight.flight.signals.family(flight.flight.input)[flight.used].mean() for flight in flying]
        hover = float(np.mean(means))
    return FlightEstimate(
        options,
        prepared,
        None,
        None,
        "none",
        verdict([reason]),
        nothing_estimated("", hover),
        np.empty(0),
        diagnostics(prepared, None, None),
        findings(prepared, hover),
    )


def _grounded(prepared: tuple[PreparedFlight, ...]) -> Reason:
    """Why no flight has a run."""
    flown = any(flight.airborne.mask.any() for flight in prepared)
    name, alone = prepared[0].recording.name, len(prepared) == 1
    if not flown:
        which = f"{name} never takes off" if alone else "No flight of the pool takes off"
        sentence = f"{which} (by {prepared[0].airborne.rule})."
        return Reason(Status.REFUSED, sentence, "Give a log of a flight.")
    return Reason(
        Status.REFUSED,
        f"{f'{name} has no' if alone else 'No flight of the pool has'} three seconds in the air without a "
        "gap, inside the window and below the largest tilt.",
        "Widen the window, allow more tilt with --max-tilt, or fly level.",
    )


def _instruments(
    flying: tuple[PreparedFlight, ...], options: FlightOptions, *, needed: bool
) -> tuple[InstrumentRule, Circumstances]:
    """Instruments for the method, and what the verdict needs to know of them and of the logs."""
    wanted = options.instruments or (("lags",) if options.method == "extended_iv" else ("references",))
    exogenous, missing, constant = True, "", False
    rule: InstrumentRule
    if not needed:
        rule = NoInstruments()
    elif wanted == ("lags",):
        rule, exogenous = LaggedInputs(), False
    else:
        shared = [name for name in flying[0].usable_references if _serves_all(name, flying)]
        rule = LaggedReferences(tuple(shared)) if shared else NoInstruments()
        exogenous = not any(contains_feedback(flight) for flight in flying)
        exogenous = exogenous and not any(_answers(name) for name in shared)
        if not shared:
            missing, constant = _why_no_reference(flying)
    variation, speed = _excitation(flying)
    return rule, Circumstances(
        flights=len(flying),
        command_rate_hz=min(flight.rates_hz["command"] for flight in flying),
        response_rate_hz=min(max(f.rates_hz["velocity"], f.rates_hz["acceleration"]) for f in flying),
        exogenous=exogenous,
        direct=not needed or isinstance(rule, NoInstruments),
        missing_reference=missing,
        constant_reference=constant,
        input_variation=variation,
        velocity_std=speed,
    )


def _answers(name: str) -> bool:
    """Whether a channel is one of the vehicle itself: its state, or the command that answers the state."""
    if name.startswith(("reference_", "pilot_")):
        return False
    return name in CANONICAL_UNITS or f"{name.rstrip('0123456789')}*" in CANONICAL_UNITS


def _excitation(flying: tuple[PreparedFlight, ...]) -> tuple[float, float]:
    """Relative standard deviation of the mapped input, and that of the vertical speed, over all runs."""
    motion = VerticalMotion(input_map(flying[0].input_map))
    inputs: list[Float[np.ndarray, " _"]] = []
    speeds: list[Float[np.ndarray, " _"]] = []
    for prepared in flying:
        flight = prepared.flight
        mapped = flight.mapped_input(motion, 0.0, 0.0)
        inputs.extend(mapped[run] for run in flight.runs)
        speeds.extend(flight.velocity[run] for run in flight.runs)
    mapped, speed = np.concatenate(inputs), np.concatenate(speeds)
    mean = abs(float(mapped.mean()))
    return float(mapped.std()) / mean if mean > 0.0 else float("nan"), float(speed.std())


def _serves_all(name: str, flying: tuple[PreparedFlight, ...]) -> bool:
    return all(name in flight.usable_references for flight in flying)


def _why_no_reference(flying: tuple[PreparedFlight, ...]) -> tuple[str, bool]:
    """Remarks on every reference, and whether one is logged and constant."""
    remarks = {f"{r.name}: {r.remark}" for flight in flying for r in flight.references if not r.usable}
    constant = any(r.remark == "constant" for flight in flying for r in flight.references)
    return "; ".join(sorted(remarks)) or "the log has none", constant


def _row(label: str, result: FlightEstimate) -> FlightRow:
    shown = {name: result.quantities[name] for name in ROW_QUANTITIES if result.estimate is not None}
    return FlightRow(label, result.verdict.status, shown, result.verdict.sentences)
