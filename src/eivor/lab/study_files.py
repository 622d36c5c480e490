"""Files of studies and of suites."""

from __future__ import annotations

from dataclasses import dataclass, replace
from importlib.resources import as_file, files
from pathlib import Path

from eivor.errors import EivorError, InputError
from eivor.lab.experiments import INPUT, OUTPUT, DifferenceEquation, Experiment, VerticalExperiment
from eivor.lab.records import Scenario
from eivor.lab.scenario_files import (
    MOST_SAMPLES,
    noises,
    of_kind,
    read_scenario,
    sample_count,
    scenario_from_table,
    shipped_scenario,
    shipped_scenarios,
)
from eivor.lab.study import MethodChoice, Regularisation, Study
from eivor.simulation.excitation import Disturbance, Excitation
from eivor.strict_toml import TomlTable, read_toml

# -- Study file --

#: What a scenario may be of, the first when it does not say.
KINDS = ("vertical", "difference_equation")


def read_study(path: Path) -> Study:
    """Study from a file."""
    return study_from_table(read_toml(path, "a study"))


def study_from_table(top: TomlTable) -> Study:
    """Study from the top table of a file, all of whose keys it takes."""
    name = top.text("name", Path(top.file).stem)
    runs, seed = top.whole("runs"), top.whole("seed")
    intervals, level = top.flag("intervals", default=False), top.number("level", 0.95)
    if isinstance(top.values.get("scenario"), str):
        experiment = _experiment(top.neighbour("scenario", "a scenario"))
    else:
        experiment = _experiment(top.section("scenario"))
    choices = tuple(method_choice(table) for table in top.sections("methods"))
    top.finish()
    try:
        return Study(name, experiment, choices, runs, seed, intervals, level)
    except EivorError as error:
        raise _placed(top, error) from error


def method_choice(table: TomlTable, channel: str = INPUT) -> MethodChoice:
    """Method and its options, from a table all of whose keys it takes."""
    name = table.text("name")
    lags = table.span("lags") if table.has("lags") else None
    channel = table.text("channel", channel)
    weighting = table.text("weighting", "unweighted")
    known = table.texts("known_noise") if table.has("known_noise") else None
    label = table.text("label", name)
    covariance, strength = table.text("covariance", "default"), table.number("strength", 1.0)
    shrunk = _regularisation(table.section("regularisation")) if table.has("regularisation") else None
    table.taken.update(("lags", "known_noise", "regularisation"))
    table.finish()
    try:
        return MethodChoice(name, lags, channel, weighting, known, label, covariance, strength, shrunk)
    except EivorError as error:
        raise _placed(table, error) from error


def _regularisation(table: TomlTable) -> Regularisation:
    towards = table.text("towards", "zero")
    parameter = table.number("parameter") if table.has("parameter") else None
    table.taken.add("parameter")
    table.finish()
    try:
        return Regularisation(parameter, towards)
    except EivorError as error:
        raise _placed(table, error) from error


def _experiment(table: TomlTable) -> Experiment:
    if table.has("kind") and table.choice("kind", KINDS) == "difference_equation":
        return _difference_equation(table)
    return VerticalExperiment(scenario_from_table(table))


def _difference_equation(table: TomlTable) -> DifferenceEquation:
    noise, ratios = noises(table, (OUTPUT, INPUT))
    disturbance = None
    if table.has("disturbance"):
        disturbance = of_kind(table.section("disturbance"), Disturbance)
    output_coefficients = table.numbers("output_coefficients")
    input_coefficients = table.numbers("input_coefficients")
    excitation = of_kind(table.section("excitation"), Excitation)
    delay, samples = table.whole("delay", 1), sample_count(table, 1000)
    rate_hz = table.number("rate_hz", 1.0)
    table.taken.update(("disturbance", "noise"))
    table.finish()
    try:
        return DifferenceEquation(
            output_coefficients,
            input_coefficients,
            excitation,
            delay=delay,
            samples=samples,
            rate_hz=rate_hz,
            noise=noise,
            noise_to_signal=ratios,
            disturbance=disturbance,
        )
    except EivorError as error:
        raise _placed(table, error) from error


def _placed(table: TomlTable, error: EivorError) -> InputError:
    """Error of what a table describes, with its place: it is the file that is wrong."""
    return table.wrong("", error.expected, error.received, error.remedy)


# -- Suite file --


@dataclass(frozen=True, slots=True)
class SuiteStudy:
    """One study of a suite."""

    scenario: str
    samples: int
    study: Study


@dataclass(frozen=True, slots=True)
class Suite:
    """Studies with the same methods, runs and seed."""

    name: str
    studies: tuple[SuiteStudy, ...]  # Every scenario at every length, lengths first

    def reduced(self, runs: int) -> Suite:
        """Same suite with other numbers of runs; trials are the same as far as they go."""
        studies = tuple(replace(study, study=replace(study.study, runs=runs)) for study in self.studies)
        return replace(self, studies=studies)


def read_suite(path: Path) -> Suite:
    """Suite from a file."""
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
