"""The Python blocks of the documentation's pages run as they stand, page by page."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

DOCS = Path(__file__).parents[1] / "docs"
BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)


def check_estimators(names: dict[str, Any]) -> None:
    assert set(names["fit"].parameters) == {"viscous_friction", "input_gain"}
    assert names["problem"].instrument_noise_covariance()[0, 1] == pytest.approx(0.0025)


def check_intervals(names: dict[str, Any]) -> None:
    low, high = names["hac"].interval("input_gain", level=0.9)
    assert low < names["fit"].parameters["input_gain"] < high
    assert names["chunked"].interval("input_gain") == pytest.approx(names["fit"].interval("input_gain"))


def check_diagnostics(names: dict[str, Any]) -> None:
    name = names["found"]
    assert name.constancy.break_at == pytest.approx(0.6, abs=0.02)
    assert any("input_gain by +0.5" in reason.sentence for reason in name.reasons)
    page = (DOCS / "diagnostics.md").read_text(encoding="utf-8")
    assert all(line in page for line in name.summary().splitlines() if not line.startswith("- "))


def check_weak_identification(names: dict[str, Any]) -> None:
    assert all(interval.is_bounded for interval in names["known"].intervals.values())
    assert not names["unknown"].interval("input_gain").is_bounded
    assert names["sets"].region.contains([0.3, 0.5])


def check_resampling(names: dict[str, Any]) -> None:
    assert names["found"].replicates.shape == (199, 2)
    low, high = names["flights"].interval("hover_input")
    assert low < names["pool"].quantities["hover_input"].value < high
    assert [len(names[figure].axes) for figure in ("beside", "joint", "residual")] == [2, 1, 3]


def check_exports(names: dict[str, Any]) -> None:
    assert names["model"].states == ("actuator", "velocity_z")
    assert names["document"].startswith("{")
    assert 0.0005 < names["hover"].std() / names["hover"].mean() < 0.003


#: What the blocks of each page must leave behind.
CHECKS: dict[str, Callable[[dict[str, Any]], None]] = {
    "diagnostics.md": check_diagnostics,
    "estimators.md": check_estimators,
    "exports.md": check_exports,
    "intervals.md": check_intervals,
    "resampling.md": check_resampling,
    "weak-identification.md": check_weak_identification,
}


@pytest.mark.filterwarnings("ignore::eivor.errors.WeakInstrumentsWarning")
@pytest.mark.usefixtures("unchecked_shapes")  # a reader's run checks none
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.thorough] if name in {"exports.md", "resampling.md"} else [])
        for name in CHECKS
    ],
)
def test_blocks_run(name):
    blocks = BLOCK.findall((DOCS / name).read_text(encoding="utf-8"))
    assert blocks
    names: dict[str, Any] = {}
    for block in blocks:
        exec(compile(block, name, "exec"), names)  # noqa: S102 - the project's own pages
    CHECKS[name](names)


@pytest.mark.parametrize("name", ["faq.md", "tutorial.md"])
def test_every_option_that_is_named_exists(name):
    from typer.main import get_command

    from eivor.cli.main import app

    def options(command: Any) -> set[str]:
        selected = {option for parameter in command.params for option in parameter.opts}
        return selected.union(*(options(child) for child in getattr(command, "commands", {}).values()))

    named = set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", (DOCS / name).read_text(encoding="utf-8")))
    assert named
    assert named <= options(get_command(app))
