"""Coverage as a table: a row for each scenario, length, method and parameter.

Columns: `suite`, `scenario`, `samples`, `method`, `parameter`; `hits` intervals of `count` held the truth;
`length` is the mean half-width of the intervals over what the normal distribution asks of the estimates'
own scatter (one: exactly right on average); `bias` is the mean error over that scatter. Runs and seed, and
the versions they were made with, stand beside them.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import polars as pl

from eivor.inference.distributions import normal_quantile
from eivor.lab.study import FAILED
from eivor.lab.study_files import SuiteStudy
from eivor.lab.study_run import StudyResult
from validation.suites import read_rows, versions

#: Columns of the table.
COLUMNS = (
    *("scenario", "samples", "method", "parameter", "hits", "count", "length", "bias"),
    *("runs", "seed", "level", "versions"),
)


def coverage_rows(suite_study: SuiteStudy, result: StudyResult) -> Iterator[dict[str, str | int | float]]:
    """Rows of one study."""
    study = suite_study.study
    for choice in study.methods:
        kept = result.trials.filter(pl.col(f"{choice.label}.status") != FAILED)
        for name in study.parameters:
            truth = study.experiment.truth[name]
            value, low, high = (
                kept[f"{choice.label}.{name}{part}"].to_numpy() for part in ("", ".low", ".high")
            )
            scatter = float(value.std(ddof=1)) if value.size > 1 else float("nan")
            yield {
                "scenario": suite_study.scenario,
                "samples": suite_study.samples,
                "method": choice.label,
                "parameter": name,
                "hits": int(((low <= truth) & (truth <= high)).sum()),
                "count": int(value.size),
                "length": float(np.mean(high - low)) / (2.0 * normal_quantile(study.level) * scatter),
                "bias": float(np.mean(value - truth)) / scatter,
                "runs": study.runs,
                "seed": study.seed,
                "level": study.level,
                "versions": versions(),
            }


def read_coverage(path: Path) -> pl.DataFrame:
    """Table from a file that the command wrote."""
    return read_rows(path, COLUMNS, "coverage")
