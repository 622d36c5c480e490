"""What the default intervals must reach, and whether a run of the suite says that they do."""

from __future__ import annotations

import polars as pl

from eivor.inference.distributions import normal_quantile
from eivor.lab.study import Share
from validation.requirement import Requirement

#: Method whose intervals are judged: the one with default settings.
JUDGED = "default"
#: Lowest and highest coverage of each interval, by samples; and of their mean at the larger length.
BOUNDS = {4000: (0.92, 0.985), 500: (0.90, 0.99)}
MEAN_BOUNDS = {4000: (0.94, 0.97)}
#: Scenario whose intervals may cover too often in a short record: the trend is its slowest motion.
OVER_COVERED = ("trend", 500)
#: Confidence with which a share from few runs is compared with a bound.
CHANCE_LEVEL = 0.999


def requirements(rows: pl.DataFrame) -> tuple[Requirement, ...]:
    """Judge a run of the suite, its judged method at the lengths that have bounds."""
    judged = rows.filter(pl.col("method") == JUDGED)
    results = []
    for samples, bounds in BOUNDS.items():
        here = judged.filter(pl.col("samples") == samples)
        if here.height:
            results.append(_each(here, samples, bounds))
            if samples in MEAN_BOUNDS:
                results.append(_mean(here, samples, MEAN_BOUNDS[samples]))
    return tuple(results)


def coverage_of(row: dict[str, object]) -> Share:
    """Hits and count of a row."""
    return Share(int(str(row["hits"])), int(str(row["count"])))


def _each(here: pl.DataFrame, samples: int, bounds: tuple[float, float]) -> Requirement:
    low, high = bounds
    shares = {}
    for row in here.iter_rows(named=True):
        exempt = (row["scenario"], samples) == OVER_COVERED
        covered = coverage_of(row)
        shares[f"{row['scenario']}, {row['parameter']}"] = (covered, low, 1.0 if exempt else high)
    missed = [
        f"{name} {covered.value:.3f}"
        for name, (covered, least, most) in shares.items()
        if not _within(covered, least, most)
    ]
    values = [covered.value for covered, _, _ in shares.values()]
    measured = f"{min(values):.3f} to {max(values):.3f}"
    return Requirement(
        f"each interval, N = {samples}",
        f"{low:.3f} to {high:.3f}" + (" (trend: to 1)" if samples == OVER_COVERED[1] else ""),
        f"{measured}; missed by {', '.join(missed)}" if missed else measured,
        not missed,
    )


def _mean(here: pl.DataFrame, samples: int, bounds: tuple[float, float]) -> Requirement:
    pooled = Share(int(here["hits"].sum()), int(here["count"].sum()))
    return Requirement(
        f"mean over scenarios, N = {samples}",
        f"{bounds[0]:.2f} to {bounds[1]:.2f}",
        f"{pooled.value:.4f}",
        _within(pooled, *bounds),
    )


def _within(covered: Share, low: float, high: float) -> bool:
    """Whether a share is between bounds, or may be but for chance when the runs are few."""
    if covered.count >= 1000:
        return low <= covered.value <= high
    slack = normal_quantile(CHANCE_LEVEL)
    n = max(covered.count, 1)
    below = slack * (low * (1.0 - low) / n) ** 0.5
    above = slack * (high * (1.0 - high) / n) ** 0.5
    return low - below <= covered.value <= high + above
