"""Requests of the page: JSON, sent files and refusals."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from http import HTTPStatus
from typing import Annotated, Any
from urllib.parse import unquote

import msgspec

from eivor.cli.options import FlightWords
from eivor.errors import EivorError, NotIdentifiedError, did_you_mean
from eivor.report.document import shortened


class RefusedError(EivorError):
    """A request that is not done."""

    def __init__(self, status: HTTPStatus, expected: str, received: str, remedy: str) -> None:
        super().__init__(expected, received, remedy)
        self.status = status

    def __reduce__(self) -> tuple[Any, tuple[HTTPStatus, str, str, str]]:  # type: ignore[override]
        return type(self), (self.status, self.expected, self.received, self.remedy)


def error_parts(error: EivorError) -> dict[str, str]:
    """Parts of an error: what was expected, what came, what to do, and all of it as a sentence."""
    return {
        "expected": error.expected,
        "received": error.received,
        "advice": error.remedy,
        "sentence": str(error),
    }


def refusal(error: EivorError) -> RefusedError:
    """An error with its HTTP status."""
    if isinstance(error, RefusedError):
        return error
    status = HTTPStatus.CONFLICT if isinstance(error, NotIdentifiedError) else HTTPStatus.BAD_REQUEST
    return RefusedError(status, error.expected, error.received, error.remedy)


def absent(what: str, name: str) -> RefusedError:
    """Error of something that is not there, or not any more."""
    return RefusedError(
        HTTPStatus.NOT_FOUND,
        f"{what} that is there",
        f"'{name[:100]}'",
        "What is an hour old is forgotten: drop the log again.",
    )


#: Letters of a word, and of a file's text.
LONGEST_WORD, LONGEST_FILE = 2_000, 100_000
MOST_LOGS = 100
#: Files of the one who asks, as text or as the name of one that comes with Eivor.
FILES = ("vehicle", "map")
#: Options of the command line that are paths.
_PATHS = ("lag_from",)


@dataclass(frozen=True, slots=True)
class JobRequest:
    """What is to be identified."""

    logs: tuple[tuple[str, str], ...]  # each log with its own window as words, empty for none
    # as words; empty where nothing was said
    model: str = ""
    vehicle: str = ""
    channel_map: str = ""
    mass: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)  # of `flight_options`


class _WindowedLog(msgspec.Struct, forbid_unknown_fields=True):
    log: str
    window: str | list[float | None] | None = None


class _Job(msgspec.Struct, forbid_unknown_fields=True):
    logs: Annotated[list[str | _WindowedLog], msgspec.Meta(min_length=1, max_length=MOST_LOGS)]
    options: dict[str, Any] | None = None


def parse_job(body: bytes) -> JobRequest:
    """Job of the JSON of a request."""
    try:
        job = msgspec.json.decode(body, type=_Job)
    except (msgspec.DecodeError, ValueError, RecursionError) as error:
        expected = f'a job {{"logs": [...], "options": {{...}}}} as JSON, of 1 to {MOST_LOGS} logs'
        raise _wrong(expected, f"other text ({str(error)[:100]})") from None
    options = {name: value for name, value in (job.options or {}).items() if value not in (None, "", [])}
    words = (_text(options.pop(name, ""), name) for name in ("model", "vehicle", "map", "mass"))
    model, vehicle, channel_map, mass = words
    parsed, known = tuple(map(_log, job.logs)), _flight_options(options)
    return JobRequest(parsed, model, vehicle, channel_map, mass, known)


def _log(given: str | _WindowedLog) -> tuple[str, str]:
    log, window = (given, None) if isinstance(given, str) else (given.log, given.window)
    return _text(log, "log"), "" if window is None else _window(window)


def _flight_options(record: Mapping[str, Any]) -> dict[str, Any]:
    known = {item.name: item for item in msgspec.structs.fields(FlightWords)}
    for name in record:
        if name not in known or name in _PATHS:
            among = [word for word in known if word not in _PATHS]
            remedy = did_you_mean(name, among, "Leave it out.")
            raise _wrong(f"options out of {', '.join(among)}", f"'{name[:100]}'", remedy)
    return {name: _value(value, name, known[name].default) for name, value in record.items()}


def _value(value: Any, name: str, default: object) -> Any:
    if name == "window":
        return _window(value)
    if isinstance(default, bool):
        _require(isinstance(value, bool), f"true or false for {name}", value)
        return value
    if isinstance(default, str):
        return _text(value, name)
    if default is None:
        return _number(value, name)
    _require(isinstance(value, list) and len(value) <= MOST_LOGS, f"a list of texts for {name}", value)
    return [_text(item, name) for item in value]


def _window(value: Any) -> str:
    if isinstance(value, str):
        return _text(value, "window")
    _require(isinstance(value, list) and len(value) == 2, "a window [FROM, TO] in seconds", value)
    return ":".join("" if item is None else repr(_number(item, "window")) for item in value)


def _number(value: Any, name: str) -> float:
    if isinstance(value, str):
        try:
            value = float(_text(value, name))
        except ValueError:
            raise _wrong(f"a number for {name}", _displayed(value)) from None
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    _require(is_number, f"a number for {name}", value)
    try:
        return float(value)
    except OverflowError:
        return math.inf


def _text(value: Any, name: str) -> str:
    longest = LONGEST_FILE if name in FILES else LONGEST_WORD
    is_short = isinstance(value, str) and len(value) <= longest
    _require(is_short, f"a text of at most {longest} letters for {name}", value)
    _require(value.isprintable() or name in FILES, f"a text in one line for {name}", value)
    try:
        value.encode("utf-8")
    except UnicodeEncodeError:
        raise _wrong(f"text for {name}", "half a letter") from None
    return str(value)


def _require(fits: bool, expected: str, value: Any) -> None:
    if not fits:
        raise _wrong(expected, _displayed(value))


def _displayed(value: Any) -> str:
    try:
        text = json.dumps(value)
    except RecursionError:
        return "something nested"
    return shortened(text, 100)


def _wrong(expected: str, received: str, remedy: str = "Load the page again.") -> RefusedError:
    return RefusedError(HTTPStatus.BAD_REQUEST, expected, received, remedy)


#: Files of a folder at most, and letters of a name.
MOST_FILES, LONGEST = 500, 120
_ENTRY = re.compile(r"([^/ ]{1,1000})/([0-9]{1,15})")
_OTHER = re.compile(r"[^A-Za-z0-9_.\-\[\]]")


def sent_files(header: str, size: int) -> tuple[tuple[str, int], ...]:
    """Files of a folder out of their header: plain names, which mean nothing to a file system, and bytes."""
    if not header:
        return ()
    entries = [_ENTRY.fullmatch(item) for item in header.split(" ")]
    files = [(plain_name(unquote(entry[1], errors="replace")), int(entry[2])) for entry in entries if entry]
    if len(files) < len(entries) or len(files) > MOST_FILES or sum(length for _, length in files) != size:
        expected = f"at most {MOST_FILES} files of a folder, NAME/BYTES, of {size} bytes"
    elif len({name.casefold() for name, _ in files}) < len(files):
        expected = "files of a folder with different names"
    else:
        return tuple(files)
    raise _wrong(expected, f"'{header[:100]}'", "Drop the files of the log one by one.")


def plain_name(name: str) -> str:
    """Name of a file in its folder: other letters than plain ones become ``_``, and it is never hidden."""
    plain = _OTHER.sub("_", name.replace("\\", "/").rpartition("/")[2])[-LONGEST:]
    return f"_{plain}" if plain.startswith(".") or not plain else plain
