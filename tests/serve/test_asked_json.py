"""What a page may ask for, and absurd JSON."""

from __future__ import annotations

import json

import pytest

from eivor.serve.requests import JobRequest, RefusedError, parse_job

LOG = "a" * 32


def asked(**options: object) -> JobRequest:
    """Job of a log with these options."""
    return parse_job(json.dumps({"logs": [LOG], "options": options}).encode())


def test_options_are_words_of_the_command_line():
    job = asked(
        model="rates",
        vehicle="crazyflie-2x",
        map="rotorpy",
        mass="1.5:0.02",
        method="least_squares",
        lag="70:15",
        window=[4, 67.5],
        compare=True,
        max_tilt=20,
        rotor_radius="0.12",
        terms=["quadratic-drag"],
        noise=["estimate"],
        instruments="",
        align=None,
    )
    assert (job.model, job.vehicle, job.channel_map, job.mass) == (
        *("rates", "crazyflie-2x"),
        *("rotorpy", "1.5:0.02"),
    )
    assert job.options == {
        "method": "least_squares",
        "lag": "70:15",
        "window": "4.0:67.5",
        "compare": True,
        "max_tilt": 20.0,
        "rotor_radius": 0.12,
        "terms": ["quadratic-drag"],
        "noise": ["estimate"],
    }
    several = parse_job(json.dumps({"logs": [LOG, {"log": LOG, "window": [None, 3]}]}).encode())
    assert several == JobRequest(((LOG, ""), (LOG, ":3.0")), "vertical")


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"\xff\xfe",
        b"null",
        b"[]",
        b"3",
        b"{}",
        b"[" * 100_000,
        b'{"logs": 1e999}',
        b'{"logs": []}',
        b'{"logs": [[]]}',
        b'{"logs": [{}]}',
        b'{"logs": [{"log": "x", "path": "/etc/passwd"}]}',
        b'{"logs": ["x"], "more": 1}',
        b'{"logs": ["x"], "options": [1]}',
        b'{"logs": ["\\ud800"]}',
        b'{"logs": ' + b"9" * 5000 + b"}",
        json.dumps({"logs": ["x"] * 101}).encode(),
    ],
)
def test_absurd_jobs_are_refused(body):
    with pytest.raises(RefusedError, match=r"Expected .*; received .*") as refused:
        parse_job(body)
    assert len(str(refused.value)) < 1000


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"windw": [1, 2]}, "Did you mean 'window'"),
        ({"lag_from": "/etc/passwd"}, "received 'lag_from'"),
        ({"window": [1]}, "a window"),
        ({"window": {"from": 1}}, "a window"),
        ({"window": ["x", 1]}, "a number for window"),
        ({"compare": "yes"}, "true or false for compare"),
        ({"compare": 1}, "true or false for compare"),
        ({"max_tilt": True}, "a number for max_tilt"),
        ({"max_tilt": [3]}, "a number for max_tilt"),
        ({"max_tilt": "steep"}, "a number for max_tilt"),
        ({"method": 3}, "a text"),
        ({"method": "x" * 2001}, "at most 2000 letters for method"),
        ({"lag": "70:15\n"}, "in one line"),
        ({"model": "\x1b[31m"}, "in one line"),
        ({"vehicle": "x" * 100_001}, "at most 100000 letters for vehicle"),
        ({"noise": "estimate"}, "a list of texts for noise"),
        ({"terms": [["x"]]}, "a text"),
        ({"model": {"x": 1}}, "a text"),
    ],
)
def test_options_are_of_their_kind(options, sentence):
    with pytest.raises(RefusedError, match=sentence):
        asked(**options)


def test_a_number_beyond_all_is_infinite():
    assert asked(max_tilt=10**400).options == {"max_tilt": float("inf")}
