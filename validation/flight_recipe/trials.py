"""One trial of the flight study: a flight of the grid, what the recipe and the controls make of it.

The recipe is `identify_flight` with its default options. Two controls must do badly in the same study, or
the study could not tell good from bad: the recipe with the actuator's lag ignored, and nonlinear least
squares, which takes no instruments. They are run on excited flights only.

Truth is the flight's effective parameters over the rows that the recipe used: what an estimator without
any error would give. In the own simulator these are the nominal ones.
"""

from __future__ import annotations

import platform
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from itertools import product
from pathlib import Path
from typing import Literal

import numpy as np
import polars as pl
from jaxtyping import Float

from eivor.atomic_file import atomic_write
from eivor.errors import EivorError, InputError
from eivor.estimation.methods import identify, reference_iv
from eivor.flights.options import FlightOptions
from eivor.flights.result import FlightEstimate
from eivor.models.lagged_runs import lag_and_delay
from eivor.motions.identify import identify_flight
from eivor.motions.vertical.regression import VerticalFlights
from eivor.process_pool import Executor, in_order
from eivor.simulation.environment import SimulatedFlight, TrajectoryKind
from eivor.simulation.vertical import VerticalFlightSpec, simulate_vertical_flights
from validation.drawn import Drawn, Value, Values, check_apart, sensor_noise
from validation.effective_parameters import FlightTruth, effective_parameters, truth_of
from validation.flight_recipe.rotorpy_flight import RotorpyFlightSpec, Vehicle, simulate_rotorpy_flight
from validation.studies import GridStruct, read_as

FlightSpec = VerticalFlightSpec | RotorpyFlightSpec


class FlightClass(GridStruct, frozen=True):
    """Flights of one kind: every combination of values, some times over; what is left open is drawn."""

    name: str
    simulator: Literal["vertical", "rotorpy"]
    kind: Literal["excited", "climbs", "hover", "hover-steps"]  # What they are scored as
    seed: int  # Of the first
    replicates: int
    every: dict[str, Values]
    small_every: int = 0  # The small size flies each n-th
    draw: Drawn = Drawn()


class GridFile(GridStruct, frozen=True, rename={"classes": "class"}):
    name: str
    duration: float  # Of each flight [s]
    calm_up_to: float  # Largest gusts of a calm flight [m/s]
    classes: list[FlightClass]
    vertical: Drawn = Drawn()  # What is drawn in each simulator
    rotorpy: Drawn = Drawn()


@dataclass(frozen=True, slots=True)
class FlightCase:
    name: str  # Class and number in the class
    flight_class: str  # Class
    simulator: str  # Those of its class
    kind: str
    calm: bool  # Excited, with gusts up to the grid's limit
    small: bool  # Flown in the small size too
    spec: FlightSpec  # The flight


@dataclass(frozen=True, slots=True)
class FlightGrid:
    name: str  # Name of the grid
    calm_up_to: float  # Largest gusts of a calm flight [m/s]
    cases: tuple[FlightCase, ...]  # In the order of the file

    def small(self) -> FlightGrid:
        """Return the small size: the flights that the file picks out."""
        return FlightGrid(self.name, self.calm_up_to, tuple(case for case in self.cases if case.small))


def published_grid() -> FlightGrid:
    text = files("validation.flight_recipe").joinpath("grid.toml").read_text(encoding="utf-8")
    return flight_grid(text)


def flight_grid(text: str) -> FlightGrid:
    return grid_of(read_as(GridFile, Path("grid.toml"), text))


def grid_of(file: GridFile) -> FlightGrid:
    cases = tuple(case for entry in file.classes for case in _class_cases(file, entry))
    seeds = [case.spec.seed for case in cases]
    check_apart([case.name for case in cases], [(seed, seed + 1) for seed in seeds])
    return FlightGrid(file.name, file.calm_up_to, cases)


def _class_cases(file: GridFile, entry: FlightClass) -> Iterator[FlightCase]:
    simulated: Drawn = getattr(file, entry.simulator)
    drawn = simulated.draws() | entry.draw.draws()
    combinations = [dict(zip(entry.every, values, strict=True)) for values in product(*entry.every.values())]
    for number, fixed in enumerate(combinations * entry.replicates):
        seed = entry.seed + number
        values = {key: draw.value(seed, key) for key, draw in drawn.items()} | fixed
        spec = _spec(entry, values, seed, file.duration)
        calm = entry.kind == "excited" and spec.gust_rms <= file.calm_up_to
        small = entry.small_every > 0 and number % entry.small_every == 0
        name = f"{entry.name} {number:03d}"
        yield FlightCase(name, entry.name, entry.simulator, entry.kind, calm, small, spec)


def _spec(entry: FlightClass, values: Mapping[str, Value], seed: int, duration: float) -> FlightSpec:
    given = dict(values)
    try:
        noise = sensor_noise(given)
        trajectory = TrajectoryKind(str(given.pop("trajectory")))
        vehicle = {"vehicle": Vehicle(str(given.pop("vehicle")))} if entry.simulator == "rotorpy" else {}
        numbers = {key: float(value) for key, value in given.items()}
        common = {"noise": noise, "trajectory": trajectory, "seed": seed, "duration": duration}
        maker = RotorpyFlightSpec if entry.simulator == "rotorpy" else VerticalFlightSpec
        return maker(**(vehicle | numbers | common))  # type: ignore[arg-type]
    except (KeyError, TypeError, ValueError) as error:
        expected = f"every value of a flight of the simulator '{entry.simulator}', and no other,"
        raise InputError(expected, f"{error!r} in class '{entry.name}'", "Correct the grid.") from error


#: What is scored, and the estimators: the recipe first, then the controls.
QUANTITIES = ("viscous_friction", "input_gain", "effective_lag", "hover_input")
RECIPE, LAG_IGNORED, NONLINEAR = "recipe", "lag_ignored", "least_squares"
ESTIMATORS: Mapping[str, tuple[str, ...]] = {
    RECIPE: QUANTITIES,
    LAG_IGNORED: ("viscous_friction", "input_gain"),
    NONLINEAR: ("viscous_friction", "input_gain", "effective_lag"),
}
#: The joint vector of the recipe.
JOINT = ("viscous_friction", "input_gain", "actuator_lag")
#: Verdict of a flight whose vehicle was lost in the simulator: there is nothing to score.
LOST = "lost"
#: Flights of the own simulator in one task.
FLIGHTS_TOGETHER = 12


#: A number and its 95 % interval, in the quantity's unit; NaN when there is none.
Number = tuple[float, float, float]
NOTHING: Number = (float("nan"), float("nan"), float("nan"))


@dataclass(frozen=True, slots=True)
class FlightTrial:
    """One flight and what was made of it."""

    case: FlightCase  # The flight
    verdict: str  # The recipe's overall verdict, or "lost"
    truth: Mapping[str, float]  # Each of `QUANTITIES`; NaN for a lost flight
    estimates: Mapping[str, Mapping[str, Number]]  # By estimator and quantity, as in `ESTIMATORS`
    # Least conditional first-stage F and the p-value of the over-identification test of the recipe; NaN when
    # it had no instruments
    first_stage: float = float("nan")
    p_value: float = float("nan")


def run_trials(grid: FlightGrid, executor: Executor) -> Iterator[FlightTrial]:
    """Fly and judge every flight of the grid, the own simulator's first."""
    for trials in in_order(executor.map(fly, flown_together(grid))):
        yield from trials


def flown_together(grid: FlightGrid) -> list[tuple[FlightCase, ...]]:
    """Tasks of a grid: flights of the own simulator, which flies them side by side, or one of RotorPy."""
    current = tuple(case for case in grid.cases if isinstance(case.spec, VerticalFlightSpec))
    tasks = [current[first : first + FLIGHTS_TOGETHER] for first in range(0, len(current), FLIGHTS_TOGETHER)]
    return tasks + [(case,) for case in grid.cases if isinstance(case.spec, RotorpyFlightSpec)]


def fly(cases: Sequence[FlightCase]) -> tuple[FlightTrial, ...]:
    specs = [case.spec for case in cases if isinstance(case.spec, VerticalFlightSpec)]
    together = (
        SimulatedFlight(flight.recording, truth_of(spec, flight), flight.flew)
        for spec, flight in zip(specs, simulate_vertical_flights(specs), strict=True)
    )
    return tuple(
        judged(
            case,
            simulate_rotorpy_flight(case.spec)
            if isinstance(case.spec, RotorpyFlightSpec)
            else next(together),
        )
        for case in cases
    )


def judged(case: FlightCase, flight: SimulatedFlight[FlightTruth]) -> FlightTrial:
    """Run the recipe and the controls on a flight and put the truth beside them."""
    nothing = {name: dict.fromkeys(scored, NOTHING) for name, scored in ESTIMATORS.items()}
    if not flight.flew:
        return FlightTrial(case, LOST, dict.fromkeys(QUANTITIES, float("nan")), nothing)
    result = identify_flight(flight.recording)
    estimates = nothing | {RECIPE: _displayed(result, RECIPE)}
    if case.kind == "excited":
        estimates[LAG_IGNORED] = _lag_ignored(result)
        direct = identify_flight(flight.recording, FlightOptions(method="least_squares"))
        estimates[NONLINEAR] = _displayed(direct, NONLINEAR)
    strengths = [result.diagnostics.get(f"first_stage_F_{name}", np.nan) for name in JOINT]
    return FlightTrial(
        case,
        result.verdict.status.value,
        _truth(flight.truth, result),
        estimates,
        float(np.min(strengths)),
        result.diagnostics.get("over_identification_p_value", np.nan)
        if result.instruments != "none"
        else np.nan,
    )


def _displayed(result: FlightEstimate, estimator: str) -> dict[str, Number]:
    quantities = {name: result.quantities[name] for name in ESTIMATORS[estimator]}
    return {name: (quantity.value, *quantity.interval) for name, quantity in quantities.items()}


def _lag_ignored(result: FlightEstimate) -> dict[str, Number]:
    scored = ESTIMATORS[LAG_IGNORED]
    if result.fit is None or not isinstance(result.fit.problem, VerticalFlights):
        return dict.fromkeys(scored, NOTHING)
    problem = replace(result.fit.problem, nuisances=lag_and_delay([0.0], [0.0]))
    try:
        estimate = identify(problem, reference_iv())
    except EivorError:
        return dict.fromkeys(scored, NOTHING)
    return {name: (estimate.parameters[name], *estimate.interval(name)) for name in scored}


def _truth(truth: FlightTruth, result: FlightEstimate) -> dict[str, float]:
    """Effective parameters over the rows that the recipe used; nominal ones where it used none."""
    used = result.prepared[0].used
    rows = np.zeros(truth.time_s.size, dtype=np.bool_)
    rows[: used.size] = used[: rows.size]
    friction, gain = truth.viscous_friction, truth.input_gain
    mapped = truth.hover_input**2
    try:
        effective = effective_parameters(truth, rows, np.square)
    except EivorError:  # A hover so still that its rows tell nothing.
        pass
    else:
        weight = gain * mapped
        friction, gain = effective.viscous_friction, effective.input_gain
        mapped = (weight - effective.intercept) / gain
    return {
        "viscous_friction": friction,
        "input_gain": gain,
        "effective_lag": truth.actuator_lag + truth.delay,
        "hover_input": float(np.sqrt(mapped)),
    }


#: Packages whose versions bear on the numbers.
PACKAGES = ("eivor", "numpy", "scipy", "rotorpy")
#: Significant binary digits of a number, five decimal ones: more would not compress.
MANTISSA_BITS = 17


@dataclass(frozen=True)
class TrialTable:
    """What a run of the study leaves behind."""

    rows: pl.DataFrame  # One row for each flight
    origin: Mapping[str, str]  # `grid`, `size`, and the versions it was made with

    def write(self, path: Path) -> None:
        narrow = self.rows.with_columns(pl.col(_rounded_columns(self.rows)).cast(pl.Float32))
        with atomic_write(path) as file:
            narrow.write_parquet(
                file, compression="zstd", compression_level=19, statistics=False, metadata=dict(self.origin)
            )


def trial_table(trials: Iterable[FlightTrial], *, grid: str, size: str) -> TrialTable:
    origin = {"grid": grid, "size": size, "python": platform.python_version()}
    rows = pl.DataFrame([_row(trial) for trial in trials])
    rounded = rows.with_columns(
        pl.Series(name, _rounded(rows[name].to_numpy())) for name in _rounded_columns(rows)
    )
    return TrialTable(rounded, origin | _versions())


def read_trial_table(path: Path) -> TrialTable:
    try:
        rows, metadata = pl.read_parquet(path), pl.read_parquet_metadata(path)
    except (OSError, pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        raise InputError("a table of trials", f"{path}: {error}", "Make one with --out.") from error
    origin = {key: value for key, value in metadata.items() if not key.startswith("ARROW")}
    if "grid" not in origin or "verdict" not in rows.columns:
        raise InputError("a table of trials", f"{path}, which is another table", "Make one with --out.")
    return TrialTable(rows.with_columns(pl.col(pl.Float32).cast(pl.Float64)), origin)


def _row(trial: FlightTrial) -> dict[str, str | float | int | bool]:
    case = trial.case
    row: dict[str, str | float | int | bool] = {
        "flight": case.name,
        "class": case.flight_class,
        "simulator": case.simulator,
        "kind": case.kind,
        "calm": case.calm,
        "trajectory": str(case.spec.trajectory),
        "noise": str(case.spec.noise.kind),
        "gust_rms": case.spec.gust_rms,
        "delay": case.spec.delay,
        "seed": case.spec.seed,
        "verdict": trial.verdict,
    }
    row |= {f"truth.{name}": trial.truth[name] for name in QUANTITIES}
    row |= {"recipe.first_stage_F": trial.first_stage, "recipe.p_value": trial.p_value}
    for estimator, quantities in ESTIMATORS.items():
        for name in quantities:
            parts = zip(("value", "low", "high"), trial.estimates[estimator][name], strict=True)
            row |= {f"{estimator}.{name}.{part}": number for part, number in parts}
    return row


def _rounded_columns(rows: pl.DataFrame) -> list[str]:
    return [name for name in rows.columns if "." in name]


def _rounded(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Values that the file holds exactly, so that tables are the same before and after it."""
    mantissa, exponent = np.frexp(values)
    scale = 2.0**MANTISSA_BITS
    return np.ldexp(np.round(mantissa * scale) / scale, exponent)


def _versions() -> dict[str, str]:
    results = {}
    for package in PACKAGES:
        try:
            results[package] = version(package)
        except PackageNotFoundError:
            results[package] = "not installed"
    return results
