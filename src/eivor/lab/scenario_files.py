"""Files of scenarios, flights, studies and suites."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from enum import Enum
from functools import lru_cache
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, TypeAlias, Union, get_args, get_origin, get_type_hints

import msgspec

from eivor import checks
from eivor.errors import EivorError, UsageError, did_you_mean
from eivor.lab import disturbances
from eivor.lab.experiments import INPUT, OUTPUT, DifferenceEquation, Experiment, VerticalExperiment
from eivor.lab.records import ABOUT_HOVER, NOISY_CHANNELS, Scenario
from eivor.lab.study import MethodChoice, Study
from eivor.signals import noise as noise_types
from eivor.simulation import excitation
from eivor.simulation.environment import SensorNoise
from eivor.simulation.rigid_body import RigidBodyFlightSpec
from eivor.simulation.vertical import VerticalFlightSpec
from eivor.strict_toml import TomlTable, read_toml

Maker = Callable[..., Any]

NOISES: Mapping[str, Maker] = {
    "white": noise_types.WhiteNoise,
    "fractional": noise_types.FractionalNoise,
    "autoregressive": noise_types.AutoregressiveNoise,
    "heavy_tailed": noise_types.HeavyTailedNoise,
    "rounding": noise_types.RoundingNoise,
}
DISTURBANCES: Mapping[str, Maker] = {
    "paper": disturbances.paper_disturbance,
    "white": excitation.WhiteDisturbance,
    "arma": disturbances.Arma,
    "time_varying_arma": disturbances.TimeVaryingArma,
    "random_coefficient_moving_average": disturbances.RandomCoefficientMovingAverage,
    "threshold_moving_average": disturbances.ThresholdMovingAverage,
    "bilinear": disturbances.Bilinear,
    "garch": disturbances.Garch,
    "variance_switch": disturbances.VarianceSwitch,
    "trend": disturbances.Trend,
    "sinusoids": disturbances.Sinusoids,
    "bounded": disturbances.BoundedAdversary,
    "dryden": excitation.DrydenGust,
    "ornstein_uhlenbeck": disturbances.OrnsteinUhlenbeck,
    "series": disturbances.GivenDisturbance,
    "sum": disturbances.SumOfDisturbances,
}
EXCITATIONS: Mapping[str, Maker] = {
    "paper": excitation.PaperInput,
    "white": excitation.WhiteExcitation,
    "filtered_white": excitation.FilteredWhite,
    "chirp": excitation.Chirp,
    "multisine": excitation.Multisine,
    "pseudo_random_binary": excitation.PseudoRandomBinary,
    "steps": excitation.SteppedExcitation,
    "random_steps": excitation.RandomSteps,
    "series": excitation.GivenSeries,
    "scaled": excitation.ScaledExcitation,
}
#: Kinds by the abstract class that a parameter asks for.
KINDS: Mapping[type, Mapping[str, Maker]] = {
    noise_types.MeasurementNoise: NOISES,
    excitation.Disturbance: DISTURBANCES,
    excitation.Excitation: EXCITATIONS,
}


def of_kind(table: TomlTable, family: type, *handled: str, **known: object) -> Any:
    """Object that a table with a `kind` describes."""
    kinds = KINDS[family]
    kind = table.choose("kind", table.values.get("kind", ""), tuple(kinds))
    return build(table, kinds[kind], "kind", *handled, **known)


def build(table: TomlTable, maker: Maker, *handled: str, **known: object) -> Any:
    """Call a class or function with what the table says of its parameters; see `of_kind`."""
    parameters, values = parameters_of(maker), dict(known)
    remaining = replace(table, values={key: item for key, item in table.values.items() if key not in handled})
    checked = remaining.convert(structure_of(maker, frozenset(known)))
    for name, value in msgspec.structs.asdict(checked).items():
        if value is not msgspec.UNSET:
            values[name] = _value(table, name, value, _required(parameters[name][0]))
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


@lru_cache(maxsize=256)
def structure_of(maker: Maker, known: frozenset[str]) -> type[msgspec.Struct]:
    """Structure of a table whose keys are the parameters of a class or function, but for those known."""
    fields: list[Any] = []
    for name, (annotation, default) in parameters_of(maker).items():
        kind = _key_type(_required(annotation))
        if name not in known and default is inspect.Parameter.empty:
            fields.append((name, kind))
        elif name not in known:
            fields.append((name, kind | msgspec.UnsetType, msgspec.UNSET))
    return msgspec.defstruct(maker.__name__, fields, forbid_unknown_fields=True, kw_only=True)


def _required(annotation: Any) -> Any:
    """A type without None, which a file says by leaving the key out."""
    if get_origin(annotation) in (Union, UnionType):
        return next(option for option in get_args(annotation) if option is not type(None))
    return annotation


#: Types of keys whose values are taken as they are, or as tuples.
_PLAIN: Mapping[Any, Any] = {
    **{kind: kind for kind in (float, int, str, bool)},
    tuple[int, int]: list[int],
    tuple[float, ...]: list[float],
    tuple[int, ...]: list[float],
    tuple[str, ...]: list[str],
    tuple[tuple[float, ...], ...]: list[list[float]],
}


def _key_type(annotation: Any) -> Any:
    """Type of a key; the values of tables are read by themselves."""
    if annotation in _PLAIN:
        return _PLAIN[annotation]
    if isinstance(annotation, type):
        return annotation if issubclass(annotation, Enum) else dict[str, Any]
    return list[dict[str, Any]]


def _value(table: TomlTable, name: str, value: Any, annotation: Any) -> Any:
    """Argument for a parameter, from the value of its key."""
    if annotation == tuple[int, int] and not (len(value) == 2 and value[0] <= value[1]):
        raise table.wrong(name, "[first, last], both whole numbers", repr(value))
    if annotation == tuple[int, ...] and any(item != round(item) for item in value):
        raise table.wrong(name, "a list of whole numbers", repr(table.values[name]))
    if annotation == tuple[int, ...]:
        return tuple(map(round, value))
    if isinstance(value, dict):
        return _of_table(table.part(name), annotation)
    if isinstance(value, list) and annotation in _PLAIN:
        return tuple(tuple(item) if isinstance(item, list) else item for item in value)
    if isinstance(value, list):
        item = get_args(annotation)[0]
        if not value:
            raise table.wrong(name, f"one table [[{name}]] or more", "none")
        return tuple(_of_table(table.part(f"{name}[{i}]", row), item) for i, row in enumerate(value, start=1))
    return value


def _of_table(table: TomlTable, annotation: Any) -> Any:
    return of_kind(table, annotation) if annotation in KINDS else build(table, annotation)


FLIGHTS, SCENARIOS = (Path(__file__).parent / name for name in ("scenario_flights", "scenarios"))


def shipped_files(*folders: Path) -> dict[str, Path]:
    """Files of the flights and scenarios that come with the package, by their names."""
    every = (path for folder in folders or (FLIGHTS, SCENARIOS) for path in sorted(folder.glob("*.toml")))
    return {path.stem: path for path in every}


def shipped_file(name: str) -> Path:
    """File of a flight or scenario that comes with the package."""
    files = shipped_files()
    if name in files:
        return files[name]
    expected = "a scenario file that ends in .toml, or one of " + ", ".join(sorted(files))
    raise UsageError(expected, f"'{name}'", did_you_mean(name, files, "Check the name."))


def flight_from_table(table: TomlTable) -> VerticalFlightSpec:
    """Flight from the top table of a TOML file, all of whose keys it takes."""
    table.choose("kind", table.values.get("kind", ""), ("flight",))
    known: dict[str, object] = {"seed": 0}
    if "noise" in table.values:
        known["noise"] = build(table.part("noise"), SensorNoise)
    return build(table, VerticalFlightSpec, "kind", "noise", **known)


#: Key of a noise or a disturbance whose size is a share of a signal's.
RATIO = "ratio_to_signal"


def noises(
    table: TomlTable, channels: tuple[str, ...]
) -> tuple[dict[str, noise_types.MeasurementNoise], dict[str, float]]:
    """Noise of each channel, and the ratio of those that are measured by their signal."""
    noise: dict[str, noise_types.MeasurementNoise] = {}
    ratios: dict[str, float] = {}
    if "noise" not in table.values:
        return noise, ratios
    sections = table.part("noise")
    if "specific_force_z" in sections.values and "acceleration_z" in channels:
        expected = f"noise of {', '.join(channels)}"
        raise sections.wrong("", expected, "noise of 'specific_force_z'", ABOUT_HOVER)
    fields: list[Any] = [(name, dict[str, Any] | msgspec.UnsetType, msgspec.UNSET) for name in channels]
    sections.convert(msgspec.defstruct("Noise", fields, forbid_unknown_fields=True))
    for name in filter(sections.values.__contains__, channels):
        section = sections.part(name)
        ratio = section.convert(_Ratio).ratio_to_signal
        if (ratio is None) != ("std" in section.values):
            received = "neither" if ratio is None else "both"
            raise section.wrong("", f"std or {RATIO}", received, "Give one of them.")
        # The std of a ratio follows from the signal; until then any will do.
        std = {} if ratio is None else {"std": 1.0}
        noise[name] = of_kind(section, noise_types.MeasurementNoise, RATIO, **std)
        ratios |= {} if ratio is None else {name: ratio}
    return noise, ratios


class _Ratio(msgspec.Struct):
    ratio_to_signal: Annotated[float, msgspec.Meta(ge=0.0)] | None = None


MOST_STEPS = 2_000_000


def shipped_rigid_body_flight(name: str) -> RigidBodyFlightSpec:
    """Flight of all axes that comes with the package, with the seed zero."""
    checks.index_of("a flight", name, ("crazyflie", "quadrotor"))
    return rigid_body_flight_from_table(read_toml(shipped_file(name), "a flight of a rigid body"))


def rigid_body_flight_from_table(table: TomlTable) -> RigidBodyFlightSpec:
    """Flight from the top table of a TOML file, all of whose keys it takes."""
    table.choose("kind", table.values.get("kind", ""), ("rigid-body",))
    flight: RigidBodyFlightSpec = build(table, RigidBodyFlightSpec, "kind", seed=0)
    if flight.count > MOST_STEPS:
        raise table.wrong("duration", f"{MOST_STEPS} steps or fewer", f"{flight.count}", "Ask for fewer.")
    return flight


MOST_SAMPLES = 50_000_000


def read_scenario(path: Path) -> Scenario:
    """Scenario from a file."""
    return scenario_from_table(read_toml(path, "a scenario"))


def shipped_scenario(name: str) -> Scenario:
    """Return a scenario that comes with the package ("rich" is one); raises UsageError, which names all."""
    checks.text("name", name)
    checks.index_of("a scenario", name, known := shipped_files(SCENARIOS))
    return read_scenario(known[name])


def scenario_from_table(table: TomlTable) -> Scenario:
    """Scenario from a table of a TOML file, all of whose keys it takes."""
    table.choose("kind", table.values.get("kind", "vertical"), ("vertical",))
    noise, ratios = noises(table, NOISY_CHANNELS)
    known: dict[str, object] = {"noise": noise, "noise_to_signal": ratios, "disturbance_to_signal": None}
    if "disturbance" in table.values:
        section = table.part("disturbance")
        known["disturbance_to_signal"] = section.convert(_Ratio).ratio_to_signal
        known["disturbance"] = of_kind(section, excitation.Disturbance, RATIO)
    check_sample_count(table)
    return build(table, Scenario, "kind", "disturbance", "noise", **known)


def check_sample_count(table: TomlTable) -> None:
    """Refuse a record of too many samples."""
    samples = table.values.get("samples")
    if isinstance(samples, int) and samples > MOST_SAMPLES:
        raise table.wrong("samples", f"{MOST_SAMPLES} samples or fewer", f"{samples}", "Ask for fewer.")


#: Whatever a file may describe to be simulated, and what reads each kind.
Simulated: TypeAlias = Scenario | VerticalFlightSpec | RigidBodyFlightSpec
SIMULATED: Mapping[str, Callable[[TomlTable], Simulated]] = {
    "vertical": scenario_from_table,
    "flight": flight_from_table,
    "rigid-body": rigid_body_flight_from_table,
}


def read_study(path: Path) -> Study:
    """Study from a file."""
    return study_from_table(read_toml(path, "a study"))


class _StudyFile(msgspec.Struct):
    runs: int
    seed: int
    scenario: str | dict[str, Any]
    methods: list[dict[str, Any]]
    name: str = ""


def study_from_table(top: TomlTable) -> Study:
    """Study from the top table of a file, all of whose keys it takes."""
    given = top.convert(_StudyFile)
    is_file = isinstance(given.scenario, str)
    scenario = top.neighbour(str(given.scenario), "a scenario") if is_file else top.part("scenario")
    experiment = _experiment(scenario)
    tables = (top.part(f"methods[{i}]", item) for i, item in enumerate(given.methods, start=1))
    name, choices = given.name or Path(top.file).stem, tuple(map(method_choice, tables))
    if not choices:
        raise top.wrong("methods", "one table [[methods]] or more", "none")
    handled = ("scenario", "methods", "name")
    return build(top, Study, *handled, name=name, experiment=experiment, methods=choices)


def method_choice(table: TomlTable, channel: str = INPUT) -> MethodChoice:
    """Method and its options, from a table all of whose keys it takes."""
    known = {} if "channel" in table.values else {"channel": channel}
    return build(table, MethodChoice, **known)


def _experiment(table: TomlTable) -> Experiment:
    kinds = ("vertical", "difference_equation")
    if table.choose("kind", table.values.get("kind", "vertical"), kinds) == "vertical":
        return VerticalExperiment(scenario_from_table(table))
    noise, ratios = noises(table, (OUTPUT, INPUT))
    check_sample_count(table)
    known: dict[str, object] = {"noise": noise, "noise_to_signal": ratios}
    return build(table, DifferenceEquation, "kind", "noise", **known)
