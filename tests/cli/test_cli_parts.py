"""Parts of the command line: steps, windows, noises and names as they are typed; logs that are fetched."""

from __future__ import annotations

import gc
import hashlib
import io
import json
import math
import subprocess
import sys
import threading
import time
import tomllib
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest

import eivor as ev
from eivor import __main__ as entry
from eivor.cli import main, outputs, tools
from eivor.cli.parsing import declared_noise, log_argument, named, parse_window
from eivor.errors import CorruptLogError, InputError
from eivor.lab.scenario_files import shipped_rigid_body_flight
from eivor.motions.rigid_body.vehicle import KnownNumber, load_vehicle, shipped_vehicles, vehicle_template
from eivor.signals.recording import DataSheet
from eivor.signals.thrust_map import input_map
from eivor.simulation.rigid_body import vehicle_text
from eivor.tools import Stage
from exports import documents


@pytest.fixture(autouse=True)
def _here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def _failing(error):
    def command():
        raise error

    return outputs.guarded(command)


@pytest.mark.parametrize(
    ("error", "code", "message"),
    [
        (ZeroDivisionError("seven"), 1, "unexpected ZeroDivisionError: seven"),
        (MemoryError(), 1, "Not enough memory"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
)
def test_an_unexpected_error_is_one_message(capsys, monkeypatch, error, code, message):
    import typer

    monkeypatch.delenv("EIVOR_DEBUG", raising=False)
    with pytest.raises(typer.Exit) as left:
        _failing(error)()
    assert left.value.exit_code == code
    assert message in capsys.readouterr().err
    monkeypatch.setenv("EIVOR_DEBUG", "1")
    if isinstance(error, ZeroDivisionError):
        with pytest.raises(ZeroDivisionError):
            _failing(error)()


#: Ctrl-C while a module is loaded: what was loaded by half cannot be used, not even to say so.
LOADING = """
class Interrupted:
    def find_spec(self, name, path=None, target=None):
        if name == {!r}: raise KeyboardInterrupt
sys.meta_path.insert(0, Interrupted())
"""

#: The same while arguments are read.
READING = """
from eivor.cli.main import Commands
def interrupted(*args, **more): raise KeyboardInterrupt
Commands.{} = interrupted
"""


@pytest.mark.parametrize(
    "code",
    [
        *(LOADING.format(name) for name in ("numpy._typing", "eivor.cli.main", "typer", "eivor.errors")),
        *(READING.format(step) for step in ("parse_args", "get_command")),
    ],
)
def test_an_interrupt_before_a_command_runs_leaves_with_130(code):
    """The console script watches from its first line on."""
    called = "sys.argv = ['eivor', 'identify', '--example']\nfrom eivor.__main__ import run; run()"
    code = f"import sys{code}{called}"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (run.returncode, run.stderr) == (outputs.ExitCode.INTERRUPTED, "eivor: interrupted\n")


def test_the_console_script_looks_for_garbage_seldom_and_never_at_the_end(monkeypatch):
    before, seen = gc.get_threshold(), []
    monkeypatch.setattr(main, "run", lambda: seen.append(gc.get_threshold()[0]))
    try:
        entry.run()
        assert seen == [entry.OBJECTS_BETWEEN_COLLECTIONS]
        assert gc.get_freeze_count() > 0
    finally:
        gc.unfreeze()
        gc.set_threshold(*before)


class _Terminal(io.StringIO):
    def isatty(self):
        return True


def test_a_step_is_announced_on_terminals_only(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    for stream, announced in ((_Terminal(), True), (io.StringIO(), False)):
        monkeypatch.setattr(sys, "stderr", stream)
        with outputs.step("Reading [red]\x1b[2J.ulg"):
            end = time.monotonic() + (600.0 if announced else 0.2)  # so long only when something hangs
            while "Reading" not in stream.getvalue() and time.monotonic() < end:
                time.sleep(0.01)
        assert ("Reading [red]\\x1b[2J.ulg" in stream.getvalue()) is announced


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("4:67", (4.0, 67.0)),
        ("-26.5:-1", (-26.5, -1.0)),
        ("0:1e2", (0.0, 100.0)),
        (" 4 : 67 ", (4.0, 67.0)),
        ("4:", (4.0, math.inf)),
        (":67", (-math.inf, 67.0)),
    ],
)
def test_a_window_is_two_seconds(text, expected):
    assert parse_window(text) == expected


def test_a_log_may_bring_its_window():
    Path("flight@4:67").touch()  # a file that is there wins
    for text, path, window in (
        ("a/b.ulg@4:67", "a/b.ulg", (4.0, 67.0)),
        ("b.ulg@-4:6.5", "b.ulg", (-4.0, 6.5)),
        ("me@home.csv", "me@home.csv", None),
        ("me@home.csv@1:2", "me@home.csv", (1.0, 2.0)),
        ("@1:2", "@1:2", None),
        ("flight@4:67", "flight@4:67", None),
    ):
        assert log_argument(text) == (Path(path), window)


def test_an_error_names_its_log_once():
    for received, several, said in (
        ("bits, in b.ulg", True, r"bits, in b\.ulg"),
        ("bits", True, r"bits, in a/b\.ulg"),
        ("bits", False, r"bits\. Try"),
    ):
        with pytest.raises(CorruptLogError, match=said), named("a/b.ulg", several=several):
            raise CorruptLogError("a log", received, "Try again.")


def test_numbers_units_sheets_and_the_word():
    assert declared_noise([]) is None
    assert declared_noise(["estimate"]) == "estimate"
    assert declared_noise(["velocity_z=0.02"]) == {"velocity_z": 0.02}
    both = declared_noise(["velocity_z=2 cm/s", "specific_force_z=30mg"])
    assert both == pytest.approx({"velocity_z": 0.02, "specific_force_z": 0.2942}, rel=1e-3)
    sheet = "velocity_z=density:0.002m/s/sqrt(Hz),bandwidth:50Hz,step:1cm/s"
    expected = {"velocity_z": DataSheet(0.002, 50.0, 0.01), "rotor_speed": 3.0}
    assert declared_noise([sheet, "rotor_speed=3"]) == expected


def test_stages_come_in_order():
    log = ev.example_flight()
    stages: list[Stage] = []
    ev.identify_flight(log, window=(0.0, 20.0), progress=stages.append)
    assert stages == list(Stage)


def test_new_writes_a_file_that_show_accepts(eivor, tmp_path):
    run = eivor("vehicle", "new", "mine.toml")
    assert (run.code, run.out, run.err) == (0, "mine.toml: fill in what you know\n", "")
    assert load_vehicle(tmp_path / "mine.toml").name == "My quadrotor"
    assert eivor("vehicle", "new").out == vehicle_template()
    run = eivor("vehicle", "show", "mine.toml")
    assert (run.code, run.out, run.err) == (0, vehicle_template(), "")


def test_list_names_what_show_shows(eivor):
    listed = eivor("vehicle", "list").out
    for name in shipped_vehicles():
        assert name in listed
        run = eivor("vehicle", "show", name)
        assert run.code == 0
        assert "[rotors]" in run.out


CONTENT = b"a log"


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, format, *args):
        pass


@pytest.fixture
def server(tmp_path):
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


def _log(base, content=CONTENT):
    return tools.PublicLog("x", f"{base}/x.ulg", hashlib.sha256(content).hexdigest(), "A log.", "MIT")


def test_a_log_is_fetched_once(server, tmp_path):
    folder = tmp_path / "cache"
    path = tools.local_file(_log(server), folder=folder)
    assert (path, path.read_bytes()) == (folder / "x.ulg", CONTENT)
    (tmp_path / "origin" / "x.ulg").unlink()
    assert tools.local_file(_log(server), folder=folder) == path


def test_what_cannot_be_fetched_is_told(server, tmp_path):
    nowhere = "http://127.0.0.1:1"
    (tmp_path / "x.ulg").write_bytes(b"damage")
    (tmp_path / "a file").touch()
    for base, folder, words in (
        (f"{server}/none", "cache", "404"),
        (nowhere, "cache", r"received no connection\. Check"),
        (nowhere, ".", r"no connection; and '.*x\.ulg' is there with another content"),
        (server, "a file", "EIVOR_CACHE"),
    ):
        with pytest.raises(InputError, match=words):
            tools.local_file(_log(base), folder=tmp_path / folder)
    assert (tmp_path / "x.ulg").read_bytes() == b"damage"


def test_fetch_prints_the_path(eivor, server, tmp_path, monkeypatch):
    monkeypatch.setenv("EIVOR_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(tools, "public_logs", lambda: {"x": _log(server)})
    run = eivor("example", "fetch", "x")
    assert (run.code, run.out) == (0, f"{tmp_path / 'cache' / 'x.ulg'}\n")
    monkeypatch.setattr(tools, "public_logs", lambda: {"x": _log("http://127.0.0.1:1", b"other")})
    run = eivor("example", "fetch", "x")
    assert run.code == 1
    assert run.err.startswith("eivor: Expected")


def test_list_and_sources(eivor):
    listed = eivor("example", "list").out
    for name, log in tools.public_logs().items():
        assert name in listed
        assert log.url.startswith("https://raw.githubusercontent.com/")
        assert any(len(part) == 40 and set(part) <= set("0123456789abcdef") for part in log.url.split("/"))
        assert len(log.sha256) == 64


def test_the_hashes_are_those_of_the_files(recordings):
    files = {path.name: path for path in recordings.glob("*/*")}
    for log in tools.public_logs().values():
        assert hashlib.sha256(files[log.file_name].read_bytes()).hexdigest() == log.sha256


def test_the_vehicle_file_is_of_the_vehicle_that_flew(eivor, tmp_path):
    (tmp_path / "mine.toml").write_text(
        'kind = "rigid-body"\nduration = 0.1\n[vehicle]\nmass = 1.1\ninertia = [0.01, 0.01, 0.02]\n'
        "[vehicle.rotors]\n"
        "positions = [[0.1, 0.2, 0.0], [-0.1, -0.2, 0.0], [0.1, -0.2, 0.0], [-0.1, 0.2, 0.0]]\n"
        "spins = [1, 1, -1, -1]\nhighest_speed = 2500.0\nthrust_quadratic = 3e-6\nthrust_linear = 1e-6\n"
        "torque_ratio = 0.02\nlag_up = 0.03\nlag_down = 0.04\n[sensors.angular_rate]\ncutoff_hz = 40.0\n",
        encoding="utf-8",
    )
    run = eivor("simulate", "mine.toml", "-o", "log.parquet", "--vehicle", "known.toml")
    assert (run.code, run.err) == (0, "")
    vehicle = load_vehicle(tmp_path / "known.toml")
    assert (vehicle.name, vehicle.mass, vehicle.spins) == ("mine", KnownNumber(1.1), (1, 1, -1, -1))
    assert vehicle.positions == ((0.1, 0.2), (-0.1, -0.2), (0.1, -0.2), (-0.1, 0.2))
    assert (vehicle.gyro_cutoff_hz, vehicle.accelerometer_cutoff_hz) == (40.0, None)
    assert (vehicle.torque_ratio, vehicle.speed_scale) == (KnownNumber(0.02), KnownNumber(1.0))
    fit = documents.written(documents.of_lopsided(delay=(0.00422, 1e-4), yaw_damping=(0.0, 0.01)), tmp_path)
    run = eivor("simulate", "mine.toml", "-o", "log.parquet", "--from", fit, "--truth", "truth.json")
    assert (run.code, run.err) == (0, "eivor: The delay is 4 ms for 4.22 ms, in whole steps of 2 ms.\n")
    truth = json.loads(Path("truth.json").read_text(encoding="utf-8"))
    assert [truth["delay"], *truth["rate_damping"]] == pytest.approx([0.004, 0.35, 0.35, 0.0])
    quick, slow = input_map(vehicle.thrust_map)(np.array([900.0, 300.0]))
    assert quick / slow == pytest.approx((3e-6 * 900.0**2 + 1e-6 * 900.0) / (3e-6 * 300.0**2 + 1e-6 * 300.0))


@pytest.mark.parametrize(("name", "told"), [('🚁 "ä"\\', '🚁 "ä"\\'), ("a\x7f\ud800\nb", "a???b")])
def test_a_vehicles_name_is_text_in_its_file(name, told):
    text = vehicle_text(shipped_rigid_body_flight("crazyflie"), name)
    assert tomllib.loads(text.encode("utf-8").decode("utf-8"))["name"] == told
