"""The import contracts hold, catch what they forbid, and are what the documentation says."""

from __future__ import annotations

import ast
import importlib
import os
import pkgutil
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import get_type_hints

import pytest

import eivor
import eivor.errors
from eivor.logs.common import COUNTS, FINDINGS
from validation.house import architecture, project

ROOT = Path(__file__).resolve().parents[1]
CONTRACTS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
    "contracts"
]
LAYERS = CONTRACTS[0]["layers"]
#: What `python -m validation.house` may count at most: lower a bound when its count has fallen.
BOUNDS = {
    "circles of imports": 0,
    "files in circles of imports": 0,
    "imports of the package inside functions": 0,
    "imports of the package for type checking only": 0,
    "files": 194,
    "lines": 63_539,
    "lines of code without docstrings and imports": 42_617,  # And 41,000
    "files of fewer than 60 lines": 2,
    "files of more than 900 lines": 0,
    "files in the largest folder": 19,
    "the words told and tells": 0,
}

#: The same of tests, studies and pages.
PROJECT_BOUNDS = {"lines of `validation/`": 8_996, "lines of tests": 36_000}


def lint_imports(source):
    """Result of the import linter on the package in the folder `source`, with the project's contracts."""
    code = "from importlinter.cli import lint_imports_command; lint_imports_command()"
    return subprocess.run(
        [sys.executable, "-c", code, "--config", str(ROOT / "pyproject.toml"), "--no-cache"],
        capture_output=True,
        text=True,
        check=False,
        cwd=source,
        env=os.environ | {"PYTHONPATH": str(source)},
    )


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    """A copy of the package that may be broken."""
    folder = tmp_path_factory.mktemp("source")
    ignore = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "src" / "eivor", folder / "eivor", ignore=ignore)
    shutil.copytree(ROOT / "validation", folder / "validation", ignore=ignore)
    return folder


def test_contracts_hold(copy):
    result = lint_imports(copy)
    assert result.returncode == 0, result.stdout + result.stderr


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("file", "line", "contract"),
    [
        ("linalg/system.py", "import eivor.models.regression", 0),
        ("linalg/system.py", "import eivor.signals.noise", 0),
        ("estimation/methods.py", "import eivor.logs.read", 0),
        ("logs/read.py", "import eivor.estimation.methods", 0),
        ("inference/verdict.py", "import eivor.flights.options", 0),
        ("flights/identify.py", "import eivor.report", 0),
        ("new_room.py", "x = 1", 0),
        ("flights/identify.py", "import matplotlib.pyplot", 1),
        ("logs/read.py", "def f():\n    import h5py", 2),
        ("logs/read.py", "def f():\n    import rosbags", 3),
        ("flights/grid.py", "import uvicorn", 4),
        ("flights/grid.py", "import polars", 5),
        ("models/regression.py", "def f():\n    import validation", 6),
        ("motions/vertical/model.py", "import rotorpy", 7),
    ],
)
def test_contracts_catch(copy, file, line, contract):
    path = copy / "eivor" / file
    before = path.read_bytes() if path.exists() else None
    try:
        path.write_bytes((before or b"") + f"\n{line}\n".encode())
        result = lint_imports(copy)
    finally:
        path.unlink() if before is None else path.write_bytes(before)
    printed = " ".join(result.stdout.split())
    broken = [item["name"] for item in CONTRACTS if f"{item['name']} BROKEN" in printed]
    assert result.returncode == 1, result.stdout + result.stderr
    assert broken == [CONTRACTS[contract]["name"]], result.stdout


def test_documented_order_is_the_contract():
    """`docs/architecture.md` shows the layers as the contract has them, and a section for each room."""
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    order = [f"({layer})" if "|" in layer else layer for layer in LAYERS if layer != LAYERS[-1]]
    assert " > ".join([*order, "errors"]) in " ".join(page.split())
    rooms = [path.name for path in (ROOT / "src" / "eivor").iterdir() if (path / "__init__.py").exists()]
    for room in rooms:
        assert f"`{room}/`" in page, f"the room {room} is not described"


@pytest.mark.parametrize("room", ["flights", "report", "cli", "estimation", "inference"])
def test_rooms_name_no_parameter_of_a_motion(room):
    """Only a motion knows what its parameters are called; others ask it."""
    of_actuators = {"actuator_lag", "delay", "effective_lag", "second_lag", "second_stage"}
    current = set(eivor.motion_by_name("vertical").quantities) - of_actuators - {"intercept"}  # a plain word
    assert {"viscous_friction", "input_gain", "hover_input"} <= current
    for path in (ROOT / "src" / "eivor" / room).rglob("*.py"):
        named = [name for name in current if name in path.read_text(encoding="utf-8")]
        assert not named, f"{path} names {', '.join(named)}"


@pytest.mark.thorough
def test_counts_of_the_house_are_bounded():
    """Imports inside functions and for type checking count, too."""
    counted = architecture(ROOT / "src" / "eivor") | project(ROOT)
    bounds = BOUNDS | PROJECT_BOUNDS
    exceeded = {name: counted[name] for name, most in bounds.items() if counted[name] > most}
    assert not exceeded, f"Expected less; received {exceeded}."


def test_every_finding_of_a_reader_has_its_sentence():
    files = (ROOT / "src" / "eivor" / "logs").rglob("*.py")
    text = "".join(file.read_text(encoding="utf-8") for file in files)
    assert {*re.findall(r'noted\(\s*"(\w+)"', text), *COUNTS} == {*FINDINGS}


#: Words that say nothing of what a value is.
NO_NAMES = {
    *("told", "tells", "asked", "one", "found", "beside"),
    *("shown", "begun", "place", "own", "flown"),
}
NAMED_BY = {ast.Name: "id", ast.arg: "arg", ast.Attribute: "attr", ast.FunctionDef: "name"}


@pytest.mark.thorough
def test_names_say_what_values_are():
    for file in (ROOT / "src" / "eivor").rglob("*.py"):
        nodes = ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        names = {getattr(node, NAMED_BY[type(node)]) for node in nodes if type(node) in NAMED_BY}
        assert not names & NO_NAMES, file


def leaves(kind):
    """Names of the final classes below an interface."""
    below = kind.__subclasses__()
    return set().union(*(leaves(child) for child in below)) if below else {kind.__name__}


def test_documented_axes_are_the_code():
    """The classes of the four axes of a linear method on the page are those that there are."""
    for module in pkgutil.walk_packages(eivor.__path__, "eivor."):
        if module.name.startswith(("eivor.estimation.", "eivor.linalg.", "eivor.lab.regularised")):
            importlib.import_module(module.name)
    interfaces = get_type_hints(type(eivor.methods.least_squares()))
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    for axis in ("assembler", "row weighting", "equation weighting", "solver"):
        row = next(line for line in page.splitlines() if line.startswith(f"| {axis} |"))
        assert set(re.findall(r"`(\w+)`", row)) == leaves(interfaces[axis.replace(" ", "_")])


def test_public_names_are_documented():
    """Each has an entry; errors and warnings share one for their whole module."""
    page = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    documented = set(re.findall(r"^::: eivor\.(\w+)$", page, flags=re.MULTILINE))
    assert "errors" in documented
    assert documented - {"errors"} == set(eivor.__all__) - set(vars(eivor.errors)) - {"__version__"}


def test_conventions_name_files_that_exist():
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    files = re.findall(r"`(\w+/\w+\.py)`", page)
    assert len(files) > 10
    for file in files:
        assert (ROOT / "src" / "eivor" / file).exists() or (ROOT / file).exists(), file
