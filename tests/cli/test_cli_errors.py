"""What never happens: a traceback, a screen rewritten by a log's name, a slow start."""

from __future__ import annotations

import os
import re
import runpy
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import typer

import eivor as ev
from eivor.cli import outputs
from eivor.cli.main import COMMANDS, app
from eivor.errors import InputError

COMMAND = typer.main.get_command(app)
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


def test_the_interpreter_runs_the_command_line(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["eivor", "--version"])
    monkeypatch.delitem(sys.modules, "eivor.__main__", raising=False)  # other tests import it
    # what the shape checks' hook compiles must not be kept as the module's own bytecode
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    with pytest.raises(SystemExit) as left:
        runpy.run_module("eivor", run_name="__main__")
    assert left.value.code == 0
    assert capsys.readouterr().out == f"eivor {ev.__version__}\n"


def commands(command=COMMAND, path=()):
    for name, child in command.commands.items():
        yield from commands(child, (*path, name)) if hasattr(child, "commands") else [((*path, name), child)]


def test_commands_and_options_stand_in_groups(tmp_path):
    assert set(COMMANDS) == set(COMMAND.commands)
    for _, command in commands():
        options = [item for item in command.params if item.param_type_name == "option" and not item.hidden]
        assert sum(item.rich_help_panel is None for item in options) <= 10
    about = next(item.help for item in COMMAND.commands["identify"].params if item.name == "logs")
    (tmp_path / "notes").write_text("no log", encoding="utf-8")
    with pytest.raises(InputError) as refused:
        ev.read_log(tmp_path / "notes")
    labels = str(refused.value).partition("that is read (")[2].partition(")")[0].split(", ")
    assert len(labels) > 10
    for item in labels:
        assert re.search(rf"\b{item.removesuffix(' table')}\b", about), item


def test_what_is_missing_or_misspelt_is_said(eivor):
    for path, command in commands():
        if any(item.required for item in command.params):
            run = eivor(*path)
            assert (run.code, run.out) == (2, "")
            words = " ".join(path)
            assert (
                f"received none. For example: eivor {words} {outputs.COMMANDS[words]['example']}" in run.err
            )
    for words, meant in (
        (("identify", "--exampel"), "--example"),
        (("fleet", "run", "--rports"), "--reports"),
        (("machine", "new", "--like", "rovr"), "rover"),
        (("example", "fetch", "ekf_failur"), "ekf_failure"),
        (("paper", "--readings", "two-lag"), "two-lags"),
        (("identify", "--example", "--input-map", "sqare"), "square"),
        (("identify", "--example", "--model", "rate"), "rates"),
        (("identify", "--example", "--instruments", "lag"), "lags"),
        (("identify", "--example", "--input", "rotor_comand"), "rotor_command"),
        (("plan", "--shape", "stepps"), "steps"),
    ):
        assert f"Did you mean '{meant}'?" in eivor(*words).err


@pytest.mark.thorough
@pytest.mark.parametrize("shell_name", ["bash", "zsh", "fish"])
def test_a_shell_completes_values(eivor, shell, shell_name, monkeypatch):
    """The first words in a process of its own, as a shell asks; the others in this one."""
    for number, (words, values) in enumerate(
        (
            ("identify --method whi", "whitened_least_squares whittle_ml"),
            ("identify --model ", "vertical rates rigid-body"),
            ("identify --map n", "nanobench"),
            ("identify --for hover,l", "hover,lag"),
            ("export fit.json --accept ", "identified weak provisional"),
            ("plan --shape ", "multisine steps"),
            ("fleet query fleet ver", "verdicts"),
            ("machine show ro", "rover"),
            ("val", "validate"),
        )
    ):
        typed = f"eivor {words}"
        last = str(len(typed.split()) - (not typed.endswith(" ")))
        action = {"COMP_CWORD": last, "_TYPER_COMPLETE_FISH_ACTION": "get-args"}
        given = {"COMP_WORDS": typed, "_TYPER_COMPLETE_ARGS": typed, **action}
        given["_EIVOR_COMPLETE"] = f"complete_{shell_name}"
        with monkeypatch.context() as patched:
            for name, text in given.items():
                patched.setenv(name, text)
            run = eivor() if number else shell(**given)
        printed = re.sub(r"_arguments|[\"'()*:]", " ", run.out)
        assert set(printed.split()) & set(values.split()) == set(values.split())


@pytest.mark.thorough
def test_an_interrupt_leaves_with_130():
    code = (
        "import os, signal, sys\n"
        "import eivor.motions.identify as motion\n"
        "motion.identify_log = lambda *a, **k: os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.argv = ['eivor', 'identify', '--example']\n"
        "from eivor.cli.main import run; run()"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert run.returncode in {130, -signal.SIGINT}
    assert "Traceback" not in run.stderr
    assert "interrupted" in run.stderr


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
