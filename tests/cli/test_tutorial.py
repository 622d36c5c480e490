"""The tutorial's commands run one after the other, and print what the page shows."""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path

import pytest

PAGE = (Path(__file__).parents[2] / "docs" / "getting-started.md").read_text(encoding="utf-8")
COMMANDS = re.compile(r"^```console\n(.*?)^```(?:\n\n```text\n(.*?)^```)?", re.MULTILINE | re.DOTALL)
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?")
CLOSE = {"rel": 1e-2, "abs": 2e-3}


def masked(text: str) -> list[str]:
    return NUMBER.sub("#", text).split()


def numbers(text: str) -> list[float]:
    return [float(number) for number in NUMBER.findall(text)]


def same(displayed: str, lines: list[str]) -> bool:
    printed = "\n".join(lines)
    return masked(displayed) == masked(printed) and numbers(displayed) == pytest.approx(
        numbers(printed), **CLOSE
    )


def check(displayed: str, printed: str) -> None:
    """Every part of what is shown, between lines of three dots, stands in what is printed, in this order."""
    left = [line for line in printed.splitlines() if line.strip()]
    for part in re.split(r"^\.\.\.\n", displayed, flags=re.MULTILINE):
        rows = [line for line in part.splitlines() if line.strip()]
        count = len(rows)
        positions = (
            index for index in range(len(left) - count + 1) if same(part, left[index : index + count])
        )
        position = next(positions, None)
        assert position is not None, f"not printed:\n{part}\nbut\n{printed}"
        left = left[position + count :]


@pytest.mark.thorough
def test_every_command_prints_what_is_shown(eivor, recordings, tmp_path, monkeypatch):
    cache = tmp_path / "cache"
    cache.mkdir()
    monkeypatch.setenv("EIVOR_CACHE", str(cache))
    monkeypatch.chdir(tmp_path)
    steps = [(line, item) for block, item in COMMANDS.findall(PAGE) for line in block.splitlines()]
    assert len(steps) == PAGE.count("\n$ ") > 10
    for line, entry in steps:
        fetched = re.fullmatch(r'\$ cp "\$\((eivor example fetch (\w+))\)" \.', line)
        words = shlex.split(fetched[1] if fetched else line.removeprefix("$ "))
        assert words[0] == "eivor"
        if fetched:  # as if it had been downloaded before
            (origin,) = recordings.rglob(f"{fetched[2]}.*[gv]")
            shutil.copy(origin, cache)
        ran = eivor(*words[1:])
        if fetched:
            shutil.copy(ran.out.strip(), tmp_path)
        check(entry, ran.out + ran.err)
    assert (tmp_path / "hover.html").stat().st_size > 100_000
