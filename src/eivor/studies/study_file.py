"""Studies from TOML.

    name = "white input"            # optional: the file's name
    runs = 200
    seed = 1
    intervals = false               # optional; level = 0.95
    scenario = "file.toml"          # a scenario file beside this one, or a table [scenario]

    [[methods]]
    name = "generalized_iv"
    lags = [0, 10]                  # of instruments, both included; none for least squares and its kin
    channel = "input"               # optional: what the instruments are lags of
    weighting = "two_step_robust"   # optional
    covariance = "newey_west"       # optional: what intervals rest on
    known_noise = ["input"]         # optional: all channels
    label = "giv"                   # optional: the name
    strength = 4.0                  # optional: of fuller and generalized_fuller
    regularisation = {parameter = 0.1, towards = "least_squares"}   # optional: Tikhonov's; without a
                                    # parameter by cross-validation, without a target towards zero

A scenario is one of vertical motion, see `eivor.simulation.scenario_files.scenario_file`, or with
``kind = "difference_equation"`` one whose keys are the parameters of `DifferenceEquation`; its noises are
tables [scenario.noise.output] and [scenario.noise.input], like those of vertical motion.
"""

from __future__ import annotations

from pathlib import Path

from eivor.errors import EivorError, InputError
from eivor.simulation.scenario_files.kinds import of_kind
from eivor.simulation.scenario_files.noise_tables import noises
from eivor.simulation.scenario_files.scenario_file import sample_count, scenario_from_table
from eivor.simulation.sources.disturbance import Disturbance
from eivor.simulation.sources.excitation import Excitation
from eivor.studies.difference_equation import INPUT, OUTPUT, DifferenceEquation
from eivor.studies.experiment import Experiment, VerticalExperiment
from eivor.studies.study import MethodChoice, Regularisation, Study
from eivor.toml_table import TomlTable, read_toml

#: What a scenario may be of, the first when it does not say.
KINDS = ("vertical", "difference_equation")


def read_study(path: Path) -> Study:
    """Study from a file.

    Parameters
    ----------
    path : Path
        TOML; a scenario file that it names is looked for beside it.

    Raises
    ------
    InputError
        When a file cannot be read, or does not describe a study; says where and why.
    """
    return study_from_table(read_toml(path, "a study"))


def study_from_table(top: TomlTable) -> Study:
    """Study from the top table of a file, all of whose keys it takes.

    Parameters
    ----------
    top : TomlTable
        As `read_toml` gives it; its `files` are all that were read once the study is there.

    Raises
    ------
    InputError
        When a file that it names cannot be read, or it does not describe a study; says where and why.
    """
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
    """Method and its options, from a table all of whose keys it takes.

    Parameters
    ----------
    table : TomlTable
        One of [[methods]].
    channel : str
        What instruments are lags of, when the table does not say.

    Raises
    ------
    InputError
        When a key is unknown or a value does not fit.
    """
    name = table.text("name")
    lags = table.span("lags") if table.has("lags") else None
    channel = table.text("channel", channel)
    weighting = table.text("weighting", "unweighted")
    known = table.texts("known_noise") if table.has("known_noise") else None
    label = table.text("label", name)
    covariance, strength = table.text("covariance", "default"), table.number("strength", 1.0)
    pulled = _regularisation(table.section("regularisation")) if table.has("regularisation") else None
    table.taken.update(("lags", "known_noise", "regularisation"))
    table.finish()
    try:
        return MethodChoice(name, lags, channel, weighting, known, label, covariance, strength, pulled)
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
