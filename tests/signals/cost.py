"""What a computation costs, in terms of another one: the same on every machine, idle or busy."""

from __future__ import annotations

import time

import numpy as np


def in_transforms(computation, size):
    """Processor time in units of that of one real FFT of the first power of two from twice `size` on."""
    values = np.random.default_rng(0).standard_normal(1 << (2 * size - 1).bit_length())
    return _least(computation) / _least(lambda: np.fft.rfft(values))


def _least(computation, tries=3):
    results = []
    for _ in range(tries):
        process_time = time.process_time()
        computation()
        results.append(time.process_time() - process_time)
    return min(results)
