"""The JSON document of a validation, schema ``eivor.validate/1``, see docs/json.md."""

from __future__ import annotations

from importlib.metadata import version

from eivor.report.json_ahead import ahead_json
from eivor.report.json_document import Json, number
from eivor.report.validation import ModelPrediction, Validation

SCHEMA = "eivor.validate/1"


def validation_json(found: Validation) -> dict[str, Json]:
    """Document of a validation, ready for `json_text`."""
    log = found.flight.recording
    fitted = found.fit.document
    return {
        "schema": SCHEMA,
        "log": {"name": log.name, "sha256": log.sha256 or None},
        "fit": {
            "logs": fitted["provenance"]["logs"],
            "model": fitted["model"]["name"],
            "verdict": found.fit.verdict.value,
        },
        "predicts": found.predicts,
        "sentence": found.sentence,
        "runs": [[number(start), number(end)] for start, end in found.spans_s],
        "samples": int(found.flight.used.sum()),
        "rate_hz": number(found.flight.signals.rate_hz),
        "band": [number(end) for end in found.flight.band_hz],
        "predictions": [_prediction(one) for one in found.predictions],
        "ahead": ahead_json(found.ahead),
        "provenance": {"version": version("eivor")},
    }


def _prediction(one: ModelPrediction) -> Json:
    return {
        "model": one.model,
        "horizon": one.horizon.value,
        "quantity": one.quantity,
        "unit": one.unit,
        "rms": number(one.error.rms),
        "explained": number(one.error.explained),
        "by_run": [{"rms": number(run.rms), "explained": number(run.explained)} for run in one.by_run],
    }
