"""Intervals and diagnostics of generalized IV with ten lags, against the estimate they belong to.

N = 1e6; target: together at most twice the estimate. Every fit is of a problem of its own, which remembers
nothing. Covariances by kernels beside them, for those who choose one, and the same work by linearmodels.
"""

from __future__ import annotations

import numpy as np
from _shared import arguments, least_seconds, machine
from generalized_iv import LAGS, METHOD, arrays, problem

import eivor as ev


def peer_intervals(v: np.ndarray, s: np.ndarray, u: np.ndarray) -> object:
    """Two-stage least squares with a Bartlett covariance of the usual bandwidth, by linearmodels."""
    from linearmodels.iv import IV2SLS

    from eivor.inference.covariance import newey_west_bandwidth

    rows = slice(LAGS, None)
    instruments = np.column_stack([u[LAGS - lag : u.size - lag] for lag in range(LAGS + 1)])
    regressors = np.column_stack([-v[rows], u[rows]])
    model = IV2SLS(s[rows], None, regressors, instruments)
    return model.fit(cov_type="kernel", bandwidth=newey_west_bandwidth(u.size)).std_errors


def main() -> None:
    small = arguments(__doc__).small
    print(machine())
    repeats = 3 if small else 7
    data = arrays(50_000 if small else 1_000_000)
    cov = ev.covariances

    def fresh() -> ev.Estimate:
        return ev.identify(problem(*data), METHOD)

    def timed(work: object, name: str) -> None:
        """Ratios of turns of one run: the processor's speed changes from one turn to the next."""
        assert callable(work)
        pairs = []
        for _ in range(repeats):
            turns = [(least_seconds(fresh, 1), fresh()) for _ in range(3)]  # as many of both
            after = min(least_seconds(lambda fit=fit: work(fit), 1) for _, fit in turns)
            pairs.append((min(estimate for estimate, _ in turns), after))
        ratios = [after / before for before, after in pairs]
        estimate, after = (min(part) for part in zip(*pairs, strict=True))
        print(
            f"{name:<42}{1e3 * after:8.1f} ms   estimate {1e3 * estimate:6.1f} ms   "
            f"ratio {np.median(ratios):5.2f}"
        )

    def intervals(fit: ev.Estimate) -> object:
        return [fit.interval(name) for name in fit.names]

    def everything(fit: ev.Estimate) -> object:
        return intervals(fit), ev.diagnose(fit).summary()

    timed(intervals, "intervals (equal-weighted cosines)")
    timed(everything, "intervals and all diagnostics (target 2)")
    choices = {
        "classical": cov.Classical(),
        "Bartlett": cov.KernelRobust(),
        "quadratic spectral": cov.KernelRobust(cov.QuadraticSpectral()),
    }
    for name, chosen in choices.items():
        timed(lambda fit, chosen=chosen: intervals(fit.with_covariance(chosen)), f"intervals, {name}")
    peer = least_seconds(lambda: peer_intervals(*data), 1)
    print(f"{'linearmodels, estimate and Bartlett':<42}{1e3 * peer:8.1f} ms")


if __name__ == "__main__":
    main()
