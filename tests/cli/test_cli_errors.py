"""What never happens: a traceback, a screen rewritten by a log's name, a slow start."""

from __future__ import annotations

import gc
import io
import os
import runpy
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import polars
import pytest

from eivor import __main__ as entry
from eivor.cli import main, outputs
from eivor.cli.outputs import ExitCode, guarded

PROJECT = Path(__file__).parents[2] / "pyproject.toml"
Caller = Callable[..., Any]

pytestmark = pytest.mark.usefixtures("coarse_search")

HOSTILE = "a[red]b[bold]$x_1$\x1b[31m\n@1é.csv"


@pytest.mark.thorough
def test_help_loads_nothing_heavy() -> None:
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


@pytest.mark.thorough
def test_help_loads_little_more_than_what_draws_it(shell: Caller) -> None:
    """Half a second on a slow machine, of which most is Python, typer and rich."""

    def spent(run: Callable[[], Any]) -> float:
        # time of the processor, not of the clock: other work on the machine must not fail this test
        before = os.times()
        assert run() == 0
        after = os.times()
        return after.children_user + after.children_system - before.children_user - before.children_system

    drawing = [sys.executable, "-c", "import typer.rich_utils, typer.main, importlib.metadata"]
    bare = min(spent(lambda: subprocess.run(drawing, check=False).returncode) for _ in range(2))
    assert min(spent(lambda: shell("--help").code) for _ in range(2)) < 2.0 * bare


def test_help_says_the_exit_codes(eivor: Caller) -> None:
    for command in (
        ["identify"],
        ["inspect"],
        ["example", "list"],
        ["example", "fetch"],
        ["example", "path"],
    ):
        run = eivor(*command, "--help")
        assert run.code == 0
        assert "Exit codes" in run.out


def test_help_names_every_method_and_shipped_map(eivor: Caller) -> None:
    from eivor.estimation.methods import TABLE
    from eivor.logs import shipped_maps

    run = eivor("identify", "--help")
    assert all(name in run.out for name in (*TABLE, *shipped_maps()))


@pytest.mark.parametrize(
    "command", [(), ("identify",), ("inspect",), ("simulate",), ("study",), ("paper",), ("example", "fetch")]
)
def test_paragraphs_of_help_are_as_wide_as_the_terminal(eivor: Caller, command: tuple[str, ...]) -> None:
    out = eivor(*command, "--help").out
    assert "--help" in out
    paragraphs = [line for line in out.splitlines() if line.startswith(" ") and line.endswith(",")]
    assert all(len(line) > 60 for line in paragraphs)


@pytest.mark.thorough
def test_a_shell_completes_commands_and_options(shell: Caller, eivor: Caller) -> None:
    for words, expected in (("eivor ide", "identify"), ("eivor identify --exa", "--example")):
        completed = shell(
            _EIVOR_COMPLETE="complete_bash", COMP_WORDS=words, COMP_CWORD=str(len(words.split()) - 1)
        )
        assert completed.out.split() == [expected]
    assert "--install-completion" in eivor("--help").out


def test_without_arguments_there_is_help(eivor: Caller) -> None:
    run = eivor()
    assert "identify" in run.out + run.err
    assert "inspect" in run.out + run.err


def test_version(eivor: Caller) -> None:
    import eivor as package

    run = eivor("--version")
    assert run.code == 0
    assert run.out == f"eivor {package.__version__}\n"


def test_the_interpreter_runs_the_command_line(eivor: Caller, monkeypatch, capsys) -> None:
    monkeypatch.setattr("sys.argv", ["eivor", "--version"])
    monkeypatch.delitem(sys.modules, "eivor.__main__", raising=False)  # other tests import it
    with pytest.raises(SystemExit) as left:
        runpy.run_module("eivor", run_name="__main__")
    assert left.value.code == 0
    assert capsys.readouterr().out == eivor("--version").out


def test_a_wrong_command_is_wrong_usage(eivor: Caller) -> None:
    run = eivor("identfy")
    assert run.code == 2
    assert "identify" in run.err


def _failing(error: BaseException) -> Callable[[], None]:
    def command() -> ExitCode:
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
def test_an_unexpected_error_is_one_message(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    error: BaseException,
    code: int,
    message: str,
) -> None:
    import typer

    monkeypatch.delenv("EIVOR_DEBUG", raising=False)
    with pytest.raises(typer.Exit) as left:
        _failing(error)()
    assert left.value.exit_code == code
    assert message in capsys.readouterr().err


def test_debug_shows_the_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EIVOR_DEBUG", "1")
    with pytest.raises(ZeroDivisionError):
        _failing(ZeroDivisionError("seven"))()


@pytest.mark.thorough
def test_an_interrupt_leaves_with_130() -> None:
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


def test_an_interrupt_while_libraries_are_loaded_leaves_with_130() -> None:
    """What was loaded by half cannot be used, not even to say so."""
    code = (
        "import sys\n"
        "class Interrupted:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'numpy._typing': raise KeyboardInterrupt\n"
        "sys.meta_path.insert(0, Interrupted())\n"
        "sys.argv = ['eivor', 'identify', '--example']\n"
        "from eivor.__main__ import run; run()"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (run.returncode, run.stderr) == (130, "eivor: interrupted\n")


@pytest.mark.parametrize("module", ["eivor.cli.main", "typer", "eivor.cli.outputs", "eivor.errors"])
def test_an_interrupt_while_the_command_line_is_loaded_leaves_with_130(module: str) -> None:
    """Ctrl-C right after the command was typed: the console script watches from its first line on."""
    code = (
        "import sys\n"
        "class Interrupted:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        f"        if name == {module!r}: raise KeyboardInterrupt\n"
        "sys.meta_path.insert(0, Interrupted())\n"
        "sys.argv = ['eivor', 'identify', '--example']\n"
        "from eivor.__main__ import run; run()"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (run.returncode, run.stderr) == (ExitCode.INTERRUPTED, "eivor: interrupted\n")


@pytest.mark.parametrize("step", ["parse_args", "get_command"])
def test_an_interrupt_while_arguments_are_read_leaves_with_130(step: str) -> None:
    code = (
        "import sys\n"
        "from eivor.cli.main import Commands\n"
        "def interrupted(*args, **more): raise KeyboardInterrupt\n"
        f"Commands.{step} = interrupted\n"
        "sys.argv = ['eivor', 'identify', '--example']\n"
        "from eivor.__main__ import run; run()"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (run.returncode, run.stderr) == (ExitCode.INTERRUPTED, "eivor: interrupted\n")


def test_the_console_script_begins_before_anything_is_loaded() -> None:
    """What is loaded before `run` watches cannot be interrupted without a traceback."""
    metadata = tomllib.loads(PROJECT.read_text(encoding="utf-8"))
    module, _, function = metadata["project"]["scripts"]["eivor"].partition(":")
    code = (
        f"import sys; before = set(sys.modules); from {module} import {function}\n"
        "print(*sorted(name.partition('.')[0] for name in set(sys.modules) - before))"
    )
    listed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"typer", "click", "numpy", "email", "zipfile"} & set(listed.stdout.split())


def test_a_command_that_is_named_is_loaded_alone() -> None:
    code = (
        "import sys\nfrom eivor.__main__ import run\n"
        "sys.argv = ['eivor', 'identify', '--help']\n"
        "try: run()\nexcept SystemExit as left: assert not left.code\n"
        "print('@modules', *sys.modules)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(run.stdout.partition("@modules")[2].split())
    assert "eivor.cli.identify" in loaded
    assert not {"eivor.lab.cli", "eivor.cli.tools"} & loaded


def test_the_console_script_looks_for_garbage_seldom_and_never_at_the_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
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
def test_a_hostile_name_does_nothing(eivor: Caller, flight: polars.DataFrame, tmp_path: Path) -> None:
    path = tmp_path / HOSTILE
    flight.head(1500).write_csv(tmp_path / "x.csv")
    (tmp_path / "x.csv").rename(path)
    for arguments in (("identify", path, "--figure", tmp_path / "x.svg"), ("inspect", path)):
        run = eivor(*arguments)
        assert run.code in {0, 3}
        assert "\x1b" not in run.out + run.err
        assert "a[red]b[bold]$x_1$\\x1b[31m\\n@1é.csv" in "".join(run.out.split("\n"))
    assert (tmp_path / "x.svg").stat().st_size > 10_000


def test_a_hostile_name_in_an_error(eivor: Caller, tmp_path: Path) -> None:
    run = eivor("identify", tmp_path / HOSTILE)
    assert run.code == 1
    assert "\x1b" not in run.err
    assert run.err.count("\n") == 1


@pytest.mark.thorough
def test_a_name_that_is_no_text(flight: polars.DataFrame, tmp_path: Path) -> None:
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
    def isatty(self) -> bool:
        return True


def test_a_step_is_announced_on_terminals_only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    for stream, announced in ((_Terminal(), True), (io.StringIO(), False)):
        monkeypatch.setattr(sys, "stderr", stream)
        with outputs.step("Reading [red]\x1b[2J.ulg"):
            end = time.monotonic() + (600.0 if announced else 0.2)  # so long only when something hangs
            while "Reading" not in stream.getvalue() and time.monotonic() < end:
                time.sleep(0.01)
        assert ("Reading [red]\\x1b[2J.ulg" in stream.getvalue()) is announced
