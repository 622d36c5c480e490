"""The JSON document of a result, schema ``eivor.identify/1``; every key is described in docs/json.md.

Keys never disappear: what a result does not have is null or empty. Numbers are finite or null.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import version

from eivor.flights.options import FlightOptions
from eivor.flights.prepare import PreparedFlight
from eivor.flights.quantities import nothing_estimated
from eivor.flights.result import FlightEstimate, FlightRow, Quantity
from eivor.signals.recording import Finding

SCHEMA = "eivor.identify/1"
PARAMETERS = ("viscous_friction", "input_gain", "intercept", "actuator_lag", "delay")
DERIVED = ("effective_lag", "hover_input", "time_constant")
#: What a row of `flights` or `comparisons` has.
ROW_PARAMETERS = ("viscous_friction", "input_gain")
ROW_DERIVED = ("effective_lag", "hover_input")
EQUATION = "z'' + g = K_u U - K z' + b; U = cos(tilt) * mean(map(w)); tau w' + w = command(t - d)"

#: A value of JSON: null, a boolean, a number, a string, a list of values, or an object of them.
Json = object


def json_document(result: FlightEstimate) -> dict[str, Json]:
    """Document of a result.

    Parameters
    ----------
    result : FlightEstimate
        With or without an estimate.

    Returns
    -------
    dict
        Ready for `json_text`.
    """
    rates = {flight.flight.signals.rate_hz for flight in result.prepared}
    first = result.prepared[0]
    parameters = _quantities(result.quantities, PARAMETERS)
    intercept = parameters["intercept"]
    if isinstance(intercept, dict):
        intercept["by_segment"] = [number(float(value)) for value in result.by_segment]
    return {
        "schema": SCHEMA,
        "logs": [_log(flight) for flight in result.prepared],
        "model": {
            "name": "vertical_motion",
            "equation": EQUATION,
            "input": first.flight.input,
            "input_map": first.input_map,
            "input_measured": first.flight.measured,
        },
        "method": result.method,
        "instruments": result.instruments,
        "window": _pair(result.window_s),
        "samples": sum(int(flight.used.sum()) for flight in result.prepared),
        "rate_hz": number(rates.pop()) if len(rates) == 1 else None,
        "verdict": result.verdict.status.value,
        "reasons": list(result.verdict.sentences),
        "parameters": parameters,
        "derived": _quantities(result.quantities, DERIVED),
        "diagnostics": {name: number(value) for name, value in result.diagnostics.items()},
        "findings": findings_list(result.findings),
        "flights": [_row("log", row) for row in result.flights],
        "comparisons": [_row("method", row) for row in result.comparisons],
        "provenance": {
            "version": version("eivor"),
            "logs": [
                {"name": flight.recording.name, "sha256": flight.recording.sha256 or None}
                for flight in result.prepared
            ],
            "options": _options(result.options),
        },
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


def _pair(interval: tuple[float, float] | None) -> Json:
    return None if interval is None else [number(interval[0]), number(interval[1])]


def _log(flight: PreparedFlight) -> Json:
    used = flight.used.nonzero()[0]
    grid = flight.flight.signals
    window = None
    if used.size:
        window = (grid.start_s + used[0] * grid.step_s, grid.start_s + used[-1] * grid.step_s)
    return {
        "name": flight.recording.name,
        "format": flight.recording.format,
        "span": _pair(flight.recording.span_s),
        "window": _pair(window),
        "runs": len(flight.flight.runs),
        "samples": int(used.size),
        "rate_hz": number(grid.rate_hz),
    }


def _quantities(quantities: Mapping[str, Quantity], names: tuple[str, ...]) -> dict[str, Json]:
    return {name: _quantity(quantities[name]) for name in names}


def _quantity(quantity: Quantity) -> Json:
    return {
        "value": number(quantity.value),
        "unit": quantity.unit,
        "std_error": number(quantity.std_error),
        "interval": _pair(quantity.interval),
        "verdict": quantity.verdict.value,
    }


def _row(key: str, row: FlightRow) -> Json:
    quantities = dict(nothing_estimated("", float("nan"))) | dict(row.quantities)
    return {
        key: row.label,
        "verdict": row.verdict.value,
        "reasons": list(row.reasons),
        "parameters": _quantities(quantities, ROW_PARAMETERS),
        "derived": _quantities(quantities, ROW_DERIVED),
    }


def _options(options: FlightOptions) -> Json:
    plain: dict[str, Json] = dict(asdict(options))
    plain["window"] = _pair(options.window)
    plain["instruments"] = list(options.instruments)
    return plain
