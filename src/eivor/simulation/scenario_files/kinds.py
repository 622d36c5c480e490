"""What a scenario file may call a noise, a disturbance, an excitation, a control or an integrator.

How each is built from a table, and anything else that is described by a dataclass: a table in a table.

The keys of a kind are the parameters of its class, with the same defaults; what they mean is said there. A
list of numbers may also stand in a table beside the scenario: { file = "mine.csv", column = "u" }.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from enum import StrEnum
from functools import lru_cache
from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

from eivor.errors import EivorError, did_you_mean
from eivor.signals.further_noises import AutoregressiveNoise, HeavyTailedNoise, RoundingNoise
from eivor.signals.noise import FractionalNoise, MeasurementNoise, WhiteNoise
from eivor.simulation.records.control import AltitudeControl, Control, VelocityControl
from eivor.simulation.rigid_body.integrators import AdaptiveSteps, Integrator, RungeKutta4
from eivor.simulation.scenario_files.number_file import numbers_in_file
from eivor.simulation.sources.band_excitation import Chirp, FilteredWhite, Multisine
from eivor.simulation.sources.binary_excitation import PseudoRandomBinary
from eivor.simulation.sources.coefficient_course import (
    CoefficientCourse,
    Course,
    GivenCourse,
    SumOfCourses,
)
from eivor.simulation.sources.deterministic_disturbance import (
    BoundedAdversary,
    GivenDisturbance,
    Sinusoids,
    SumOfDisturbances,
    Trend,
    paper_disturbance,
)
from eivor.simulation.sources.disturbance import Disturbance, WhiteDisturbance
from eivor.simulation.sources.dryden import DrydenGust
from eivor.simulation.sources.excitation import (
    Excitation,
    GivenSeries,
    PaperInput,
    RandomSteps,
    ScaledExcitation,
    Steps,
    WhiteExcitation,
)
from eivor.simulation.sources.gust import OrnsteinUhlenbeck
from eivor.simulation.sources.linear_disturbance import (
    Arma,
    RandomCoefficientMovingAverage,
    TimeVaryingArma,
)
from eivor.simulation.sources.nonlinear_disturbance import Bilinear, BilinearSum, ThresholdMovingAverage
from eivor.simulation.sources.volatility import Garch, VarianceSwitch
from eivor.toml_table import TomlTable

Maker = Callable[..., Any]

NOISES: Mapping[str, Maker] = {
    "white": WhiteNoise,
    "fractional": FractionalNoise,
    "autoregressive": AutoregressiveNoise,
    "heavy_tailed": HeavyTailedNoise,
    "rounding": RoundingNoise,
}
DISTURBANCES: Mapping[str, Maker] = {
    "paper": paper_disturbance,
    "white": WhiteDisturbance,
    "arma": Arma,
    "time_varying_arma": TimeVaryingArma,
    "random_coefficient_moving_average": RandomCoefficientMovingAverage,
    "threshold_moving_average": ThresholdMovingAverage,
    "bilinear": Bilinear,
    "bilinear_sum": BilinearSum,
    "garch": Garch,
    "variance_switch": VarianceSwitch,
    "trend": Trend,
    "sinusoids": Sinusoids,
    "bounded": BoundedAdversary,
    "dryden": DrydenGust,
    "ornstein_uhlenbeck": OrnsteinUhlenbeck,
    "series": GivenDisturbance,
    "sum": SumOfDisturbances,
}
#: Of coefficients that change; sinusoids when none is named.
COURSES: Mapping[str, Maker] = {"sinusoid": CoefficientCourse, "series": GivenCourse, "sum": SumOfCourses}
EXCITATIONS: Mapping[str, Maker] = {
    "paper": PaperInput,
    "white": WhiteExcitation,
    "filtered_white": FilteredWhite,
    "chirp": Chirp,
    "multisine": Multisine,
    "pseudo_random_binary": PseudoRandomBinary,
    "steps": Steps,
    "random_steps": RandomSteps,
    "series": GivenSeries,
    "scaled": ScaledExcitation,
}
CONTROLS: Mapping[str, Maker] = {"velocity": VelocityControl, "altitude": AltitudeControl}
INTEGRATORS: Mapping[str, Maker] = {"runge_kutta_4": RungeKutta4, "adaptive": AdaptiveSteps}
#: Kinds by the abstract class that a parameter asks for.
KINDS: Mapping[type, Mapping[str, Maker]] = {
    MeasurementNoise: NOISES,
    Disturbance: DISTURBANCES,
    Excitation: EXCITATIONS,
    Control: CONTROLS,
    Integrator: INTEGRATORS,
    Course: COURSES,
}
#: Kinds that are meant where a table names none.
USUAL: Mapping[type, str] = {Course: "sinusoid"}


def of_kind(table: TomlTable, family: type, **known: object) -> Any:
    """Object that a table with a `kind` describes.

    Parameters
    ----------
    table : TomlTable
        Its keys, apart from those taken already.
    family : type
        A key of `KINDS`: what is described.
    **known
        Parameters that do not come from the table.

    Raises
    ------
    InputError
        When the kind or a key is unknown, a value of the wrong type, or a parameter out of its range.
    """
    kinds = KINDS[family]
    kind = table.text("kind", USUAL[family]) if family in USUAL else table.text("kind")
    if kind not in kinds:
        remedy = did_you_mean(kind, kinds, "Name one of them.")
        raise table.wrong("kind", f"one of {', '.join(kinds)}", f"'{kind}'", remedy)
    return built(table, kinds[kind], **known)


def built(table: TomlTable, maker: Maker, **known: object) -> Any:
    """Call a class or function with what the table says of its parameters; see `of_kind`."""
    values = dict(known)
    for name, (annotation, default) in parameters_of(maker).items():
        if name in known:
            continue
        if default is inspect.Parameter.empty or table.has(name):
            values[name] = _value(table, name, annotation)
        table.taken.add(name)
    table.finish()
    try:
        return maker(**values)
    except EivorError as error:
        raise table.wrong("", error.expected, error.received, error.remedy) from error


@lru_cache(maxsize=64)
def parameters_of(maker: Maker) -> dict[str, tuple[Any, Any]]:
    """Type and default of each parameter."""
    hints = get_type_hints(maker)
    signature = inspect.signature(maker)
    return {name: (hints[name], parameter.default) for name, parameter in signature.parameters.items()}


def _value(table: TomlTable, name: str, annotation: Any) -> Any:
    """Value of one key, by the type that its parameter has."""
    if get_origin(annotation) in (Union, UnionType):
        annotation = next(option for option in get_args(annotation) if option is not type(None))
    if annotation in _PLAIN:
        return _PLAIN[annotation](table, name)
    if annotation in KINDS:
        return of_kind(table.section(name), annotation)
    if isinstance(annotation, type):
        if issubclass(annotation, StrEnum):
            return annotation(table.choice(name, tuple(annotation)))
        return built(table.section(name), annotation)
    item = get_args(annotation)[0]
    if item in KINDS:
        return tuple(of_kind(section, item) for section in table.sections(name))
    return tuple(built(section, item) for section in table.sections(name))


def _numbers(table: TomlTable, name: str) -> tuple[float, ...]:
    """A list of numbers, or a column of a file of numbers."""
    if isinstance(table.values.get(name), dict):
        return numbers_in_file(table.section(name))
    return table.numbers(name)


def _rows(table: TomlTable, name: str) -> tuple[tuple[float, ...], ...]:
    """A list of lists of numbers."""
    rows = table.values.get(name)
    if not isinstance(rows, list):
        raise table.wrong(name, "a list of lists of numbers", repr(rows) if table.has(name) else "nothing")
    path = ".".join(part for part in (table.path, name) if part)
    numbered = table.part({f"{number + 1}": row for number, row in enumerate(rows)}, path)
    return tuple(numbered.numbers(key) for key in numbered.values)


def _wholes(table: TomlTable, name: str) -> tuple[int, ...]:
    """A list of whole numbers."""
    numbers = table.numbers(name)
    if any(number != round(number) for number in numbers):
        raise table.wrong(name, "a list of whole numbers", repr(table.values[name]))
    return tuple(round(number) for number in numbers)


#: How values of the plain types are taken.
_PLAIN: Mapping[Any, Callable[[TomlTable, str], Any]] = {
    float: TomlTable.number,
    int: TomlTable.whole,
    str: TomlTable.text,
    tuple[float, ...]: _numbers,
    tuple[int, ...]: _wholes,
    tuple[str, ...]: TomlTable.texts,
    tuple[tuple[float, ...], ...]: _rows,
}
