"""The comparison of two parity records: what may differ, what must be listed, what is an error."""

from __future__ import annotations

import copy
import json

import pytest

from validation.parity.compare import CHANGED, DIFFERENT, Change, changes, compare, main
from validation.parity.flights import key_paths, told
from validation.parity.record import lines
from validation.parity.where import Done

QUANTITY = {"value": 0.5, "std_error": 0.01, "interval": [0.48, 0.52], "verdict": "identified"}
LINE = {"std_error": [0.1, 2.0], "low": [-0.2, 4.0], "high": [0.2, 12.0]}
RECORD = {
    "identify": {
        "flights": {
            "example": {
                "exit_code": 0,
                "document": {
                    "verdict": "identified",
                    "reasons": ["It moved."],
                    "samples": 6000,
                    "parameters": {"friction": QUANTITY, "delay": {"value": 0.0, "std_error": None}},
                    "diagnostics": {"J": 10.0, "J_p_value": 1e-6},
                },
            }
        },
        "keys": ["verdict"],
    },
    "problems": {
        "line": {
            "least_squares": {
                "status": "identified",
                "condition": 10.0,
                "values": [0.0, 8.0],
                "covariances": {"cosines": LINE},
            },
            "filip": {"condition": 1e10, "values": [1.0]},
            "refused": {"error": "InstrumentError"},
        }
    },
    "flight_study": {
        "columns": ["verdict", "recipe.K.value", "recipe.K.low", "recipe.K.high"],
        "trials": {"calm": ["identified", 0.5, 0.3, 0.7]},
    },
}
FRICTION = "identify/flights/example/document/parameters/friction"
LEAST_SQUARES = "problems/line/least_squares"


def changed(path: str, value: object) -> dict:
    """The record with one entry replaced."""
    record = copy.deepcopy(RECORD)
    *folders, last = path.split("/")
    at = record
    for name in folders:
        at = at[int(name)] if isinstance(at, list) else at[name]
    at[int(last) if isinstance(at, list) else last] = value
    return record


def test_a_record_agrees_with_itself():
    result = compare(RECORD, copy.deepcopy(RECORD), [])
    assert result.agrees
    assert result.equal > 30
    assert not result.reworded
    assert not result.added


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (f"{FRICTION}/value", 0.5 + 0.9e-5),  # a thousandth of the standard error is 1e-5
        (f"{FRICTION}/interval/0", 0.48 - 0.9e-5),
        ("identify/flights/example/document/diagnostics/J", 10.009),
        ("identify/flights/example/document/diagnostics/J_p_value", 1.01e-6),
        (f"{LEAST_SQUARES}/values/0", 0.9e-10),  # zero, measured by its standard error of 0.1
        (f"{LEAST_SQUARES}/values/1", 8.0 + 7e-9),
        (f"{LEAST_SQUARES}/covariances/cosines/low/0", -0.2 - 1.9e-10),
        ("problems/line/filip/values/0", 1.0 + 2e-6),  # 2.2e-16 times a condition of 1e10
        ("flight_study/trials/calm/1", 0.5 + 0.9e-4),  # the interval is four standard errors long
    ],
)
def test_what_may_differ(path, value):
    assert compare(RECORD, changed(path, value), []).agrees


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (f"{FRICTION}/value", 0.5 + 1.2e-5),
        (f"{FRICTION}/value", None),
        (f"{FRICTION}/interval/1", 0.52 + 1.2e-5),
        (f"{FRICTION}/std_error", 0.01002),
        (f"{FRICTION}/verdict", "weak"),
        ("identify/flights/example/document/parameters/delay/value", 0.01),
        ("identify/flights/example/document/diagnostics/J", 10.011),
        ("identify/flights/example/document/diagnostics/J_p_value", 1.03e-6),
        ("identify/flights/example/document/samples", 5999),
        ("identify/flights/example/exit_code", 3),
        ("identify/keys", []),
        (f"{LEAST_SQUARES}/values/0", 1.1e-10),
        (f"{LEAST_SQUARES}/values/1", 8.0 + 9e-9),
        (f"{LEAST_SQUARES}/covariances/cosines/std_error/1", 2.0 + 3e-9),
        (f"{LEAST_SQUARES}/covariances/cosines/high/1", 12.0 + 13e-9),
        (f"{LEAST_SQUARES}/status", "weak"),
        ("problems/line/filip/values/0", 1.0 + 3e-6),
        ("problems/line/refused", {"condition": 1.0}),
        ("problems/line/refused/error", "UsageError"),
        ("flight_study/trials/calm/0", "weak"),
        ("flight_study/trials/calm/1", 0.5 + 1.3e-4),
    ],
)
def test_what_may_not_differ(path, value):
    result = compare(RECORD, changed(path, value), [])
    assert not result.agrees
    assert len(result.unexplained) == 1
    assert result.unexplained[0].path.startswith(path)


def test_sentences_and_new_keys_are_listed():
    record = changed("identify/flights/example/document/reasons/0", "The reference moved it.")
    record["identify"]["flights"]["example"]["document"]["covariance"] = {"names": ["friction"]}
    result = compare(RECORD, record, [])
    assert result.agrees
    assert [difference.new for difference in result.reworded] == ["The reference moved it."]
    assert result.added == ["identify/flights/example/document/covariance/names/0"]


def test_a_listed_change_is_told_and_must_be_there():
    listed = [Change("problems/*/status", 12, "Refused now.")]
    result = compare(RECORD, changed(f"{LEAST_SQUARES}/status", "refused"), listed)
    assert result.agrees
    assert [str(difference) for difference in result.explained[0][1]] == [
        f"{LEAST_SQUARES}/status: identified -> refused"
    ]
    unmet = compare(RECORD, RECORD, listed)
    assert not unmet.agrees
    assert unmet.unmet == listed
    other = compare(RECORD, changed(f"{FRICTION}/verdict", "weak"), listed)
    assert len(other.unexplained) == 1


def test_the_listed_changes_can_be_read():
    for change in changes(CHANGED.read_text(encoding="utf-8")):
        assert change.pattern
        assert change.why
        assert change.finding > 0


def test_the_command(tmp_path, capsys):
    files = [tmp_path / name for name in ("old.json", "new.json", "changed.toml")]
    files[0].write_text(lines(RECORD))
    files[1].write_text(json.dumps(changed(f"{LEAST_SQUARES}/status", "weak")))
    files[2].write_text("")
    arguments = [str(files[0]), str(files[1]), "--changed", str(files[2])]
    assert main(arguments) == DIFFERENT
    assert f"DIFFERENT: {LEAST_SQUARES}/status: identified -> weak" in capsys.readouterr().out
    files[2].write_text('[[changed]]\npattern = "*/status"\nfinding = 13\nwhy = "No freedom is left."\n')
    assert main(arguments) == 0
    assert "Finding 13: No freedom is left." in capsys.readouterr().out


def test_documents_are_kept_without_what_is_of_the_day():
    document = {
        "findings": [{"name": "b", "message": "B."}, {"name": "a", "message": "A."}],
        "provenance": {"version": "1", "options": {"window": None}},
    }
    kept = told(Done(3, json.dumps(document), ""))
    assert kept == {
        "exit_code": 3,
        "document": {"findings": {"a": ["A."], "b": ["B."]}, "provenance": {"options": {"window": None}}},
    }
    assert told(Done(1, "", "Expected a log\n")) == {"exit_code": 1, "message": "Expected a log"}
    assert sorted(set(key_paths(document))) == [
        "findings",
        "findings[].message",
        "findings[].name",
        "provenance",
        "provenance.options",
        "provenance.options.window",
        "provenance.version",
    ]
