"""Requests of the page: JSON, sent files and refusals."""

from __future__ import annotations

import re
from http import HTTPStatus
from typing import Annotated, Any
from urllib.parse import unquote

import msgspec

from eivor.cli.options import FlightWords
from eivor.errors import EivorError, NotIdentifiedError
from eivor.strict_toml import TomlTable


class RefusedError(EivorError):
    """A request that is not done."""

    def __init__(self, status: HTTPStatus, expected: str, received: str, remedy: str) -> None:
        super().__init__(expected, received, remedy)
        self.status = status

    @property
    def parts(self) -> dict[str, str]:
        """What was expected, what came, what to do, and all of it as a sentence."""
        parts = {"expected": self.expected, "received": self.received, "advice": self.remedy}
        return parts | {"sentence": str(self)}

    def __reduce__(self) -> tuple[Any, tuple[HTTPStatus, str, str, str]]:  # type: ignore[override]
        return type(self), (self.status, self.expected, self.received, self.remedy)


def refusal(error: EivorError) -> RefusedError:
    """An error with its HTTP status."""
    if isinstance(error, RefusedError):
        return error
    status = HTTPStatus.CONFLICT if isinstance(error, NotIdentifiedError) else HTTPStatus.BAD_REQUEST
    return RefusedError(status, error.expected, error.received, error.remedy)


def absent(what: str, name: str) -> RefusedError:
    """Error of something that is not there, or not any more."""
    remedy = "What is an hour old is forgotten: drop the log again."
    return RefusedError(HTTPStatus.NOT_FOUND, f"{what} that is there", f"'{name[:100]}'", remedy)


MOST_LOGS = 100


class JobOptions(FlightWords, kw_only=True, forbid_unknown_fields=True):
    """Options of a job as words, empty where nothing was said; a vehicle and a map are names or texts."""

    model: str = ""
    vehicle: str = ""
    map: str = ""
    mass: str = ""


class _WindowedLog(msgspec.Struct, forbid_unknown_fields=True):
    log: str
    window: str = ""


class JobRequest(msgspec.Struct, forbid_unknown_fields=True):
    """What is to be identified."""

    logs: Annotated[list[str | _WindowedLog], msgspec.Meta(min_length=1, max_length=MOST_LOGS)]
    options: JobOptions = msgspec.field(default_factory=JobOptions)

    @property
    def windows(self) -> list[tuple[str, str]]:
        """Each log with its own window as words, empty for none."""
        return [(item, "") if isinstance(item, str) else (item.log, item.window) for item in self.logs]


def parse_job(body: bytes) -> JobRequest:
    """Job of the JSON of a request."""
    try:
        values = msgspec.json.decode(body, type=dict[str, Any])
    except (msgspec.DecodeError, ValueError, RecursionError) as error:
        expected = 'a job {"logs": [...], "options": {...}} as JSON'
        raise _wrong(expected, f"other text ({str(error)[:100]})") from None
    job = TomlTable(values, "the request", remedy="Load the page again.").convert(JobRequest)
    if job.options.lag_from:  # a path of the server
        raise _wrong("options without lag_from", "lag_from", "Give the lag itself: lag.")
    return job


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
