"""Spectral generalized IV: the time of a record of 4,000 samples, and what twice the record costs.

Targets: 50 ms at N = 4,000, and N log N to 1e6. Beside it generalized IV, from which it begins, and both
other spectral methods. Last a frequency response of 60 s at 400 Hz, 100 ms, and its models, 500 ms, beside
Welch's spectra by SciPy.
"""

from __future__ import annotations

import time
import warnings
from dataclasses import replace

import numpy as np
import scipy
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


def print_responses(repetitions: int) -> None:
    """Bands of 40 frequencies and models of a rate in closed loop, over the cross spectra of Welch."""
    rate_hz, steps, rng = 400.0, 24_000, np.random.default_rng(0)
    sweep = scipy.signal.chirp(np.arange(steps) / rate_hz, 0.3, 60.0, 20.0, "logarithmic")
    wind = 2e-3 * rng.standard_normal(steps)
    state, u, y = 0.0, np.zeros(steps), np.zeros(steps)
    for k in range(1, steps):
        state += (u[k - 1] - state) / 16.0  # a lag of 40 ms
        y[k] = 0.998 * y[k - 1] + 0.3 * state + wind[k]
        u[k] = 0.2 * sweep[k] - 0.05 * y[k]
    grid = np.geomspace(0.5, 18.0, 40)

    def response() -> ev.FrequencyResponse:
        result = ev.frequency_response(u, y, reference=sweep, rate_hz=rate_hz, frequency_hz=grid)
        assert len(result.bands) == 2
        return result

    made, clock = response(), time.process_time
    peer = least_seconds(lambda: scipy.signal.csd(u, y, rate_hz, nperseg=4096), repetitions, clock)
    for words, work in (("with bands", response), ("models", lambda: ev.transfer_functions(made))):
        seconds = least_seconds(work, repetitions, clock)
        print(f"response, {words:10s} {1e3 * seconds:9.1f} ms   over scipy.signal.csd {seconds / peer:7.1f}")


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
    print_responses(3 if small else 5)


if __name__ == "__main__":
    main()
