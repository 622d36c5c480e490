"""What the page asks for, as the words that the command line would be given.

Here is only looked at what kind of thing it is; what the words mean is read where the command line reads it.
"""

from __future__ import annotations

import inspect
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from http import HTTPStatus
from typing import Any

from eivor.asked.options import flight_options
from eivor.errors import did_you_mean
from eivor.motions import DEFAULT
from eivor.serve.refusals import RefusedError

#: Letters of a word, and of a file's text.
LONGEST_WORD, LONGEST_FILE = 2_000, 100_000
#: Logs of a job.
MOST_LOGS = 100
#: Files of the one who asks, as text or as the name of one that comes with Eivor.
FILES = ("vehicle", "map")
#: Options of the command line that are paths.
_PATHS = ("lag_from",)


@dataclass(frozen=True, slots=True)
class AskedJob:
    """What is to be identified."""

    logs: tuple[tuple[str, str], ...]  # each log with its own window as words, empty for none
    # as words; empty where nothing was said
    model: str = DEFAULT
    vehicle: str = ""
    channel_map: str = ""
    mass: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)  # of `flight_options`


def asked_job(body: bytes) -> AskedJob:
    """Job of the JSON of a request."""
    try:
        told = json.loads(body)
    except (ValueError, RecursionError):
        raise _wrong("a job as JSON", "other text") from None
    if not isinstance(told, dict) or set(told) - {"logs", "options"}:
        raise _wrong('a job {"logs": [...], "options": {...}}', _shown(told))
    logs, options = told.get("logs"), told.get("options") or {}
    if not isinstance(logs, list) or not 1 <= len(logs) <= MOST_LOGS:
        raise _wrong(f"1 to {MOST_LOGS} logs", _shown(logs))
    if not isinstance(options, dict):
        raise _wrong("options by name", _shown(options))
    options = {name: value for name, value in options.items() if value not in (None, "", [])}
    model, vehicle, channel_map, mass = (
        _text(options.pop(name, ""), name) for name in ("model", "vehicle", "map", "mass")
    )
    return AskedJob(
        tuple(map(_log, logs)), model or DEFAULT, vehicle, channel_map, mass, _flight_options(options)
    )


def _log(told: Any) -> tuple[str, str]:
    if isinstance(told, dict) and set(told) <= {"log", "window"}:
        window = told.get("window")
        return _text(told.get("log"), "log"), "" if window is None else _window(window)
    return _text(told, "log"), ""


def _flight_options(told: Mapping[str, Any]) -> dict[str, Any]:
    known = {
        name: one
        for name, one in inspect.signature(flight_options).parameters.items()
        if one.kind is one.KEYWORD_ONLY and name not in _PATHS
    }
    for name in told:
        if name not in known:
            remedy = did_you_mean(name, known, "Leave it out.")
            raise _wrong(f"options out of {', '.join(known)}", f"'{name[:100]}'", remedy)
    return {name: _value(value, name, known[name].default) for name, value in told.items()}


def _value(value: Any, name: str, default: object) -> Any:
    """Value of the kind that an option has."""
    if name == "window":
        return _window(value)
    if isinstance(default, bool):
        if not isinstance(value, bool):
            raise _wrong(f"true or false for {name}", _shown(value))
        return value
    if isinstance(default, str):
        return _text(value, name)
    if default is None:
        return _number(value, name)
    if not isinstance(value, list) or len(value) > MOST_LOGS:
        raise _wrong(f"a list of texts for {name}", _shown(value))
    return [_text(one, name) for one in value]


def _window(value: Any) -> str:
    """Window as words, of words or of two numbers."""
    if isinstance(value, str):
        return _text(value, "window")
    if not isinstance(value, list) or len(value) != 2:
        raise _wrong("a window [FROM, TO] in seconds", _shown(value))
    return ":".join("" if one is None else repr(_number(one, "window")) for one in value)


def _number(value: Any, name: str) -> float:
    if isinstance(value, str):
        try:
            value = float(_text(value, name))
        except ValueError:
            raise _wrong(f"a number for {name}", _shown(value)) from None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise _wrong(f"a number for {name}", _shown(value))
    try:
        return float(value)
    except OverflowError:
        return math.inf


def _text(value: Any, name: str) -> str:
    longest = LONGEST_FILE if name in FILES else LONGEST_WORD
    if not isinstance(value, str) or len(value) > longest:
        raise _wrong(f"a text of at most {longest} letters for {name}", _shown(value))
    if not value.isprintable() and name not in FILES:
        raise _wrong(f"a text in one line for {name}", _shown(value))
    try:
        value.encode("utf-8")
    except UnicodeEncodeError:
        raise _wrong(f"text for {name}", "half a letter") from None
    return value


def _shown(value: Any) -> str:
    try:
        text = json.dumps(value)
    except RecursionError:
        return "something nested"
    return text if len(text) <= 100 else f"{text[:99]}…"


def _wrong(expected: str, received: str, remedy: str = "Load the page again.") -> RefusedError:
    return RefusedError(HTTPStatus.BAD_REQUEST, expected, received, remedy)
