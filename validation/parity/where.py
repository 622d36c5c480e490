"""What the record takes from outside: commands, modules that may move, files, recordings.

The record uses the public API (`eivor`) and the commands, so that it runs on any state of the code. What
is neither stands here and nowhere else: when a module moves, its line below is changed, and no other file.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
#: The command line, whatever the PATH holds.
EIVOR = (sys.executable, "-c", "from eivor.cli.entry import run; run()")
#: The module that runs the study of the flight recipe.
FLIGHT_STUDY = (sys.executable, "-m", "validation.flight_recipe.study")
#: The flight that comes with Eivor.
EXAMPLE = ROOT / "src" / "eivor" / "data" / "example_flight.parquet"
#: NIST's observations of "Filip".
FILIP = ROOT / "tests" / "reference" / "nist_filip.csv"
#: Studies that are recorded.
STUDIES = ROOT / "examples" / "studies"
#: Scenarios that only the record has.
SCENARIOS = Path(__file__).with_name("scenarios")
#: What z'' is called in signals and scenarios, and in the log that `eivor simulate` writes.
ACCELERATION, LOGGED_ACCELERATION = "acceleration_z", "acceleration_z"
#: Surroundings of every process: the package of this tree and no other; matrices are small, and sums of
#: one thread are always taken in one order.
SURROUNDINGS = {f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL")} | {
    "PYTHONPATH": str(ROOT / "src"),
    "PYTHONUTF8": "1",
    "COLUMNS": "200",
}


@dataclass(frozen=True, slots=True)
class Done:
    """A command that was run.

    Parameters
    ----------
    code : int
        Its exit code.
    out, err : str
        What it printed.
    """

    code: int
    out: str
    err: str

    @property
    def document(self) -> Any:
        """JSON on standard output; None when there is none."""
        return json.loads(self.out) if self.out.startswith("{") else None


def run(command: tuple[str, ...], *arguments: object) -> Done:
    """Run a command to its end, in the root of the project, on one core."""
    done = subprocess.run(
        [*command, *map(str, arguments)],
        capture_output=True,
        encoding="utf-8",
        check=False,
        cwd=ROOT,
        env=os.environ | SURROUNDINGS,
    )
    return Done(done.returncode, done.stdout, done.stderr)


def eivor(*arguments: object) -> Done:
    """Run `eivor` with those arguments."""
    return run(EIVOR, *arguments)


def recordings() -> Path:
    """Folder of the real recordings: EIVOR_DATA, or ../shared/data beside the project.

    Raises
    ------
    SystemExit
        When there is none: a record without them would prove less than it says.
    """
    folder = Path(os.environ.get("EIVOR_DATA") or ROOT.parent / "shared" / "data")
    if not folder.is_dir():
        raise SystemExit(f"no real recordings at {folder}; set EIVOR_DATA")
    return folder


def linear_system(matrix: Any, right: Any) -> Any:
    """Equations A theta = b, as `ev.weighted_total_least_squares` takes them."""
    from eivor.linalg import LinearSystem

    return LinearSystem(matrix, right)
