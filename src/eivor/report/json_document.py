"""JSON documents of results and inspections."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import version

import numpy as np

from eivor.estimation.derived import ParameterSets
from eivor.estimation.estimate import Estimate
from eivor.flights.lag_prior import TELEMETRY, LagPrior
from eivor.flights.motion import MultiStepPrediction
from eivor.flights.options import FlightOptions
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import Implied, Kind, Quantity
from eivor.flights.result import Fit, FlightEstimate
from eivor.inference.distributions import chi_square_quantile
from eivor.models.separable import Bounds, Prior
from eivor.motions.vertical.model import curve_in_force
from eivor.report.flight import FlightReport, QuantityReport, ReportRow, flight_report, of_kind
from eivor.report.inspection import AirborneTime, ChannelSummary, Inspection, PooledInspection
from eivor.report.saved_fit import IDENTIFY_SCHEMA
from eivor.signals.channels import common_side
from eivor.signals.recording import Finding

# -- JSON ahead --


def prediction_json(prediction: MultiStepPrediction | None) -> dict[str, object] | None:
    """Object of the predictions; None for none."""
    if prediction is None:
        return None
    return {
        "horizons": list(prediction.horizons_s),
        "starts": int(prediction.start_s.size),
        "errors": [
            {
                "model": error.model,
                "words": error.words,
                "quantity": error.quantity,
                "unit": error.unit,
                "rms": list(error.rms),
            }
            for error in prediction.errors
        ],
        "left_out": list(prediction.omitted),
        "sentence": prediction.sentence if prediction.errors else "",
    }


# -- JSON document --

#: Candidates that do not fit even at this level are left out.
WIDEST_LEVEL = 0.999

#: A value of JSON: null, a boolean, a number, a string, a list of values, or an object of them.
Json = object


def json_document(result: FlightEstimate) -> dict[str, Json]:
    """Document of a result."""
    return json_of(flight_report(result), result)


def json_of(record: FlightReport, result: FlightEstimate) -> dict[str, Json]:
    """Document of what is reported about a result, and of what besides only programs read."""
    rates = {flight.signals.rate_hz for flight in result.prepared}
    first = result.prepared[0]
    return {
        "schema": IDENTIFY_SCHEMA,
        "logs": [_log(flight) for flight in result.prepared],
        "model": {
            "name": result.motion.model_name,
            "equation": "; ".join(record.equation),
            "input": first.input.name,
            "input_map": first.input_map,
            "input_measured": first.input.measured,
            "autopilot_curve": _autopilot_curve(result.prepared),
        },
        "method": record.method,
        "instruments": record.instruments,
        "window": _pair(result.window_s),
        "samples": sum(int(flight.used.sum()) for flight in result.prepared),
        "rate_hz": number(rates.pop()) if len(rates) == 1 else None,
        "verdict": record.verdict.status.value,
        "summary": record.summary,
        "reasons": list(record.verdict.sentences),
        "parameters": _with_sets(_quantities(record.quantities, Kind.PARAMETER), result),
        "derived": _quantities(record.quantities, Kind.DERIVED),
        "implied": [_implied(item) for item in record.implications.numbers],
        "contradictions": list(record.implications.contradictions),
        "covariance": None if result.fit is None else _covariance(result.fit.estimate),
        "prediction": None if result.fit is None else _prediction(result, result.fit),
        "ahead": prediction_json(record.multi_step_prediction),
        "given_lag": None if result.fit is None else _lag_prior(result.fit.lag_prior),
        "diagnostics": {name: number(value) for name, value in record.diagnostics.items()},
        "findings": findings_list(record.findings),
        "flights": [_row("log", row) for row in record.flights],
        "by_flight": [_row("log", row) for row in record.by_flight],
        "comparisons": [_row("method", row) for row in record.comparisons],
        "provenance": {
            "version": version("eivor"),
            "logs": [
                {"name": flight.recording.name, "sha256": flight.recording.sha256 or None}
                for flight in result.prepared
            ],
            "options": _options(result.options),
        },
    }


def _autopilot_curve(flights: tuple[PreparedFlight, ...]) -> Json:
    """Side of the thrust curve that the input is on, null for unknown, and its parameters in force."""
    return {
        "side": common_side(flight.curve_side for flight in flights).value or None,
        "in_force": curve_in_force([flight.recording.parameters for flight in flights]),
    }


def _implied(implied: Implied) -> dict[str, Json]:
    """What follows for the vehicle, or does not."""
    return {
        "name": implied.name,
        "words": implied.words,
        "symbol": implied.symbol,
        "unit": implied.unit,
        "value": number(implied.value),
        "std_error": number(implied.std_error),
        "interval": None if implied.interval is None else [number(end) for end in implied.interval],
        "sentence": implied.sentence,
    }


def json_text(document: Mapping[str, Json]) -> str:
    """Text of a document: ASCII, two spaces of indent, a line break at the end."""
    return json.dumps(document, indent=2, ensure_ascii=True, allow_nan=False) + "\n"


def number(value: float | None) -> float | None:
    """`value` when it is finite, else None."""
    return None if value is None or not math.isfinite(value) else float(value)


def findings_list(findings: tuple[Finding, ...]) -> list[Json]:
    """Findings as objects with a name and a message."""
    return [{"name": finding.name, "message": finding.message} for finding in findings]


def _covariance(estimate: Estimate) -> Json:
    """Joint vector and its covariance, for each combination of the discrete nuisances that fits at all."""
    most = chi_square_quantile(WIDEST_LEVEL, estimate.choices)
    return {
        "names": list(estimate.names),
        "choices": estimate.choices,
        "candidates": [
            {
                "at": {name: number(value) for name, value in candidate.nuisances.items()},
                "best": candidate is estimate.best,
                "excess": number(excess),
                "values": [number(value) for value in candidate.values],
                "parts": [
                    {
                        "name": part.name,
                        "matrix": [[number(value) for value in row] for row in part.matrix],
                        "degrees": number(part.degrees),
                        "share": part.share,
                    }
                    for part in candidate.covariance.parts
                ],
            }
            for candidate, excess in zip(estimate.candidates, estimate.excesses, strict=True)
            if excess <= most
        ],
    }


def _prediction(result: FlightEstimate, fit: Fit) -> Json:
    """What a prediction of the same motion needs beside the quantities."""
    first = result.prepared[0]
    flying = tuple(flight.shortened for flight in result.prepared if flight.runs)
    intercepts = {
        name: [number(value) for value in result.quantities[name].by_run]
        for name, words in result.motion.wording.items()
        if words.by_run
    }
    return {
        "input": first.input.name,
        "input_map": first.input_map,
        "instruments": fit.instruments,
        "at": {name: number(value) for name, value in fit.estimate.best.nuisances.items()},
        "by_run": intercepts,
        "limits": {
            "max_tilt_deg": number(result.options.max_tilt_deg),
            "window": _pair(result.options.window),
            "band_hz": _pair(first.band_hz),
        },
        "beside": {
            name: {
                "words": simple.words,
                "values": {key: number(item) for key, item in simple.values.items()},
            }
            for name, simple in result.simple_models.items()
        },
        "input_level": number(float(np.mean([result.motion.input_level(flight) for flight in flying]))),
        "vehicle": result.motion.vehicle_record(),
        "flown": dict(result.motion.closed_loop_record(fit.problem, fit.estimate, flying)),
    }


def _pair(interval: tuple[float, float] | None) -> Json:
    return None if interval is None else [number(interval[0]), number(interval[1])]


def _log(flight: PreparedFlight) -> Json:
    used = flight.used.nonzero()[0]
    grid = flight.signals
    window = None
    if used.size:
        time = flight.grid.time_s
        window = (float(time[used[0]]), float(time[used[-1]]))
    return {
        "name": flight.recording.name,
        "format": flight.recording.format,
        "span": _pair(flight.recording.span_s),
        "window": _pair(window),
        "runs": len(flight.runs),
        "samples": int(used.size),
        "rate_hz": number(grid.rate_hz),
    }


def _quantities(quantities: tuple[QuantityReport, ...], kind: Kind) -> dict[str, dict[str, Json]]:
    """Quantities of one kind; what belongs to a run has its value in each besides."""
    return {
        item.name: _quantity_json(item.quantity)
        | {"lowest": number(item.wording.lowest)}
        | ({"by_segment": [number(value) for value in item.quantity.by_run]} if item.wording.by_run else {})
        for item in of_kind(quantities, kind)
    }


def _with_sets(parameters: dict[str, dict[str, Json]], result: FlightEstimate) -> dict[str, dict[str, Json]]:
    """Parameters, those of the headline with their three confidence sets."""
    sets = {} if result.fit is None else result.fit.sets
    return {
        name: fields | ({"sets": _sets(sets.get(name))} if name in result.motion.headline else {})
        for name, fields in parameters.items()
    }


def _sets(sets: ParameterSets | None) -> Json:
    if sets is None:
        return None
    three = {"wald": sets.wald, "profile": sets.profile, "anderson_rubin": sets.anderson_rubin}
    return {name: [_pair(piece) for piece in item.intervals] for name, item in three.items()}


def _quantity_json(quantity: Quantity) -> dict[str, Json]:
    return {
        "value": number(quantity.value),
        "unit": quantity.unit,
        "std_error": number(quantity.std_error),
        "interval": _pair(quantity.interval),
        "verdict": quantity.verdict.value,
        "reasons": [reason.sentence for reason in quantity.reasons],
        "systematic": [
            {
                "counts": systematic_uncertainty.counts.value,
                "below": number(systematic_uncertainty.below),
                "above": number(systematic_uncertainty.above),
                "sentence": systematic_uncertainty.sentence,
            }
            for systematic_uncertainty in quantity.systematic_uncertainties
        ],
    }


def _row(key: str, row: ReportRow) -> Json:
    return {
        key: row.label,
        "verdict": row.status.value,
        "reasons": list(row.reasons),
        "parameters": _quantities(row.quantities, Kind.PARAMETER),
        "derived": _quantities(row.quantities, Kind.DERIVED),
    }


def _lag_prior(given: LagPrior | None) -> Json:
    if given is None:
        return None
    by = given.by
    return {
        **_known_json(given.known),
        "alone": number(given.alone.value),
        "alone_interval": _pair(given.alone.interval),
        "p_value": number(given.p_value),
        "told_by": None if by is None else by.source,
        "told_interval": None if by is None else _pair(by.measured.interval),
        "telemetry_interval": _pair(by.measured.interval)
        if by is not None and by.source == TELEMETRY
        else None,
    }


def _options(options: FlightOptions) -> Json:
    plain: dict[str, Json] = dict(asdict(options))
    plain["window"] = _pair(options.window)
    plain["instruments"] = list(options.instruments)
    plain["accelerometer_bias"] = number(options.accelerometer_bias)
    plain["lag"] = None if options.lag is None else asdict(options.lag)
    return plain


def _known_json(known: Prior | Bounds) -> dict[str, Json]:
    """Mean and standard deviation, or bounds; null for what was not given."""
    names = ("mean", "std", "low", "high")
    return {name: number(getattr(known, name, None)) for name in names}


# -- JSON inspection --

INSPECT_SCHEMA = "eivor.inspect/1"
POOLED_SCHEMA = "eivor.inspect_pool/1"


def inspection_json(inspection: Inspection) -> dict[str, Json]:
    """Document of an inspection, ready for `json_text`."""
    log = inspection.recording
    return {
        "schema": INSPECT_SCHEMA,
        "log": {
            "name": log.name,
            "format": log.format,
            "frame": log.frame.name.lower(),
            "sha256": log.sha256 or None,
            "span": [number(end) for end in log.span_s],
        },
        "channels": [_channel(summary) for summary in inspection.channels],
        "missing": list(inspection.missing),
        "looked_for": {name: list(sources) for name, sources in log.looked_for.items()},
        "advice": list(inspection.advice),
        "airborne": None if inspection.airborne is None else _airborne(inspection.airborne),
        "tried": None if inspection.tried is None else [number(end) for end in inspection.tried],
        "references": [] if inspection.airborne is None else _references(inspection.airborne),
        "parameters": {name: number(value) for name, value in inspection.parameters.items()},
        "findings": findings_list(inspection.findings),
        "verdict": inspection.verdict,
        "reasons": list(inspection.reasons),
        "provenance": {"version": version("eivor")},
    }


def pooled_json(pooled_inspection: PooledInspection) -> dict[str, Json]:
    """Document of several logs, ready for `json_text`."""
    return {
        "schema": POOLED_SCHEMA,
        "logs": [inspection_json(log) for log in pooled_inspection.logs],
        "findings": []
        if pooled_inspection.result is None
        else findings_list(pooled_inspection.result.findings),
        "verdict": pooled_inspection.verdict,
        "reasons": list(pooled_inspection.reasons),
        "provenance": {"version": version("eivor")},
    }


def _channel(summary: ChannelSummary) -> Json:
    quality = summary.quality
    return {
        "name": summary.name,
        "source": summary.source,
        "unit": summary.unit,
        "samples": summary.samples,
        "rate_hz": number(summary.rate_hz),
        "held": summary.held,
        "estimated": summary.estimated,
        "delay_s": number(summary.delay_s),
        "range": [number(summary.lowest), number(summary.highest)],
        "gaps": [[number(start), number(end)] for start, end in summary.gaps],
        "duplicated_stamps": quality.duplicated_stamps,
        "backward_stamps": quality.backward_stamps,
        "evened_stamps": quality.evened_stamps,
        "missing_values": quality.missing_values,
        "overflowed": quality.overflowed,
        "saturated": quality.saturated,
    }


def _airborne(flight: AirborneTime) -> Json:
    return {
        "rule": flight.rule,
        "segments": [[number(start), number(end)] for start, end in flight.active],
        "used": [[number(start), number(end)] for start, end in flight.used],
    }


def _references(flight: AirborneTime) -> list[Json]:
    return [
        {"name": reference.name, "usable": reference.usable, "remark": reference.remark}
        for reference in flight.references
    ]
