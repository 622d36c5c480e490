"""What never happens: a traceback, a screen rewritten by a log's name, a slow start."""

from __future__ import annotations

import gc
import io
import math
import os
import re
import runpy
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import pytest

import eivor as ev
from eivor import __main__ as entry
from eivor.cli import main, outputs
from eivor.cli.outputs import ExitCode, guarded
from eivor.cli.parsing import LogArgument, declared_noise, log_argument, named, parse_names, parse_window
from eivor.errors import CorruptLogError, UsageError
from eivor.signals.recording import DataSheet
from eivor.tools import Stage

PROJECT = Path(__file__).parents[2] / "pyproject.toml"


pytestmark = pytest.mark.usefixtures("coarse_search")
HOSTILE = "a[red]b[bold]$x_1$\x1b[31m\n@1é.csv"


@pytest.mark.thorough
def test_help_loads_nothing_heavy():
    """The help of one command loads what that command needs."""
    code = (
        "import sys\nsys.argv = ['eivor', '--help']\nfrom eivor.cli.main import run\n"
        "try: run()\n"
        "except SystemExit as left: assert not left.code\n"
        "print('@modules', *sys.modules)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.count("Usage: eivor") == 1
    loaded = set(run.stdout.partition("@modules")[2].split())
    heavy = {"numpy", "polars", "scipy", "scipy.signal", "matplotlib", "pyulog", "pooch", "requests"}
    assert "eivor.cli.main" in loaded
    assert not heavy & loaded


def test_version(eivor):
    import eivor as package

    run = eivor("--version")
    assert run.code == 0
    assert run.out == f"eivor {package.__version__}\n"


def test_the_interpreter_runs_the_command_line(eivor, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["eivor", "--version"])
    monkeypatch.delitem(sys.modules, "eivor.__main__", raising=False)  # other tests import it
    # what the shape checks' hook compiles must not be kept as the module's own bytecode
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    with pytest.raises(SystemExit) as left:
        runpy.run_module("eivor", run_name="__main__")
    assert left.value.code == 0
    assert capsys.readouterr().out == eivor("--version").out


def test_a_wrong_command_is_wrong_usage(eivor):
    run = eivor("identfy")
    assert run.code == 2
    assert "identify" in run.err


def _failing(error):
    def command():
        raise error

    return guarded(command)


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


@pytest.mark.thorough
def test_an_interrupt_leaves_with_130():
    code = (
        "import os, signal, sys\n"
        "import eivor.motions.identify as motion\n"
        "motion.identify_flight = lambda *a, **k: os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.argv = ['eivor', 'identify', '--example']\n"
        "from eivor.cli.main import run; run()"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert run.returncode in {130, -signal.SIGINT}
    assert "Traceback" not in run.stderr
    assert "interrupted" in run.stderr


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
    assert (run.returncode, run.stderr) == (ExitCode.INTERRUPTED, "eivor: interrupted\n")


def test_the_console_script_begins_before_anything_is_loaded():
    """What is loaded before `run` watches cannot be interrupted without a traceback."""
    metadata = tomllib.loads(PROJECT.read_text(encoding="utf-8"))
    module, _, function = metadata["project"]["scripts"]["eivor"].partition(":")
    code = (
        f"import sys; before = set(sys.modules); from {module} import {function}\n"
        "print(*sorted(name.partition('.')[0] for name in set(sys.modules) - before))"
    )
    listed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"typer", "click", "numpy", "email", "zipfile"} & set(listed.stdout.split())


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


@pytest.mark.thorough
def test_a_hostile_name_does_nothing(eivor, flight, tmp_path):
    path = tmp_path / HOSTILE
    flight.head(1500).write_csv(tmp_path / "x.csv")
    (tmp_path / "x.csv").rename(path)
    for arguments in (("identify", path, "--figure", tmp_path / "x.svg"), ("inspect", path)):
        run = eivor(*arguments)
        assert run.code in {0, 3}
        assert "\x1b" not in run.out + run.err
        assert "a[red]b[bold]$x_1$\\x1b[31m\\n@1é.csv" in "".join(run.out.split("\n"))
    assert (tmp_path / "x.svg").stat().st_size > 10_000


def test_a_hostile_name_in_an_error(eivor, tmp_path):
    run = eivor("identify", tmp_path / HOSTILE)
    assert run.code == 1
    assert "\x1b" not in run.err
    assert run.err.count("\n") == 1


@pytest.mark.thorough
def test_a_name_that_is_no_text(flight, tmp_path):
    path = os.path.join(os.fsencode(tmp_path), b"\xff.csv")  # noqa: PTH118 - bytes are the point
    source = tmp_path / "x.csv"
    flight.head(1500).write_csv(source)
    os.rename(source, path)  # noqa: PTH104 - bytes are the point
    for more in ([], [b"--json", b"-"]):
        run = subprocess.run(
            [sys.executable, "-c", "from eivor.cli.main import run; run()", b"identify", path, *more],
            capture_output=True,
            check=False,
        )
        assert run.returncode in {0, 1, 3}
        assert b"Traceback" not in run.stderr


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
    "option",
    ["--lag", "--lag-from", "--window", "--input", "--input-map", "--map", "--json", "--figure", "--html"],
)
def test_an_empty_option_is_not_passed_over(eivor, option):
    run = eivor("identify", "--example", option, "")
    assert run.code == 2
    assert run.out == ""
    assert f"Expected a value for {option}; received an empty text." in run.err
    assert run.err.rstrip().endswith("or leave it out.")


def test_of_the_group_and_of_a_file(eivor, tmp_path, monkeypatch):
    assert "a value for --config" in eivor("--config", "", "identify", "--example").err
    monkeypatch.chdir(tmp_path)
    (tmp_path / "eivor.toml").write_text('[identify]\nlag = ""\n')
    run = eivor("identify", "--example")
    assert (run.code, run.out) == (2, "")
    assert "a value for --lag" in run.err


PAGE = (Path(__file__).parents[2] / "docs" / "from-a-log.md").read_text(encoding="utf-8")


@pytest.fixture
def written(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def write(text, name="eivor.toml"):
        (tmp_path / name).write_text(text, encoding="utf-8")

    return write


def test_it_is_read_where_it_is_and_said(eivor, written):
    written('[identify]\nlag = "65:15"\nterm = ["quadratic-drag", "voltage"]\nalign = true\nmax-tilt = 20\n')
    ran = eivor("identify", "missing.ulg")
    assert ran.code == 1
    splitline, missing = ran.err.splitlines()[0], ran.err
    assert (
        splitline
        == "eivor: options of eivor.toml: max-tilt 20, lag 65:15, align, term quadratic-drag voltage"
    )
    assert "missing.ulg" in missing
    assert ran.out == ""


def test_the_command_line_comes_first(eivor, written):
    written('[identify]\nlag = "65:15"\n')
    assert "options of" not in eivor("identify", "missing.ulg", "--lag", "60:10").err
    assert "options of" not in eivor("inspect", "missing.ulg").err


def test_a_file_that_is_named(eivor, written):
    written('[identify]\nlag = "65:15"\n')
    written("[fleet.run]\nworkers = 2\n", "lab.toml")
    assert "options of" not in eivor("--config", "lab.toml", "identify", "missing.ulg").err
    assert (
        "options of lab.toml: workers 2"
        in eivor("--config", "lab.toml", "fleet", "run", "missing", "-o", "out").err
    )


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("[identfy]", r"tables named as commands.*\[identfy\]\. Did you mean 'identify'"),
        ("lag = 3", "tables named as commands.*Remove it"),
        ("identify = 3", r"Expected a table \[identify\]"),
        ("[identify]\nlagg = 3", "options of eivor identify.*'lagg'. Did you mean 'lag'"),
        ("[fleet.run]\nworker = 3", "options of eivor fleet run.*Did you mean 'workers'"),
        ("[identify]\nalign = 3", "true or false at identify.align of eivor.toml; received 3"),
        ("[identify]\nlag = true", "a text or a number, at identify.lag of eivor.toml; received True"),
        ("[identify]\nterm = [{}]", "a text or a number, or a list of them"),
        ("[identify", "not: "),
    ],
)
def test_what_is_wrong_is_said(eivor, written, text, wrong):
    written(text)
    ran = eivor("identify", "missing.ulg")
    assert ran.code == 1
    assert re.search(wrong, ran.err)
    assert "missing.ulg" not in ran.err


def test_a_file_that_is_missing(eivor, written):
    ran = eivor("--config", "lab.toml", "identify", "missing.ulg")
    assert ran.code == 1
    assert "'lab.toml', unreadable" in ran.err


def test_tables_of_commands_that_are_not_loaded(written):
    from typer.testing import CliRunner

    from eivor.cli.main import application

    written('[fleet.run]\nworkers = 2\n[identify]\nlag = "65:15"\n')
    ran = CliRunner().invoke(application("plan", "identify"), ["identify", "missing.ulg"])
    assert "lag 65:15" in ran.output


def test_the_file_of_the_page_is_valid(eivor, written):
    (block,) = re.findall(r"```text\n(\[identify\]\n.*?)```", PAGE, flags=re.DOTALL)
    written(block)
    splitline = eivor("identify", "missing.ulg").err.splitlines()[0]
    assert splitline.startswith("eivor: options of eivor.toml: ")
    assert all(
        option in splitline for option in ("lag 65:15", "map mycopter.toml", "align", "term quadratic-drag")
    )


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


@pytest.mark.parametrize("text", ["", "4", "67:4", "4:4", "a:b", "4:nan", "nan:", "1:2:3", "4-67"])
def test_a_window_that_is_none_is_refused(text):
    with pytest.raises(UsageError, match="START before END"):
        parse_window(text)


def test_a_log_may_bring_its_window():
    assert log_argument("a/b.ulg@4:67") == LogArgument(Path("a/b.ulg"), (4.0, 67.0))
    assert log_argument("b.ulg@-4:6.5") == LogArgument(Path("b.ulg"), (-4.0, 6.5))
    assert log_argument("me@home.csv") == LogArgument(Path("me@home.csv"))
    assert log_argument("me@home.csv@1:2") == LogArgument(Path("me@home.csv"), (1.0, 2.0))
    assert log_argument("@1:2") == LogArgument(Path("@1:2"))


def test_an_existing_file_with_an_at_in_its_name_wins(tmp_path):
    path = tmp_path / "flight@4:67"
    path.touch()
    assert log_argument(str(path)) == LogArgument(path)


@pytest.mark.parametrize("text", [",", " ", "lags,references", "references,pilot_throttle"])
def test_instruments_that_exclude_each_other_are_refused(text):
    with pytest.raises(UsageError, match="alone"):
        parse_names(text)


def test_an_error_names_its_log_once():
    with pytest.raises(CorruptLogError, match=r"bits, in b\.ulg"), named("a/b.ulg", several=True):
        raise CorruptLogError("a log", "bits, in b.ulg", "Try again.")
    with pytest.raises(CorruptLogError, match=r"bits, in a/b\.ulg"), named("a/b.ulg", several=True):
        raise CorruptLogError("a log", "bits", "Try again.")
    with pytest.raises(CorruptLogError, match=r"bits\. Try"), named("a/b.ulg", several=False):
        raise CorruptLogError("a log", "bits", "Try again.")


def test_numbers_units_sheets_and_the_word():
    assert declared_noise([]) is None
    assert declared_noise(["estimate"]) == "estimate"
    assert declared_noise(["velocity_z=0.02"]) == {"velocity_z": 0.02}
    assert declared_noise(["velocity_z=2 cm/s,specific_force_z=30mg"]) == {
        "velocity_z": pytest.approx(0.02),
        "specific_force_z": pytest.approx(0.2942, rel=1e-3),
    }
    assert declared_noise(
        ["velocity_z=density:0.002m/s/sqrt(Hz),bandwidth:50Hz,step:1cm/s", "rotor_speed=3"]
    ) == {"velocity_z": DataSheet(0.002, 50.0, 0.01), "rotor_speed": 3.0}


@pytest.mark.parametrize(
    ("texts", "words"),
    [
        (["velocity_z"], "NAME=STD"),
        (["velocity_z="], "NAME=STD"),
        (["velocity_z=-1"], "zero or more for velocity_z"),
        (["velocity_z=nan"], "zero or more for velocity_z"),
        (["velocity_z=lots"], "zero or more for velocity_z"),
        (["velocity_z=1 m"], "in m/s, or a unit of that kind"),
        (["velocity_z=1 parsec"], "in m/s, or a unit of that kind"),
        (["velocity_z=1", "velocity_z=2"], "twice"),
        (["velocity_z=densty:1"], "density"),
        (["velocity_z=bandwidth:50"], "sheet of velocity_z; received 'bandwidth:50'. Give --noise"),
        (["velocity_z=density:0,bandwidth:50"], "above zero of the data sheet of velocity_z"),
        (["estimate", "velocity_z=2"], "estimate alone"),
    ],
)
def test_noises_that_are_none(texts, words):
    with pytest.raises(UsageError, match=words):
        declared_noise(texts)


def test_stages_come_in_order():
    log = ev.example_flight()
    stages: list[Stage] = []
    ev.identify_flight(log, window=(0.0, 20.0), progress=stages.append)
    assert stages == list(Stage)
