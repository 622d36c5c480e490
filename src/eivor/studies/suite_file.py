"""Suites from TOML: one set of methods on several scenarios, each at several lengths.

    name = "coverage"
    runs = 1000
    seed = 1
    level = 0.95                    # optional
    samples = [4000, 500]
    scenarios = ["rich", "mine.toml"]   # shipped ones by name, others as files beside this one

    [[methods]]                     # as in a study file, see `eivor.studies.study_file`
    name = "generalized_iv"
    lags = [0, 10]

A suite records intervals. Instruments are lags of what the vehicle does not answer, unless a method names
a channel: of the input in open loop, of the reference under control.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from importlib.resources import as_file, files
from pathlib import Path

from eivor.errors import EivorError
from eivor.simulation.records.scenario import Scenario
from eivor.simulation.scenario_files.scenario_file import (
    MOST_SAMPLES,
    read_scenario,
    shipped_scenario,
    shipped_scenarios,
)
from eivor.studies.experiment import VerticalExperiment
from eivor.studies.study import Study
from eivor.studies.study_file import method_choice
from eivor.toml_table import TomlTable, read_toml


@dataclass(frozen=True, slots=True)
class SuiteStudy:
    """One study of a suite.

    Parameters
    ----------
    scenario : str
        Name of its scenario.
    samples : int
        Length of its records.
    study : Study
        What to run.
    """

    scenario: str
    samples: int
    study: Study


@dataclass(frozen=True, slots=True)
class Suite:
    """Studies with the same methods, runs and seed.

    Parameters
    ----------
    name : str
        What reports call it.
    studies : tuple of SuiteStudy
        Every scenario at every length, lengths first.
    """

    name: str
    studies: tuple[SuiteStudy, ...]

    def reduced(self, runs: int) -> Suite:
        """Same suite with other numbers of runs; trials are the same as far as they go."""
        studies = tuple(replace(one, study=replace(one.study, runs=runs)) for one in self.studies)
        return replace(self, studies=studies)


def read_suite(path: Path) -> Suite:
    """Suite from a file.

    Raises
    ------
    InputError
        When a file cannot be read, or does not describe a suite; says where and why.
    """
    top = read_toml(path, "a suite of studies")
    name, runs, seed = top.text("name", path.stem), top.whole("runs"), top.whole("seed")
    level = top.number("level", 0.95)
    lengths = [_length(top, value) for value in top.numbers("samples")]
    scenarios = {word: _scenario(top, word, path.parent) for word in top.texts("scenarios")}
    tables = top.sections("methods")
    top.finish()
    if not lengths or not scenarios or len(set(lengths)) < len(lengths):
        raise top.wrong(
            "", "one scenario or more, and one length or more, each once", f"{lengths} of {list(scenarios)}"
        )
    studies = []
    for samples in lengths:
        for word, scenario in scenarios.items():
            experiment = VerticalExperiment(replace(scenario, samples=samples))
            channel = experiment.exogenous_channel
            choices = tuple(method_choice(table, channel) for table in tables)
            try:
                label = f"{name}: {word}, {samples} samples"
                study = Study(label, experiment, choices, runs, seed, intervals=True, level=level)
            except EivorError as error:
                raise top.wrong("", error.expected, error.received, error.remedy) from error
            studies.append(SuiteStudy(word, samples, study))
    return Suite(name, tuple(studies))


def coverage_suite() -> Suite:
    """The suite that comes with the package: coverage of the intervals of generalized IV."""
    with as_file(files("validation.coverage").joinpath("coverage.toml")) as path:
        return read_suite(path)


def _length(top: TomlTable, value: float) -> int:
    if value != int(value) or not 1 <= value <= MOST_SAMPLES:
        raise top.wrong("samples", f"whole numbers up to {MOST_SAMPLES}", f"{value:g}")
    return int(value)


def _scenario(top: TomlTable, word: str, folder: Path) -> Scenario:
    if word in shipped_scenarios():
        return shipped_scenario(word)
    if not word.endswith(".toml"):
        raise top.wrong("scenarios", f"names out of {', '.join(shipped_scenarios())}, or files", f"'{word}'")
    return read_scenario(folder / word)
