"""Suites of studies: files of scenarios, lengths and methods."""

from __future__ import annotations

import platform
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import msgspec

from eivor.lab.experiments import VerticalExperiment
from eivor.lab.records import Scenario
from eivor.lab.scenario_files import (
    MOST_SAMPLES,
    SCENARIOS,
    located,
    method_choice,
    read_scenario,
    shipped_files,
)
from eivor.lab.study import Study
from eivor.strict_toml import TomlTable, read_toml

PACKAGES = ("eivor", "numpy", "scipy")


def versions() -> str:
    packages = ", ".join(f"{package} {version(package)}" for package in PACKAGES)
    return f"{packages}, Python {platform.python_version()}"


@dataclass(frozen=True, slots=True)
class SuiteStudy:
    """One study of a suite."""

    scenario: str
    samples: int
    study: Study

    def row(self, method: str, parameter: str, **values: str | float) -> dict[str, str | int | float]:
        """A row of a method's estimates of a parameter, with whose they are."""
        study = self.study
        return {
            "scenario": self.scenario,
            "samples": self.samples,
            "method": method,
            "parameter": parameter,
            **values,
            "runs": study.runs,
            "seed": study.seed,
            "level": study.level,
            "versions": versions(),
        }


@dataclass(frozen=True, slots=True)
class Suite:
    """Studies with the same methods, runs and seed."""

    name: str
    studies: tuple[SuiteStudy, ...]  # Every scenario at every length, lengths first

    def reduced(self, runs: int) -> Suite:
        """Same suite with other numbers of runs; trials are the same as far as they go."""
        studies = tuple(replace(study, study=replace(study.study, runs=runs)) for study in self.studies)
        return replace(self, studies=studies)


class _SuiteFile(msgspec.Struct, forbid_unknown_fields=True):
    runs: int
    seed: int
    samples: list[int]
    scenarios: list[str]
    methods: list[dict[str, Any]]
    name: str = ""
    level: float = 0.95


def read_suite(path: Path) -> Suite:
    """Suite from a file."""
    top = read_toml(path, "a suite of studies")
    given = top.convert(_SuiteFile)
    lengths, scenarios = given.samples, {word: _scenario(top, word, path.parent) for word in given.scenarios}
    tables = [top.part(f"methods[{i}]", item) for i, item in enumerate(given.methods, start=1)]
    if not lengths or not scenarios or len(set(lengths)) < len(lengths):
        raise top.wrong(
            "", "one scenario or more, and one length or more, each once", f"{lengths} of {list(scenarios)}"
        )
    if not all(1 <= length <= MOST_SAMPLES for length in lengths):
        raise top.wrong("samples", f"whole numbers up to {MOST_SAMPLES}", f"{lengths}")
    studies = []
    for samples in lengths:
        for word, scenario in scenarios.items():
            experiment = VerticalExperiment(replace(scenario, samples=samples))
            channel = next(iter(scenario.references), "input")
            choices = tuple(method_choice(table, channel) for table in tables)
            label = f"{given.name or path.stem}: {word}, {samples} samples"
            with located(top):
                study = Study(
                    label, experiment, choices, given.runs, given.seed, intervals=True, level=given.level
                )
            studies.append(SuiteStudy(word, samples, study))
    return Suite(given.name or path.stem, tuple(studies))


def coverage_suite() -> Suite:
    """Coverage of the intervals of generalized IV."""
    return read_suite(Path(__file__).parent / "coverage" / "coverage.toml")


def _scenario(top: TomlTable, word: str, folder: Path) -> Scenario:
    if word.endswith(".toml"):
        return read_scenario(folder / word)
    if word not in (known := shipped_files(SCENARIOS)):
        raise top.wrong("scenarios", f"names out of {', '.join(known)}, or files", f"'{word}'")
    return read_scenario(known[word])
