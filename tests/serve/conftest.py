"""A server in this process, and the page that asks it."""

from __future__ import annotations

import http.client
import json
import time
from collections.abc import Callable
from contextlib import closing, contextmanager

import pytest

from eivor.process_pool import Limits
from eivor.serve.app import ServeOptions, Server
from serve.quick_work import QuickWork


def wait_for(condition):
    """Return once it holds."""
    end = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def closed(server):
    """Return once no connection is open."""
    wait_for(lambda: not server.connections)


class Asking:
    """A page of a server."""

    def __init__(self, server):
        self.server = server

    def __call__(self, method, path, body=None, **headers):
        """Status, body and headers of an answer; a header of None is left out."""
        with closing(http.client.HTTPConnection("127.0.0.1", self.server.port, timeout=30.0)) as line:
            line.putrequest(method, path, skip_host="host" in headers, skip_accept_encoding=True)
            given = {
                "x-eivor-token": self.server.token,
                **{k.replace("_", "-"): v for k, v in headers.items()},
            }
            if body is not None:
                given.setdefault("content-length", str(len(body)))
            for name, value in given.items():
                if value is not None:
                    line.putheader(name, value)
            line.endheaders()
            if body is not None:
                line.send(body)
            answer = line.getresponse()
            return answer.status, answer.read(), answer.headers

    def json(self, method, path, body=None, **headers):
        """JSON of an answer that is one."""
        data = body if body is None or isinstance(body, bytes) else json.dumps(body).encode()
        status, text, _ = self(method, path, data, **headers)
        assert status == 200, text
        return json.loads(text)

    def refused(self, method, path, body=None, **headers):
        """Status and sentence of a refusal, whose parts are all there."""
        status, text, _ = self(method, path, body, **headers)
        error = json.loads(text)["error"]
        assert set(error) == {"expected", "received", "advice", "sentence"}
        return status, error["sentence"]

    def dropped(self, content, name="flight.csv"):
        """Identifier of a log that is dropped."""
        log: str = self.json("POST", "/logs", content, x_eivor_name=name)["log"]
        return log

    def job(self, content, name="flight.csv", **options):
        """Identifier of a job of a log that is dropped."""
        requested = {"logs": [self.dropped(content, name)], "options": options}
        job: str = self.json("POST", "/jobs", requested)["job"]
        return job

    @contextmanager
    def events(self, job):
        """What is told of a job, as it comes."""
        with closing(http.client.HTTPConnection("127.0.0.1", self.server.port, timeout=30.0)) as line:
            line.request("GET", f"/jobs/{job}/events", headers={"X-Eivor-Token": self.server.token})
            answer = line.getresponse()
            assert answer.status == 200
            yield map(json.loads, answer)

    def last(self, job):
        """The last that is told of a job."""
        with self.events(job) as events:
            return list(events)[-1]


class Clock:
    """Seconds that pass when they are told to."""

    def __init__(self):
        self.now = 0.0

    def __call__(self):
        return self.now


Opening = Callable[..., Asking]


@pytest.fixture(scope="module")
def opening():
    """Open servers whose processes do what logs say; they are closed in the end."""
    servers: list[Server] = []

    def opened(**options):
        quick = {"work": QuickWork(), "limits": Limits(5.0, 0.5), "largest": 1000}
        servers.append(Server(ServeOptions(**{**quick, **options})))
        return Asking(servers[-1])

    yield opened
    for server in servers:
        server.close()
        assert not server.folder.exists()
        assert not server.workers.pids()


@pytest.fixture(scope="module")
def page(opening):
    """The page of a server for a whole file of tests."""
    return opening()
