"""Who may ask for what: everything else is refused, in a sentence, and touches nothing."""

from __future__ import annotations

import errno
import html
import http.client
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager, suppress
from importlib import resources
from pathlib import Path
from types import SimpleNamespace

import polars as pl
import pytest
import typer

from eivor.atomic_file import LOCK, folder_lock
from eivor.cli.main import app as command_line
from eivor.errors import EivorError
from eivor.process_pool import TRIES, Limits
from eivor.serve import app, jobs
from eivor.serve.app import KEPT_S, ServeOptions, Server, page_text
from eivor.serve.jobs import shown_name
from eivor.serve.requests import MOST_FILES, JobOptions, RefusedError, parse_job, plain_name, sent_files
from refusal_rows import rows, table
from serve.quick_work import QuickWork

NOBODY = "0" * 32


def wait_for(condition):
    """Return once it holds."""
    end = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def pids(server):
    """Processes that wait for work."""
    return [process.pid for process, _ in list(server.workers._free) if process.pid is not None]


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
            given = {"x-eivor-token": self.server.token}
            given |= {name.replace("_", "-"): value for name, value in headers.items()}
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


@pytest.fixture
def clock(monkeypatch):
    """Seconds that pass when they are told to."""
    made = SimpleNamespace(now=0.0)
    monkeypatch.setattr(jobs, "clock", lambda: made.now)
    return made


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
        assert not pids(server)


@pytest.fixture(scope="module")
def page(opening):
    """The page of a server for a whole file of tests."""
    return opening()


def test_the_page_comes_with_its_token_and_a_policy(page):
    status, body, headers = page("GET", f"/?token={page.server.token}", x_eivor_token=None)
    assert (status, body.decode()) == (200, page_text())
    policy, _, last = headers["Content-Security-Policy"].rpartition("; ")
    assert last == "frame-ancestors 'none'"
    assert policy.startswith("default-src 'none'; script-src 'sha256-")
    assert f'content="{policy}"' in html.unescape(body.decode())
    assert (headers["Cache-Control"], headers["X-Content-Type-Options"]) == ("no-store", "nosniff")
    assert page.server.url == f"http://127.0.0.1:{page.server.port}/?token={page.server.token}"
    json = page.json("GET", "/choices")
    assert json["models"] == [{"name": "vertical", "words": "up and down"}]
    assert json["largest_bytes"] == 1000


@pytest.mark.parametrize(
    ("status", "headers"),
    [
        *((403, {"x_eivor_token": token}) for token in (None, "x", "é")),
        *((403, {"origin": origin}) for origin in ("http://evil.example", "null")),
        *((403, {"sec_fetch_site": site}) for site in ("cross-site", "same-site")),
        *(
            (421, {"host": host})
            for host in ("evil.example", "evil.example:80", "127.0.0.1", "127.0.0.1:1@e.x")
        ),
    ],
)
@pytest.mark.parametrize(("method", "path"), [("GET", "/choices"), ("POST", "/logs")])
def test_others_may_not_ask(page, method, path, status, headers):
    before = list(page.server.folder.rglob("*"))
    code, sentence = page.refused(method, path, b"a log" if method == "POST" else None, **headers)
    assert code == status
    assert "Open the address that `eivor serve` has printed." in sentence
    assert list(page.server.folder.rglob("*")) == before


def test_the_own_origin_may_ask_by_either_name(page):
    port = page.server.port
    for host in (f"127.0.0.1:{port}", f"localhost:{port}", f"LocalHost:{port}"):
        headers = {"host": host, "origin": f"http://{host}", "sec_fetch_site": "same-origin"}
        assert page("GET", "/choices", **headers)[0] == 200
    assert page.refused("GET", "/choices", origin=f"https://127.0.0.1:{port}")[0] == 403
    assert page.refused("GET", "/", x_eivor_token=None)[0] == 403
    assert page.refused("GET", f"/choices?token={page.server.token}", x_eivor_token=None)[0] == 403


GONE = ("/nothing", "/jobs/../logs", "/../../etc/passwd", "/%2e%2e/%2e%2e/etc/passwd", "//evil.example/")
OF_NOBODY = ("/events", "/result.json", "/exports", "/exports/..%2f..%2fresult.json", "%00/events")


@pytest.mark.parametrize(
    ("status", "method", "path"),
    [
        *((404, "GET", path) for path in GONE),
        *((404, "GET", f"/jobs/{NOBODY}{path}") for path in OF_NOBODY),
        *((404, "DELETE", f"/{kind}/{NOBODY}") for kind in ("jobs", "logs")),
        *((405, method, "/") for method in ("POST", "PROPFIND")),
        *((405, method, "/logs") for method in ("PUT", "GET")),
        (405, "OPTIONS", "/jobs"),
        (405, "PATCH", f"/jobs/{NOBODY}/events"),
        (411, "POST", "/logs"),
    ],
)
def test_what_is_not_there_is_not_found(page, status, method, path):
    assert page.refused(method, path)[0] == status


@pytest.mark.parametrize("length", ["-1", "+5", "5.0", "five", "", "9" * 16])
def test_a_body_says_how_long_it_is(page, length):
    assert page.refused("POST", "/logs", b"12345", content_length=length)[0] in {400, 411}


def test_a_body_comes_in_one_piece(page):
    assert page.refused("POST", "/logs", b"5\r\n12345", transfer_encoding="chunked")[0] == 411


@pytest.mark.parametrize(
    ("status", "request_line", "rest"),
    [
        (400, "", "x"),
        (400, "GET", ""),
        (404, "PRI * HTTP/2.0", ""),
        (400, f"GET / HTTP/1.{'1' * 5000}", ""),
        (400, "\x16\x03\x01\x02", ""),
        (400, "GET / x y HTTP/1.1", ""),
        (400, f"GET /{'a' * 700_000} HTTP/1.1", ""),
        (400, "GET / HTTP/1.1", f"X: {'a' * 700_000}\r\n"),
        (400, "GET /choices HTTP/1.1", "Host: 127.0.0.1:80\r\n"),
        (400, "POST /logs HTTP/1.1", "Content-Length: 1\r\nContent-Length: 2\r\n"),
        (400, "POST /logs HTTP/1.1", "Content-Length: 0\r\nContent-Length: 0\r\n"),
        (400, "POST /logs HTTP/1.1", "Content-Length: 1\r\nX-Y: z\r\ncontent-length : 1\r\n"),
        (404, "CONNECT evil.example:80 HTTP/1.1", ""),
        (404, "OPTIONS * HTTP/1.1", ""),
        (404, "GET http://evil.example/ HTTP/1.1", ""),
        (200, "GET /choices HTTP/1.1", "Connection: Upgrade\r\nUpgrade: websocket\r\n"),
        (200, "HEAD /choices HTTP/1.1", ""),
        (200, "GET /choices HTTP/1.0", ""),
    ],
)
def test_whatever_comes_is_answered_once_and_no_more_is_read(page, capfd, status, request_line, rest):
    """As one request and as three, one after the other, in what is sent at once."""
    text = f"Host: 127.0.0.1:{page.server.port}\r\nX-Eivor-Token: {page.server.token}\r\n"
    request = f"{request_line}\r\n{text}{rest}\r\n".encode()
    for times in (1, 3):
        with socket.create_connection(("127.0.0.1", page.server.port), timeout=10.0) as line:
            line.sendall(times * request)
            sentence = received(line)
        assert sentence.startswith(f"HTTP/1.1 {status} ".encode())
        assert sentence.count(b"HTTP/1.1 ") == 1
        assert sentence.count(b'"error"') == (status >= 400)
    assert capfd.readouterr() == ("", "")


def received(line):
    """What comes until the other side closes; it may do so before all was read that was sent."""
    sentence = b""
    with suppress(ConnectionResetError):
        while part := line.recv(65536):
            sentence += part
    return sentence


def sending(page, length, body, more=""):
    """A connection on which the head of a log of this length and a part of it were sent."""
    line = socket.create_connection(("127.0.0.1", page.server.port), timeout=10.0)
    line.sendall(
        f"POST /logs HTTP/1.1\r\nHost: 127.0.0.1:{page.server.port}\r\n{more}"
        f"X-Eivor-Token: {page.server.token}\r\nContent-Length: {length}\r\n\r\n{body}".encode()
    )
    return line


def test_a_body_beyond_the_limit_is_refused_before_it_is_read(page):
    with sending(page, 1001, "") as line:
        sentence = received(line)
    assert sentence.startswith(b"HTTP/1.1 413 ")
    assert json.loads(sentence.partition(b"\r\n\r\n")[2])["error"]["received"] == "1001 bytes"
    assert page.refused("POST", "/logs", bytes(1001))[0] == 413
    assert page.json("POST", "/logs", bytes(1000))["bytes"] == 1000
    assert page.refused("POST", "/jobs", b" " * 1_000_001)[0] == 413


@pytest.mark.parametrize(
    ("header", "name"),
    [
        ("flight.ulg", "flight.ulg"),
        ("..%2f..%2fetc%2fpasswd", "passwd"),
        ("..%5c..%5cboot.ini", "boot.ini"),
        ("%252e%252e%252fx", "%2e%2e%2fx"),
        ("a%00b.csv", "ab.csv"),
        ("%ff", "�"),
        ("..", ".."),
        ("x/", "log"),
        ("%3Cscript%3Ealert(1)%3C%2Fscript%3E", "script>"),
        ("%E2%80%AEgpj.ulg", "\u202egpj.ulg"),
        ("x" * 10_000, "x" * 255),
    ],
)
def test_a_name_is_shown_and_no_path(page, header, name):
    assert shown_name(header) == name
    log = page.json("POST", "/logs", b"x", x_eivor_name=header)
    assert log["name"] == name
    for folder in (page.server.folder, *page.server.folder.iterdir()):
        assert folder.stat().st_mode & 0o077 == 0
    (kept,) = page.server.folder.glob(f"logs/{log['log']}*")
    assert kept.suffix in {"", ".ulg", ".ini", ".csv"}
    page.json("DELETE", f"/logs/{log['log']}")
    assert not kept.exists()
    assert page.refused("DELETE", f"/logs/{log['log']}")[0] == 404


@pytest.mark.parametrize("more", ["", "X-Eivor-Files: a/3 b/497\r\n"])
def test_a_log_or_a_folder_that_breaks_off_leaves_nothing(page, more):
    def entries():
        """Unlike `rglob` a walk goes on where a folder is removed under it."""
        return [(folder, *map(sorted, names)) for folder, *names in os.walk(page.server.folder)]

    before = entries()
    with sending(page, 500, "half", more):
        wait_for(lambda: page.server.logs._coming > 0)
    wait_for(lambda: sorted(entries()) == sorted(before) and page.server.logs._coming == 0)


def test_connections_are_bounded(page, monkeypatch):
    """Those that have shown no token make room for others, the oldest first; those with one are counted."""
    closed(page.server)
    monkeypatch.setattr(app, "MOST_CONNECTIONS", 0)
    address = ("127.0.0.1", page.server.port)
    with socket.create_connection(address, timeout=10.0) as further:
        assert further.recv(100).startswith(b"HTTP/1.1 503 ")
    monkeypatch.setattr(app, "MOST_CONNECTIONS", 3)
    monkeypatch.setattr(app, "MOST_STRANGERS", 3)
    monkeypatch.setattr(app, "HEAD_S", 600.0)
    with ExitStack() as held:
        lines = [held.enter_context(socket.create_connection(address, timeout=10.0)) for _ in range(5)]
        assert [line.recv(100) for line in lines[:2]] == [b"", b""]
        assert page("GET", "/choices")[0] == 200
        assert lines[2].recv(100) == b""
    closed(page.server)


@pytest.mark.skipif(os.name == "nt", reason="files in use stay there")
def test_a_server_deletes_what_a_killed_one_left(opening, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    left, lives = tmp_path / f"{app.PREFIX}left", tmp_path / f"{app.PREFIX}lives"
    for folder in (left, lives):
        (folder / "logs").mkdir(parents=True)
        (folder / LOCK).touch()
    with folder_lock(lives):
        opening()
    assert (left.exists(), lives.exists()) == (False, True)
    (tmp_path / f"{app.PREFIX}link").symlink_to(lives)
    (lives / LOCK).unlink()
    app.remove_abandoned()
    assert lives.exists()


def test_a_connection_must_say_what_it_wants(page, monkeypatch):
    monkeypatch.setattr(app, "HEAD_S", 0.2)
    with socket.create_connection(("127.0.0.1", page.server.port), timeout=30.0) as slow:
        slow.sendall(b"GET / HTTP/1.1\r\nHo")
        assert slow.recv(100) == b""


def test_a_slow_log_is_given_up(page, monkeypatch):
    monkeypatch.setattr(app, "BODY_S", -10.0)
    assert page.refused("POST", "/logs", b"slow")[0] == 408
    wait_for(lambda: page.server.logs._coming == 0)


def test_a_full_disk_is_told(page, monkeypatch):
    monkeypatch.setattr(jobs, "LEFT_FREE", 10**18)
    status, sentence = page.refused("POST", "/logs", b"log")
    assert (status, "room for 3 bytes more" in sentence) == (507, True)
    monkeypatch.undo()

    def full(_path):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(jobs, "atomic_write", full)
    status, sentence = page.refused("POST", "/logs", b"log")
    assert (status, "No space left on device" in sentence) == (500, True)


def test_the_server_loads_nothing_heavy():
    code = "import sys, eivor.serve.app; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"polars", "matplotlib", "pyulog", "eivor.serve.worker"} & set(done.stdout.split())


def test_options_are_declared_once(page):
    """The command line, the page's requests and the JSON Schema have the same options of the same types."""
    command = typer.main.get_command(command_line).commands["identify"]
    typed = {
        item.name: "array" if item.multiple else "boolean" if getattr(item, "is_flag", False) else "value"
        for item in command.params
    }
    words = {"string": "value", "number": "value", "boolean": "boolean", "array": "array"}
    schema = page.json("GET", "/options.schema.json")
    declared = schema["$defs"]["FlightWords"]["properties"]
    kinds = {name: words[item.get("type") or item["anyOf"][0]["type"]] for name, item in declared.items()}
    assert kinds == {name: typed[name] for name in kinds}
    assert {*kinds} == {*typed} - {
        *("logs", "example", "model", "vehicle", "machine", "channel_map"),
        *("needs", "json", "figure", "html", "card", "residuals", "help"),
    }
    body = {"logs": ["1"], "options": {"surprise": 1}}
    refused = page.refused("POST", "/jobs", json.dumps(body).encode())
    assert all(name in str(refused) for name in kinds if name != "lag_from")


LOG, FILES = "a" * 32, [f"{number}.csv/1" for number in range(MOST_FILES + 1)]


def asked(**options):
    """Job of a log with these options."""
    return parse_job(json.dumps({"logs": [LOG], "options": options}).encode())


def test_options_are_words_of_the_command_line():
    words = {"method": "least_squares", "lag": "70:15", "compare": True, "noise": ["estimate"]}
    words |= {"terms": ["quadratic-drag"], "window": "4:67.5", "max_tilt": 20, "rotor_radius": 0.12}
    others = {"model": "rates", "vehicle": "crazyflie-2x", "map": "rotorpy", "mass": "1.5:0.02"}
    job = asked(**words, **others, instruments="")
    assert job.options == JobOptions(**words, **others)
    several = parse_job(json.dumps({"logs": [LOG, {"log": LOG, "window": ":3"}]}).encode())
    assert several.windows == [(LOG, ""), (LOG, ":3")]


test_refused = table(
    rows("job", EivorError, parse_job, *((body, r"\A(?=.{0,999}\Z)Expected .*; received .*") for body in (
        b"", b"\xff\xfe", b"null", b"[]", b"3", b"{}", b"[" * 100_000, b'{"logs": 1e999}', b'{"logs": []}'))),
    rows("options", EivorError, lambda options: asked(**options),
        ({"windw": [1, 2]}, "Did you mean 'window'"),
        ({"lag_from": "/etc/passwd"}, "received lag_from"),
        ({"window": [1]}, "a text"),
        ({"compare": "yes"}, "true or false at options.compare of the request"),
        ({"max_tilt": True}, "a finite number"),
        ({"method": 3}, "a text"),
        ({"terms": [["x"]]}, "a text"),
    ),
    rows("files", RefusedError, sent_files, *((header, 3, "files of a folder") for header in (
        "a.csv", "a.csv/5", "a.csv/-1 b.csv/4", "a.csv/3  ", "a.csv/1 A.csv/2", "/3")),
        (" ".join(FILES), len(FILES), f"at most {MOST_FILES} files")),
)  # fmt: skip


@pytest.mark.parametrize(
    ("name", "plain"),
    [
        ("flight_1_vehicle_attitude_0.csv", "flight_1_vehicle_attitude_0.csv"),
        ("../../etc/passwd", "passwd"),
        ("..\\boot.ini", "boot.ini"),
        ("..", "_.."),
        (".hidden", "_.hidden"),
        ("", "_"),
        ("a\0b\u202e<c>:d*.db3", "a_b__c__d_.db3"),
        ("ä" * 10_000 + ".csv", "_" * 116 + ".csv"),
    ],
)
def test_a_name_in_a_folder_is_plain(name, plain):
    assert plain_name(name) == plain


def test_as_many_files_as_a_folder_may_have():
    assert len(sent_files(" ".join(FILES[1:]), MOST_FILES)) == MOST_FILES


def test_its_files_are_kept_and_deleted_with_it(page):
    files = {"a_0.db3": b"123", "metadata.yaml": b"", "..%2Fb%3C_1.db3": b"4567"}
    text = " ".join(f"{name}/{len(content)}" for name, content in files.items())
    body = b"".join(files.values())
    log = page.json("POST", "/logs", body, x_eivor_name="my%2Fbag", x_eivor_files=text)
    assert (log["name"], log["bytes"]) == ("bag", 7)
    folder = page.server.folder / "logs" / log["log"]
    kept = {file.name: file.read_bytes() for file in folder.iterdir()}
    assert kept == {"a_0.db3": b"123", "metadata.yaml": b"", "b__1.db3": b"4567"}
    assert folder.stat().st_mode & 0o077 == 0
    page.json("DELETE", f"/logs/{log['log']}")
    assert not folder.exists()
    assert page.refused("POST", "/logs", body, x_eivor_files="a/1")[0] == 400
    assert page.refused("POST", "/logs", bytes(1001), x_eivor_files="a/1001")[0] == 413


def test_the_example_is_kept_as_if_it_was_dropped(opening):
    page = opening(largest=10**6)
    log = page.json("POST", "/example", {})
    (kept,) = page.server.folder.glob(f"logs/{log['log']}*")
    assert kept.name == f"{log['log']}.parquet"
    assert kept.read_bytes() == resources.files("eivor.data").joinpath(log["name"]).read_bytes()


# Jobs in processes of their own: told by stages, cancelled, kept to their limits, forgotten.


def until(events, stage):
    """Wait for a stage."""
    assert any(event["stage"] == stage for event in events)


def is_alive(process):
    """Whether a process is there that has not ended."""
    try:
        stat = Path(f"/proc/{process}/stat").read_text(encoding="ascii", errors="replace")
    except (FileNotFoundError, ProcessLookupError):
        return False
    return stat.rpartition(")")[2].split()[0] != "Z"


def test_a_job_tells_its_stages_and_has_a_result(page):
    job = page.job("a flight ü".encode(), "my ü flight.ulg", mass="1.5")
    with page.events(job) as events:
        reported = list(events)
    stages = dict.fromkeys(item["stage"] for item in reported[:-1])
    assert list(stages) == ["waiting", "reading", "identifying"]
    assert all(item["elapsed"] >= 0.0 for item in reported[:-1])
    assert reported[-1] == {"done": {"status": "identified"}}
    assert page("GET", f"/jobs/{job}/result.json")[1].decode() == "a flight ü"
    assert page("GET", f"/jobs/{job}/report.html")[1].decode() == "<p>a flight ü"
    assert page.last(job) == reported[-1]  # for those who come late, too
    targets = page.json("GET", f"/jobs/{job}/exports")["targets"]
    assert targets == [{"name": "px4", "file": "my ü flight-px4.params", "reason": "1.5"}]
    status, body, headers = page("GET", f"/jobs/{job}/exports/px4?mass=2:1&prior=a=1&prior=b=2&vehicle=x")
    assert (status, body.decode()) == (200, "mass='2:1', vehicle='x', prior='a=1\\nb=2'")
    assert headers["Content-Disposition"] == (
        "attachment; filename=\"my_flight-px4.txt\"; filename*=UTF-8''my%20%C3%BC%20flight-px4.txt"
    )
    assert page.refused("GET", f"/jobs/{job}/plan/csv") == (409, "Expected csv; received csv. csv")
    assert page.refused("GET", f"/jobs/{job}/exports?" + "&".join(f"x{n}=1" for n in range(21)))[0] == 400
    page.json("DELETE", f"/jobs/{job}")
    assert page.refused("GET", f"/jobs/{job}/result.json")[0] == 404
    assert not list(page.server.folder.glob(f"jobs/{job}*"))


@pytest.mark.thorough
def test_a_running_job_is_cancelled_and_so_is_one_that_waits(opening):
    page = opening(workers=1, limits=Limits(60.0, 0.5))
    running, waiting = page.job(b"child and sleep"), page.job(b"sleep")
    with page.events(running) as events:
        until(events, "sleeping")
        assert next(events)["stage"] == "sleeping"  # something is said while it lasts
        with page.events(waiting) as others:
            assert next(others)["position"] == 1
            assert page.refused("GET", f"/jobs/{waiting}/result.json")[0] == 409
            page.json("DELETE", f"/jobs/{waiting}")
            assert list(others)[-1] == {"cancelled": True}
        (child,) = page.server.folder.glob(f"jobs/{running}/child")
        page.json("DELETE", f"/jobs/{running}")
        assert list(events)[-1] == {"cancelled": True}
    process, given_up_at = int(child.read_text(encoding="ascii")), time.monotonic()
    while is_alive(process):  # what is killed ends when it has its turn
        assert time.monotonic() < given_up_at + 10.0
        time.sleep(0.02)
    assert page.refused("GET", f"/jobs/{running}/report.html")[0] == 409
    assert page.last(page.job(b"well")) == {"done": {"status": "identified"}}


def test_a_log_that_is_refused_is_a_sentence(page):
    assert page.last(page.job(b"refuse"))["failed"]["advice"] == "refuse"


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"die", "died (exit code 7)"),
        pytest.param(b"memory", "it took more than 0.2 GB of memory", marks=pytest.mark.thorough),
        pytest.param(b"sleep", "it took longer than 0.6 s to answer", marks=pytest.mark.thorough),
    ],
)
def test_what_a_process_dies_of_is_a_sentence(opening, content, sentence):
    page = opening(workers=1, limits=Limits(0.6, 0.2))
    reported = page.last(page.job(content))["failed"]
    assert reported["expected"] == "a log that takes at most 0.6 s and 0.2 GB"
    assert sentence in reported["sentence"]
    assert "eivor serve --time S --memory GB" in reported["advice"]
    assert page.last(page.job(b"once")) == {"done": {"status": "identified"}}


@pytest.mark.thorough
def test_a_process_that_is_killed_takes_nothing_along(opening):
    page = opening(workers=1, limits=Limits(60.0, 0.5))
    job = page.job(b"sleep")
    with page.events(job) as events:
        for left in reversed(range(TRIES)):
            until(events, "sleeping")
            (pid,) = page.server.folder.glob(f"jobs/{job}/pid")
            os.kill(int(pid.read_text(encoding="ascii")), signal.SIGKILL)
            if left:
                until(events, "reading")
        last = list(events)[-1]
    assert "signal 9" in last["failed"]["sentence"]
    assert page.last(page.job(b"well")) == {"done": {"status": "identified"}}


def test_a_verdict_stays_where_its_report_fails(page):
    job = page.job(b"unreported")
    assert page.last(job) == {"done": {"status": "identified"}}
    assert page("GET", f"/jobs/{job}/result.json")[1] == b"unreported"
    sentence = "Expected unreported; received unreported. unreported"
    assert page.refused("GET", f"/jobs/{job}/report.html") == (500, sentence)


def test_the_queue_is_bounded(opening, monkeypatch):
    monkeypatch.setattr(jobs, "MOST_WAITING", 2)
    page = opening(workers=1, limits=Limits(60.0, 0.5))
    page.json("GET", "/choices")
    first = page.job(b"sleep")
    with page.events(first) as events:
        until(events, "sleeping")
    page.job(b"sleep")
    page.job(b"sleep")
    log = page.dropped(b"sleep")
    requested = json.dumps({"logs": [log]}).encode()
    status, sentence = page.refused("POST", "/jobs", requested)
    assert (status, "at most 2 tasks that wait" in sentence) == (503, True)
    assert len(list(page.server.folder.glob("jobs/*"))) == 3


def test_many_drops_at_once_are_all_answered(page):
    with ThreadPoolExecutor(20) as many:
        reported = list(many.map(lambda number: page.last(page.job(b"%d" % number)), range(20)))
    assert reported == [{"done": {"status": "identified"}}] * 20


def test_what_is_old_is_forgotten(opening, clock):
    page = opening()
    server = page.server
    log = page.dropped(b"well")
    job = page.json("POST", "/jobs", {"logs": [log]})["job"]
    assert "done" in page.last(job)
    page("GET", f"/jobs/{job}/report.html")
    clock.now += KEPT_S - 1.0
    server.forget()
    assert page("GET", f"/jobs/{job}/result.json")[0] == 200
    clock.now += 2.0
    server.forget()
    assert page.refused("GET", f"/jobs/{job}/result.json")[0] == 404
    assert page.refused("POST", "/jobs", json.dumps({"logs": [log]}).encode())[0] == 404
    assert {path.name for path in server.folder.rglob("*")} == {"logs", "jobs", LOCK}


def test_old_logs_make_room_and_those_of_jobs_stay(opening, clock):
    page = opening(workers=1, limits=Limits(60.0, 0.5))
    used = page.dropped(b"sleep" + bytes(900))
    job = page.json("POST", "/jobs", {"logs": [used]})["job"]
    others = []
    for _ in range(4):
        clock.now += 1.0
        others.append(page.dropped(bytes(1000)))
    assert page.refused("DELETE", f"/logs/{others[0]}")[0] == 404
    assert page.refused("DELETE", f"/logs/{used}")[0] == 409
    page.json("DELETE", f"/jobs/{job}")
    page.last(job)
    page.json("DELETE", f"/logs/{used}")
    page.json("DELETE", f"/logs/{others[1]}")


@pytest.mark.thorough
def test_nothing_is_left_when_it_closes_in_the_middle(opening):
    page = opening(workers=2, limits=Limits(60.0, 0.5))
    jobs = [page.job(b"sleep") for _ in range(3)]
    with page.events(jobs[0]) as events:
        until(events, "sleeping")
        page.server.close()
        assert list(events)[-1] == {"cancelled": True}
    assert not page.server.folder.exists()
    assert not pids(page.server)


@pytest.mark.thorough
def test_a_process_that_has_worked_gives_its_memory_back(opening, monkeypatch):
    monkeypatch.setattr(jobs, "IDLE_S", 0.1)
    page = opening(workers=1)
    page.json("GET", "/choices")
    assert "done" in page.last(page.job(b"well"))
    before, until = set(pids(page.server)), time.monotonic() + 20.0
    while set(pids(page.server)) in (before, set()) and time.monotonic() < until:
        time.sleep(0.02)
    assert len(set(pids(page.server)) - before) == 1


#: What memory may have grown by [bytes].
GROWN = 50_000_000


def held(pids: list[int]) -> int:
    """Memory that processes hold [bytes]."""
    return sum(int(Path(f"/proc/{pid}/statm").read_text("ascii").split()[1]) * 4096 for pid in pids)


def fresh(server: Server) -> int:
    """The process that waits, once those that have worked are gone."""
    used, end = set(pids(server)), time.monotonic() + 60.0
    assert used
    while time.monotonic() < end:
        waiting = pids(server)
        if len(waiting) == 1 and waiting[0] not in used:
            return waiting[0]
        time.sleep(0.05)
    raise AssertionError(f"no new process: {waiting}")


def dropped(page: Asking, content: bytes, count: int, at_once: int) -> None:
    """Drop a log so often, and ask for everything that comes of it."""

    def drop(number: int) -> None:
        job = page.job(content, f"{number}.csv")
        assert set(page.last(job)) == {"done"}
        for name in ("result.json", "report.html", "exports"):
            assert page("GET", f"/jobs/{job}/{name}")[0] == 200
        page.json("DELETE", f"/jobs/{job}")

    with ThreadPoolExecutor(at_once) as many:
        list(many.map(drop, range(count)))


def check(monkeypatch: pytest.MonkeyPatch, seconds: float, *rounds: tuple[int, int]) -> None:
    """Drop logs of so many seconds: so many, so many of them at once."""
    with resources.as_file(resources.files("eivor.data") / "example_flight.parquet") as path:
        content = pl.read_parquet(path).filter(pl.col("time") < seconds).write_csv().encode()
    monkeypatch.setattr(jobs, "IDLE_S", 1.0)
    server = Server(ServeOptions(workers=2))
    try:
        page = Asking(server)
        page.json("GET", "/choices")
        dropped(page, content, 1, 1)  # what this process loads by itself
        before = held([os.getpid(), fresh(server)])
        for count, at_once in rounds:
            dropped(page, content, count, at_once)
        assert held([os.getpid(), fresh(server)]) < before + GROWN
        assert not list(server.folder.glob("jobs/*"))
    finally:
        server.close()
    assert not server.folder.exists()
    assert not pids(server)


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from /proc")
@pytest.mark.thorough
def test_twenty_drops(monkeypatch):
    check(monkeypatch, 2.0, (20, 4))
