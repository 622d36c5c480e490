"""Record what Eivor says today of flights, array problems and studies.

    EIVOR_DATA=FOLDER python -m validation.parity.record FILE.json

The numbers are written as Python prints them, so that none is lost; the same code gives the same file. It
takes a few minutes on one core. README.md says what is in it and how two records are compared.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from validation.parity.where import SURROUNDINGS, recordings

SCHEMA = "eivor.parity/1"
#: Runs of the studies.
RUNS = 20
STUDIES = ("white-input", "dynamic-errors-in-variables", "altitude-control")
READINGS = ("ratios-of-variances", "row-of-h-as-printed", "count-left-out", "central-2-lags")
#: Problems whose diagnostics, sets and bootstrap are recorded as well.
INFERRED = ("housing", "paper-1", "closed-loop", "noisy-input")


def parts(data: Path) -> dict[str, Callable[[], Any]]:
    """Every part of the record by its name."""
    from validation.parity.estimates import (
        attempted,
        flight_record,
        inference_record,
        problem_record,
        streamed_record,
        york_record,
    )
    from validation.parity.flights import flights, nanobench
    from validation.parity.problems import array_problems
    from validation.parity.studies import flight_study_record, paper_record, study_record

    cases = {case.name: case for case in array_problems()}
    return {
        "identify": lambda: flights(data),
        "from_python": lambda: flight_record(nanobench(data)),
        "problems": lambda: {name: problem_record(case) for name, case in cases.items()},
        "york": lambda: attempted(york_record),
        "inference": lambda: {name: inference_record(cases[name]) for name in INFERRED},
        "streamed": lambda: attempted(streamed_record),
        "studies": lambda: {name: study_record(name, RUNS) for name in STUDIES},
        "paper": lambda: paper_record(READINGS, RUNS),
        "flight_study": flight_study_record,
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m validation.parity.record",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("file", type=Path, metavar="FILE.json")
    parser.add_argument("--part", action="append", metavar="NAME", help="only this part; may be repeated")
    chosen = parser.parse_args(arguments)
    made = parts(recordings())
    wanted = chosen.part or list(made)
    found: dict[str, Any] = {"schema": SCHEMA}
    for name in wanted:
        begun = time.perf_counter()
        found[name] = made[name]()
        print(f"{name}: {time.perf_counter() - begun:.1f} s", file=sys.stderr)
    chosen.file.write_text(lines(found), encoding="utf-8")
    return 0


def lines(found: dict[str, Any]) -> str:
    """JSON with a line for each entry of each part, so that a difference of two files can be read."""
    written = []
    for name, part in found.items():
        if isinstance(part, dict):
            entries = [f"{json.dumps(key)}:{_compact(value)}" for key, value in part.items()]
            written.append(f"{json.dumps(name)}:{{\n" + ",\n".join(entries) + "\n}")
        else:
            written.append(f"{json.dumps(name)}:{_compact(part)}")
    return "{\n" + ",\n".join(written) + "\n}\n"


def _compact(value: Any) -> str:
    return json.dumps(value, separators=(",", ":"), allow_nan=False)


if __name__ == "__main__":
    # Read when Python and its libraries start: start again where they are not as they must be.
    if any(os.environ.get(name) != value for name, value in SURROUNDINGS.items()):
        command = [sys.executable, "-m", "validation.parity.record", *sys.argv[1:]]
        os.execve(sys.executable, command, os.environ | SURROUNDINGS)
    sys.exit(main())
