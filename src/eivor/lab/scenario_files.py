"""Files of scenarios, flights, studies and suites."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from enum import Enum
from functools import lru_cache
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Any, Union, get_args, get_origin, get_type_hints

from eivor.errors import EivorError, UsageError, did_you_mean
from eivor.lab.disturbances import (
    Arma,
    Bilinear,
    BilinearSum,
    BoundedAdversary,
    CoefficientCourse,
    CoefficientPath,
    Garch,
    GivenCourse,
    GivenDisturbance,
    OrnsteinUhlenbeck,
    RandomCoefficientMovingAverage,
    Sinusoids,
    SumOfCourses,
    SumOfDisturbances,
    ThresholdMovingAverage,
    TimeVaryingArma,
    Trend,
    VarianceSwitch,
    paper_disturbance,
)
from eivor.lab.experiments import INPUT, OUTPUT, DifferenceEquation, Experiment, VerticalExperiment
from eivor.lab.records import ABOUT_HOVER, NOISY_CHANNELS, AltitudeControl, Control, Scenario, VelocityControl
from eivor.lab.study import MethodChoice, Study
from eivor.signals.noise import (
    AutoregressiveNoise,
    FractionalNoise,
    HeavyTailedNoise,
    MeasurementNoise,
    RoundingNoise,
    WhiteNoise,
)
from eivor.simulation.environment import SensorNoise
from eivor.simulation.excitation import (
    Chirp,
    Disturbance,
    DrydenGust,
    Excitation,
    FilteredWhite,
    GivenSeries,
    Multisine,
    PaperInput,
    PseudoRandomBinary,
    RandomSteps,
    ScaledExcitation,
    SteppedExcitation,
    WhiteDisturbance,
    WhiteExcitation,
)
from eivor.simulation.rigid_body_spec import AdaptiveSteps, Integrator, RigidBodyFlightSpec, RungeKutta4
from eivor.simulation.vertical import VerticalFlightSpec
from eivor.strict_toml import LARGEST_NUMBER, TomlTable, read_toml

if TYPE_CHECKING:
    import polars as pl


# -- Number file --

#: Endings of files that can be read.
FORMATS = (".csv", ".parquet")
#: Larger files, and longer columns, are no excitation: they would be held whole in every process.
LARGEST_BYTES, MOST_NUMBERS = 200_000_000, 10_000_000


def numbers_in_file(table: TomlTable) -> tuple[float, ...]:
    """Numbers of a table ``{ file = ..., column = ... }``."""
    path = _path(table, table.text("file"))
    name = table.text("column")
    table.finish()
    import polars as pl

    column = _column(table, path, name)
    table.files.add(path)
    numbers = column.str.strip_chars().cast(pl.Float64, strict=False) if column.dtype == pl.String else column
    numbers = numbers.cast(pl.Float64, strict=False)
    bad = numbers.is_null() | ~numbers.is_finite() | (numbers.abs() > LARGEST_NUMBER)
    if bad.any():
        row = bad.arg_max()
        value = column[row] if row is not None else None
        expected = f"finite numbers in column '{name}' of {path.name}, up to {LARGEST_NUMBER:g} in size"
        remedy = f"See its row {0 if row is None else row + 1}, not counting the header."
        raise table.wrong("column", expected, "no value" if value is None else repr(value)[:60], remedy)
    return tuple(numbers.to_list())


def _path(table: TomlTable, text: str) -> Path:
    """File that a text names, which is inside the folder of the scenario."""
    relative = Path(text)
    inside = not relative.is_absolute() and ".." not in relative.parts
    path = table.folder / relative
    try:
        inside = inside and path.resolve().is_relative_to(table.folder.resolve())
    except (OSError, ValueError, RuntimeError):  # a loop of links, a name that no system has
        inside = False
    if not inside:
        expected = "a file beside the scenario or in a folder below it"
        raise table.wrong("file", expected, f"'{text}'", "Put it there.")
    if path.suffix.lower() not in FORMATS:
        raise table.wrong("file", f"a file that ends in {' or '.join(FORMATS)}", f"'{text}'")
    if not path.is_file():
        raise table.wrong("file", "a file that exists", f"'{text}', which does not", "Check the name.")
    if path.stat().st_size > LARGEST_BYTES:
        raise table.wrong("file", f"a file of {LARGEST_BYTES} bytes or fewer", f"'{text}', larger than that")
    return path


def _column(table: TomlTable, path: Path, name: str) -> pl.Series:
    """Column as it is stored; as texts from CSV, so that what is no number can be shown."""
    import polars as pl

    try:
        if path.suffix.lower() == ".csv":
            lazy = pl.read_csv(path, infer_schema=False).lazy()  # the whole of it: every row is checked
        else:
            lazy = pl.scan_parquet(path, hive_partitioning=False)
        names = lazy.collect_schema().names()
        result = lazy.select(name).head(MOST_NUMBERS + 1).collect()[name] if name in names else None
    except (OSError, pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise table.wrong(
            "file", f"a table as {path.suffix.lower()[1:].upper()}", f"'{path.name}', which is not: {reason}"
        ) from error
    if result is None:
        remedy = did_you_mean(name, names, "Name one of its columns.")
        text = ", ".join(names[:20]) or "none"
        raise table.wrong("column", f"a column out of {text}", f"'{name}', not in {path.name}", remedy)
    if not (result.dtype.is_numeric() or result.dtype == pl.String):
        raise table.wrong("column", f"numbers in column '{name}' of {path.name}", f"values of {result.dtype}")
    if result.len() > MOST_NUMBERS:
        raise table.wrong("column", f"{MOST_NUMBERS} numbers or fewer", "more", "Cut the file.")
    return result


# -- Kinds --

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
    "steps": SteppedExcitation,
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
    CoefficientPath: COURSES,
}
#: Kinds that are meant where a table names none.
USUAL: Mapping[type, str] = {CoefficientPath: "sinusoid"}


def of_kind(table: TomlTable, family: type, **known: object) -> Any:
    """Object that a table with a `kind` describes."""
    kinds = KINDS[family]
    return built(table, kinds[table.choice("kind", tuple(kinds), USUAL.get(family))], **known)


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
    with located(table):
        return maker(**values)


@contextmanager
def located(table: TomlTable) -> Iterator[None]:
    """Turn the error of what a table describes into one with its place: it is the file that is wrong."""
    try:
        yield
    except EivorError as error:
        raise table.wrong("", error.expected, error.received, error.remedy) from error


@lru_cache(maxsize=64)
def parameters_of(maker: Maker) -> dict[str, tuple[Any, Any]]:
    """Type and default of each parameter."""
    hints = get_type_hints(maker)
    signature = inspect.signature(maker)
    return {name: (hints[name], parameter.default) for name, parameter in signature.parameters.items()}


def _value(table: TomlTable, name: str, annotation: Any) -> Any:
    if get_origin(annotation) in (Union, UnionType):
        annotation = next(option for option in get_args(annotation) if option is not type(None))
    if annotation in _PLAIN:
        return _PLAIN[annotation](table, name)
    if annotation in KINDS:
        return of_kind(table.section(name), annotation)
    if isinstance(annotation, type):
        if issubclass(annotation, Enum):
            return annotation(table.choice(name, tuple(member.value for member in annotation)))
        return built(table.section(name), annotation)
    item = get_args(annotation)[0]
    read = of_kind if item in KINDS else built
    return tuple(read(section, item) for section in table.sections(name))


def _numbers(table: TomlTable, name: str) -> tuple[float, ...]:
    if isinstance(table.values.get(name), dict):
        return numbers_in_file(table.section(name))
    return table.numbers(name)


def _rows(table: TomlTable, name: str) -> tuple[tuple[float, ...], ...]:
    rows = table.rows(name)
    return tuple(rows.numbers(key) for key in rows.values)


def _wholes(table: TomlTable, name: str) -> tuple[int, ...]:
    numbers = table.numbers(name)
    if any(number != round(number) for number in numbers):
        raise table.wrong(name, "a list of whole numbers", repr(table.values[name]))
    return tuple(round(number) for number in numbers)


#: How values of the plain types are taken.
_PLAIN: Mapping[Any, Callable[[TomlTable, str], Any]] = {
    float: TomlTable.number,
    int: TomlTable.whole,
    str: TomlTable.text,
    bool: lambda table, name: table.flag(name, default=False),
    tuple[int, int]: TomlTable.span,
    tuple[float, ...]: _numbers,
    tuple[int, ...]: _wholes,
    tuple[str, ...]: TomlTable.texts,
    tuple[tuple[float, ...], ...]: _rows,
}


# -- Flight file --

#: What a file of a flight says of itself.
FLIGHT_KIND = "flight"
#: Folders of what comes with the package.
_FLIGHTS, _SCENARIOS = (Path(__file__).parent / name for name in ("scenario_flights", "scenarios"))


def read_flight(path: Path) -> VerticalFlightSpec:
    """Flight from a file, with the seed zero."""
    return flight_from_table(read_toml(path, "a flight"))


def shipped_flight() -> VerticalFlightSpec:
    """Flight that comes with the package, "flight"."""
    return read_flight(_FLIGHTS / f"{FLIGHT_KIND}.toml")


def flight_from_table(table: TomlTable) -> VerticalFlightSpec:
    """Flight from the top table of a TOML file, all of whose keys it takes."""
    table.choice("kind", (FLIGHT_KIND,))
    known: dict[str, object] = {"seed": 0}
    if table.has("noise"):
        # The log of vertical motion has no angular rates.
        quiet = SensorNoise().angular_rate
        known["noise"] = built(table.section("noise"), SensorNoise, angular_rate=quiet)
    flight: VerticalFlightSpec = built(table, VerticalFlightSpec, **known)
    return flight


# -- Noise tables --

#: Key of a noise or a disturbance whose size is a share of a signal's.
RATIO = "ratio_to_signal"


def noises(
    table: TomlTable, channels: tuple[str, ...]
) -> tuple[dict[str, MeasurementNoise], dict[str, float]]:
    """Noise of each channel, and the ratio of those that are measured by their signal."""
    noise: dict[str, MeasurementNoise] = {}
    ratios: dict[str, float] = {}
    if not table.has("noise"):
        return noise, ratios
    sections = table.section("noise")
    sections.taken.update(channels)
    for name in filter(sections.has, channels):
        section = sections.section(name)
        ratio = ratio_to_signal(section)
        if (ratio is None) != section.has("std"):
            given = "both" if section.has("std") else "neither"
            raise section.wrong("", f"std or {RATIO}", given, "Give one of them.")
        # The std of a ratio follows from the signal; until then any will do.
        std = {} if ratio is None else {"std": 1.0}
        noise[name] = of_kind(section, MeasurementNoise, **std)
        ratios |= {} if ratio is None else {name: ratio}
    if sections.has("specific_force_z") and "acceleration_z" in channels:
        expected = f"noise of {', '.join(channels)}"
        raise sections.wrong("", expected, "noise of 'specific_force_z'", ABOUT_HOVER)
    sections.finish()
    return noise, ratios


def ratio_to_signal(table: TomlTable) -> float | None:
    """Ratio that a table gives, None when it gives none."""
    table.taken.add(RATIO)
    ratio = table.number(RATIO) if table.has(RATIO) else None
    if ratio is not None and ratio < 0.0:
        raise table.wrong(RATIO, "a ratio of zero or more", f"{ratio}")
    return ratio


# -- Rigid body file --

#: What a file of such a flight says of itself.
RIGID_BODY_KIND = "rigid-body"
#: Flights that come with the package.
SHIPPED = ("crazyflie", "quadrotor")
#: Most steps of a flight from a file.
MOST_STEPS = 2_000_000


def read_rigid_body_flight(path: Path) -> RigidBodyFlightSpec:
    """Flight from a file, with the seed zero."""
    return rigid_body_flight_from_table(read_toml(path, "a flight of a rigid body"))


def shipped_rigid_body_flight(name: str) -> RigidBodyFlightSpec:
    """Flight that comes with the package."""
    if name not in SHIPPED:
        raise UsageError(f"a flight out of {', '.join(SHIPPED)}", f"'{name}'", "Name one of them.")
    return read_rigid_body_flight(_FLIGHTS / f"{name}.toml")


def rigid_body_flight_from_table(table: TomlTable) -> RigidBodyFlightSpec:
    """Flight from the top table of a TOML file, all of whose keys it takes."""
    table.choice("kind", (RIGID_BODY_KIND,))
    flight: RigidBodyFlightSpec = built(table, RigidBodyFlightSpec, seed=0)
    if flight.count > MOST_STEPS:
        raise table.wrong("duration", f"{MOST_STEPS} steps or fewer", f"{flight.count}", "Ask for fewer.")
    return flight


# -- Scenario file --

#: Most samples of a record that is simulated from a file.
MOST_SAMPLES = 50_000_000


def read_scenario(path: Path) -> Scenario:
    """Scenario from a file."""
    return scenario_from_table(read_toml(path, "a scenario"))


def shipped_scenarios() -> tuple[str, ...]:
    """Names of the scenarios that come with the package."""
    return tuple(sorted(path.stem for path in _SCENARIOS.glob("*.toml")))


def shipped_scenario(name: str) -> Scenario:
    """Scenario that comes with the package."""
    if name not in shipped_scenarios():
        expected = f"a scenario out of {', '.join(shipped_scenarios())}"
        raise UsageError(expected, f"'{name}'", "Name one of them.")
    return read_scenario(_SCENARIOS / f"{name}.toml")


def scenario_from_table(table: TomlTable) -> Scenario:
    """Scenario from a table of a TOML file, all of whose keys it takes."""
    if table.has("kind") and table.text("kind") != "vertical":
        raise table.wrong("kind", "'vertical'", repr(table.values["kind"]))
    noise, ratios = noises(table, NOISY_CHANNELS)
    known: dict[str, object] = {"noise": noise, "noise_to_signal": ratios, "disturbance_to_signal": None}
    if table.has("disturbance"):
        section = table.section("disturbance")
        known["disturbance_to_signal"] = ratio_to_signal(section)
        known["disturbance"] = of_kind(section, Disturbance)
    table.taken.update({"kind", "disturbance", "noise"})
    scenario: Scenario = built(table, Scenario, samples=sample_count(table, Scenario.samples), **known)
    return scenario


def sample_count(table: TomlTable, default: int) -> int:
    """Samples of a record; default when the table does not say."""
    samples = table.whole("samples", default)
    if samples > MOST_SAMPLES:
        raise table.wrong("samples", f"{MOST_SAMPLES} samples or fewer", f"{samples}", "Ask for fewer.")
    return samples


# -- Study file --


def read_study(path: Path) -> Study:
    """Study from a file."""
    return study_from_table(read_toml(path, "a study"))


def study_from_table(top: TomlTable) -> Study:
    """Study from the top table of a file, all of whose keys it takes."""
    name = top.text("name", Path(top.file).stem)
    runs, seed = top.whole("runs"), top.whole("seed")
    if isinstance(top.values.get("scenario"), str):
        experiment = _experiment(top.neighbour("scenario", "a scenario"))
    else:
        experiment = _experiment(top.section("scenario"))
    choices = tuple(method_choice(table) for table in top.sections("methods"))
    study: Study = built(top, Study, name=name, experiment=experiment, methods=choices, runs=runs, seed=seed)
    return study


def method_choice(table: TomlTable, channel: str = INPUT) -> MethodChoice:
    """Method and its options, from a table all of whose keys it takes."""
    choice: MethodChoice = built(table, MethodChoice, channel=table.text("channel", channel))
    return choice


def _experiment(table: TomlTable) -> Experiment:
    kinds = ("vertical", "difference_equation")
    if not table.has("kind") or table.choice("kind", kinds) == "vertical":
        return VerticalExperiment(scenario_from_table(table))
    noise, ratios = noises(table, (OUTPUT, INPUT))
    table.taken.add("noise")
    known: dict[str, object] = {"noise": noise, "noise_to_signal": ratios}
    equation: DifferenceEquation = built(
        table, DifferenceEquation, samples=sample_count(table, 1000), **known
    )
    return equation
