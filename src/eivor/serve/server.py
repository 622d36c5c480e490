"""The server: one address, one token, one private folder, and an end that leaves nothing behind."""

from __future__ import annotations

import html
import os
import re
import secrets
import shutil
import socket
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from http.server import ThreadingHTTPServer
from pathlib import Path
from typing import Any

from eivor.fleets.limits import Limits
from eivor.fleets.telling import Telling
from eivor.serve.gate import ADDRESS, Gate
from eivor.serve.jobs import Jobs
from eivor.serve.kept_logs import KeptLogs
from eivor.serve.page.page import page_text
from eivor.serve.tasks import Work
from eivor.serve.workers import Workers

#: Logs and results are forgotten after so long [s].
KEPT_S = 3600.0
#: How often it is looked for what is to be forgotten, and for requests that do not come on [s].
LOOK_S = 1.0
#: A request's head has come after so long [s], or never will.
HEAD_S = 10.0
#: Connections at a time.
MOST_CONNECTIONS = 64
#: Answers that are being written when the server ends have so long [s].
LAST_S = 2.0
_FULL = (
    b"HTTP/1.1 503 Service Unavailable\r\nContent-Type: application/json\r\nConnection: close\r\n\r\n"
    b'{"error": {"expected": "fewer connections", "received": "one more", "advice": "Close some tabs.", '
    b'"sentence": "Expected fewer connections; received one more. Close some tabs."}}\n'
)
_POLICY = re.compile(r'http-equiv="Content-Security-Policy" content="([^"]*)"')


@dataclass(frozen=True, slots=True)
class ServeOptions:
    """What a server may spend.

    Parameters
    ----------
    port : int
        Zero for any that is free.
    workers : int
        Processes at most.
    limits : Limits
        Of each job.
    largest : int
        Bytes of a log at most.
    most_waiting : int
        Jobs that may wait.
    clock : callable
        Seconds, by which things are forgotten.
    work : Telling
        What worker processes do.
    """

    port: int = 0
    workers: int = 2
    limits: Limits = field(default_factory=Limits)
    largest: int = 500_000_000
    most_waiting: int = 256
    clock: Callable[[], float] = time.monotonic
    work: Telling = field(default_factory=Work)


class Server:
    """A page on this machine, until it is closed.

    Parameters
    ----------
    options : ServeOptions
        What it may spend.

    Raises
    ------
    OSError
        When the port is taken.
    """

    def __init__(self, options: ServeOptions | None = None) -> None:
        from eivor.serve.handler import Handler

        self.options = chosen = options or ServeOptions()
        self.page = page_text()
        self.token = secrets.token_urlsafe(24)
        self._http = _Http((ADDRESS, chosen.port), partial(Handler, self))
        self.folder = Path(tempfile.mkdtemp(prefix="eivor-serve-"))
        self.gate = Gate(self._http.server_port, self.token)
        self.workers = Workers(chosen.workers, chosen.limits, chosen.most_waiting, chosen.work)
        self.logs = KeptLogs(self.folder / "logs", chosen.largest, chosen.clock)
        self.jobs = Jobs(self.folder / "jobs", self.workers, chosen.clock)
        self._closed = threading.Event()
        self._threads = [
            threading.Thread(target=one, daemon=True)
            for one in (partial(self._http.serve_forever, 0.1), self._look_after)
        ]
        for thread in self._threads:
            thread.start()

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{ADDRESS}:{self.gate.port}/?token={self.token}"

    @property
    def connections(self) -> Connections:
        """Those that are open."""
        return self._http.connections

    def policy(self) -> str:
        """Content security policy of the page, as it says itself, and that nobody may frame it."""
        stated = _POLICY.search(self.page)
        own = html.unescape(stated.group(1)) if stated else "default-src 'none'"
        return f"{own}; frame-ancestors 'none'"

    def forget(self) -> None:
        """Forget what is an hour old."""
        self.jobs.forget_older(KEPT_S)
        self.logs.forget_older(KEPT_S, self.jobs.in_use())

    def close(self) -> None:
        """End everything: connections, processes, files."""
        self._closed.set()
        self._http.shutdown()
        self._http.server_close()
        self.workers.close()
        self._http.connections.end(LAST_S)
        for thread in self._threads:
            thread.join()
        shutil.rmtree(self.folder, ignore_errors=True)

    def _look_after(self) -> None:
        while not self._closed.wait(LOOK_S):
            self.forget()
            self.connections.end_late()


class Connections:
    """Open connections, and those of them whose request has not come yet."""

    def __init__(self) -> None:
        self._change = threading.Condition()
        self._open: dict[socket.socket, float] = {}

    def opened(self, connection: socket.socket) -> bool:
        """Whether there is room for one more; its request has to come."""
        with self._change:
            if len(self._open) >= MOST_CONNECTIONS:
                return False
            self._open[connection] = time.monotonic() + HEAD_S
            return True

    def came(self, connection: socket.socket) -> None:
        """Take note that a request's head has come."""
        with self._change:
            if connection in self._open:
                self._open[connection] = float("inf")

    def closed(self, connection: socket.socket) -> None:
        """Take note that it is closed."""
        with self._change:
            self._open.pop(connection, None)
            self._change.notify_all()

    def end_late(self) -> None:
        """End those whose request does not come."""
        with self._change:
            late = [one for one, until in self._open.items() if until < time.monotonic()]
        for one in late:
            _end(one)

    def end(self, patience_s: float) -> None:
        """End all, once they had so long to finish."""
        for patience in (patience_s, 1.0):
            with self._change:
                if self._change.wait_for(lambda: not self._open, timeout=patience):
                    return
                for one in self._open:
                    _end(one)


def _end(connection: socket.socket) -> None:
    with suppress(OSError):
        connection.shutdown(socket.SHUT_RDWR)


class _Http(ThreadingHTTPServer):
    """Connections, each in a thread of its own."""

    daemon_threads = True
    block_on_close = False
    allow_reuse_address = True
    request_queue_size = 128

    def __init__(self, address: tuple[str, int], handler: Any) -> None:
        self.connections = Connections()
        super().__init__(address, handler)

    def server_bind(self) -> None:
        """Bind without asking anybody for the name of the address."""
        if os.name == "posix":  # elsewhere another program could take the port over
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self.socket.bind(self.server_address)
        self.server_address = self.socket.getsockname()
        self.server_name, self.server_port = ADDRESS, self.server_address[1]

    def process_request(self, request: Any, client_address: Any) -> None:
        """Begin the thread of a connection, when there is room for one more."""
        if self.connections.opened(request):
            super().process_request(request, client_address)
            return
        with suppress(OSError):
            request.settimeout(LOOK_S)
            request.sendall(_FULL)
        self.shutdown_request(request)

    def shutdown_request(self, request: Any) -> None:
        """Close a connection."""
        super().shutdown_request(request)
        self.connections.closed(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of connections that break."""
