"""Maximum likelihood that is told every spectrum: rows for the tables of efficiency, and their command.

    python -m validation.efficiency.known_spectra SUITE.toml --kept FILE.jsonl --out FILE.parquet [--runs N]

runs the scenarios and lengths of a suite, on the same records as the other methods. Strengths and orders of
all noises are those that were simulated, and so is the way the disturbance takes: Q is minimised once, from
generalized IV's numbers. Of a real record nobody has that: it is what other methods are measured by. Every
trial is kept in the file; a run that was interrupted goes on.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import polars as pl

from eivor.errors import UsageError
from eivor.estimation.sampled_motion import sampled_problem
from eivor.estimation.spectral_equations import consistent_estimate, first_transient
from eivor.estimation.spectral_iv import minimise_quadratic, start_of
from eivor.lab.cramer_rao import cramer_rao, noise_of_record
from eivor.lab.experiments import VerticalExperiment
from eivor.lab.records import Scenario, simulate
from validation.efficiency.study import KNOWN
from validation.studies import (
    KEPT,
    OUT,
    Answer,
    Option,
    Row,
    StudyCommand,
    alone,
    completed,
    write_rows,
)
from validation.suite_files import SuiteStudy, read_suite


@dataclass(frozen=True, slots=True)
class Found:
    scenario: str  # Name of a shipped one
    samples: int  # Length, and number of the record
    run: int
    values: list[float]  # K and K_u


def trial(suite_study: SuiteStudy, run: int) -> Found:
    """Estimate from one record, the same as the suite's own."""
    scenario, experiment = _scenario(suite_study), suite_study.study.experiment
    record = simulate(scenario, suite_study.study.rng(run))
    problem = experiment.problem(record.signals, suite_study.study.methods[0].instruments)
    sampled = sampled_problem(problem, KNOWN)
    start = start_of(sampled, consistent_estimate(sampled.problem))
    spectrum = noise_of_record(scenario, record).spectrum
    motion, _, _ = minimise_quadratic(start, first_transient(start), spectrum)
    return Found(suite_study.scenario, suite_study.samples, run, [motion.friction, motion.gain])


def _scenario(suite_study: SuiteStudy) -> Scenario:
    experiment = suite_study.study.experiment
    if not isinstance(experiment, VerticalExperiment):
        raise UsageError("vertical motion", type(experiment).__name__, "Choose other scenarios.")
    return experiment.scenario


def key_of(found: Found) -> tuple[str, int, int]:
    return found.scenario, found.samples, found.run


def rows_of(suite_study: SuiteStudy, founds: Sequence[Found]) -> Iterator[Row]:
    """Rows of one scenario and length; there are no intervals."""
    scenario = _scenario(suite_study)
    bounds, truth = cramer_rao(scenario).relative, suite_study.study.experiment.truth
    values = np.array([each.values for each in founds])
    for name, value in zip(truth, values.T, strict=True):
        errors = value - truth[name]
        error = {
            "rmse": float(np.sqrt(np.mean(errors**2))) / abs(truth[name]),
            "bias": float(errors.mean() / errors.std(ddof=1)),
        }
        counts = dict.fromkeys(("hits", "count", "failed", "weak"), 0)
        yield suite_study.row(KNOWN, name, bound=bounds[name], **error, **counts) | {"runs": len(founds)}


def answer(chosen: argparse.Namespace) -> Answer:
    """Estimate from every record that the file does not have yet, and write the rows."""
    suite = read_suite(chosen.suite)
    if chosen.runs is not None:
        suite = suite.reduced(chosen.runs)
    rows: list[Row] = []
    for study in suite.studies:
        trials = {
            (study.scenario, study.samples, run): partial(trial, study, run)
            for run in range(study.study.runs)
        }
        found = completed(chosen.kept, Found, alone(trials), key_of)
        rows.extend(rows_of(study, found))
    write_rows(pl.DataFrame(rows), chosen.out)
    return f"{len(rows)} rows", ()


OPTIONS: dict[str, Option] = {
    "suite": {"type": Path, "help": "a suite file"},
    "--runs": {"type": int, "help": "instead of the suite's"},
    "--kept": KEPT,
    "--out": {**OUT, "required": True},
}
main = StudyCommand("validation.efficiency.known_spectra", __doc__, KNOWN, answer, OPTIONS).main

if __name__ == "__main__":
    sys.exit(main())
