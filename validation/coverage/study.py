"""How often intervals hold the truth, over a suite of scenarios, and the command that finds out.

    python -m validation.coverage.study [SUITE.toml] [--runs N] [--out FILE.parquet] [--page FILE.md]

runs the suite that comes with the package, or another one, and prints its tables. `--from FILE.parquet`
makes them anew from a finished run. Trials are kept in `--folder` as they are done, and a run that was
interrupted goes on there. The method with the label "default" is judged.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import polars as pl

from eivor.inference.distributions import normal_quantile
from eivor.lab.study import FAILED, Share, StudyResult
from validation.pages import markdown
from validation.studies import (
    Requirement,
    may_be_within,
    read_rows,
    requirement_table,
    suite_command,
)
from validation.suite_files import SuiteStudy, coverage_suite

#: Columns of the table.
COLUMNS = (
    *("scenario", "samples", "method", "parameter", "hits", "count", "length", "bias"),
    *("runs", "seed", "level", "versions"),
)


def coverage_rows(suite_study: SuiteStudy, result: StudyResult) -> Iterator[dict[str, str | int | float]]:
    study = suite_study.study
    for choice in study.methods:
        kept = result.trials.filter(pl.col(f"{choice.label}.status") != FAILED)
        for name in study.parameters:
            truth = study.experiment.truth[name]
            value, low, high = (
                kept[f"{choice.label}.{name}{part}"].to_numpy() for part in ("", ".low", ".high")
            )
            scatter = float(value.std(ddof=1)) if value.size > 1 else float("nan")
            yield suite_study.row(
                choice.label,
                name,
                hits=int(((low <= truth) & (truth <= high)).sum()),
                count=int(value.size),
                length=float(np.mean(high - low)) / (2.0 * normal_quantile(study.level) * scatter),
                bias=float(np.mean(value - truth)) / scatter,
            )


def read_coverage(path: Path) -> pl.DataFrame:
    return read_rows(path, COLUMNS, "coverage")


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
    asked = f"{low:.3f} to {high:.3f}" + (" (trend: to 1)" if samples == OVER_COVERED[1] else "")
    measured = f"{min(values):.3f} to {max(values):.3f}"
    return Requirement.by_all(f"each interval, N = {samples}", asked, measured, missed, ", ")


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
    return may_be_within(covered.value, covered.count, (low, high), CHANCE_LEVEL)


PART = "coverage"
CALLED = "python -m validation.coverage.study"
SYMBOLS = {"viscous_friction": "K", "input_gain": "K_u"}
#: What covariances are called in a table.
NAMES = {
    "default": "EWC, 8 averages (default)",
    "widest": "widest of EWC and classical (flights)",
    "bartlett_fixed_b": "Bartlett, 1.3 sqrt(N), fixed-b",
    "andrews": "quadratic spectral, Andrews",
    "newey_west": "Bartlett, Newey and West",
    "heteroskedasticity_robust": "heteroskedasticity-robust",
    "classical": "classical",
}


def coverage_tables(rows: pl.DataFrame) -> str:
    first = rows.row(0, named=True)
    level = f"{100 * first['level']:g} %"
    parts = [
        f"Made by `{CALLED}` with {first['versions']}: {first['runs']} records of each scenario and length, "
        f"seed {first['seed']}, intervals at {level}. In brackets: the 95 % Wilson interval of a share.",
        "## What is asked, and what came out",
        requirement_table(requirements(rows), "coverage of the default intervals"),
    ]
    for samples in rows["samples"].unique(maintain_order=True):
        here = rows.filter(pl.col("samples") == samples)
        parts += [
            f"## N = {samples}",
            _default_table(here.filter(pl.col("method") == JUDGED)),
            "And the rivals, on the same estimates; each cell is K / K_u:",
            _rival_table(here),
        ]
    return "\n\n".join(parts)


def _default_table(rows: pl.DataFrame) -> str:
    lines = []
    for scenario in rows["scenario"].unique(maintain_order=True):
        cells = [scenario]
        for row in rows.filter(pl.col("scenario") == scenario).iter_rows(named=True):
            low, high = coverage_of(row).interval
            cells += [
                f"{coverage_of(row).value:.3f} [{low:.3f}, {high:.3f}]",
                f"{row['length']:.2f}",
                f"{row['bias']:+.2f}",
            ]
        lines.append(cells)
    names = [SYMBOLS.get(name, name) for name in rows["parameter"].unique(maintain_order=True)]
    header = ["scenario"]
    for name in names:
        header += [f"{name}: coverage", "length", "bias / SD"]
    return markdown(header, lines)


def _rival_table(rows: pl.DataFrame) -> str:
    methods = rows["method"].unique(maintain_order=True).to_list()
    shares = {
        key: [coverage_of(row).value for row in part.iter_rows(named=True)]
        for key, part in rows.group_by("scenario", "method", maintain_order=True)
    }
    lines = [
        [scenario, *(" / ".join(f"{share:.3f}" for share in shares[scenario, method]) for method in methods)]
        for scenario in rows["scenario"].unique(maintain_order=True)
    ]
    worst, length = ["least"], ["mean length"]
    for method in methods:
        worst.append(f"{min(min(each) for (_, name), each in shares.items() if name == method):.3f}")
        length.append(f"{rows.filter(pl.col('method') == method)['length'].to_numpy().mean():.2f}")
    header = ["scenario", *(NAMES.get(method, method) for method in methods)]
    return markdown(header, [*lines, worst, length])


main = suite_command(
    "validation.coverage.study",
    __doc__,
    PART,
    coverage_suite,
    coverage_rows,
    COLUMNS,
    "coverage",
    lambda rows: (coverage_tables(rows), requirements(rows)),
).main

if __name__ == "__main__":
    sys.exit(main())
