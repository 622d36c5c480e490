"""Spectral generalized IV: the time of a record of 4,000 samples, and what twice the record costs.

Targets: 50 ms at N = 4,000, and N log N to 1e6. Beside it generalized IV, from which it begins, and both
other spectral methods.
"""

from __future__ import annotations

import time
import warnings
from dataclasses import replace

import numpy as np
from _shared import arguments, least_seconds, machine

import eivor as ev
from eivor.lab.scenario_files import shipped_scenario

METHODS = (
    ev.methods.generalized_iv(),
    ev.methods.spectral_giv(),
    ev.methods.spectral_giv_combined(),
    ev.methods.whittle_ml(),
)


def problem(samples: int) -> ev.SignalRegression:
    scenario = replace(shipped_scenario("rich"), samples=samples)
    signals = ev.simulate(scenario, np.random.default_rng(1)).signals
    known = {"input": signals.noise["input"]}
    return ev.VerticalMotion(intercept=False).regression(
        replace(signals, noise=known), ev.lags("input", 0, 10)
    )


def main() -> None:
    small = arguments(__doc__).small
    print(machine())
    # processor time: other programs do not count
    clock = time.process_time
    sizes = (4_000,) if small else (4_000, 32_000, 64_000, 128_000, 256_000, 512_000, 1_000_000)
    before: dict[str, float] = {}
    for size in sizes:
        record = problem(size)
        for method in METHODS if size == sizes[0] else METHODS[1:2]:
            with warnings.catch_warnings(action="ignore"):
                seconds = least_seconds(
                    lambda method=method, record=record: ev.identify(record, method),
                    1 if small else 40 if size == sizes[0] else 2,
                    clock,
                )
            half = before.get(method.name) if size in {64_000, 128_000, 256_000, 512_000} else None
            ratio = f"   of half the samples {seconds / half:5.2f}" if half else ""
            print(f"N = {size:9,d}   {method.name:22s} {1e3 * seconds:9.1f} ms{ratio}")
            before[method.name] = seconds


if __name__ == "__main__":
    main()
