"""Report of a fleet: 200,000 flights of 5,000 vehicles, from the files to its result.

Target: 3 s by the clock. The peer is statsmodels' pooling of one quantity by the same variance between
flights, vehicle after vehicle, scaled from some of them; the report pools four and looks for changes in each.
"""

from __future__ import annotations

import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
from _shared import arguments, least_seconds, machine
from statsmodels.stats.meta_analysis import combine_effects

from eivor.fleet.analysis import fleet_reports
from validation.simulated_fleets import FleetSpec, fleet_rows

FLIGHTS = 40
#: Vehicles that the peer pools.
POOLED = 20


def main() -> None:
    small = arguments(__doc__).small
    print(machine())
    vehicles, repeats = (50, 1) if small else (5_000, 2)
    table = fleet_rows(FleetSpec(vehicles=vehicles, flights=FLIGHTS, weather=0.03, battery=0.03))
    rows = POOLED * FLIGHTS
    gain, error = (
        table[f"input_gain.{part}"].to_numpy()[:rows].reshape(POOLED, -1) for part in ("value", "std_error")
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "flights" / "part-0.parquet"
        path.parent.mkdir()
        table.write_parquet(path)
        current, cpu = (
            least_seconds(lambda: fleet_reports(Path(folder)), repeats, clock)
            for clock in (time.perf_counter, time.process_time)
        )
    peer = least_seconds(lambda: pooled(np.log(gain), (error / gain) ** 2), repeats, time.process_time)
    scaled = peer * vehicles / POOLED
    text = f"report {current:.2f} s, of processors {cpu:.2f} s; pooled one by one {scaled:.2f} s"
    print(f"{table.height:9,d} rows: {text}; ratio {cpu / scaled:.2f}")


def pooled(values: np.ndarray, variances: np.ndarray) -> None:
    """Pool one vehicle after the other."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for y, v in zip(values, variances, strict=True):
            combine_effects(y, v, method_re="iterated", use_t=True)


if __name__ == "__main__":
    main()
