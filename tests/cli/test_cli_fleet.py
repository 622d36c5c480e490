"""`eivor fleet` as a user meets it."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
from pathlib import Path

import polars as pl
import pytest

import eivor as ev
from fleets.fleet_rows import row, rows_of, write_fleet, write_logs
from report.parsed_page import parsed
from validation.simulated_fleets import FleetSpec, fleet_rows


def test_query_prints_and_writes(eivor, monkeypatch, tmp_path):
    name, reason = "a_log_of_a_vehicle_in_a_hall_of_ours.ulg", f"It is empty{', and so is another' * 4}."
    small = row("a", **{f"gain.{part}": 3.067e-06 for part in ("value", "std_error", "low", "high")})
    fleet = write_fleet(tmp_path / "fleet", [small, row(name, verdict="failed", reason=reason)])
    monkeypatch.setenv("COLUMNS", "60")  # words are folded there, numbers are not cut
    assert reason not in eivor("fleet", "query", fleet, "failed").out
    assert eivor("fleet", "query", fleet, "gain").out.count("3.067e-06") == 4
    monkeypatch.setenv("COLUMNS", "100")
    run = eivor("fleet", "query", fleet)
    assert (run.code, run.out.split()) == (0, ["verdict", "logs", "failed", "1", "weak", "1"])
    run = eivor("fleet", "query", fleet, "gain", "--csv", "-")
    assert run.out.splitlines()[1].startswith("vertical,,2026-05-01T12:00:00.000000+0000,a,3.067e-6,")
    run = eivor("fleet", "query", fleet, "gain", "--csv", tmp_path / "gain.csv")
    assert "2026-05-01 12:00" in run.out
    assert (tmp_path / "gain.csv").read_text().startswith("motion,vehicle,")


@pytest.fixture
def logs(tmp_path, monkeypatch):
    """Logs whose rows are made here, at once."""
    rows_of(monkeypatch)
    return write_logs(tmp_path / "logs", {"a.csv": "one", "b/c.csv": "one", "notes": "none"})


def test_run_tells_what_it_found(eivor, logs, tmp_path):
    run = eivor("fleet", "run", logs, "-o", tmp_path / "fleet", "--workers", 1)
    assert run.code == 0
    assert run.out.splitlines()[:2] == ["2 logs, each with a row: 1 weak, 1 copy", "1 other file is no log"]
    run = eivor("fleet", "run", logs, "-o", tmp_path / "fleet", "--workers", 1)
    assert run.out.splitlines()[1] == "2 of the rows were there before"
    assert eivor("fleet", "compact", tmp_path / "fleet").out == "2 rows in 1 file\n"


def test_an_interrupted_run_says_how_to_go_on(eivor, logs, tmp_path, monkeypatch):
    def interrupted(_options):
        raise KeyboardInterrupt

    rows_of(monkeypatch, interrupted)
    run = eivor("fleet", "run", logs, "-o", tmp_path / "fleet", "--workers", 1)
    assert run.code == 130
    assert "Run the same command again to go on." in run.err


@pytest.mark.thorough
def test_real_logs_become_rows(eivor, log, tmp_path):
    """Nothing is replaced: a process of its own reads and identifies."""
    (tmp_path / "damaged.ulg").write_bytes(b"ULog\x01\x12\x35\x01" + bytes(8))
    run = eivor("fleet", "run", tmp_path / "*.*", "-o", tmp_path / "fleet", "--workers", 1)
    assert run.out.startswith("2 logs, each with a row: ")
    parts = map(pl.read_parquet, (tmp_path / "fleet" / "flights").glob("*.parquet"))
    rows = {row["name"]: row for row in pl.concat(parts, how="diagonal_relaxed").rows(named=True)}
    assert rows["damaged.ulg"]["verdict"] == "failed"
    flight = rows["flight.csv"]
    result = ev.identify_flight(ev.read_log(log))
    assert flight["input_gain.value"] == result.quantities["input_gain"].value
    assert flight["covariance"] == result.covariance.ravel().tolist()
    assert flight["covariance_names"] == list(result.names)
    assert flight["diagnostic.r_squared"] == result.diagnostics["r_squared"]
    assert flight["duration_s"] == pytest.approx(29.99)


HOSTILE = "</script><img src=x onerror=alert(1)>\x1b[31m"


@pytest.mark.thorough
def test_report_prints_and_writes(eivor, tmp_path):
    spec = FleetSpec(vehicles=3, flights=8, broken=((1, 4, 0.4),))
    table = fleet_rows(spec).with_columns(vehicle=pl.col("vehicle").replace("v0001", HOSTILE))
    (tmp_path / "fleet" / "flights").mkdir(parents=True)
    table = table.with_columns(sha256=pl.Series([f"{number:064x}" for number in range(table.height)]))
    table.write_parquet(tmp_path / "fleet" / "flights" / "part-0.parquet")
    (tmp_path / "fleet" / "reports").mkdir()
    (tmp_path / "fleet" / "reports" / f"{3:064x}.html").write_text("a page")
    files = tmp_path / "report.json", tmp_path / "report.html"
    run = eivor("fleet", "report", tmp_path / "fleet", "--json", files[0], "--html", files[1])
    assert (run.code, run.err) == (0, "")
    assert "24 logs; 3 vehicles of 1 type" in run.out
    assert "the input gain steps by" in run.out
    assert "\x1b[31m" not in run.out
    reported = json.loads(files[0].read_text())
    assert reported["schema"] == "eivor.fleet_report/1"
    (motion,) = reported["motions"]
    keys = set(re.findall(r"`(\w+)`", Path("docs/fleet.md").read_text()))
    for name in ("types", "vehicles", "deviating", "left_out", "covariates"):
        assert all(set(item) <= keys for item in motion[name])
    assert [item["course"] for item in motion["vehicles"] if item["quantity"] == "input_gain"].count(
        "steps"
    ) == 1
    page = parsed(files[1].read_text())
    drawn = page.all("img")
    assert all(item.attributes["src"].startswith("data:image/svg+xml;base64,") for item in drawn)
    assert len(drawn) == len(page.all("img", class_="drawn")) == 16  # forests, and a line for each vehicle
    assert HOSTILE.split("\x1b", maxsplit=1)[0] in page.all("main")[0].text
    assert json.loads(page.all("script", id="result")[0].text) == reported
    links = [link.attributes["href"] for link in page.all("a") if "fleet/" in link.attributes["href"]]
    assert set(links) == {f"fleet/reports/{3:064x}.html"}
    assert "no report of its own" in page.all("main")[0].text
    run = eivor("fleet", "report", tmp_path / "fleet", "--json", "-")
    assert json.loads(run.out) == reported
    (tmp_path / "masses.csv").write_text("\n".join(["name,mass", *(f"{item},1" for item in table["name"])]))
    run = eivor("fleet", "report", tmp_path / "fleet", "--covariates", tmp_path / "masses.csv")
    assert (run.code, run.err) == (0, "")
    assert "mass is not known" not in run.out
    assert eivor("fleet", "report", tmp_path / "fleet", "--covariates", "none.csv").code == 1


def test_report_of_what_tells_nothing(eivor, tmp_path):
    fleet = write_fleet(tmp_path / "fleet", [row("a", verdict="failed", reason="It is empty.")])
    run = eivor("fleet", "report", fleet, "--html", tmp_path / "report.html")
    assert run.code == 0
    assert "No flight identifies a quantity" in run.out


STOPS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


@pytest.mark.parametrize("stop", STOPS)
def test_it_opens_the_page_and_stops(eivor, monkeypatch, tmp_path, stop):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    opened = []

    def browser(url):
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

    def browser(_url):
        results.append(signal.getsignal(signal.SIGHUP))
        os.kill(os.getpid(), signal.SIGTERM)

    monkeypatch.setattr("webbrowser.open", browser)
    try:
        assert eivor("serve", "--workers", 1).code == 0
    finally:
        signal.signal(signal.SIGHUP, before)
    assert results == [signal.SIG_IGN]


@pytest.mark.parametrize(
    ("words", "code", "sentence"),
    [
        ("serve --no-browser", 1, "pip install 'eivor[serve]'"),
        ("idenify flight.ulg", 2, "Did you mean 'identify'?"),  # what others lack is not in the way
    ],
)
def test_a_missing_extra_is_a_sentence(words, code, sentence):
    code_of = (
        f"import sys; sys.modules['uvicorn'] = None; sys.argv = ['eivor', *{words.split()}]; "
        "from eivor.__main__ import run; run()"
    )
    run = subprocess.run([sys.executable, "-c", code_of], capture_output=True, text=True, check=False)
    assert run.returncode == code
    assert sentence in run.stderr
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
