"""Standard output and error as they are found: poor in letters, full, closed, or read by nobody."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from eivor.tools import plain_text

pytestmark = pytest.mark.thorough

Caller = Callable[..., Any]


def test_a_reader_that_goes_away_is_no_error_message(tmp_path: Path) -> None:
    command = f"{sys.executable} -c 'from eivor.cli.main import run; run()' identify --example | true"
    run = subprocess.run(command, shell=True, capture_output=True, text=True, check=False)  # noqa: S602
    assert run.stderr == ""


@pytest.mark.long
def test_signs_that_an_encoding_lacks_are_spelt(shell: Caller) -> None:
    """A question mark in the equation would say nothing; the columns of the table stay where they are."""
    poor = shell("identify", "--example", encoding="ascii", PYTHONIOENCODING="ascii", PYTHONUTF8="0")
    rich = shell("identify", "--example", PYTHONIOENCODING="utf-8")
    latin = shell("identify", "--example", encoding="latin-1", PYTHONIOENCODING="latin-1", PYTHONUTF8="0")
    for run in (poor, rich, latin):
        assert run.code == 0, run.err
        assert run.err == ""
        assert "identified" in run.out
    assert "z'' + g = K_u U - K z' + b" in poor.out
    assert "U = cos(tilt) x the mean" in poor.out
    assert "?" not in poor.out
    assert "z'' + g = K_u U − K z' + b" in rich.out
    rows = [
        [line for line in run.out.splitlines() if line.startswith("effective lag")] for run in (poor, rich)
    ]
    assert rows[0][0] == rows[1][0].replace("τ + d  ", "tau + d")
    assert "m/s²" in latin.out
    assert "K_u U - K z'" in latin.out


def test_help_and_errors_are_spelt_too(shell: Caller) -> None:
    help_text = shell("identify", "--help", encoding="ascii", PYTHONIOENCODING="ascii", PYTHONUTF8="0")
    assert "+- Options ---" in help_text.out
    error = shell("identify", "fläche τ.csv", encoding="ascii", PYTHONIOENCODING="ascii", PYTHONUTF8="0")
    assert "'flache tau.csv', which does not exist" in error.err


@pytest.mark.parametrize(
    ("text", "encoding", "plain"),
    [
        ("K z' ± 1 − 2", "ascii", "K z' +- 1 - 2"),
        ("τ Δ χ² µ 8.5°", "ascii", "tau Delta chi^2 u 8.5deg"),
        ("τ      | x", "ascii", "tau    | x"),
        ("m/s²  yes", "ascii", "m/s^2 yes"),
        ("é漢", "ascii", "e?"),
        ("√2 ± 1", "latin-1", "sqrt2 ± 1"),
        ("τ ± 1\n  2", "utf-8", "τ ± 1\n  2"),
    ],
)
def test_plain_text(text: str, encoding: str, plain: str) -> None:
    assert plain_text(text, encoding) == plain


@pytest.mark.parametrize(
    "arguments",
    [
        ("identify", "--example"),
        ("identify", "--example", "--json", "-"),
        ("example", "list"),
        ("--help",),
        ("--version",),
    ],
)
def test_a_full_disk_behind_standard_output_is_one_message(arguments: tuple[str, ...]) -> None:
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        run = subprocess.run(
            [sys.executable, "-c", "from eivor.cli.main import run; run()", *arguments],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert run.returncode == 1
    assert run.stderr.startswith("eivor: Expected a standard output that can be written to; received one for")
    assert "No space left on device" in run.stderr
    assert run.stderr.count("\n") == 1


@pytest.mark.parametrize(("stream", "code"), [(1, 1), (2, 0)])
def test_a_stream_that_is_closed(stream: int, code: int) -> None:
    """Without standard output the numbers cannot be printed; without standard error nothing is missing."""
    command = f"{sys.executable} -c 'from eivor.cli.main import run; run()' identify --example {stream}>&-"
    run = subprocess.run(command, shell=True, capture_output=True, text=True, check=False)  # noqa: S602
    assert run.returncode == code
    if stream == 1:
        assert "received one that is closed" in run.stderr
    else:
        assert "viscous friction" in run.stdout
    assert "mistake" not in run.stderr
