"""`eivor example`: from a local server and from files, never from the network."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Callable, Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from eivor.cli import tools
from eivor.cli.tools import PublicLog, fetched, public_logs
from eivor.errors import CorruptLogError, InputError

Caller = Callable[..., Any]
CONTENT = b"a log"


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:
        pass


@pytest.fixture
def server(tmp_path: Path) -> Iterator[str]:
    """Address of a server on this machine that has one file."""
    folder = tmp_path / "origin"
    folder.mkdir()
    (folder / "x.ulg").write_bytes(CONTENT)
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(_Quiet, directory=str(folder))) as result:
        thread = threading.Thread(target=result.serve_forever, daemon=True)
        thread.start()
        yield f"http://127.0.0.1:{result.server_address[1]}"
        result.shutdown()
        thread.join()


def _log(base: str, content: bytes = CONTENT) -> PublicLog:
    return PublicLog("x", f"{base}/x.ulg", hashlib.sha256(content).hexdigest(), "A log.", "MIT")


def test_a_log_is_fetched_once(server: str, tmp_path: Path) -> None:
    folder = tmp_path / "cache"
    path = fetched(_log(server), folder=folder)
    assert path == folder / "x.ulg"
    assert path.read_bytes() == CONTENT
    (tmp_path / "origin" / "x.ulg").unlink()
    assert fetched(_log(server), folder=folder) == path


@pytest.mark.thorough
def test_a_damaged_copy_is_fetched_again(server: str, tmp_path: Path) -> None:
    path = fetched(_log(server), folder=tmp_path)
    path.write_bytes(b"damage")
    assert fetched(_log(server), folder=tmp_path).read_bytes() == CONTENT


@pytest.mark.thorough
def test_another_content_is_refused_and_not_kept(server: str, tmp_path: Path) -> None:
    with pytest.raises(CorruptLogError, match="another content"):
        fetched(_log(server, b"other"), folder=tmp_path / "cache")
    assert not list((tmp_path / "cache").glob("*"))


def test_what_is_not_there_is_told(server: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="404"):
        fetched(_log(f"{server}/none"), folder=tmp_path / "cache")


def test_no_network_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no connection"):
        fetched(_log("http://127.0.0.1:1"), folder=tmp_path / "cache")


def test_no_network_and_a_wrong_file_are_both_told(tmp_path: Path) -> None:
    (tmp_path / "x.ulg").write_bytes(b"damage")
    with pytest.raises(InputError, match=r"no connection; and '.*x\.ulg' is there with another content"):
        fetched(_log("http://127.0.0.1:1"), folder=tmp_path)
    assert (tmp_path / "x.ulg").read_bytes() == b"damage"
    with pytest.raises(InputError, match=r"received no connection\. Check"):
        fetched(_log("http://127.0.0.1:1"), folder=tmp_path / "empty")


@pytest.mark.thorough
def test_a_folder_that_cannot_be_is_told(server: str, tmp_path: Path) -> None:
    (tmp_path / "cache").write_text("a file")
    with pytest.raises(InputError, match="EIVOR_CACHE"):
        fetched(_log(server), folder=tmp_path / "cache")


def test_fetch_prints_the_path(eivor: Caller, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    origin = tmp_path / "origin folder"
    origin.mkdir()
    (origin / "x.ulg").write_bytes(CONTENT)
    monkeypatch.setenv("EIVOR_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(tools, "public_logs", lambda: {"x": _log(origin.as_uri())})
    for name in ("x", "x.ulg"):
        run = eivor("example", "fetch", name)
        assert run.code == 0
        assert run.out == f"{tmp_path / 'cache' / 'x.ulg'}\n"
    monkeypatch.setattr(tools, "public_logs", lambda: {"x": _log("http://127.0.0.1:1", b"other")})
    run = eivor("example", "fetch", "x")
    assert run.code == 1
    assert run.err.startswith("eivor: Expected")


def test_an_unknown_name_is_wrong_usage(eivor: Caller) -> None:
    run = eivor("example", "fetch", "nothing")
    assert run.code == 2
    assert "ekf_failure" in run.err


def test_list_has_every_log(eivor: Caller) -> None:
    run = eivor("example", "list")
    assert run.code == 0
    assert all(name in run.out for name in public_logs())


def test_path_is_the_bundled_flight(eivor: Caller) -> None:
    run = eivor("example", "path")
    assert run.code == 0
    assert Path(run.out.strip()).is_file()


def test_every_source_is_at_a_fixed_version() -> None:
    for log in public_logs().values():
        assert log.url.startswith("https://raw.githubusercontent.com/")
        assert any(len(part) == 40 and set(part) <= set("0123456789abcdef") for part in log.url.split("/"))
        assert len(log.sha256) == 64


@pytest.mark.recordings
def test_the_hashes_are_those_of_the_files(recordings: Path) -> None:
    hashes = {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest()
        for path in recordings.glob("*/*")
        if path.is_file()
    }
    for log in public_logs().values():
        assert hashes[log.file_name] == log.sha256
