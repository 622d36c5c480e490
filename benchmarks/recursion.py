"""Recursive generalized IV with eleven instruments and two parameters, in chunks, against its batch estimate.

Samples per second of `RecursiveIdentification.update` in chunks of 1,000, with and without the detector of
changes (target of both: 100,000), and of estimates with intervals after each chunk, and the time over that
of the products of the whole record at once.
"""

from __future__ import annotations

import time
import warnings

from _shared import arguments, least_seconds, machine
from generalized_iv import LAGS, METHOD, MOTION, arrays, problem

import eivor as ev
from eivor.errors import WeakInstrumentsWarning
from eivor.estimation.moments import products_of

CHUNK = 1000


def chunks_of(signals: ev.Signals) -> list[ev.Signals]:
    return [
        ev.Signals(
            signals.rate_hz,
            {name: values[first : first + CHUNK] for name, values in signals.channels.items()},
            noise=signals.noise,
        )
        for first in range(0, signals.sample_count, CHUNK)
    ]


def updated(chunks: list[ev.Signals], detector: ev.ChangeDetector | None) -> ev.RecursiveIdentification:
    recursion = ev.RecursiveIdentification(
        MOTION, METHOD, ev.lags("input", 0, LAGS), memory=200.0, detector=detector
    )
    for chunk in chunks:
        recursion = recursion.update(chunk)
    return recursion


def main() -> None:
    small = arguments(__doc__).small
    print(machine())
    repeats, count = (1, 20_000) if small else (3, 1_000_000)
    whole = problem(*arrays(count))
    chunks = chunks_of(whole.signals)
    # processor time: other programs do not count
    clock = time.process_time
    batch = least_seconds(lambda: products_of(whole), repeats, clock)
    for what, detector, part in (
        ("without detector", None, chunks),
        ("with detector", ev.ChangeDetector(), chunks[: max(len(chunks) // 20, 1)]),
    ):
        seconds = least_seconds(lambda given=part, item=detector: updated(given, item), repeats, clock)
        samples = CHUNK * len(part)
        ratio = seconds / (batch * samples / count)
        print(
            f"{what:18s} {samples / seconds:12,.0f} samples/s   products at once {count / batch:14,.0f} "
            f"samples/s   ratio {ratio:7.1f}"
        )
    part = chunks[: max(len(chunks) // 20, 1)]
    started = updated(part[:1], None)
    with warnings.catch_warnings(action="ignore", category=WeakInstrumentsWarning):
        seconds = least_seconds(lambda: list(ev.identify_recursively(part[1:], started)), repeats, clock)
    print(f"estimates after each chunk {CHUNK * (len(part) - 1) / seconds:11,.0f} samples/s")
    recursion = updated(chunks[:10], None)
    print(f"estimate with intervals: {1e3 * least_seconds(recursion.estimate, repeats, clock):6.2f} ms")


if __name__ == "__main__":
    main()
