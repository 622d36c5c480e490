"""JSON documents of results and inspections."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass
from enum import Enum
from importlib.metadata import version

import numpy as np

from eivor.estimation.estimate import Estimate
from eivor.flights.lag_prior import TELEMETRY, LagPrior
from eivor.flights.motion import MultiStepPrediction
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import Kind
from eivor.flights.result import Fit, FlightEstimate
from eivor.inference.distributions import chi_square_quantile
from eivor.motions.vertical.model import curve_in_force
from eivor.report.flight import FlightReport, QuantityReport, ReportRow, flight_report, spans_of
from eivor.report.inspection import Inspection, PooledInspection
from eivor.report.saved_fit import IDENTIFY_SCHEMA
from eivor.signals.channels import common_side

# -- Values --

#: A value of JSON: null, a boolean, a number, a string, a list of values, or an object of them.
Json = object


def plain(value: object) -> Json:
    """A value as JSON has it: records are objects, arrays are lists, numbers are finite or null."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    elif isinstance(value, Enum):
        value = value.value
    elif is_dataclass(value):
        value = {item.name: getattr(value, item.name) for item in fields(value)}
    if isinstance(value, float):
        return number(value)
    if isinstance(value, Mapping):
        return {str(name): plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value


def document(schema: str, **parts: object) -> dict[str, Json]:
    """Document of a schema, with the version that wrote it."""
    provenance: object = parts.pop("provenance", {})
    made = {"version": version("eivor")} | dict(provenance if isinstance(provenance, Mapping) else {})
    return {name: plain(value) for name, value in ({"schema": schema} | parts | {"provenance": made}).items()}


def json_text(document: Mapping[str, Json]) -> str:
    """Text of a document: ASCII, two spaces of indent, a line break at the end."""
    return json.dumps(document, indent=2, ensure_ascii=True, allow_nan=False) + "\n"


def number(value: float | None) -> float | None:
    """`value` when it is finite, else None."""
    return None if value is None or not math.isfinite(value) else float(value)


# -- JSON ahead --


def prediction_json(prediction: MultiStepPrediction | None) -> dict[str, object]:
    """The key of multi-step predictions; null for none."""
    if prediction is None:
        return {"ahead": None}
    fields = {
        "horizons": prediction.horizons_s,
        "starts": prediction.start_s.size,
        "errors": [
            {name: getattr(error, name) for name in ("model", "words", "quantity", "unit", "rms")}
            for error in prediction.errors
        ],
        "left_out": prediction.omitted,
        "sentence": prediction.sentence if prediction.errors else "",
    }
    return {"ahead": fields}


# -- JSON document --

#: Candidates that do not fit even at this level are left out.
WIDEST_LEVEL = 0.999
OF_QUANTITY = ("value", "unit", "std_error", "interval", "verdict")


def json_document(result: FlightEstimate) -> dict[str, Json]:
    """Document of a result."""
    return json_of(flight_report(result))


def json_of(record: FlightReport) -> dict[str, Json]:
    """Document of what is reported about a result, and of what besides only programs read."""
    result = record.result
    first, fit = result.prepared[0], result.fit
    rates = {flight.signals.rate_hz for flight in result.prepared}
    parameters = _quantities(record.quantities, Kind.PARAMETER)
    for name in parameters:
        if name in result.motion.quantities.headline:
            sets = None if fit is None else fit.sets.get(name)
            three = ("wald", "profile", "anderson_rubin")
            parameters[name]["sets"] = sets and {word: getattr(sets, word).intervals for word in three}
    return document(
        IDENTIFY_SCHEMA,
        logs=[_log(flight) for flight in result.prepared],
        model={
            "name": result.motion.words.model,
            "equation": "; ".join(result.motion.equation),
            "input": first.input.name,
            "input_map": first.input_map,
            "input_measured": first.input.measured,
            # on which side of the autopilot's thrust curve the input is, and the parameters in force
            "autopilot_curve": {
                "side": common_side(flight.curve_side for flight in result.prepared).value or None,
                "in_force": curve_in_force([flight.recording.parameters for flight in result.prepared]),
            },
        },
        method=result.method,
        instruments=result.instruments,
        window=result.window_s,
        samples=sum(int(flight.used.sum()) for flight in result.prepared),
        rate_hz=rates.pop() if len(rates) == 1 else None,
        verdict=record.verdict.status,
        summary=record.summary,
        reasons=record.verdict.sentences,
        parameters=parameters,
        derived=_quantities(record.quantities, Kind.DERIVED),
        implied=result.implications.numbers,
        contradictions=result.implications.contradictions,
        covariance=None if fit is None else _covariance(fit.estimate),
        prediction=None if fit is None else _prediction(result, fit),
        **prediction_json(result.multi_step_prediction),
        given_lag=None if fit is None or fit.lag_prior is None else _lag_prior(fit.lag_prior),
        diagnostics=result.diagnostics,
        findings=result.findings,
        flights=[_row("log", row) for row in record.flights],
        by_flight=[_row("log", row) for row in record.by_flight],
        comparisons=[_row("method", row) for row in record.comparisons],
        provenance={
            "logs": [
                {"name": flight.recording.name, "sha256": flight.recording.sha256 or None}
                for flight in result.prepared
            ],
            "options": result.options,
        },
    )


def _covariance(estimate: Estimate) -> Json:
    """Joint vector and its covariance, for each combination of the discrete nuisances that fits at all."""
    most = chi_square_quantile(WIDEST_LEVEL, estimate.choices)
    return {
        "names": estimate.names,
        "choices": estimate.choices,
        "candidates": [
            {
                "at": candidate.nuisances,
                "best": candidate is estimate,
                "excess": excess,
                "values": candidate.values,
                "parts": candidate.joint_covariance.parts,
            }
            for candidate, excess in zip(estimate.candidates, estimate.excesses, strict=True)
            if excess <= most
        ],
    }


def _prediction(result: FlightEstimate, fit: Fit) -> Json:
    first = result.prepared[0]
    flying = tuple(flight.shortened for flight in result.prepared if flight.runs)
    abilities = result.motion.abilities
    record = abilities.closed_loop_record
    return {
        "input": first.input.name,
        "input_map": first.input_map,
        "instruments": fit.instruments,
        "at": fit.estimate.nuisances,
        "by_run": {
            name: result.quantities[name].by_run
            for name, words in result.motion.quantities.items()
            if words.by_run
        },
        "limits": {
            "max_tilt_deg": result.options.max_tilt_deg,
            "window": result.options.window,
            "band_hz": first.band_hz,
        },
        "beside": result.simple_models,
        "input_level": float(np.mean([flight.input_level for flight in flying])),
        "vehicle": None if abilities.vehicle is None else abilities.vehicle.record,
        "flown": {} if record is None else record(fit.problem, fit.estimate, flying),
    }


def _log(flight: PreparedFlight) -> Json:
    spans = spans_of(flight.used, flight.grid.time_s)
    return {
        "name": flight.recording.name,
        "format": flight.recording.format,
        "span": flight.recording.span_s,
        "window": (spans[0][0], spans[-1][1]) if spans else None,
        "runs": len(flight.runs),
        "samples": int(flight.used.sum()),
        "rate_hz": flight.signals.rate_hz,
    }


def _quantities(quantities: tuple[QuantityReport, ...], kind: Kind) -> dict[str, dict[str, object]]:
    """Quantities of one kind; what belongs to a run has its value in each besides."""
    return {
        item.name: {
            **{name: getattr(item.quantity, name) for name in OF_QUANTITY},
            "reasons": [reason.sentence for reason in item.quantity.reasons],
            "systematic": item.quantity.systematic_uncertainties,
            "lowest": item.wording.lowest,
        }
        | ({"by_segment": item.quantity.by_run} if item.wording.by_run else {})
        for item in quantities
        if item.wording.kind is kind
    }


def _row(key: str, row: ReportRow) -> Json:
    return {
        key: row.label,
        "verdict": row.status,
        "reasons": row.reasons,
        "parameters": _quantities(row.quantities, Kind.PARAMETER),
        "derived": _quantities(row.quantities, Kind.DERIVED),
    }


def _lag_prior(given: LagPrior) -> Json:
    by = given.by
    interval = None if by is None else by.measured.interval
    return {
        # a prior has the first two, bounds the others
        **{name: getattr(given.known, name, None) for name in ("mean", "std", "low", "high")},
        "alone": given.alone.value,
        "alone_interval": given.alone.interval,
        "p_value": given.p_value,
        "told_by": None if by is None else by.source,
        "told_interval": interval,
        "telemetry_interval": interval if by is not None and by.source == TELEMETRY else None,
    }


# -- JSON inspection --

INSPECT_SCHEMA = "eivor.inspect/1"
POOLED_SCHEMA = "eivor.inspect_pool/1"
OF_CHANNEL = ("name", "source", "unit", "samples", "rate_hz", "held", "estimated", "delay_s")


def inspection_json(inspection: Inspection) -> dict[str, Json]:
    """Document of an inspection, ready for `json_text`."""
    log, airborne = inspection.recording, inspection.airborne
    return document(
        INSPECT_SCHEMA,
        log={
            "name": log.name,
            "format": log.format,
            "frame": log.frame.name.lower(),
            "sha256": log.sha256 or None,
            "span": log.span_s,
        },
        channels=[
            {
                **{name: getattr(channel, name) for name in OF_CHANNEL},
                "range": (channel.lowest, channel.highest),
                "gaps": channel.gaps,
                **asdict(channel.quality),
            }
            for channel in inspection.channels
        ],
        missing=inspection.missing,
        looked_for=log.looked_for,
        advice=inspection.advice,
        airborne=airborne and {"rule": airborne.rule, "segments": airborne.active, "used": airborne.used},
        tried=inspection.tried,
        references=[
            {"name": reference.name, "usable": reference.usable, "remark": reference.remark}
            for reference in (airborne.references if airborne else ())
        ],
        parameters=inspection.parameters,
        findings=inspection.findings,
        verdict=inspection.verdict,
        reasons=inspection.reasons,
    )


def pooled_json(pooled: PooledInspection) -> dict[str, Json]:
    """Document of several logs, ready for `json_text`."""
    return document(
        POOLED_SCHEMA,
        logs=[inspection_json(log) for log in pooled.logs],
        findings=[] if pooled.result is None else pooled.result.findings,
        verdict=pooled.verdict,
        reasons=pooled.reasons,
    )
