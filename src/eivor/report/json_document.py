"""JSON documents: values, and the tree of a result, which is written and read by the same structures."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import version
from typing import Annotated, Any, TypeAlias

import msgspec
import numpy as np

from eivor.estimation.estimate import Estimate
from eivor.exports.autopilots import PARAMETERS
from eivor.flights.lag_prior import TELEMETRY, LagPrior
from eivor.flights.motion import MultiStepPrediction
from eivor.flights.options import MAX_TILT_DEG
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import KeyFigure, SimpleModel, SystematicUncertainty
from eivor.flights.result import Fit, FlightEstimate, FlightRow, LogEstimate
from eivor.inference.verdict import Status
from eivor.motions.vertical.model import curve_in_force, in_common
from eivor.report.document import QuantityRow, quantity_rows
from eivor.report.flight import result_card, row_quantities
from eivor.signals.channels import common_side
from eivor.signals.recording import Finding

#: A value of JSON: null, a boolean, a number, a string, a list of values, or an object of them.
Json = object
#: A number whose square is one; null for none, and for one that is not finite.
Number: TypeAlias = Annotated[float, msgspec.Meta(ge=-1e150, le=1e150)] | None
Pair: TypeAlias = tuple[Number, Number]


def plain(value: object) -> Any:
    """A value as JSON has it: records are objects, arrays are lists, numbers are finite or null."""
    return _finite(msgspec.to_builtins(value, str_keys=True, enc_hook=lambda item: item.tolist()))


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return number(value)
    if isinstance(value, dict):
        return {name: _finite(item) for name, item in value.items()}
    return [_finite(item) for item in value] if isinstance(value, list | tuple) else value


def document(schema: str, **parts: object) -> dict[str, Any]:
    """Document of a schema, with the version that wrote it."""
    made = {"schema": schema} | parts | {"provenance": {"version": version("eivor")}}
    return {name: plain(value) for name, value in made.items()}


def json_text(document: Mapping[str, Json]) -> str:
    """Text of a document: ASCII, two spaces of indent, a line break at the end."""
    return json.dumps(document, indent=2, ensure_ascii=True, allow_nan=False) + "\n"


def number(value: float | None) -> float | None:
    """`value` when it is finite, else None."""
    return None if value is None or not math.isfinite(value) else float(value)


#: Of a motion's result, and of the results of a log, which holds those of its motions.
MOTION_SCHEMA, LOG_SCHEMA = "eivor.identify/1", "eivor.identify/2"


class JsonQuantity(msgspec.Struct, kw_only=True):
    """A quantity; what belongs to a run has its value in each, a headline parameter its three sets."""

    value: Number
    unit: str
    std_error: Number
    interval: Pair
    verdict: Status
    reasons: Sequence[str] = ()
    systematic: Sequence[SystematicUncertainty] = ()
    lowest: Number = None
    by_segment: Sequence[Number] | msgspec.UnsetType = msgspec.UNSET
    sets: Any = msgspec.UNSET


class JsonRow(msgspec.Struct, kw_only=True):
    """One flight of a pool, or one method."""

    log: str | msgspec.UnsetType = msgspec.UNSET
    method: str | msgspec.UnsetType = msgspec.UNSET
    verdict: Status = Status.REFUSED
    reasons: Sequence[str] = ()
    parameters: Mapping[str, JsonQuantity]
    derived: Mapping[str, JsonQuantity]


class JsonLog(msgspec.Struct, kw_only=True):
    """A log, and what was used of it."""

    name: str
    format: str
    span: Pair | None = None
    window: Pair | None = None
    runs: int = 0
    samples: int = 0
    rate_hz: Number = None


class JsonModel(msgspec.Struct, kw_only=True, frozen=True):
    """What was identified, and what drove it."""

    name: str = ""
    equation: str = ""
    input: str = ""
    input_map: str = ""
    input_measured: bool = False
    #: On which side of the autopilot's thrust curve the input is, and the parameters in force
    autopilot_curve: Mapping[str, str | Mapping[str, float] | None] = {}


class JsonPart(msgspec.Struct, kw_only=True):
    """The covariance under one assumption on the residual."""

    name: str
    matrix: Sequence[Sequence[Number]]
    degrees: Number
    share: Annotated[float, msgspec.Meta(gt=0.0)]


class JsonCandidate(msgspec.Struct, kw_only=True):
    """The joint vector at one delay, in documents of before the delay was continuous."""

    at: Mapping[str, Number]
    best: bool
    values: Sequence[Number]
    parts: Annotated[Sequence[JsonPart], msgspec.Meta(min_length=1)]


class JsonCovariance(msgspec.Struct, kw_only=True):
    """The joint vector and its covariance."""

    names: Sequence[str] = ()
    at: Mapping[str, Number] = {}
    values: Sequence[Number] = ()
    parts: Sequence[JsonPart] = ()
    candidates: Sequence[JsonCandidate] | msgspec.UnsetType = msgspec.UNSET  # In place of the last three


class JsonPrediction(msgspec.Struct, kw_only=True):
    """What a prediction needs beside the quantities."""

    input: str = ""
    input_map: str = ""
    instruments: str = ""
    at: Mapping[str, Number]
    by_run: Mapping[str, Sequence[Number]] = {}
    limits: Mapping[str, float | Pair | None] = {}
    simple_models: Mapping[str, SimpleModel] = msgspec.field(default_factory=dict, name="beside")
    input_level: Number = None
    vehicle: Any = None
    flight_record: Any = msgspec.field(default_factory=dict, name="flown")

    @property
    def max_tilt_deg(self) -> float:
        """Largest tilt of the flights; the default one where a document does not say it [deg]."""
        most = self.limits.get("max_tilt_deg")
        return most if isinstance(most, float) else MAX_TILT_DEG


class JsonProvenance(msgspec.Struct, kw_only=True, frozen=True):
    """Where a document comes from."""

    version: str = ""
    logs: Sequence[Mapping[str, str | None]] = ()
    options: Mapping[str, Any] = {}


class FitDocument(msgspec.Struct, kw_only=True, rename={"schema_": "schema"}):
    """The document of a motion's result, as ``fit.to_json()`` writes it and `eivor.load_fit` reads it."""

    schema_: str = MOTION_SCHEMA
    logs: Sequence[JsonLog] = ()
    model: JsonModel = JsonModel()
    method: str = ""
    instruments: str = ""
    window: Pair | None = None
    samples: int = 0
    rate_hz: Number = None
    verdict: Status
    summary: str = ""
    reasons: Sequence[str]
    parameters: Mapping[str, JsonQuantity]
    derived: Mapping[str, JsonQuantity]
    implied: Any = ()
    figures: Sequence[KeyFigure] = ()
    contradictions: Sequence[str] = ()
    covariance: JsonCovariance | None = None
    prediction: JsonPrediction | None = None
    ahead: Any = None
    given_lag: Any = None
    diagnostics: Any = {}
    findings: Sequence[Finding] = ()
    flights: Sequence[JsonRow] = ()
    by_flight: Sequence[JsonRow] | None = None
    comparisons: Sequence[JsonRow] = ()
    provenance: JsonProvenance = JsonProvenance()


class LogDocument(msgspec.Struct, kw_only=True):
    """The results of every motion of a log."""

    motions: Annotated[Mapping[str, Any], msgspec.Meta(min_length=1)]  # A `FitDocument` each
    provenance: JsonProvenance = JsonProvenance()


def log_document(result: LogEstimate) -> dict[str, Any]:
    """Document of the results of a log; where they come from stands once."""
    motions = {name: json_document(item) for name, item in result.motions.items()}
    provenance = [item.pop("provenance") for item in motions.values() if item.pop("schema")]
    return {
        "schema": LOG_SCHEMA,
        "identified": list(result.identified),
        "weak": list(result.weak),
        "refused": list(result.refused),
        "motions": motions,
        "left_out": dict(result.left_out),
        "provenance": provenance[0],
    }


def json_document(result: FlightEstimate) -> dict[str, Any]:
    """Document of a motion's result."""
    return plain(fit_document(result))


def fit_document(result: FlightEstimate) -> FitDocument:
    """Tree of a motion's result."""
    motion, first, fit = result.motion, result.prepared[0], result.fit
    rates = {flight.signals.rate_hz for flight in result.prepared}
    rows = quantity_rows(result.quantities, motion.quantities)
    parameters = _quantities(rows, derived=False)
    for name in parameters:
        if name in motion.quantities.headline:
            sets = None if fit is None else fit.sets.get(name)
            three = ("wald", "profile", "anderson_rubin")
            parameters[name].sets = sets and {word: getattr(sets, word).intervals for word in three}
    logs = [_log(flight) for flight in result.prepared]
    logged = [flight.recording.parameters for flight in result.prepared]
    return FitDocument(
        logs=logs,
        model=JsonModel(
            name=motion.words.model,
            equation="; ".join(motion.equation),
            input=first.input.name,
            input_map=first.input_map,
            input_measured=first.input.measured,
            autopilot_curve={
                "side": common_side(flight.curve_side for flight in result.prepared).value or None,
                "in_force": curve_in_force(logged),
                "logged": {name: value for name, value in in_common(logged).items() if name in PARAMETERS},
            },
        ),
        method=result.method,
        instruments=result.instruments,
        window=result.window_s,
        samples=sum(log.samples for log in logs),
        rate_hz=rates.pop() if len(rates) == 1 else None,
        verdict=result.verdict.status,
        summary=result_card((result,)).title,
        reasons=result.verdict.sentences,
        parameters=parameters,
        derived=_quantities(rows, derived=True),
        implied=result.implications.numbers,
        figures=result.figures,
        contradictions=result.implications.contradictions,
        covariance=None if fit is None else _covariance(fit.estimate),
        prediction=None if fit is None else _prediction(result, fit),
        ahead=prediction_json(result.multi_step_prediction),
        given_lag=None if fit is None or fit.lag_prior is None else _lag_prior(fit.lag_prior),
        diagnostics=result.diagnostics,
        findings=result.findings,
        flights=[_row(row, row_quantities(row, motion), log=row.label) for row in result.flights],
        by_flight=[
            _row(row, quantity_rows(row.quantities, motion.quantities), log=row.label)
            for row in result.by_flight
        ],
        comparisons=[_row(row, row_quantities(row, motion), method=row.label) for row in result.comparisons],
        provenance=JsonProvenance(
            version=version("eivor"),
            logs=[
                {"name": flight.recording.name, "sha256": flight.recording.sha256 or None}
                for flight in result.prepared
            ],
            options=asdict(result.options),
        ),
    )


def _log(flight: PreparedFlight) -> JsonLog:
    time, log = flight.grid.time_s[flight.used], flight.recording
    return JsonLog(
        name=log.name,
        format=log.format,
        span=log.span_s,
        window=(float(time[0]), float(time[-1])) if time.size else None,
        runs=len(flight.runs),
        samples=time.size,
        rate_hz=flight.signals.rate_hz,
    )


def _quantities(rows: Sequence[QuantityRow], *, derived: bool) -> dict[str, JsonQuantity]:
    return {
        row.name: JsonQuantity(
            value=row.quantity.value,
            unit=row.quantity.unit,
            std_error=row.quantity.std_error,
            interval=row.quantity.interval,
            verdict=row.quantity.verdict,
            reasons=[reason.sentence for reason in row.quantity.reasons],
            systematic=row.quantity.systematic_uncertainties,
            lowest=row.wording.lowest,
            by_segment=row.quantity.by_run if row.wording.by_run else msgspec.UNSET,
        )
        for row in rows
        if row.wording.derived is derived
    }


def _row(row: FlightRow, quantities: Sequence[QuantityRow], **label: str) -> JsonRow:
    parameters, derived = (_quantities(quantities, derived=item) for item in (False, True))
    return JsonRow(**label, verdict=row.verdict, reasons=row.reasons, parameters=parameters, derived=derived)


def _covariance(estimate: Estimate) -> JsonCovariance:
    parts = (
        JsonPart(name=part.name, matrix=part.matrix.tolist(), degrees=part.degrees, share=part.share)
        for part in estimate.joint_covariance.parts
    )
    return JsonCovariance(
        names=estimate.names, at=estimate.nuisances, values=estimate.values.tolist(), parts=list(parts)
    )


def _prediction(result: FlightEstimate, fit: Fit) -> JsonPrediction:
    first, abilities = result.prepared[0], result.motion.abilities
    record = abilities.closed_loop_record
    flying = tuple(flight.shortened for flight in result.prepared if flight.runs)
    return JsonPrediction(
        input=first.input.name,
        input_map=first.input_map,
        instruments=fit.instruments,
        at=fit.estimate.nuisances,
        by_run={
            name: result.quantities[name].by_run
            for name, words in result.motion.quantities.items()
            if words.by_run
        },
        limits={
            "max_tilt_deg": result.options.max_tilt_deg,
            "window": result.options.window,
            "band_hz": first.band_hz,
        },
        simple_models=result.simple_models,
        input_level=float(np.mean([flight.input_level for flight in flying])),
        vehicle=None if abilities.vehicle is None else abilities.vehicle.record,
        flight_record={} if record is None else record(fit.problem, fit.estimate, flying),
    )


def _lag_prior(given: LagPrior) -> Json:
    interval = None if given.measured is None else given.measured.interval
    return {
        # a prior has the first two, bounds the others
        **{name: getattr(given.known, name, None) for name in ("mean", "std", "low", "high")},
        "alone": given.flight_lag.value,
        "alone_interval": given.flight_lag.interval,
        "p_value": given.p_value,
        "told_by": given.source or None,
        "told_interval": interval,
        "telemetry_interval": interval if given.source == TELEMETRY else None,
    }


def prediction_json(prediction: MultiStepPrediction | None) -> Json:
    """Multi-step predictions; null for none."""
    return prediction and {
        "horizons": prediction.horizons_s,
        "starts": prediction.start_s.size,
        "errors": [
            {name: getattr(error, name) for name in ("model", "words", "quantity", "unit", "rms", "theil")}
            for error in prediction.errors
        ],
        "left_out": prediction.omitted,
        "sentence": prediction.sentence if prediction.errors else "",
    }
