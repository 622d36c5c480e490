"""Efficiency as a table: a row for each scenario, length, method and parameter.

Columns: `scenario`, `samples`, `method`, `parameter`; `bound` and `rmse` over the size of the parameter, the
bound NaN where there is none; `bias` over the estimates' scatter; `hits` intervals of `count` held the truth;
`failed` and `weak` trials. Runs and seed, and the versions they were made with, stand beside them.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from eivor.errors import ParameterError
from eivor.lab.cramer_rao import cramer_rao
from eivor.lab.experiments import VerticalExperiment
from eivor.lab.study_files import SuiteStudy
from eivor.lab.study_run import StudyResult, scores
from validation.efficiency.open_loop import open_loop
from validation.suites import Row, versions

#: Columns of the table.
COLUMNS = (
    *("scenario", "samples", "method", "parameter", "bound", "rmse", "bias", "hits", "count"),
    *("failed", "weak", "runs", "seed", "level", "versions"),
)

#: Records under control that a bound is averaged over.
CONTROLLED_RUNS = 10


def efficiency_rows(suite_study: SuiteStudy, result: StudyResult) -> Iterator[Row]:
    """Rows of one study."""
    bounds = bounds_of(suite_study)
    for score in scores(result):
        for parameter in score.parameters:
            covered = parameter.coverage
            yield {
                "scenario": suite_study.scenario,
                "samples": suite_study.samples,
                "method": score.label,
                "parameter": parameter.name,
                "bound": bounds.get(parameter.name, float("nan")),
                "rmse": parameter.rmse / abs(parameter.truth),
                "bias": parameter.bias / parameter.estimate.std,
                "hits": 0 if covered is None else covered.hits,
                "count": 0 if covered is None else covered.count,
                "failed": score.failed,
                "weak": score.weak,
                "runs": suite_study.study.runs,
                "seed": suite_study.study.seed,
                "level": suite_study.study.level,
                "versions": versions(),
            }


def bounds_of(suite_study: SuiteStudy) -> dict[str, float]:
    """Bound of each parameter over its size; under control that of the open loop with the same input."""
    experiment = suite_study.study.experiment
    if not isinstance(experiment, VerticalExperiment):
        return {}
    scenario = experiment.scenario
    try:
        if not scenario.controlled:
            return cramer_rao(scenario).relative
        relatives = [
            cramer_rao(open_loop(scenario, seed), runs=1).relative for seed in range(CONTROLLED_RUNS)
        ]
    except ParameterError:
        return {}
    return {name: float(np.sqrt(np.mean([each[name] ** 2 for each in relatives]))) for name in relatives[0]}
