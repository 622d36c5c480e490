"""`eivor serve` says where it is, and leaves nothing when it is stopped."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

STOPS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


@pytest.mark.parametrize("stop", STOPS)
def test_it_opens_the_page_and_stops(eivor, monkeypatch, tmp_path, stop):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    opened = []

    def browser(url: str) -> None:
        opened.append((url, [path.name for path in tmp_path.iterdir()]))
        os.kill(os.getpid(), stop)

    monkeypatch.setattr("webbrowser.open", browser)
    outside = signal.signal(stop, signal.default_int_handler)  # `nohup` has one of them ignored
    try:
        run = eivor("serve", "--workers", 1)
        after = signal.getsignal(stop)
    finally:
        signal.signal(stop, outside)
    ((url, folders),) = opened
    assert (run.code, run.err) == (0, "")
    assert run.out.startswith(f"{url}\n")
    assert url.startswith("http://127.0.0.1:")
    assert [name.startswith("eivor-serve-") for name in folders] == [True]
    assert list(tmp_path.iterdir()) == []
    assert after is signal.default_int_handler


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="no terminals here that can be closed")
def test_it_outlives_its_terminal_where_it_shall(eivor, monkeypatch):
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    results = []

    def browser(_url: str) -> None:
        results.append(signal.getsignal(signal.SIGHUP))
        os.kill(os.getpid(), signal.SIGTERM)

    monkeypatch.setattr("webbrowser.open", browser)
    try:
        assert eivor("serve", "--workers", 1).code == 0
    finally:
        signal.signal(signal.SIGHUP, before)
    assert results == [signal.SIG_IGN]


@pytest.mark.parametrize(
    ("arguments", "code", "sentence"),
    [
        (("--port", -1), 2, "a port of 0 to 65535"),
        (("--port", 65536), 2, "a port of 0 to 65535"),
        (("--workers", 0), 2, "at least one worker"),
        (("--memory", 0), 2, "a limit memory_gb above zero"),
        (("--time", "nan"), 2, "a limit time_s above zero"),
        (("--largest", 0), 2, "a size above zero"),
        (("--host", "localhost"), 2, "No such option"),
    ],
)
def test_wrong_usage_is_told(eivor, arguments, code, sentence):
    run = eivor("serve", "--no-browser", *arguments)
    assert run.code == code
    assert sentence in run.err


def test_a_missing_extra_is_a_sentence():
    code = (
        "import sys; sys.modules['uvicorn'] = None; sys.argv = ['eivor', 'serve', '--no-browser']; "
        "from eivor.__main__ import run; run()"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert run.returncode == 1
    assert "pip install 'eivor[serve]'" in run.stderr
    assert "Traceback" not in run.stderr


def test_a_port_that_is_taken_is_told(eivor):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        run = eivor("serve", "--no-browser", "--port", taken.getsockname()[1])
    assert run.code == 1
    assert "Choose another with --port" in run.err


@pytest.mark.thorough
@pytest.mark.parametrize("stop", STOPS)
def test_its_process_ends_with_its_workers(tmp_path, stop):
    process = subprocess.Popen(
        [sys.executable, "-c", "from eivor.cli.main import run; run()", "serve", "--no-browser"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "TMPDIR": str(tmp_path)},
    )
    assert process.stdout is not None
    assert process.stdout.readline().startswith(b"http://127.0.0.1:")
    process.send_signal(stop)
    _, sentence = process.communicate(timeout=60.0)
    assert (process.returncode, sentence) == (0, b"")
    assert list(Path(tmp_path).iterdir()) == []
