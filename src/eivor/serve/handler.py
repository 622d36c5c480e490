"""One request: let in, looked at, answered."""

from __future__ import annotations

import json
import re
import socket
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler
from importlib import resources
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, quote

from eivor.errors import EivorError
from eivor.serve.asked_json import asked_job
from eivor.serve.gate import TOKEN
from eivor.serve.kept_logs import shown_name
from eivor.serve.refusals import RefusedError, status_of, told
from eivor.serve.sent_files import sent_files
from eivor.serve.tasks import RESULT, Export, File, ListExports, Outcome, Plan, Refused, Supply, Task

if TYPE_CHECKING:
    from eivor.serve.server import Server

#: Bytes of a request that is no log.
MOST_JSON = 1_000_000
#: Bytes that are read at a time.
CHUNK = 1 << 20
#: A body comes within so long [s], and at least so fast [bytes/s].
BODY_S, BODY_RATE = 30.0, 100_000.0
#: A refused request is read for so long [s] before its connection is closed: else the answer is lost.
LINGER_S = 1.0
#: The flight that comes with Eivor, for who has no log at hand.
EXAMPLE = "example_flight.parquet"
#: Fields of a query, and its letters.
MOST_FIELDS, LONGEST_QUERY = 20, 200_000
JSON, NDJSON, HTML, TEXT = (
    f"{kind}; charset=utf-8"
    for kind in ("application/json", "application/x-ndjson", "text/html", "text/plain")
)
_HEADERS = {
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "X-Frame-Options": "DENY",
    "Connection": "close",
}
_NOTHING_ALLOWED = "default-src 'none'; frame-ancestors 'none'"
_ID = "([0-9a-f]{32})"
_WORD = "([a-z0-9_-]{1,40})"


class Handler(BaseHTTPRequestHandler):
    """A connection, which has one request.

    Parameters
    ----------
    own : Server
        Whose it is.
    """

    protocol_version = "HTTP/1.1"
    server_version, sys_version = "eivor", ""
    timeout = 20.0

    def __init__(self, own: Server, *connection: Any) -> None:
        self._own = own
        self._answered = False
        super().__init__(*connection)

    def log_message(self, *_args: Any) -> None:
        """Print nothing: addresses have the token in them."""

    def send_error(self, code: int, message: str | None = None, *_explain: Any, **_more: Any) -> None:
        """Answer what is no request."""
        status = HTTPStatus(code)
        self._refuse(
            RefusedError(status, "a request of the page", message or status.phrase, "Load it again.")
        )

    def parse_request(self) -> bool:
        """Read the head of the request, within its time."""
        parsed = super().parse_request()
        self._own.connections.came(self.connection)
        return parsed

    def answer(self) -> None:
        """Answer any request."""
        self.close_connection = True
        try:
            path, _, query = self.path.partition("?")
            fields = _fields(query)
            token = self.headers.get(TOKEN, "")
            if path == "/" and self.command == "GET":
                token = token or fields.get("token", "")
            self._own.gate.check(self.headers, token)
            self._found(path)(fields)
        except (ConnectionError, TimeoutError):
            return
        except EivorError as error:
            self._refuse(error)
        except OSError as error:
            said = error.strerror or type(error).__name__
            self._refuse(
                RefusedError(
                    HTTPStatus.INTERNAL_SERVER_ERROR, "files that can be written", said, "Make room."
                )
            )

    do_GET = do_POST = do_DELETE = do_PUT = do_PATCH = do_HEAD = do_OPTIONS = answer  # noqa: N815

    def _found(self, path: str) -> Callable[[dict[str, str]], None]:
        """What answers a path."""
        methods: list[str] = []
        for method, pattern, name in _ROUTES:
            matched = pattern.fullmatch(path)
            if matched and method == self.command:
                return lambda fields: getattr(self, name)(*matched.groups(), fields)
            if matched:
                methods.append(method)
        if methods:
            raise RefusedError(
                HTTPStatus.METHOD_NOT_ALLOWED,
                " or ".join(methods),
                self.command,
                "Load the page again.",
            )
        raise RefusedError(
            HTTPStatus.NOT_FOUND, "an address of the page", f"'{path[:100]}'", "Load the page again."
        )

    # -- what is asked ---------------------------------------------------------------------------------

    def _page(self, _fields: dict[str, str]) -> None:
        self._send(self._own.page.encode("utf-8"), HTML, {"Content-Security-Policy": self._own.policy()})

    def _choices(self, _fields: dict[str, str]) -> None:
        self._json({**self._own.workers.choices().known, "largest_bytes": self._own.options.largest})

    def _keep_log(self, _fields: dict[str, str]) -> None:
        size = self._length(self._own.options.largest)
        name = shown_name(self.headers.get("X-Eivor-Name", ""))
        end = time.monotonic() + BODY_S + size / BODY_RATE
        files = [(one.name, one.size) for one in sent_files(self.headers.get("X-Eivor-Files", ""), size)]
        self._kept(name, size, ((one, self._body(part, end)) for one, part in files or [("", size)]))

    def _keep_example(self, _fields: dict[str, str]) -> None:
        content = resources.files("eivor.data").joinpath(EXAMPLE).read_bytes()
        self._kept(EXAMPLE, len(content), [("", iter([content]))])

    def _kept(self, name: str, size: int, files: Iterable[tuple[str, Iterator[bytes]]]) -> None:
        log = self._own.logs.keep(name, size, files, self._own.jobs.in_use)
        self._json({"log": log, "name": name, "bytes": size})

    def _forget_log(self, log: str, _fields: dict[str, str]) -> None:
        if log in self._own.jobs.in_use():
            raise RefusedError(
                HTTPStatus.CONFLICT, "a log that nobody works on", "one of a job", "Cancel the job first."
            )
        self._own.logs.forget(log)
        self._json({})

    def _begin_job(self, _fields: dict[str, str]) -> None:
        size = self._length(MOST_JSON)
        asked = asked_job(b"".join(self._body(size, time.monotonic() + BODY_S + size / BODY_RATE)))
        logs = {log: self._own.logs.get(log) for log, _ in asked.logs}
        self._json({"job": self._own.jobs.begin(asked, logs)})

    def _end_job(self, job: str, _fields: dict[str, str]) -> None:
        self._own.jobs.end(job)
        self._json({})

    def _events(self, job: str, _fields: dict[str, str]) -> None:
        events = self._own.jobs.get(job).events()
        self._head(HTTPStatus.OK, NDJSON, {})
        for event in events:
            self.wfile.write(_line(event))

    def _result(self, job: str, _fields: dict[str, str]) -> None:
        folder = self._own.jobs.get(job).result_folder()
        self._send((folder / RESULT).read_bytes(), JSON)

    def _report(self, job: str, _fields: dict[str, str]) -> None:
        self._send(self._own.jobs.get(job).report().read_bytes(), HTML)

    def _list_exports(self, job: str, fields: dict[str, str]) -> None:
        one = self._own.jobs.get(job)
        outcome = self._done(ListExports(one.result_folder(), _supply(fields, one.asked.mass), one.stem))
        self._json({"targets": outcome})

    def _export(self, job: str, target: str, fields: dict[str, str]) -> None:
        one = self._own.jobs.get(job)
        self._file(self._done(Export(one.result_folder(), _supply(fields, one.asked.mass), one.stem, target)))

    def _plan(self, job: str, form: str, fields: dict[str, str]) -> None:
        one = self._own.jobs.get(job)
        self._file(
            self._done(
                Plan(one.result_folder(), one.stem, form, fields.get("home", ""), fields.get("for", ""))
            )
        )

    def _done(self, task: Task) -> Outcome:
        outcome = self._own.jobs.do(task)
        if isinstance(outcome, Refused):
            parts = outcome.told
            raise RefusedError(
                HTTPStatus(outcome.status), parts["expected"], parts["received"], parts["advice"]
            )
        if outcome is None:
            raise RefusedError(
                HTTPStatus.SERVICE_UNAVAILABLE,
                "a server that stays",
                "one that stops",
                "Start it again: eivor serve.",
            )
        return outcome

    # -- what comes ------------------------------------------------------------------------------------

    def _length(self, most: int) -> int:
        """Bytes of the body, before any of it is read.

        Raises
        ------
        RefusedError
            When it is not said, or too much.
        """
        text = self.headers.get("Content-Length", "")
        if self.headers.get("Transfer-Encoding") or not re.fullmatch("[0-9]{1,15}", text):
            raise RefusedError(
                HTTPStatus.LENGTH_REQUIRED,
                "a request that says how long it is",
                "one that does not",
                "Load the page again.",
            )
        if int(text) > most:
            raise RefusedError(
                HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
                f"at most {most} bytes",
                f"{text} bytes",
                "Cut the log to the manoeuvre of interest, or start with more: eivor serve --largest MB.",
            )
        return int(text)

    def _body(self, size: int, end: float) -> Iterator[bytes]:
        """The body, or the next bytes of it, in parts as they come until a time.

        Raises
        ------
        RefusedError
            When it comes too slowly.
        ConnectionError
            When it ends before it should.
        """
        while size:
            part = self.rfile.read1(min(CHUNK, size))
            if not part:
                raise ConnectionAbortedError
            size -= len(part)
            yield part
            if time.monotonic() > end:
                raise RefusedError(
                    HTTPStatus.REQUEST_TIMEOUT, "a log that comes at once", "a slow one", "Drop it again."
                )

    # -- what goes -------------------------------------------------------------------------------------

    def _json(self, value: object) -> None:
        self._send(_line(value), JSON)

    def _file(self, outcome: Outcome) -> None:
        if not isinstance(outcome, File):
            raise TypeError(f"a file, not {type(outcome).__name__}")
        plain = re.sub(r"[^\w.-]+", "_", outcome.name, flags=re.ASCII) or "file"
        where = f"attachment; filename=\"{plain}\"; filename*=UTF-8''{quote(outcome.name, safe='')}"
        self._send(outcome.text.encode("utf-8"), TEXT, {"Content-Disposition": where})

    def _send(self, body: bytes, kind: str, headers: dict[str, str] | None = None) -> None:
        self._head(HTTPStatus.OK, kind, {**(headers or {}), "Content-Length": str(len(body))})
        if self.command != "HEAD":
            self.wfile.write(body)

    def _refuse(self, error: EivorError) -> None:
        """Tell why not, and read for a while what is sent all the same."""
        self.close_connection = True
        if self._answered:
            return
        body = _line({"error": told(error)})
        with suppress(OSError):
            self._head(status_of(error), JSON, {"Content-Length": str(len(body))})
            if self.command != "HEAD":
                self.wfile.write(body)
            self._linger()

    def _head(self, status: HTTPStatus, kind: str, headers: dict[str, str]) -> None:
        self._answered = True
        self.close_connection = True
        self.send_response(status)
        for name, value in (
            _HEADERS | {"Content-Security-Policy": _NOTHING_ALLOWED, "Content-Type": kind} | headers
        ).items():
            self.send_header(name, value)
        self.end_headers()

    def _linger(self) -> None:
        self.connection.shutdown(socket.SHUT_WR)
        self.connection.settimeout(LINGER_S)
        end = time.monotonic() + LINGER_S
        while time.monotonic() < end and self.connection.recv(CHUNK):
            pass


_ROUTES = tuple(
    (method, re.compile(pattern), name)
    for method, pattern, name in (
        ("GET", "/", "_page"),
        ("GET", "/choices", "_choices"),
        ("POST", "/logs", "_keep_log"),
        ("POST", "/example", "_keep_example"),
        ("DELETE", f"/logs/{_ID}", "_forget_log"),
        ("POST", "/jobs", "_begin_job"),
        ("DELETE", f"/jobs/{_ID}", "_end_job"),
        ("GET", f"/jobs/{_ID}/events", "_events"),
        ("GET", f"/jobs/{_ID}/result\\.json", "_result"),
        ("GET", f"/jobs/{_ID}/report\\.html", "_report"),
        ("GET", f"/jobs/{_ID}/exports", "_list_exports"),
        ("GET", f"/jobs/{_ID}/exports/{_WORD}", "_export"),
        ("GET", f"/jobs/{_ID}/plan/{_WORD}", "_plan"),
    )
)


def _fields(query: str) -> dict[str, str]:
    """Fields of a query.

    Raises
    ------
    RefusedError
        When there are too many.
    """
    try:
        if len(query) > LONGEST_QUERY:
            raise ValueError
        found = parse_qs(query, max_num_fields=MOST_FIELDS, errors="replace")
    except ValueError:
        raise RefusedError(
            HTTPStatus.BAD_REQUEST, f"at most {MOST_FIELDS} fields", "more", "Load the page again."
        ) from None
    return {name: "\n".join(values) for name, values in found.items()}


def _supply(fields: dict[str, str], mass: str) -> Supply:
    priors = tuple(line for line in fields.get("prior", "").split("\n") if line)
    return Supply(fields.get("mass", "") or mass, fields.get("vehicle", ""), priors)


def _line(value: object) -> bytes:
    return json.dumps(value, ensure_ascii=False, allow_nan=False).encode("utf-8", "replace") + b"\n"
