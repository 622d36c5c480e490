"""The parity record: what it keeps, what may differ between two, and that it uses public doors only."""

from __future__ import annotations

import copy

import pytest

from validation.parity import record as recording
from validation.parity.compare import DIFFERENT, compare, main
from validation.parity.record import entry, write_record

QUANTITY = {"value": 0.5, "std_error": 0.01, "interval": [0.48, 0.52], "verdict": "identified"}
DOCUMENT = {
    "verdict": "identified",
    "reasons": ["It moved."],
    "samples": 6000,
    "logs": [{"rate_hz": 100.0}],
    "parameters": {"friction": QUANTITY, "delay": {"value": 0.0, "std_error": None}},
    "diagnostics": {"J": 10.0, "J_p_value": 1e-6},
    "covariance": {"matrix": [[4.0, 1e-7], [1e-7, 9.0]]},
}
LINE = {"std_error": [0.1, 2.0], "low": [-0.2, 4.0], "high": [0.2, 12.0]}
FIT = {"status": "identified", "condition": 10.0, "values": [0.0, 8.0], "covariances": {"cosines": LINE}}
CONTENT = {
    "flights/example": {"exit_code": 0, "printed": "ab", "document": DOCUMENT},
    "problems/line": {
        "shared": {"least_squares": FIT, "refused": {"error": "InstrumentError"}},
        "clean": {"filip": {"condition": 1e10, "values": [1.0]}},
    },
}
FRICTION = "flights/example/document/parameters/friction"
LEAST_SQUARES = "problems/line/shared/least_squares"


def record(content):
    return {name: entry(value) for name, value in content.items()}


RECORD = record(CONTENT)


def changed(path, value):
    """The record with one value replaced."""
    content = copy.deepcopy(CONTENT)
    part, name, *keys, last = path.split("/")
    index = content[f"{part}/{name}"]
    for key in keys:
        index = index[int(key)] if isinstance(index, list) else index[key]
    index[int(last) if isinstance(index, list) else last] = value
    return record(content)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (f"{FRICTION}/value", 0.5 + 1.2e-5),
        (f"{FRICTION}/value", None),
        (f"{FRICTION}/std_error", 0.01002),
        (f"{FRICTION}/verdict", "weak"),
        ("flights/example/document/diagnostics/J", 10.011),
        ("flights/example/document/diagnostics/J_p_value", 1.03e-6),
        ("flights/example/document/samples", 5999),
        ("flights/example/document/added", 1.0),
        ("flights/example/exit_code", 3),
        (f"{LEAST_SQUARES}/values/0", 1.1e-10),
        (f"{LEAST_SQUARES}/covariances/cosines/std_error/1", 2.0 + 3e-9),
        (f"{LEAST_SQUARES}/status", "weak"),
        ("problems/line/clean/filip/values/0", 1.0 + 3e-6),
        ("problems/line/shared/refused/error", "UsageError"),
    ],
)
def test_what_may_not_differ(path, value):
    result = compare(RECORD, changed(path, value))
    assert [difference.path for difference in result.different] == [path]


def test_the_command(tmp_path, capsys):
    old, new = (tmp_path / name for name in ("old.json.xz", "new.json"))
    write_record(old, {"schema": recording.SCHEMA, "entries": RECORD})
    write_record(new, {"schema": recording.SCHEMA, "entries": changed(f"{LEAST_SQUARES}/status", "weak")})
    arguments = [str(old), str(new)]
    assert main(arguments) == DIFFERENT
    assert f"DIFFERENT: {LEAST_SQUARES}/status: identified -> weak" in capsys.readouterr().out
    assert main([*arguments, "--exact", "--part", "flights"]) == 0
