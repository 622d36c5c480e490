"""Whether ratios of README.md still hold: benchmarks are run again and compared with what is written there.

    python benchmarks/check.py                    every benchmark whose ratios are read below
    python benchmarks/check.py inference report   some of them
    python benchmarks/check.py --small FOLDER     what small cases printed, into FOLDER/NAME.txt

It fails when a measured ratio exceeds the written one by more than half. Small cases have ratios of their own
in README.md. Of one that exceeds its ratio the least of three runs counts, since other work slows it, too.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
from pathlib import Path

FOLDER = Path(__file__).parent
#: What a measured ratio may be over the written one.
TOLERATED = 1.5
#: What the table of small cases stands below.
SMALL_HEADING = "## Small cases"
#: Runs of a small case, the least ratio of which counts.
SMALL_RUNS = 3
#: How the row begins in the README, and what the benchmark prints of it. Where the pattern ends in "x faster"
#: the ratio is one over the number.
RATIOS: dict[str, dict[str, str]] = {
    "augmented_systems": {"reduced augmented system": r"([\d.]+) x faster"},
    "dataflash": {
        "`read_log` on a CSV": r"flight.csv .*ratio +([\d.]+)",
        "on a Parquet": r"flight.parquet .*ratio +([\d.]+)",
    },
    "export": {"`eivor export --to gazebo`": r"--to rotorpy --draws 1000 .*ratio to import +([\d.]+)"},
    "generalized_iv": {
        "generalized IV, N = 1e6": r"fit, .* ([\d.]+) x faster",
        "its moments": r"moments, .*ratio +([\d.]+)",
        "of 500 rows;": r"^500 rows +[\d.]+ ms.*ratio +([\d.]+)",
        "of 500 rows, with intervals": r"^500 rows with intervals.*ratio +([\d.]+)",
        "of 500 rows, with intervals and diagnostics": r"^500 rows with diagnostics.*ratio +([\d.]+)",
        "trials of a study": r"^trials of 1 methods.* ([\d.]+) x faster",
        "of three methods": r"^trials of 3 methods.* ([\d.]+) x faster",
    },
    "identify_ulog": {"synthetic": r"^synthetic.ulg .*ratio +([\d.]+)"},
    "help_time": {
        "`eivor --help`": r"^eivor --help .*ratio to import typer +([\d.]+)",
        "`eivor identify --help`": r"^eivor identify --help .*ratio to import typer +([\d.]+)",
    },
    "inference": {
        "its intervals": r"intervals \(.*ratio +([\d.]+)",
        "intervals and all diagnostics": r"intervals and all diagnostics.*ratio +([\d.]+)",
        "intervals with a Bartlett": r"intervals, Bartlett.*ratio +([\d.]+)",
        "intervals with a quadratic": r"intervals, quadratic.*ratio +([\d.]+)",
    },
    "lag_search": {
        "search of the lag": r"^ *1\.\d min .*ratio to lfilter alone +([\d.]+)",
        "4 min": r"^ *4\.\d min .*ratio to lfilter alone +([\d.]+)",
    },
    "report": {
        "the page of a report": r"one method: .*ratio ([\d.]+)",
        "with every method": r"every method: .*ratio ([\d.]+)",
    },
    "rigid_body_identify": {"a whole vehicle identified": r"ratio +([\d.]+)"},
    "serve": {"from a drop to the verdict": r"^example_flight.*ratio ([\d.]+)"},
    "spectral": {
        "frequency response of 60 s": r"^response, with bands .*csd +([\d.]+)",
        "its models of order 1 to 4": r"^response, models .*csd +([\d.]+)",
    },
}


def written_ratios(readme: str) -> dict[tuple[str, str], float]:
    """Largest ratio of each row of the table, by benchmark and by what the row is of."""
    results, script = {}, ""
    for line in readme.splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if len(cells) not in (3, 7):
            continue
        named = re.search(r"benchmarks/(\w+)\.py", cells[0])
        script = named[1] if named else script
        last = re.search(r"^(?:.*-)?(1/)?([\d.,]+)$", cells[4 if len(cells) == 7 else 2])
        if script and last:
            number = float(last[2].replace(",", ""))
            results[script, cells[1]] = 1.0 / number if last[1] else number
    return results


def measured_ratio(printed: str, pattern: str) -> float:
    """Ratio that a benchmark printed."""
    match = re.search(pattern, printed, re.MULTILINE)
    if match is None:
        raise SystemExit(f"Expected a line like {pattern!r}; received\n{printed}")
    return 1.0 / float(match[1]) if pattern.endswith("x faster") else float(match[1])


def exceeded(script: str, printed: str, written: dict[tuple[str, str], float]) -> list[str]:
    """Compare what a benchmark printed with the table, and return the rows that do not hold."""
    broken = []
    for begins, pattern in RATIOS[script].items():
        rows = [row for of, row in written if of == script and row.startswith(begins)]
        if not rows:  # a row that the small case does not have
            continue
        reported = written[script, min(rows, key=len)]
        ratio = measured_ratio(printed, pattern)
        verdict = "holds" if ratio <= TOLERATED * reported else "EXCEEDED"
        print(
            f"{script:<20}{begins:<32}written {reported:8.4g}   measured {ratio:8.4g}   {verdict}", flush=True
        )
        if verdict != "holds":
            broken.append(f"{script}, {begins}")
    return broken


def run(name: str, *options: str) -> str:
    """What a benchmark prints."""
    command = [sys.executable, str(FOLDER / f"{name}.py"), *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{name} failed:\n{done.stdout}{done.stderr}")
    return done.stdout


def small_exceeded(name: str, folder: Path, written: dict[tuple[str, str], float]) -> list[str]:
    """Rows of a small case that hold in no run."""
    broken = exceeded(name, (folder / f"{name}.txt").read_text(encoding="utf-8"), written)
    for _ in range(SMALL_RUNS - 1):
        if broken:
            again = exceeded(name, run(name, "--small"), written)
            broken = [row for row in broken if row in again]
    return broken


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("benchmarks", nargs="*", metavar="NAME", help=f"out of {', '.join(RATIOS)}")
    parser.add_argument("--small", type=Path, metavar="FOLDER", help="compare what small cases printed")
    parse_args = parser.parse_args()
    unknown = [name for name in parse_args.benchmarks if name not in RATIOS]
    if unknown:
        parser.error(f"expected names out of {', '.join(RATIOS)}; received {', '.join(unknown)}")
    readme, _, small = (FOLDER / "README.md").read_text(encoding="utf-8").partition(SMALL_HEADING)
    broken: list[str] = []
    if parse_args.small:
        written = written_ratios(small)
        for name in dict.fromkeys(script for script, _ in written):
            broken += small_exceeded(name, parse_args.small, written)
    else:
        for name in parse_args.benchmarks or RATIOS:
            broken += exceeded(name, run(name), written_ratios(readme))
    if broken:
        raise SystemExit(
            f"More than {TOLERATED:g} times what benchmarks/README.md says: {'; '.join(broken)}."
        )


if __name__ == "__main__":
    main()
