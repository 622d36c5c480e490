"""The JSON document keeps its keys, types and meaning."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import eivor as ev

DOCS = Path(__file__).parents[2] / "docs"

VERDICTS = {"identified", "weak", "provisional", "refused"}

NUMBER = (float, int, type(None))

PAIR = "pair"

#: Key to type; a dict is an object with exactly these keys, a list the type of every element.
QUANTITY: dict[str, Any] = {
    "value": NUMBER,
    "unit": str,
    "std_error": NUMBER,
    "interval": PAIR,
    "verdict": VERDICTS,
    "reasons": [str],
    "systematic": [
        {
            "counts": {"added", "at least", "independent", "factor"},
            "below": NUMBER,
            "above": NUMBER,
            "sentence": str,
        }
    ],
    "lowest": NUMBER,
}

SETS: dict[str, Any] = {**QUANTITY, "sets": (dict, type(None))}

ROW: dict[str, Any] = {
    "verdict": VERDICTS,
    "reasons": [str],
    "parameters": {"viscous_friction": QUANTITY, "input_gain": QUANTITY},
    "derived": {"hover_input": QUANTITY, "effective_lag": QUANTITY},
}

SCHEMA: dict[str, Any] = {
    "schema": {"eivor.identify/1"},
    "logs": [
        {
            "name": str,
            "format": str,
            "span": PAIR,
            "window": (list, type(None)),
            "runs": int,
            "samples": int,
            "rate_hz": NUMBER,
        }
    ],
    "model": {
        "name": str,
        "equation": str,
        "input": str,
        "input_map": str,
        "input_measured": bool,
        "autopilot_curve": {"side": (str, type(None)), "in_force": {}, "logged": {}},
    },
    "method": str,
    "instruments": str,
    "window": (list, type(None)),
    "samples": int,
    "rate_hz": NUMBER,
    "verdict": VERDICTS,
    "summary": str,
    "reasons": [str],
    "parameters": {
        "viscous_friction": SETS,
        "input_gain": QUANTITY,
        "actuator_lag": QUANTITY,
        "delay": QUANTITY,
        "intercept": {**QUANTITY, "by_segment": [NUMBER]},
    },
    "derived": {"time_constant": QUANTITY, "hover_input": QUANTITY, "effective_lag": QUANTITY},
    "implied": [],
    "figures": [
        {
            "name": str,
            "words": str,
            "value": NUMBER,
            "unit": str,
            "interval": (list, type(None)),
            "sentence": str,
        }
    ],
    "contradictions": [],
    "covariance": (dict, type(None)),
    "prediction": (dict, type(None)),
    "ahead": (dict, type(None)),
    "given_lag": (dict, type(None)),
    "diagnostics": dict,
    "findings": [{"name": str, "message": str}],
    "flights": [{"log": str, **ROW}],
    "by_flight": [{"log": str, "verdict": VERDICTS, "reasons": [str], "parameters": dict, "derived": dict}],
    "comparisons": [{"method": str, **ROW}],
    "provenance": {
        "version": str,
        "logs": [{"name": str, "sha256": (str, type(None))}],
        "options": {
            "window": (list, type(None)),
            "max_tilt_deg": float,
            "input": str,
            "input_map": str,
            "instruments": [str],
            "method": str,
            "compare": bool,
            "lag": (dict, type(None)),
            "align": bool,
            "accelerometer_bias": float,
            "pool_friction": {"auto", "common", "separate"},
            "pool_anyway": bool,
            "terms": [str],
            "rotor_radius": (float, type(None)),
            "controller_rate_hz": (float, type(None)),
            "order": (int, type(None)),
            "noise": (dict, str, type(None)),
        },
    },
}


def check(value, expected, where="document"):
    """Compare a value of JSON with the description above."""
    if expected == PAIR:
        assert isinstance(value, list), where
        assert len(value) == 2, where
        assert all(isinstance(end, NUMBER) for end in value), where
    elif isinstance(expected, dict):
        assert list(value) == list(expected), where
        for key in expected:
            check(value[key], expected[key], f"{where}.{key}")
    elif isinstance(expected, list):
        assert isinstance(value, list), where
        for element in value:
            check(element, expected[0], where)
    elif isinstance(expected, set):
        assert value in expected, where
    else:
        assert isinstance(value, expected), where


@pytest.fixture(params=["fit", pytest.param("pool", marks=pytest.mark.thorough), "still"])
def document(request):
    """The document of a flight, a pool, and a result without an estimate, read back."""
    result: ev.FlightEstimate = request.getfixturevalue(request.param)
    read: dict[str, Any] = json.loads(result.to_json())
    return read


def test_the_schema_holds(document):
    check(document, SCHEMA)


def test_every_key_is_documented(document):
    page = (DOCS / "json.md").read_text(encoding="utf-8")
    for key, value in document.items():
        assert f"| `{key}` |" in page
        nested = value[0] if isinstance(value, list) and value else value
        if key != "diagnostics" and isinstance(nested, dict):
            assert all(f"`{inner}`" in page for inner in nested), key
    diagnostics = (DOCS / "diagnostics.md").read_text(encoding="utf-8")
    assert all(f"`{key}`" in diagnostics for key in document["diagnostics"])


def test_numbers_are_finite_or_null(still):
    text = still.to_json()
    assert "NaN" not in text
    assert "Infinity" not in text
    friction = json.loads(text)["parameters"]["viscous_friction"]
    assert friction == {
        "value": None,
        "unit": "1/s",
        "std_error": None,
        "interval": [None, None],
        "verdict": "refused",
        "reasons": [],
        "systematic": [],
        "lowest": None,
        "sets": None,
    }


def test_text_is_ascii_whatever_the_log_is_called(fit):
    flight = fit.prepared[0]
    named = replace(flight, recording=replace(flight.recording, name="é\udcff\x1b"))
    text = replace(fit, prepared=(named,)).to_json()
    assert text.isascii()
    assert "\x1b" not in text
    assert json.loads(text)["logs"][0]["name"] == "é\udcff\x1b"
