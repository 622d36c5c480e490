"""Generalized IV with ten lags from three arrays to theta, and its moments, against peers.

* fit against linearmodels' `IV2SLS` on the same instruments, N = 1e6 (target: 100 x faster);
* instrumental moments of 3e7 samples against one plain read of the three arrays (target: within 6 x);
* peak memory above the arrays during that work (target: under 100 MB);
* time against N from 1e5 to 1e7: slope on a log-log plot (target: 0.9 to 1.1);
* 500 rows, with intervals and with all diagnostics, against NumPy by hand (targets: 8, 15, 60 times);
* trials of a study of 500 samples, side by side against one by one (target: 30 x as many). Processor time.
"""

from __future__ import annotations

import threading
import time
from pathlib import Path

import numpy as np
from _shared import arguments, least_seconds, machine

import eivor as ev
from eivor.estimation.moments import products_of
from eivor.lab.experiments import DifferenceEquation
from eivor.lab.study import MethodChoice, Study, side_by_side, trial
from eivor.simulation.excitation import WhiteExcitation

LAGS = 10
MOTION = ev.VerticalMotion(intercept=False)
METHOD = ev.methods.generalized_iv()


def arrays(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Velocity, specific force and input; the physics does not matter here."""
    rng = np.random.default_rng(count)
    u, v = rng.standard_normal(count), rng.standard_normal(count)
    v[1:] += u[:-1]
    return v, 0.5 * u - 0.3 * v, u


def problem(v: np.ndarray, s: np.ndarray, u: np.ndarray) -> ev.SignalRegression:
    signals = ev.Signals(
        rate_hz=5.0,
        channels={"velocity_z": v, "specific_force_z": s, "input": u},
        noise={"input": ev.WhiteNoise(std=0.1)},
    )
    return MOTION.regression(signals, ev.lags("input", 0, LAGS))


def fit(v: np.ndarray, s: np.ndarray, u: np.ndarray) -> dict[str, float]:
    return ev.identify(problem(v, s, u), METHOD).parameters


def peer_fit(v: np.ndarray, s: np.ndarray, u: np.ndarray) -> object:
    """Two-stage least squares on the same instruments, by linearmodels."""
    from linearmodels.iv import IV2SLS

    rows = slice(LAGS, None)
    instruments = np.column_stack([u[LAGS - lag : u.size - lag] for lag in range(LAGS + 1)])
    regressors = np.column_stack([-v[rows], u[rows]])
    return IV2SLS(s[rows], None, regressors, instruments).fit(cov_type="unadjusted").params


def by_hand(v: np.ndarray, s: np.ndarray, u: np.ndarray) -> np.ndarray:
    """The same theta from NumPy alone."""
    count = u.size - LAGS
    Psi = np.column_stack([u[LAGS - lag : u.size - lag] for lag in range(LAGS + 1)])
    A = Psi.T @ np.column_stack([-v[LAGS:], u[LAGS:]]) / count
    A[0, 1] -= 0.01
    return np.linalg.lstsq(A, Psi.T @ s[LAGS:] / count, rcond=None)[0]


def short_records(repeats: int) -> None:
    """Times of what 500 rows cost, in turns."""
    data = arrays(500)

    def intervals() -> ev.Estimate:
        estimate = ev.identify(problem(*data), METHOD)
        for name in estimate.names:
            estimate.interval(name)
        return estimate

    works = {
        "": lambda: fit(*data),
        " with intervals": intervals,
        " with diagnostics": lambda: ev.diagnose(intervals()).summary(),
    }
    for name, work in works.items():
        pairs = [
            [least_seconds(each, 20, time.process_time) for each in (work, lambda: by_hand(*data))]
            for _ in range(repeats)
        ]
        ours, peer = np.min(pairs, axis=0)
        ratio = np.median([mine / other for mine, other in pairs])
        print(f"500 rows{name:<18}{1e3 * ours:8.2f} ms   by hand {1e6 * peer:5.0f} us   ratio {ratio:6.1f}")


def studies(trials: int) -> None:
    """Trials of generalized IV, and of that with least squares and extended IV."""
    noise = {"output": ev.WhiteNoise(0.5)}
    equation = DifferenceEquation((0.5,), (2.0,), WhiteExcitation(1.0), samples=500, noise=noise)
    choices = (MethodChoice("generalized_iv", (0, LAGS)), MethodChoice("extended_iv", (1, LAGS)))
    for methods in (choices[:1], (*choices, MethodChoice("least_squares"))):
        study = Study("benchmark", equation, methods, trials)
        pairs = []
        for first in range(0, trials, trials // 4):
            numbers = range(first, first + trials // 4)
            one = least_seconds(lambda study=study, first=first: trial(study, first), 9, time.process_time)
            many = least_seconds(lambda study=study, n=numbers: side_by_side(study, n), 3, time.process_time)
            pairs.append((one, many / len(numbers)))
        one, many = np.min(pairs, axis=0)
        ratio = np.median([mine / other for mine, other in pairs])
        print(
            f"trials of {len(methods)} methods   side by side {1e6 * many:5.0f} us   one by one "
            f"{1e6 * one:6.0f} us   {ratio:5.1f} x faster (target 30)"
        )


def moments(cut: ev.SignalRegression) -> object:
    return products_of(cut)


def resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


def peak_above(action: object) -> float:
    """Most resident memory during `action` above what there was before it [MB], sampled each millisecond."""
    assert callable(action)
    before, peak, done = resident_bytes(), [0], threading.Event()

    def watch() -> None:
        while not done.is_set():
            peak[0] = max(peak[0], resident_bytes())
            time.sleep(0.001)

    watcher = threading.Thread(target=watch)
    watcher.start()
    action()
    done.set()
    watcher.join()
    return max(peak[0] - before, 0) / 1e6


def main() -> None:
    small = arguments(__doc__).small
    print(machine())
    repeats = 3 if small else 5

    data = arrays(50_000 if small else 1_000_000)
    current, peer = (
        least_seconds(lambda: fit(*data), repeats),
        least_seconds(lambda: peer_fit(*data), repeats),
    )
    print(
        f"fit, N = {data[0].size:.0e}   {1e3 * current:8.1f} ms   IV2SLS {1e3 * peer:9.1f} ms   "
        f"{peer / current:6.0f} x faster (target 100 at 1e6)"
    )

    data = arrays(200_000 if small else 30_000_000)
    cut = problem(*data)
    ratios, reads, sums = [], [], []
    for _ in range(repeats):
        reads.append(least_seconds(lambda: [array.sum() for array in data], 1))
        sums.append(least_seconds(lambda: moments(cut), 1))
        ratios.append(sums[-1] / reads[-1])
    print(
        f"moments, N = {data[0].size:.0e}   {min(sums):6.3f} s   plain read {min(reads):6.3f} s   "
        f"ratio {np.median(ratios):5.2f} (target 6, aim 3)"
    )
    print(f"memory above the arrays: moments {peak_above(lambda: moments(cut)):6.1f} MB (target 100)")
    print(f"                             fit {peak_above(lambda: fit(*data)):6.1f} MB (target 100)")

    counts = np.array([20_000, 200_000] if small else [100_000, 316_228, 1_000_000, 3_162_278, 10_000_000])
    seconds = []
    for count in counts:
        data = arrays(int(count))
        seconds.append(least_seconds(lambda data=data: fit(*data), repeats))
    slope = np.polyfit(np.log10(counts), np.log10(seconds), 1)[0]
    short_records(repeats)
    studies(80 if small else 2_000)
    print(f"time against N, {counts[0]:.0e} to {counts[-1]:.0e}: slope {slope:.2f} (target 0.9 to 1.1)")


if __name__ == "__main__":
    main()
