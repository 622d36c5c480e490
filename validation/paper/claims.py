"""What the paper says of its methods, answered with a figure each, and the command that makes them.

    python -m validation.paper.claims [SUITE.toml] [--runs N] [--out FILE] [--page docs/paper.md]

runs the suite claims.toml beside this file, or another one with the same labels, and prints its tables;
`--from FILE` makes them anew from a finished run. Trials are kept in `--folder` as they are done. Nothing is
required of the figures: the exit code is 0, or 2 for an input that cannot be used.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from eivor.estimation.methods import identify
from eivor.lab.study import MethodChoice, Study, StudyResult, scores, trial_nrmse
from validation.paper.claims_page import PART, claims_tables
from validation.suite_files import Suite, SuiteStudy, read_suite
from validation.suites import Row, SuiteCommand, versions

#: Columns of the table; errors, spreads and biases over the size of the parameter.
COLUMNS = (
    *("scenario", "samples", "method", "parameter", "rmse", "median", "bias", "std"),
    *("condition", "unscaled_condition", "failed", "weak", "runs", "seed", "versions"),
)
#: Trials whose condition numbers are looked at: they hardly differ.
CONDITIONED = 5


def claims_rows(suite_study: SuiteStudy, result: StudyResult) -> Iterator[Row]:
    """Rows of one study."""
    for choice, score in zip(suite_study.study.methods, scores(result), strict=True):
        condition, unscaled = _conditions(suite_study.study, choice)
        for parameter in score.parameters:
            errors = trial_nrmse(result, score.label, parameter.name)
            yield {
                "scenario": suite_study.scenario,
                "samples": suite_study.samples,
                "method": score.label,
                "parameter": parameter.name,
                "rmse": parameter.rmse / abs(parameter.truth),
                "median": float(np.median(errors)) / 100.0 if errors.size else float("nan"),
                "bias": parameter.bias / abs(parameter.truth),
                "std": parameter.estimate.std / abs(parameter.truth),
                "condition": condition,
                "unscaled_condition": unscaled,
                "failed": score.failed,
                "weak": score.weak,
                "runs": suite_study.study.runs,
                "seed": suite_study.study.seed,
                "versions": versions(),
            }


def _conditions(study: Study, choice: MethodChoice) -> tuple[float, float]:
    """Median condition number of a method's equations: of columns of unit length, and as they are."""
    results = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for index in range(min(study.runs, CONDITIONED)):
            signals = study.experiment.record(study.rng(index))
            problem = study.experiment.problem(signals, choice.instruments)
            estimate = identify(problem, MethodChoice(choice.name, choice.lags, choice.channel).method)
            results.append((estimate.condition, np.linalg.cond(estimate.best.system.matrix)))
    scaled, unscaled = np.median(results, axis=0).tolist()
    return scaled, unscaled


def claims_suite() -> Suite:
    """The suite beside this file."""
    return read_suite(Path(__file__).with_name("claims.toml"))


COMMAND = SuiteCommand(
    "validation.paper.claims",
    __doc__,
    claims_suite,
    claims_rows,
    COLUMNS,
    "claims",
    claims_tables,
    PART,
    lambda _: (),
)
main = COMMAND.main


if __name__ == "__main__":
    sys.exit(main())
