"""Trials of the study: flights of a family are flown, logged and identified; a row is what came of one.

A trial is a function of the family and of the flight's number. The recipe is `identify_flight` with its
default options, and with the lag where the family gives it one.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal

import numpy as np
from msgspec import field
from msgspec.structs import replace

from eivor.errors import EivorError, InputError
from eivor.flights.options import FlightOptions
from eivor.flights.quantity import Quantity
from eivor.flights.result import FlightEstimate
from eivor.inference.verdict import Status
from eivor.models.separable import Prior
from eivor.motions.identify import identify_flight
from eivor.motions.vertical.misspecification import MISSED
from validation.drawn import Drawn, Value, check_apart, sensor_noise
from validation.flight_recipe.trials import LOST, QUANTITIES, RECIPE
from validation.real_logs.closed_loop import FlightSpec, Jitter, LoggerSpec, Reference, VehicleSpec, stream
from validation.real_logs.flights import LoggedFlight, logged_flight
from validation.studies import GridStruct, Row, StudyFolder, Task, read_as, tasks_of

#: What is told in sentences.
SENTENCES: dict[str, re.Pattern[str]] = {
    "thrust curve": re.compile(r"thrust grows as the command to the power"),
    "accelerometer late": re.compile(r"accelerometer is [\d.]+ ± [\d.]+ ms behind"),
    "velocity late": re.compile(r"velocity is [\d.]+ ± [\d.]+ ms behind"),
    "velocity reads more": re.compile(r"velocity reads [\d.]+ ?% \(± [\d.]+ ?%\) more than"),
    "velocity reads less": re.compile(r"velocity reads [\d.]+ ?% \(± [\d.]+ ?%\) less than"),
    "tilt error": re.compile(r"Attitude and accelerometer differ by"),
    "sideways": re.compile(r"flew sideways at"),
    "voltage": re.compile(r"battery's voltage fell|No battery voltage is logged"),
    "lag contradicted": re.compile(r"contradicts the flight"),
    "lag from the frictions": re.compile(r"the lag rests on the differences of"),
}
#: Terms that are missed, by the p-value of their test.
TESTS = {
    "drag missed": "left_out_quadratic_drag_p_value",
    "ground missed": "left_out_ground_effect_p_value",
    "supply missed": "left_out_supply_p_value",
}
#: All that may be said.
NAMES = (*SENTENCES, *TESTS)


def named(result: FlightEstimate) -> dict[str, bool]:
    """Say which of `NAMES` a result says, in its sentences, those of its quantities, or its findings."""
    text = "\n".join(_sentences(result))
    results = {name: pattern.search(text) is not None for name, pattern in SENTENCES.items()}
    return results | {name: result.diagnostics.get(key, 1.0) < MISSED for name, key in TESTS.items()}


def _sentences(result: FlightEstimate) -> Iterator[str]:
    yield from result.verdict.sentences
    for quantity in result.quantities.values():
        for reason in quantity.reasons:
            yield f"{reason.sentence} {reason.remedy}"
        yield from (part.sentence for part in quantity.systematic_uncertainties)
    for finding in result.findings:
        yield f"{finding.name}: {finding.message}"


GRID_FILE = "grid.toml"


class Family(GridStruct, frozen=True, rename={"count": "flights"}):
    name: str  # What they are
    seed: int  # First seed, and number of flights; of pools, if they are pooled
    count: int
    holds: Literal["yes", "short", "no"] = "no"  # Whether the model does
    lag_bias: bool = False  # The mean error of the lag must be small
    named: str = ""  # What must be said of them; empty for nothing
    share: float = 1.0  # In which share of them
    given: Literal["", "truth", "wrong"] = ""  # What the recipe is told of the lag
    refused: bool = False  # None of them may be identified
    pool: int = 1  # Flights of a pool; 1 for flights that are judged one by one
    shared: tuple[str, ...] = ()  # What the flights of a pool share
    frequencies: tuple[float, ...] = ()  # Of the references in a pool [Hz], one flight after the other
    fixed: dict[str, Value] = field(default_factory=dict)  # What is the same in all of them
    draw: Drawn = Drawn()  # What differs, and what does in every family
    common: Drawn = Drawn()

    def __post_init__(self) -> None:
        if self.named not in ("", *NAMES):
            raise ValueError(f"expected one of {', '.join(NAMES)}; received '{self.named}'")

    def flight(self, number: int) -> FlightSpec:
        """Specification of a flight; of pools the flights are numbered through."""
        seed = self.seed + number
        first = self.seed + number - number % self.pool
        given = {
            key: draw.value(first if key in self.shared else seed, key)
            for key, draw in (self.common.draws() | self.draw.draws()).items()
        }
        if self.frequencies:
            given["frequency"] = self.frequencies[number % self.pool % len(self.frequencies)]
        return _spec({**given, **self.fixed}, seed)


class Grid(GridStruct, frozen=True, rename={"families": "family"}):
    name: str  # Name of the grid
    lag_given_std: float  # Standard error of a lag that is given [s]
    families: tuple[Family, ...]  # In the order of the file
    draw: Drawn = Drawn()  # In every family
    text: str = ""  # The file

    def family(self, name: str) -> Family:
        return next(family for family in self.families if family.name == name)


@cache
def published_grid() -> Grid:
    return grid_from(files("validation.real_logs").joinpath(GRID_FILE).read_text(encoding="utf-8"))


def grid_from(text: str) -> Grid:
    read = read_as(Grid, Path(GRID_FILE), text)
    families = tuple(replace(family, common=read.draw) for family in read.families)
    seeds = [(family.seed, family.seed + family.count * family.pool) for family in families]
    check_apart([family.name for family in families], seeds)
    for family in families:
        try:
            family.flight(0)
        except (KeyError, TypeError, ValueError) as error:
            wrong = f"{error!r} in family '{family.name}'"
            raise InputError("values of a flight, and no other,", wrong, "Correct the grid.") from error
    return replace(read, families=families, text=text)


def _spec(values: Mapping[str, Value], seed: int) -> FlightSpec:
    given = dict(values)
    noise = sensor_noise(given)
    parts: list[dict[str, Any]] = [
        {
            name: _TYPES.get(name, float)(given.pop(name))
            for name in {field.name for field in fields(kind)} & given.keys()
        }
        for kind in (VehicleSpec, LoggerSpec, FlightSpec)
    ]
    if given:
        raise InputError("keys of a flight", ", ".join(given), "Remove them.")
    vehicle, logger, flight = parts
    return FlightSpec(VehicleSpec(**vehicle), LoggerSpec(**logger, noise=noise), seed=seed, **flight)


#: Quantities that are words, or are on or off.
_TYPES: Mapping[str, Callable[[Any], Any]] = {
    "jitter": Jitter,
    "reference": Reference,
    "multirotor": str,
    "voltage_logged": bool,
    "even_stamps": bool,
}


#: Flights of a minute that make one task; longer ones count as more.
FLIGHTS_TOGETHER = 10
#: Verdict of a flight that the recipe did not take.
FAILED = "failed"


def _together(family: Family) -> int:
    """Flights, or pools, that take about as long as ten flights of a minute; RotorPy's take as ten."""
    spec = family.flight(0)
    minutes = family.pool * spec.duration / 60.0 * (10.0 if spec.multirotor else 1.0)
    return int(np.clip(round(FLIGHTS_TOGETHER / minutes), 1, FLIGHTS_TOGETHER))


def rows_of(task: Task) -> tuple[Row, ...]:
    """Rows of a task: one for each flight."""
    family = published_grid().family(task.of[0])
    if family.pool > 1:
        return tuple(row for pool in range(task.first, task.last) for row in _pool_rows(family, pool))
    return tuple(_flight_row(family, number) for number in range(task.first, task.last))


def _row(
    family: Family,
    number: int,
    verdict: str,
    reason: str = "",
    result: FlightEstimate | None = None,
    quantities: Mapping[str, Quantity] | None = None,
    truth: Mapping[str, float] | None = None,
) -> Row:
    """Row of a flight; without a result of one that was not identified at all."""
    spec, said = family.flight(number), {} if result is None else named(result)
    row: dict[str, str | int | float] = {
        "class": family.name,
        "number": number,
        "reference": str(spec.reference),
        "gust_rms": spec.vehicle.gust_rms,
        "verdict": verdict,
        "reason": reason,
    }
    for name in QUANTITIES:
        quantity = quantities[name] if quantities else None
        ends = (quantity.value, *quantity.interval) if quantity else (np.nan, np.nan, np.nan)
        row[f"truth.{name}"] = truth[name] if truth else np.nan
        row |= {
            f"{RECIPE}.{name}.{part}": end for part, end in zip(("value", "low", "high"), ends, strict=True)
        }
        row[f"verdict.{name}"] = quantity.verdict.value if quantity else ""
    row |= {f"named.{name}": said.get(name, False) for name in NAMES}
    diagnostics = {} if result is None else result.diagnostics
    strengths = [value for name, value in diagnostics.items() if name.startswith("first_stage_F")]
    return row | {
        "recipe.first_stage_F": min(strengths, default=np.nan),
        "recipe.p_value": diagnostics.get("over_identification_p_value", np.nan),
    }


def _flight_row(family: Family, number: int) -> Row:
    spec = family.flight(number)
    flight = logged_flight(spec)
    if not flight.flown.flew:
        return _row(family, number, LOST)
    try:
        result = identify_flight(flight.recording, _options(family, spec))
    except EivorError as error:
        return _row(family, number, FAILED, str(error))
    return _identified_row(family, number, result, 0, flight)


def _pool_rows(family: Family, pool: int) -> tuple[Row, ...]:
    numbers = range(pool * family.pool, (pool + 1) * family.pool)
    flights = [logged_flight(family.flight(number)) for number in numbers]
    try:
        result = identify_flight([flight.recording for flight in flights])
    except EivorError as error:
        return tuple(_row(family, number, FAILED, str(error)) for number in numbers)
    return tuple(
        _identified_row(family, number, result, position, flight)
        for position, (number, flight) in enumerate(zip(numbers, flights, strict=True))
    )


def _identified_row(
    family: Family, number: int, result: FlightEstimate, position: int, flight: LoggedFlight
) -> Row:
    """Row of a flight, or of one of a pool: verdict and quantities are its own where the pool has them."""
    prepared = result.prepared[position]
    truth = flight.flown.effective(prepared.grid.time_s, prepared.used)
    if any(finding.name == "command_rate_limit" for finding in prepared.findings):
        truth["effective_lag"] = flight.flown.truth.actuator_lag + flight.flown.truth.delay
    if family.pool > 1 and position < len(result.by_flight):
        member = result.by_flight[position]
        status, quantities = member.verdict, {**result.quantities, **member.quantities}
        against = member.reasons[:1]
    else:
        status, quantities = result.verdict.status, dict(result.quantities)
        against = tuple(reason.sentence for reason in result.verdict.reasons[:1])
    reason = "" if status is Status.IDENTIFIED or not against else against[0]
    return _row(family, number, status.value, reason, result, quantities, truth)


def _options(family: Family, spec: FlightSpec) -> FlightOptions:
    """What the recipe is told: nothing, or a lag with an error as large as it is said to be, or larger."""
    if not family.given:
        return FlightOptions()
    std = published_grid().lag_given_std
    true, draw = spec.vehicle.actuator_lag + spec.vehicle.delay, stream(spec, "given lag")
    if family.given == "wrong":
        off = 4.0 * std
        return FlightOptions(
            lag=Prior(true - off if draw.random() < 0.5 and true > off + std else true + off, std)
        )
    return FlightOptions(lag=Prior(max(true + std * draw.standard_normal(), 0.1 * std), std))


def folder_of(path: Path, grid: Grid) -> StudyFolder:
    planned = sum(family.count * family.pool for family in grid.families)
    numbers = {family.name: number for number, family in enumerate(published_grid().families, start=1)}
    tasks = [
        task
        for each in grid.families
        for task in tasks_of(
            (each.name,), f"family-{numbers[each.name]:02d}", each.count, _together(each), each.pool
        )
    ]
    return StudyFolder(path, tasks, grid.name, grid.text, "validation.real_logs", planned, rows_of)
