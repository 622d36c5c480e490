"""What the paper says of its methods, answered with a figure each, and the command that makes them.

    python -m validation.paper.claims [SUITE.toml] [--runs N] [--out FILE] [--page docs/paper.md]

runs the suite claims.toml beside this file, or another one with the same labels, and prints its tables;
`--from FILE` makes them anew from a finished run. Trials are kept in `--folder` as they are done. Nothing is
required of the figures: the exit code is 0, or 2 for an input that cannot be used.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import polars as pl

from eivor.estimation.methods import identify
from eivor.lab.study import MethodChoice, Study, StudyResult, scores, trial_nrmse
from validation.pages import markdown
from validation.studies import Row, suite_command
from validation.suite_files import Suite, SuiteStudy, read_suite, versions

PART = "claims"
CALLED = "python -m validation.paper.claims"
PARAMETERS = ("viscous_friction", "input_gain")
Cell = Callable[[Row, Row], str]


def claims_tables(rows: pl.DataFrame) -> str:
    first = rows.row(0, named=True)
    made = (
        f"Made by `{CALLED}` with {first['versions']}: {first['runs']} records of each scenario and length, "
        f"seed {first['seed']}. Cells are K / K_u."
    )
    return "\n\n".join([made, *_parts(Claims(rows))])


class Claims:
    """Rows by scenario, length, method and parameter."""

    def __init__(self, rows: pl.DataFrame) -> None:
        keys = ("scenario", "samples", "method", "parameter")
        self.found = {tuple(row[key] for key in keys): row for row in rows.iter_rows(named=True)}
        self.scenarios = [str(name) for name in rows["scenario"].unique(maintain_order=True)]
        self.lengths = sorted(int(length) for length in rows["samples"].unique())

    def pair(self, scenario: str, samples: int, method: str, base: str, cell: Cell) -> str:
        here, there = (
            [self.found[scenario, samples, name, parameter] for parameter in PARAMETERS]
            for name in (method, base)
        )
        return " / ".join(map(cell, here, there))

    def by_length(self, heads: Sequence[tuple[str, str, str, Cell]]) -> str:
        """Scenarios and heads in rows, lengths in columns; a head is a name, a method, a base and a cell."""
        lines = [
            [scenario, head, *(self.pair(scenario, length, method, base, cell) for length in self.lengths)]
            for scenario in self.scenarios
            for head, method, base, cell in heads
        ]
        return markdown(["scenario", "", *(f"N = {length}" for length in self.lengths)], lines)


def _parts(claims: Claims) -> Iterator[str]:
    yield '### "Using a TLS solution is preferable to an LS solution on short samples"'
    yield "Error of the total least squares form over that of the least squares form:"
    yield claims.by_length(
        [
            (f"{word}, {kind}", f"{name}_tls", name, _over(column))
            for word, name in (("IV", "extended_iv"), ("GIV", "generalized_iv"))
            for kind, column in (("RMSE", "rmse"), ("median", "median"))
        ]
    )
    yield '### "Generalized instrumental variables have better numerical stability"'
    yield "Condition of $\\Psi^\\top\\Phi$, columns of unit length (as they are), median of five records:"
    lines = [
        [scenario, *(_conditioning(claims, scenario, method) for method in ("extended_iv", "generalized_iv"))]
        for scenario in claims.scenarios
    ]
    yield markdown([f"scenario, N = {claims.lengths[-1]}", "IV", "GIV"], lines)
    yield '### IV is ill-conditioned "or even incorrect if the input signal is white noise"'
    yield "RMSE of extended IV over that of generalized IV:"
    yield claims.by_length([("IV / GIV", "extended_iv", "generalized_iv", _over("rmse"))])
    yield "Share of their estimates that say that they are weak, IV and GIV:"
    lines = [
        [scenario, *(_weak_shares(claims, scenario, length) for length in claims.lengths)]
        for scenario in claims.scenarios
    ]
    yield markdown(["scenario", *(f"N = {length}" for length in claims.lengths)], lines)
    yield '### "The proposed approach allows more accurate [estimates than] LS and EIV"'
    yield "RMSE and bias in per cent of the parameter:"
    yield claims.by_length(
        [
            (f"{word}: RMSE, bias", method, method, _error_and_bias)
            for word, method in (("LS", "least_squares"), ("GIV-TLS", "generalized_iv_tls"))
        ]
    )
    yield '### "LS has the smallest standard deviation"'
    yield "Standard deviation over that of generalized IV:"
    yield claims.by_length(
        [
            (word, method, "generalized_iv", _over("std"))
            for word, method in (
                ("LS", "least_squares"),
                ("TLS", "total_least_squares"),
                ("IV", "extended_iv"),
            )
        ]
    )
    yield '### "To further reduce the standard deviation, ... a regularized version ... is an urgent task"'
    yield (
        "SD and RMSE over those of generalized IV: Tikhonov's regularisation, the parameter by "
        "generalized cross-validation, towards zero and towards LS:"
    )
    yield claims.by_length(
        [
            (f"{word}: {kind}", method, "generalized_iv", _over(column))
            for word, method in (("to 0", "regularised"), ("to LS", "regularised to least squares"))
            for kind, column in (("SD", "std"), ("RMSE", "rmse"))
        ]
    )


def _over(column: str) -> Cell:
    def cell(row: Row, base: Row) -> str:
        return f"{float(row[column]) / float(base[column]):.3g}"

    return cell


def _weak_shares(claims: Claims, scenario: str, samples: int) -> str:
    rows = [
        claims.found[scenario, samples, name, PARAMETERS[0]] for name in ("extended_iv", "generalized_iv")
    ]
    return ", ".join(f"{int(row['weak']) / int(row['runs']):.2f}" for row in rows)


def _error_and_bias(row: Row, _base: Row) -> str:
    return f"{100.0 * float(row['rmse']):.3g} ({100.0 * float(row['bias']):+.2g})"


def _conditioning(claims: Claims, scenario: str, method: str) -> str:
    row = claims.found[scenario, claims.lengths[-1], method, PARAMETERS[0]]
    return f"{float(row['condition']):.3g} ({float(row['unscaled_condition']):.3g})"


#: Columns of the table; errors, spreads and biases over the size of the parameter.
COLUMNS = (
    *("scenario", "samples", "method", "parameter", "rmse", "median", "bias", "std"),
    *("condition", "unscaled_condition", "failed", "weak", "runs", "seed", "versions"),
)
#: Trials whose condition numbers are looked at: they hardly differ.
CONDITIONED = 5


def claims_rows(suite_study: SuiteStudy, result: StudyResult) -> Iterator[Row]:
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
            results.append((estimate.condition, np.linalg.cond(estimate.system.matrix)))
    scaled, unscaled = np.median(results, axis=0).tolist()
    return scaled, unscaled


def claims_suite() -> Suite:
    return read_suite(Path(__file__).with_name("claims.toml"))


main = suite_command(
    "validation.paper.claims",
    __doc__,
    PART,
    claims_suite,
    claims_rows,
    COLUMNS,
    "claims",
    lambda rows: (claims_tables(rows), ()),
).main

if __name__ == "__main__":
    sys.exit(main())
