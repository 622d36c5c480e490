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

TYPES = (
    {"text": str, "count": int, "number": NUMBER, "real": float, "flag": bool, "object": dict, "pair": PAIR}
    | {"verdict": VERDICTS, "texts": [str], "list?": (list, type(None)), "object?": (dict, type(None))}
    | {"text?": (str, type(None)), "number?": (float, type(None)), "order?": (int, type(None))}
    | {"noise?": (dict, str, type(None))}
)


def keys(row, **others):
    """Keys of a row "key:type ..." and of others with their types, in order."""
    return {key: TYPES[kind] for key, kind in (pair.split(":") for pair in row.split())} | others


#: Key to type; a dict is an object with exactly these keys, a list the type of every element.
QUANTITY: dict[str, Any] = {
    **keys("value:number unit:text std_error:number interval:pair verdict:verdict reasons:texts"),
    "systematic": [
        {
            "counts": {"added", "at least", "independent", "factor"},
            **keys("below:number above:number sentence:text"),
        }
    ],
    "lowest": NUMBER,
}
SETS: dict[str, Any] = {**QUANTITY, "sets": (dict, type(None))}
ROW: dict[str, Any] = keys(
    "verdict:verdict reasons:texts",
    parameters={"viscous_friction": QUANTITY, "input_gain": QUANTITY},
    derived={"hover_input": QUANTITY, "effective_lag": QUANTITY},
)
SCHEMA: dict[str, Any] = {
    "schema": {"eivor.identify/1"},
    "logs": [keys("name:text format:text span:pair window:list? runs:count samples:count rate_hz:number")],
    "model": keys(
        "name:text equation:text input:text input_map:text input_measured:flag",
        autopilot_curve={"side": (str, type(None)), "in_force": {}, "logged": {}},
    ),
    **keys("method:text instruments:text window:list? samples:count rate_hz:number"),
    **keys("verdict:verdict summary:text reasons:texts"),
    "parameters": dict.fromkeys(("viscous_friction", "input_gain", "actuator_lag", "delay"), QUANTITY)
    | {"viscous_friction": SETS, "intercept": {**QUANTITY, "by_segment": [NUMBER]}},
    "derived": {"time_constant": QUANTITY, "hover_input": QUANTITY, "effective_lag": QUANTITY},
    "implied": [],
    "figures": [keys("name:text words:text value:number unit:text interval:list? sentence:text")],
    "contradictions": [],
    **keys("covariance:object? prediction:object? ahead:object? given_lag:object? diagnostics:object"),
    "findings": [keys("name:text message:text")],
    "flights": [{"log": str, **ROW}],
    "by_flight": [keys("log:text verdict:verdict reasons:texts parameters:object derived:object")],
    "comparisons": [{"method": str, **ROW}],
    "provenance": {
        "version": str,
        "logs": [keys("name:text sha256:text?")],
        "options": {
            **keys("window:list? max_tilt_deg:real input:text input_map:text instruments:texts method:text"),
            **keys("compare:flag lag:object? align:flag accelerometer_bias:real"),
            "pool_friction": {"auto", "common", "separate"},
            **keys("pool_anyway:flag terms:texts rotor_radius:number? controller_rate_hz:number?"),
            **keys("order:order? noise:noise?"),
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
