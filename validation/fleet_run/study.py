"""Whether a fleet's table is the same whatever computes it and whatever is killed meanwhile.

    python -m validation.fleet_run.study --kept FILE.jsonl [--size small|full] [--page docs/fleet.md]

simulates the fleet of the grid beside this file, runs it in one process, in two, in two that are killed and
interrupted at random instants and begun again, and on two workers of Dask of which one is killed, and
compares the tables to the byte. Logs and fleets are in a folder beside the file; what is there is not made
again. It ends with what a million logs take, reckoned from what was measured. The exit code is 0 when every
requirement is met, 3 when one is not, 2 for an input of no use.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from eivor.lab.experiments import markdown
from eivor.logs.read import read_log
from eivor.motions.identify import identify_flight
from eivor.strict_toml import read_toml
from validation.fleet_run.logs import SEED, Size, write_logs
from validation.fleet_run.modes import MODES, Told
from validation.kept_study import Answer, KeptStudyCommand, keep, kept_lines
from validation.requirement import Requirement
from validation.simulated_fleets import FleetSpec, write_fleet_logs
from validation.suites import versions

PART = "fleet run"
GRID = Path(__file__).with_name("grid.toml")
WHOLE = ("told_vehicles", "told_flights", "short_vehicles", "short_flights", "kills", "interrupts")
SECONDS = ("told_s", "short_s", "cost_s")
#: Logs and cores of the cluster on paper, and logs of its tasks.
MANY, CORES, TASK_LOGS = 1_000_000, 100, 200


@dataclass(frozen=True, slots=True)
class Cost:
    """Processor time of a plain identification, reading included [s], of a flight of some length [s]."""

    flight_s: float
    cpu_s: float


def answer(grid: Path, size: str, kept: Path) -> Answer:
    """Run what the folder does not have yet, and judge all of it."""
    requested, folder = _parsed(grid, size), kept.with_suffix("")
    write_logs(requested, folder / "logs")
    selected = {kept_line.mode: kept_line for kept_line in kept_lines(kept, Told)}
    for name, run in MODES.items():
        if name not in selected:
            selected[name] = run(requested, folder / "logs", folder / name)
            keep(kept, [selected[name]])
    costs = kept.with_suffix(".cost.jsonl")
    if not costs.exists():
        keep(costs, [_cost(requested.cost_s)])
    (cost,) = kept_lines(costs, Cost)
    results = [selected[name] for name in MODES]
    requirements = tuple(_requirements(requested, results))
    return _tables(requested, results, requirements, cost), requirements


def _parsed(grid: Path, size: str) -> Size:
    root = read_toml(grid, "grid of fleets")
    sizes = {name: root.section(name) for name in ("small", "full")}
    read = {
        name: Size(*(item.whole(key) for key in WHOLE), *(item.number(key) for key in SECONDS))
        for name, item in sizes.items()
    }
    root.finish()
    return read[size]


def _cost(flight_s: float) -> Cost:
    with tempfile.TemporaryDirectory() as folder:
        spec = FleetSpec(vehicles=2, flights=1, duration_s=flight_s, seed=SEED)
        first, second = (read_log(str(path)) for path in write_fleet_logs(spec, Path(folder)))
    identify_flight(first)  # what is loaded once is not counted
    process_time = time.process_time()
    identify_flight(second)
    return Cost(flight_s, time.process_time() - process_time)


def _requirements(size: Size, tolds: Sequence[Told]) -> Iterator[Requirement]:
    rows = {item.rows for item in tolds} | {item.names for item in tolds}
    yield Requirement(
        "a row for each log, and one only, in every case",
        f"{size.logs:,}",
        ", ".join(f"{count:,}" for count in sorted(rows)),
        rows == {size.logs},
    )
    tables = len({item.sha256 for item in tolds})
    yield Requirement("different tables, compared to the byte", "1", f"{tables}", tables == 1)
    ended = sum(item.ended for item in tolds)
    wanted = size.kills + size.interrupts + 1
    yield Requirement("runs and workers that were ended", f"{wanted}", f"{ended}", ended >= wanted)


def _tables(size: Size, tolds: Sequence[Told], requirements: Sequence[Requirement], cost: Cost) -> str:
    requested = [
        (requirement.what, requirement.asked, requirement.measured, "yes" if requirement.met else "no")
        for requirement in requirements
    ]
    verdicts = ", ".join(f"{count:,} {verdict}" for verdict, count in tolds[0].verdicts.items())
    return "\n\n".join(
        (
            f"Made by `python -m validation.fleet_run.study` with {versions()}, seed {SEED}: "
            f"{size.short_vehicles:,} vehicles with {size.short_flights} flights each that are too short to "
            f"be told, {size.told_vehicles} with {size.told_flights} that are not; a copy, a damaged log and "
            f"an empty one. Rows: {verdicts}.",
            markdown(("what", "asked", "measured", "met"), requested),
            markdown(("run", "rows", "parts", "table", "memory of who hands out"), map(_line, tolds)),
            "On paper, from these figures:",
            markdown((f"{MANY:,} logs", "take"), _on_paper(tolds[0], cost)),
        )
    )


def _line(first: Told) -> tuple[str, ...]:
    return (
        first.what,
        f"{first.rows:,}",
        f"{first.parts:,}",
        f"{first.table_bytes / 1e6:.1f} MB",
        f"{first.parent_mb:.0f} MB",
    )


def _on_paper(first: Told, cost: Cost) -> Iterator[tuple[str, str]]:
    hours = MANY * cost.cpu_s / 3600.0
    yield (
        f"processor time, {cost.cpu_s:.2f} s for a flight of {cost.flight_s:g} s",
        f"{hours:,.0f} hours; {hours / CORES:.1f} h on {CORES} cores",
    )
    yield (
        f"table, {first.row_bytes / 1e3:.2f} kB a row",
        f"{first.row_bytes * MANY / 1e9:.1f} GB",
    )
    yield (
        f"tasks of {TASK_LOGS} logs",
        f"{MANY // TASK_LOGS:,}, of which two a core are known to the scheduler",
    )


COMMAND = KeptStudyCommand("validation.fleet_run.study", __doc__, GRID, PART, answer)
main = COMMAND.main


if __name__ == "__main__":
    sys.exit(main())
