"""The logs of the study: simulated flights, and what folders hold beside them."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

from validation.simulated_fleets import FleetSpec, write_fleet_logs

#: Of all draws.
SEED = 20261122
#: Where the vehicle stands in a log's name.
VEHICLES = "**/{vehicle}/*.parquet"


@dataclass(frozen=True, slots=True)
class Size:
    """A fleet of the grid, see its file."""

    told_vehicles: int
    told_flights: int
    short_vehicles: int
    short_flights: int
    kills: int
    interrupts: int
    told_s: float
    short_s: float
    cost_s: float

    @property
    def logs(self) -> int:
        """Of the folder: flights, a copy, a damaged log and an empty one."""
        return self.told_vehicles * self.told_flights + self.short_vehicles * self.short_flights + 3


def write_logs(size: Size, folder: Path) -> None:
    """Simulate what is not there yet, and put a copy, a damaged log and an empty one beside it."""
    parts = (
        ("told", size.told_vehicles, size.told_flights, size.told_s),
        ("short", size.short_vehicles, size.short_flights, size.short_s),
    )
    for name, vehicles, flights, duration_s in parts:
        path = folder / name
        if path.exists():
            continue
        started = folder / f"{name}-begun"
        shutil.rmtree(started, ignore_errors=True)
        spec = FleetSpec(vehicles=vehicles, flights=flights, duration_s=duration_s, wear=0.1, seed=SEED)
        for _ in write_fleet_logs(spec, started):
            pass
        started.rename(path)
    first = folder / "told" / "v0000" / "0000.parquet"
    shutil.copyfile(first, folder / "zz-copy.parquet")
    (folder / "damaged.parquet").write_bytes(first.read_bytes()[:-40])
    (folder / "empty.ulg").touch()
