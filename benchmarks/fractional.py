"""Fractional difference equations: what twice the record costs, and what the direct sums would.

Target: N log N, never N^2: at most 2.3 times the time for twice the samples. The peer is the sum over all
past samples that a difference is defined by, at one order only.
"""

from __future__ import annotations

import time

import numpy as np
from _shared import arguments, least_seconds, machine

import eivor as ev
from eivor.signals.noise import fractional_weights

#: Orders are known in a regression, and sought in an identification.
KNOWN = ev.FractionalDifferenceModel((0.0, 0.7), (0.0,))
SOUGHT = ev.FractionalDifferenceModel((0.0, ev.UnknownOrder("order", 0.3, 1.1)), (0.0,))
TRUTH = {"output_coefficient_2": 8.0, "input_coefficient_1": 1.0, "order": 0.7}


def main() -> None:
    small = arguments(__doc__).small
    print(machine())
    sizes = (2_000, 4_000) if small else (32_000, 64_000, 128_000, 256_000)
    repeats = 1 if small else 2
    before: dict[str, float] = {}
    for size in sizes:
        rng = np.random.default_rng(0)
        driven = rng.standard_normal(size)
        output = KNOWN.simulate(TRUTH, driven)
        noise = {"output": ev.WhiteNoise(0.01 * float(output.std())), "input": ev.WhiteNoise(0.01)}
        measured = {"output": output, "input": driven}
        noisy = {name: series + noise[name].sample(size, rng) for name, series in measured.items()}
        signals = ev.Signals(1.0, noisy, noise=noise)
        actions = {
            "free run": lambda driven=driven: KNOWN.simulate(TRUTH, driven),
            "orders known": lambda signals=signals: ev.identify(
                KNOWN.problem(signals, ev.lags("input", 0, 5)), ev.methods.generalized_iv()
            ),
            "an order sought": lambda signals=signals: ev.identify(
                SOUGHT.problem(signals, ev.lags("input", 0, 5)), ev.methods.generalized_iv()
            ),
        }
        for name, action in actions.items():
            seconds = least_seconds(action, repeats, time.process_time)
            ratio = f"   of half the samples {seconds / before[name]:5.2f}" if name in before else ""
            print(f"N = {size:9,d}   {name:16s} {seconds:8.3f} s{ratio}")
            before[name] = seconds
    direct = least_seconds(lambda: direct_difference(output[: sizes[0]]), 1, time.process_time)
    scaled = direct * (sizes[-1] / sizes[0]) ** 2
    print(f"one difference by direct sums, N = {sizes[-1]:,d} by scaling: {scaled:.1f} s")


def direct_difference(values: np.ndarray) -> np.ndarray:
    """Difference of order 0.7, sample by sample."""
    weights = fractional_weights(0.7, values.size)
    return np.array([weights[: k + 1] @ values[k::-1] for k in range(values.size)])


if __name__ == "__main__":
    main()
