"""The Python blocks of the documentation's pages run as they stand, page by page."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Any

import pytest

DOCS = Path(__file__).parents[1] / "docs"
BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)


def check_estimators(names: dict[str, Any]) -> None:
    assert set(names["fit"].parameters) == {"viscous_friction", "input_gain"}
    assert names["problem"].instrument_noise_covariance()[0, 1] == pytest.approx(0.0025)


def check_from_arrays(names: dict[str, Any]) -> None:
    page = (DOCS / "from-arrays.md").read_text(encoding="utf-8")
    displayed = [tuple(map(float, pair)) for pair in re.findall(r"  # .*\[([\d.]+), ([\d.]+)\]", page)]
    fits = [names[name] for name in ("biased", "fit", "attenuated", "compensated", "orthogonal")]
    assert [fit.interval("slope") for fit in fits] == [pytest.approx(pair, abs=1e-3) for pair in displayed]


def check_diagnostics(names: dict[str, Any]) -> None:
    name = names["diagnostics"]
    assert name.constancy.break_at == pytest.approx(0.6, abs=0.02)
    assert any("input_gain by +0.5" in reason.sentence for reason in name.reasons)
    page = (DOCS / "diagnostics.md").read_text(encoding="utf-8")
    assert all(line in page for line in name.summary().splitlines() if not line.startswith("- "))


def check_method(names: dict[str, Any]) -> None:
    low, high = names["hac"].interval("input_gain", level=0.9)
    assert low < names["fit"].parameters["input_gain"] < high
    assert names["chunked"].interval("input_gain") == pytest.approx(names["fit"].interval("input_gain"))
    assert all(interval.is_bounded for interval in names["known"].intervals.values())
    assert not names["unknown"].interval("input_gain").is_bounded
    assert names["sets"].region.contains([0.3, 0.5])
    assert names["boot"].replicates.shape == (199, 2)
    low, high = names["flights"].interval("hover_input")
    assert low < names["pool"].quantities["hover_input"].value < high
    assert [len(names[figure].axes) for figure in ("comparison", "joint", "residual")] == [2, 1, 3]


def check_efficiency(names: dict[str, Any]) -> None:
    assert names["spectral"].noises
    assert {"viscous_friction", "input_gain"} <= set(names["undeclared"].parameters)


def check_fractional_equations(names: dict[str, Any]) -> None:
    low, high = names["fit"].interval("order")
    assert low < names["fit"].parameters["order"] < high
    assert names["fit"].parameters["order"] == pytest.approx(0.7, abs=0.02)


def check_exports(names: dict[str, Any]) -> None:
    assert names["model"].states == ("actuator", "velocity_z")
    assert names["document"].startswith("{")
    assert 0.0005 < names["hover"].std() / names["hover"].mean() < 0.003


#: What the blocks of each page must leave behind.
CHECKS: dict[str, Callable[[dict[str, Any]], None]] = {
    "diagnostics.md": check_diagnostics,
    "efficiency.md": check_efficiency,
    "estimators.md": check_estimators,
    "exports.md": check_exports,
    "fractional-equations.md": check_fractional_equations,
    "from-arrays.md": check_from_arrays,
    "method.md": check_method,
}


@pytest.mark.filterwarnings("ignore::eivor.errors.WeakInstrumentsWarning")
@pytest.mark.usefixtures("unchecked_shapes")  # a reader's run checks none
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.thorough] if name in {"exports.md", "method.md"} else [])
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


@pytest.mark.usefixtures("unchecked_shapes")
def test_the_first_steps_in_python_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copy(str(resources.files("eivor.data") / "example_flight.parquet"), "flight.ulg")
    (block,) = BLOCK.findall((DOCS / "getting-started.md").read_text(encoding="utf-8"))
    names: dict[str, Any] = {}
    exec(compile(block, "getting-started.md", "exec"), names)  # noqa: S102 - the project's own page
    assert names["fit"].verdict.status.value == "identified"
    assert Path("fit.png").stat().st_size > 1000


@pytest.mark.parametrize("name", ["from-a-log.md", "getting-started.md", "to-a-simulator.md"])
def test_every_option_that_is_named_exists(name):
    from typer.main import get_command

    from eivor.cli.main import app

    def options(command: Any) -> set[str]:
        selected = {option for parameter in command.params for option in parameter.opts}
        return selected.union(*(options(child) for child in getattr(command, "commands", {}).values()))

    text = re.sub(r"^python3 -m venv .*$", "", (DOCS / name).read_text(encoding="utf-8"), flags=re.MULTILINE)
    named = set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", text))
    assert named
    assert named <= options(get_command(app))
