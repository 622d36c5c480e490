"""The page and its server: Starlette's routes behind a gate, run by uvicorn on the loopback address only."""

from __future__ import annotations

import asyncio
import hmac
import os
import re
import secrets
import shutil
import socket
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from functools import partial
from http import HTTPStatus
from importlib import resources
from pathlib import Path
from typing import cast
from urllib.parse import quote

import anyio.from_thread
import anyio.to_thread
import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import MutableHeaders
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import HTMLResponse, JSONResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from eivor.atomic_file import LOCK, folder_lock
from eivor.cli.options import options_schema
from eivor.errors import EivorError, InputError
from eivor.logs.read import EXAMPLE_FLIGHT
from eivor.process_pool import Limits
from eivor.report.html import SHAPES, Sources, asset, rendered, report_sources, whole_page
from eivor.serve import jobs
from eivor.serve.requests import RefusedError, parse_job, refusal, sent_files

#: The only address, and the header with the token.
ADDRESS, TOKEN = "127.0.0.1", "X-Eivor-Token"
#: Logs and results are deleted after this time, and the server looks for them this often [s].
KEPT_S, LOOK_S = 3600.0, 1.0
#: Time for the head of a request, and for its body beside the bytes per second that it must reach [s].
HEAD_S, BODY_S, BODY_RATE = 10.0, 30.0, 100_000.0
#: A refused body is read for this long, since a browser that still sends would not see the answer [s].
LINGER_S = 1.0
#: Time to finish answers when the server ends [s].
LAST_S = 2
#: Connections at a time that have shown a token and that have not, and bytes of a request's head and of one
#: that is no log.
MOST_CONNECTIONS, MOST_STRANGERS, MOST_HEAD, MOST_JSON = 64, 32, 65_536, 1_000_000
#: Headers of which a request has one.
_SINGLE = re.compile(rb"(?im)^(host|content-length)[ \t]*:")
#: How folders of servers are called.
PREFIX = "eivor-serve-"
MOST_FIELDS = 20
_REOPEN = "Open the address that `eivor serve` has printed."
_RELOAD = "Load the page again."
_HEADERS = {
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "X-Frame-Options": "DENY",
    "Connection": "close",
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'",
}


#: Parts of the script, in the order in which they stand in it.
PARTS = ("base", "talk", "folders", "flights", "course", "choices", "downloads", "result", "compare", "start")
#: Shapes of stages, drawn as those of verdicts are: gone by, at it, to come.
STAGES = {"over": "M6 10.4l2.8 2.9 5.4-6.4", "now": "M6 10h7.6M10.4 6.6l3.4 3.4-3.4 3.4", "ahead": ""}


def page_text() -> str:
    """Text of the page: HTML with its style, its script and a policy that allows nothing else."""
    shapes = SHAPES | STAGES
    return whole_page("Eivor", rendered("serve.html"), {"shapes": shapes}, page_sources())


def page_sources() -> Sources:
    """The report's style with what is this page's own; its policy is for the reports in it, too."""
    folder = resources.files("eivor.serve").joinpath("static")
    scripts = [folder.joinpath(f"{name}.js").read_text(encoding="utf-8") for name in PARTS]
    style = f"{asset('page.css')}\n{folder.joinpath('serve.css').read_text(encoding='utf-8')}"
    script = "\n".join(['"use strict";', "(() => {", *scripts, "})();"])
    # it asks its own server alone, and makes the reports within the page itself
    return Sources(style, script, (report_sources(),), ("connect-src 'self'", "frame-src blob:"))


@dataclass(frozen=True, slots=True)
class ServeOptions:
    """Resources of a server."""

    port: int = 0  # zero for any that is free
    workers: int = 2  # processes at most
    limits: Limits = field(default_factory=Limits)  # of each job
    largest: int = 500_000_000  # bytes of a log at most
    work: jobs.WorkFunction = jobs.work  # function of the worker processes


class Server:
    """A page on this machine, until it is closed."""

    def __init__(self, options: ServeOptions | None = None) -> None:
        self.options = chosen = options or ServeOptions()
        self.page = page_text()
        self.policy = f"{page_sources().policy}; frame-ancestors 'none'"
        self.token = secrets.token_urlsafe(24)
        listening = _listening(chosen.port)
        self.port: int = listening.getsockname()[1]
        remove_abandoned()
        self.folder = Path(tempfile.mkdtemp(prefix=PREFIX))
        self._held = ExitStack()
        self._held.enter_context(folder_lock(self.folder))
        (self.folder / LOCK).chmod(0o600)
        self.workers = jobs.Workers(chosen.workers, chosen.limits, chosen.work)
        self.logs = jobs.KeptLogs(self.folder / "logs", chosen.largest)
        self.jobs = jobs.Jobs(self.folder / "jobs", self.workers)
        self._uvicorn = uvicorn.Server(
            uvicorn.Config(
                Gate(_Routes(self).application(), self.port, self.token),
                http=BoundedProtocol,
                ws="none",
                lifespan="off",
                log_config=None,
                log_level="critical",
                access_log=False,
                server_header=False,
                h11_max_incomplete_event_size=MOST_HEAD,
                timeout_graceful_shutdown=LAST_S,
            )
        )
        self._closed = threading.Event()
        self._threads = [
            threading.Thread(target=self._uvicorn.run, args=([listening],), daemon=True),
            threading.Thread(target=self._look_after, daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    @property
    def url(self) -> str:
        return f"http://{ADDRESS}:{self.port}/?token={self.token}"

    @property
    def connections(self) -> int:
        return len(self._uvicorn.server_state.connections)

    def forget(self) -> None:
        self.jobs.forget_older(KEPT_S)
        self.logs.forget_older(KEPT_S, self.jobs.in_use())

    def close(self) -> None:
        self._closed.set()
        self._uvicorn.should_exit = True
        self.workers.close()
        for thread in self._threads:
            thread.join()
        self._held.close()
        shutil.rmtree(self.folder, ignore_errors=True)

    def _look_after(self) -> None:
        while not self._closed.wait(LOOK_S):
            self.forget()
            self.workers.end_idle()


def remove_abandoned() -> None:
    """Delete what servers of this user left that were killed: folders that nobody holds."""
    for folder in Path(tempfile.gettempdir()).glob(f"{PREFIX}*"):
        with suppress(OSError, InputError):  # another user's, or that of a server that runs
            if not folder.is_symlink() and (folder / LOCK).is_file():
                with folder_lock(folder):
                    pass
                shutil.rmtree(folder, ignore_errors=True)


def _listening(port: int) -> socket.socket:
    listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        if os.name == "posix":  # elsewhere another program could take the port over
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((ADDRESS, port))
        listening.listen(128)
    except OSError:
        listening.close()
        raise
    return listening


class BoundedProtocol(H11Protocol):
    """Connections of a limited number, whose requests come within a limited time."""

    #: What has come of the head of the request; None once all of it has.
    head: bytes | None = b""
    has_token = False

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Accept a connection when there is room; of those without a token the oldest makes room."""
        super().connection_made(transport)
        self.began_at = self.loop.time()
        self.app_state = {"passed": partial(setattr, self, "has_token")}  # the gate calls it
        others = [item for item in self.connections if isinstance(item, BoundedProtocol) and item is not self]
        strangers = [item for item in others if not item.has_token and not item.transport.is_closing()]
        if len(others) - len(strangers) >= MOST_CONNECTIONS:
            busy = HTTPStatus.SERVICE_UNAVAILABLE
            self._end(RefusedError(busy, "fewer connections", "one more", "Close some tabs."))
            return
        if len(strangers) >= MOST_STRANGERS:
            min(strangers, key=lambda item: item.began_at).transport.close()
        self.loop.call_later(HEAD_S, self._end_late)

    def data_received(self, data: bytes) -> None:
        """Refuse a head that says twice what it may say once, before it is parsed."""
        if self.head is not None:
            head, *rest = re.split(rb"\r?\n\r?\n", self.head + data, maxsplit=1)
            names = [name.lower() for name in _SINGLE.findall(head)]
            if len(names) > len(set(names)):
                self.send_400_response("one that says its host or its length twice")
                return
            self.head = None if rest else head
        super().data_received(data)

    def send_400_response(self, msg: str) -> None:
        self._end(RefusedError(HTTPStatus.BAD_REQUEST, "a request of the page", msg, _RELOAD))

    def _end_late(self) -> None:
        if cast("object", self.cycle) is None and not self.transport.is_closing():
            self.transport.close()

    def _end(self, error: EivorError) -> None:
        answer = _refused(error)
        status = HTTPStatus(answer.status_code)
        head = [f"HTTP/1.1 {status.value} {status.phrase}".encode()]
        head += [name + b": " + value for name, value in answer.raw_headers]
        self.transport.write(b"\r\n".join([*head, b"", bytes(answer.body)]))
        self.transport.close()


class Gate:
    """Lets the page of this run pass, in a browser on this machine, and nobody else."""

    def __init__(self, app: ASGIApp, port: int, token: str) -> None:
        self._app, self._token = app, token
        self._hosts = f"{ADDRESS}:{port}", f"localhost:{port}"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in _HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        anyio.to_thread.current_default_thread_limiter().total_tokens = 2 * MOST_CONNECTIONS
        request = Request(scope, receive)
        try:
            self._check(request)
        except RefusedError as error:
            await _read_on(request)
            await _refused(error)(scope, receive, with_headers)
        else:
            scope["state"]["passed"](True)
            with suppress(ClientDisconnect):
                await self._app(scope, receive, with_headers)

    def _check(self, request: Request) -> None:
        headers = request.headers
        host, origin = headers.get("host", ""), headers.get("origin")
        if host.lower() not in self._hosts:
            wrong, expected = HTTPStatus.MISDIRECTED_REQUEST, f"the host {self._hosts[0]}"
            raise RefusedError(wrong, expected, f"'{host[:100]}'", _REOPEN)
        site, itself = headers.get("sec-fetch-site", "none"), "a request of the page itself"
        if origin is not None and origin.lower() not in {f"http://{_host}" for _host in self._hosts}:
            raise _forbidden(itself, f"one of '{origin[:100]}'")
        if site not in ("same-origin", "none"):
            raise _forbidden(itself, f"one that is {site[:100]}")
        token = headers.get(TOKEN, "")
        if request.scope["path"] == "/" and request.method == "GET":
            token = token or _fields(request).get("token", "")
        if not hmac.compare_digest(token.encode("utf-8", "replace"), self._token.encode()):
            raise _forbidden("the token of this run", "another one" if token else "none")


def _forbidden(expected: str, received: str) -> RefusedError:
    return RefusedError(HTTPStatus.FORBIDDEN, expected, received, _REOPEN)


def _refused(error: EivorError) -> Response:
    refused = refusal(error)
    return JSONResponse({"error": refused.parts}, refused.status, headers=_HEADERS)


async def _read_on(request: Request) -> None:
    """Read what is sent all the same, for a while."""
    with suppress(ClientDisconnect, RuntimeError), anyio.move_on_after(LINGER_S):
        if request.headers.get("content-length", "0") != "0":
            async for _ in request.stream():
                pass


class _Routes:
    """What answers each path; functions that are not `async` run in threads."""

    def __init__(self, server: Server) -> None:
        self._server, self._logs, self._jobs = server, server.logs, server.jobs

    def application(self) -> Starlette:
        routes = (
            ("GET", "/", self.page),
            ("GET", "/choices", self.choices),
            ("GET", "/options.schema.json", self.options_schema),
            ("POST", "/logs", self.keep_log),
            ("POST", "/example", self.keep_example),
            ("DELETE", "/logs/{log}", self.forget_log),
            ("POST", "/jobs", self.begin_job),
            ("DELETE", "/jobs/{job}", self.end_job),
            ("GET", "/jobs/{job}/events", self.events),
            ("GET", "/jobs/{job}/result.json", self.result),
            ("GET", "/jobs/{job}/report.html", self.report),
            ("GET", "/jobs/{job}/exports", self.list_exports),
            ("GET", "/jobs/{job}/exports/{target}", self.export),
            ("GET", "/jobs/{job}/plan/{form}", self.plan),
        )
        app = Starlette(
            routes=[Route(path, endpoint, methods=[method]) for method, path, endpoint in routes],
            exception_handlers=dict.fromkeys((EivorError, HTTPException, OSError, TimeoutError), self.refuse),
        )
        app.router.redirect_slashes = False
        return app

    def page(self, _request: Request) -> Response:
        return HTMLResponse(self._server.page, headers={"Content-Security-Policy": self._server.policy})

    def choices(self, _request: Request) -> Response:
        return JSONResponse({**self._server.workers.choices(), "largest_bytes": self._server.options.largest})

    def options_schema(self, _request: Request) -> Response:
        return JSONResponse(options_schema())

    async def keep_log(self, request: Request) -> Response:
        size = _length(request, self._server.options.largest)
        name = jobs.shown_name(request.headers.get("x-eivor-name", ""))
        body = _Body(request, size)
        files = sent_files(request.headers.get("x-eivor-files", ""), size) or (("", size),)
        parts = ((item, body.parts(length)) for item, length in files)
        log = await anyio.to_thread.run_sync(lambda: self._logs.keep(name, size, parts, self._jobs.in_use))
        return JSONResponse({"log": log, "name": name, "bytes": size})

    def keep_example(self, _request: Request) -> Response:
        content = resources.files("eivor.data").joinpath(EXAMPLE_FLIGHT).read_bytes()
        log = self._logs.keep(EXAMPLE_FLIGHT, len(content), [("", iter([content]))], self._jobs.in_use)
        return JSONResponse({"log": log, "name": EXAMPLE_FLIGHT, "bytes": len(content)})

    def forget_log(self, request: Request) -> Response:
        log = request.path_params["log"]
        if log in self._jobs.in_use():
            busy = HTTPStatus.CONFLICT
            raise RefusedError(busy, "a log that nobody works on", "one of a job", "Cancel the job first.")
        self._logs.forget(log)
        return JSONResponse({})

    async def begin_job(self, request: Request) -> Response:
        size = _length(request, MOST_JSON)
        body = _Body(request, size)

        def begin() -> str:
            job_request = parse_job(b"".join(body.parts(size)))
            return self._jobs.begin(job_request, {log: self._logs.get(log) for log, _ in job_request.windows})

        return JSONResponse({"job": await anyio.to_thread.run_sync(begin)})

    def end_job(self, request: Request) -> Response:
        self._jobs.end(request.path_params["job"])
        return JSONResponse({})

    def events(self, request: Request) -> Response:
        job = self._jobs.get(request.path_params["job"])
        lines = (bytes(JSONResponse(event).body) + b"\n" for event in job.events())
        return StreamingResponse(lines, media_type="application/x-ndjson; charset=utf-8")

    def result(self, request: Request) -> Response:
        folder = self._jobs.get(request.path_params["job"]).result_folder()
        return Response((folder / jobs.RESULT).read_bytes(), media_type="application/json; charset=utf-8")

    def report(self, request: Request) -> Response:
        return HTMLResponse(self._jobs.get(request.path_params["job"]).report().read_bytes())

    def list_exports(self, request: Request) -> Response:
        return JSONResponse({"targets": self._done(request, "list_exports")})

    def export(self, request: Request) -> Response:
        return _file(self._done(request, "export"))

    def plan(self, request: Request) -> Response:
        return _file(self._done(request, "plan"))

    def _done(self, request: Request, name: str) -> jobs.Outcome:
        job, fields = self._jobs.get(request.path_params["job"]), _fields(request)
        words = {**fields, **request.path_params, "mass": fields.get("mass") or job.request.options.mass}
        given = {"folder": job.result_folder(), "stem": job.stem, "words": words}
        outcome = self._jobs.do(jobs.Task(name, given))
        if isinstance(outcome, RefusedError):
            raise outcome
        if outcome is None:
            stopped, remedy = HTTPStatus.SERVICE_UNAVAILABLE, "Start it again: eivor serve."
            raise RefusedError(stopped, "a server that stays", "one that stops", remedy)
        return outcome

    async def refuse(self, request: Request, error: Exception) -> Response:
        await _read_on(request)
        return _refused(_as_refusal(request, error))


def _as_refusal(request: Request, error: Exception) -> EivorError:
    if isinstance(error, EivorError):
        return error
    if isinstance(error, TimeoutError):
        late = HTTPStatus.REQUEST_TIMEOUT
        return RefusedError(late, "a log that comes at once", "a slow one", "Drop it again.")
    if isinstance(error, OSError):
        broken, sentence = HTTPStatus.INTERNAL_SERVER_ERROR, error.strerror or type(error).__name__
        return RefusedError(broken, "files that can be written", sentence, "Make room.")
    status = HTTPStatus(error.status_code) if isinstance(error, HTTPException) else HTTPStatus(500)
    if status == HTTPStatus.METHOD_NOT_ALLOWED and isinstance(error, HTTPException):
        return RefusedError(status, (error.headers or {}).get("Allow", ""), request.method, _RELOAD)
    return RefusedError(status, "an address of the page", f"'{request.url.path[:100]}'", _RELOAD)


class _Body:
    """The body of a request, read by a thread in parts as they come."""

    def __init__(self, request: Request, size: int) -> None:
        self._chunks = request.stream()
        self._rest = b""
        self._end = time.monotonic() + BODY_S + size / BODY_RATE

    def parts(self, size: int) -> Iterator[bytes]:
        while size:
            chunk = self._rest or anyio.from_thread.run(self._next)
            if time.monotonic() > self._end:
                raise TimeoutError
            part, self._rest = chunk[:size], chunk[size:]
            size -= len(part)
            yield part

    async def _next(self) -> bytes:
        with anyio.fail_after(self._end - time.monotonic()):
            async for chunk in self._chunks:
                if chunk:
                    return chunk
        raise ClientDisconnect


def _length(request: Request, most: int) -> int:
    text = request.headers.get("content-length", "")
    if "transfer-encoding" in request.headers or not re.fullmatch("[0-9]{1,15}", text):
        expected = "a request that says how long it is"
        raise RefusedError(HTTPStatus.LENGTH_REQUIRED, expected, "one that does not", _RELOAD)
    if int(text) > most:
        received = f"{text} bytes"
        remedy = "Cut the log to the manoeuvre of interest, or start with more: eivor serve --largest MB."
        raise RefusedError(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"at most {most} bytes", received, remedy)
    return int(text)


def _fields(request: Request) -> dict[str, str]:
    query = request.query_params
    if len(query.multi_items()) > MOST_FIELDS:
        raise RefusedError(HTTPStatus.BAD_REQUEST, f"at most {MOST_FIELDS} fields", "more", _RELOAD)
    return {name: "\n".join(query.getlist(name)) for name in query}


def _file(outcome: jobs.Outcome) -> Response:
    if not isinstance(outcome, jobs.File):
        raise TypeError(f"a file, not {type(outcome).__name__}")
    plain = re.sub(r"[^\w.-]+", "_", outcome.name, flags=re.ASCII) or "file"
    where = f"attachment; filename=\"{plain}\"; filename*=UTF-8''{quote(outcome.name, safe='')}"
    return PlainTextResponse(outcome.text, headers={"Content-Disposition": where})
