#!/usr/bin/env python3
"""Install the package with exactly the lower bounds that pyproject.toml declares, and use it.

    python .ci/lowest.py FOLDER

FOLDER gets a virtual environment and the outputs. What runs: every module is imported, every command
shows its help, and the example flight is identified from the package, from a CSV and from a Parquet file;
a ULog made by the tests and those of EIVOR_DATA are inspected and identified, and bags made by the tests.
A command that leaves with another code than it should, or prints a traceback, fails.

The lower bounds have wheels for the lowest Python that is supported, so that is the one that is used; where
it is not there, the check says so and is left out.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
#: Extras that read logs, that of figures, and that of the page.
EXTRAS = ("plot", "ros", "hdf5", "serve")
_BOUND = re.compile(r"([A-Za-z0-9_.-]+)>=(\d[\w.]*)")

IMPORT_ALL = """
import importlib, pkgutil, eivor
missing = set()
for module in pkgutil.walk_packages(eivor.__path__, "eivor."):
    try:
        importlib.import_module(module.name)
    except ModuleNotFoundError as error:
        missing.add(error.name.partition(".")[0])
print("All modules are imported, but for optional packages:", ", ".join(sorted(missing)) or "none")
assert not missing & set(MODULES), missing
"""

COMMANDS = """
import typer
from eivor.cli.main import app

def walk(command, words):
    print(" ".join(words))
    for name, inner in getattr(command, "commands", {}).items():
        walk(inner, [*words, name])

walk(typer.main.get_command(app), [])
"""

EXAMPLE_AS_CSV = """
import sys
from importlib import resources
import polars
table = resources.files("eivor.data") / "example_flight.parquet"
frame = polars.read_parquet(str(table))
frame.write_csv(sys.argv[1])
frame.write_parquet(sys.argv[2])
"""

ULOG = """
import sys
from pathlib import Path
from ulog_writer import flight
Path(sys.argv[1]).write_bytes(flight(2000).bytes())
"""

BAGS = """
from dataflash_writer import simulated
from rosbags.rosbag2 import StoragePlugin
from bag_writer import mavros_messages, px4_messages, stores, without_definitions, write_ros1, write_ros2
flight = simulated(seed=3, duration=20.0)
ros1, ros2 = stores()
write_ros1("mavros.bag", mavros_messages(ros1, flight), ros1)
write_ros2("mcap", px4_messages(ros2, flight), ros2, StoragePlugin.MCAP)
without_definitions(write_ros2("sqlite", px4_messages(ros2, flight), ros2))
"""


def lower_bounds() -> tuple[tuple[int, int], dict[str, str]]:
    """Lowest Python, and the lowest version of each dependency, with the extras that read logs."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    python = re.fullmatch(r">=(\d+)\.(\d+)", project["requires-python"])
    if python is None:
        sys.exit(f"Expected requires-python >=X.Y; received {project['requires-python']!r}")
    lowest = {}
    extras = (item for extra in EXTRAS for item in project["optional-dependencies"][extra])
    for requirement in (*project["dependencies"], *extras):
        if requirement.startswith("eivor["):  # another of the extras
            continue
        bound = _BOUND.match(requirement)
        if bound is None:
            sys.exit(f"Expected a dependency with a lower bound, NAME>=VERSION; received {requirement!r}")
        lowest[bound[1]] = bound[2]
    return (int(python[1]), int(python[2])), lowest


def interpreter(version: tuple[int, int]) -> str | None:
    """Return a Python of this version that works; None when there is none."""
    name = "python{}.{}".format(*version)
    for candidate in (sys.executable, shutil.which(name)):
        if candidate is None:
            continue
        completed = subprocess.run(
            [candidate, "-c", "import sys, ensurepip; print(*sys.version_info[:2])"],
            capture_output=True,
            text=True,
            check=False,
        )
        if completed.stdout.split() == [str(number) for number in version]:
            return candidate
    return None


class Installed:
    """The package in its environment."""

    def __init__(self, folder: Path, python: str, lowest: dict[str, str]) -> None:
        self.folder = folder
        self.python = str(folder / "venv" / "bin" / "python")
        self.environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"} | {"EIVOR_DEBUG": "1"}
        subprocess.run([python, "-m", "venv", str(folder / "venv")], check=True)
        exactly = [f"{name}=={version}" for name, version in lowest.items()]
        print("With", *exactly, flush=True)
        options = ["--quiet", "--disable-pip-version-check", "--prefer-binary", "--no-compile"]
        subprocess.run(
            [self.python, "-m", "pip", "install", *options, f"{ROOT}[{','.join(EXTRAS)}]", *exactly],
            check=True,
        )

    def run(self, *arguments: str, codes: tuple[int, ...] = (0,), **variables: str) -> str:
        """Run the environment's Python; stop when it fails."""
        done = subprocess.run(
            [self.python, *arguments],
            cwd=self.folder,
            env=self.environment | variables,
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode not in codes or "Traceback (most recent" in done.stdout + done.stderr:
            print(done.stdout, done.stderr, sep="\n")
            sys.exit(f"Expected exit code {codes} and no traceback; received {done.returncode}: {arguments}")
        return done.stdout

    def eivor(self, *arguments: str, codes: tuple[int, ...] = (0,)) -> str:
        """Run the command line."""
        print("eivor", *arguments, flush=True)
        return self.run(str(self.folder / "venv" / "bin" / "eivor"), *arguments, codes=codes)


def use(installed: Installed, modules: list[str]) -> None:
    """Run what must work."""
    print(installed.run("-c", IMPORT_ALL.replace("MODULES", repr(modules))), end="")
    for words in installed.run("-c", COMMANDS).splitlines():
        installed.eivor(*words.split(), "--help")
    installed.eivor("identify", "--example", "--compare", "--json", "a.json", "--figure", "a.svg")
    installed.run("-c", EXAMPLE_AS_CSV, "flight.csv", "flight.parquet")
    for table in ("flight.csv", "flight.parquet"):
        installed.eivor("identify", table)
        installed.eivor("inspect", table)
    installed.run("-c", ULOG, "made.ulg", PYTHONPATH=f"{ROOT / 'tests' / 'logs'}{os.pathsep}{ROOT / 'tests'}")
    data = Path(os.environ.get("EIVOR_DATA", "/nowhere"))
    for log in (Path("made.ulg"), *sorted(data.glob("px4/*.ulg"))):
        installed.eivor("inspect", str(log))
        # 3: an answer, though not an identified one
        installed.eivor("identify", str(log), codes=(0, 3))
    installed.run("-c", BAGS, PYTHONPATH=f"{ROOT / 'tests' / 'logs'}{os.pathsep}{ROOT / 'tests'}")
    for bag in ("mavros.bag", "mcap", "sqlite"):
        installed.eivor("identify", bag, codes=(0, 3))  # 20 s are too short for more than weak
    installed.eivor("simulate", "closed-loop", "--out", "simulated.parquet")
    for study in sorted((ROOT / "examples" / "studies").glob("*.toml")):
        installed.eivor("study", str(study), "--runs", "4")
    installed.eivor("example", "list")


def main() -> None:
    """Check the lower bounds."""
    python, lowest = lower_bounds()
    result = interpreter(python)
    if result is None:
        print(
            "Left out: the lowest versions have wheels for Python {}.{}, which is not here.".format(*python)
        )
        return
    folder = Path(sys.argv[1]).resolve()
    folder.mkdir(parents=True)
    use(Installed(folder, result, lowest), list(lowest))


if __name__ == "__main__":
    main()
