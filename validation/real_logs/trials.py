"""Trials of the study: flights of a family are flown, logged and identified; a row is what came of one.

A trial is a function of the family and of the flight's number. The recipe is `identify_flight` with its
default options, and with the lag where the family gives it one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from eivor.errors import EivorError
from eivor.flights.options import FlightOptions
from eivor.flights.quantity import Quantity
from eivor.flights.result import FlightEstimate
from eivor.inference.verdict import Status
from eivor.models.separable import Prior
from eivor.motions.identify import identify_flight
from validation.flight_recipe.trials import LOST, QUANTITIES, RECIPE, IntervalEstimate
from validation.real_logs.flights import LoggedFlight, logged_flight
from validation.real_logs.grid import Family, published_grid
from validation.real_logs.named import NAMES, named
from validation.real_logs.own_flights import stream
from validation.real_logs.spec import FlightSpec

#: Flights of a minute that make one task; longer ones count as more.
FLIGHTS_TOGETHER = 10
#: Verdict of a flight that the recipe did not take.
FAILED = "failed"

Row = dict[str, str | float | int | bool]


@dataclass(frozen=True, slots=True)
class Task:
    """Some flights, or pools, of a family."""

    family: str  # Its name
    first: int  # First flight, and the one after the last; of pools likewise
    last: int

    @property
    def file_name(self) -> str:
        """Name of the file that its rows are kept in, without its ending."""
        index = [family.name for family in published_grid().families].index(self.family)
        return f"family-{index + 1:02d}-{self.first:03d}-{self.last:03d}"

    @property
    def facts(self) -> Mapping[str, str]:
        """What that file is sealed with."""
        return {"family": self.family, "flights": f"{self.first} to {self.last - 1}"}

    @property
    def flights(self) -> int:
        """Number of flights, those of pools counted one by one."""
        return (self.last - self.first) * published_grid().family(self.family).pool


def family_tasks(family: Family) -> tuple[Task, ...]:
    """Tasks of a family, in order."""
    size = _together(family)
    return tuple(
        Task(family.name, first, min(first + size, family.count)) for first in range(0, family.count, size)
    )


def _together(family: Family) -> int:
    """Flights, or pools, that take about as long as ten flights of a minute; RotorPy's take as ten."""
    spec = family.flight(0)
    minutes = family.pool * spec.duration / 60.0 * (10.0 if spec.multirotor else 1.0)
    return int(np.clip(round(FLIGHTS_TOGETHER / minutes), 1, FLIGHTS_TOGETHER))


def rows_of(task: Task) -> tuple[Row, ...]:
    """Rows of a task: one for each flight."""
    family = published_grid().family(task.family)
    if family.pool > 1:
        return tuple(row for pool in range(task.first, task.last) for row in _pool_rows(family, pool))
    return tuple(_flight_row(family, number) for number in range(task.first, task.last))


@dataclass(frozen=True)
class _Outcome:
    """What was made of a flight."""

    verdict: str
    truth: Mapping[str, float] = field(default_factory=dict)
    estimates: Mapping[str, IntervalEstimate] = field(default_factory=dict)
    verdicts: Mapping[str, str] = field(default_factory=dict)
    named: Mapping[str, bool] = field(default_factory=dict)
    numbers: Mapping[str, float] = field(default_factory=dict)
    reason: str = ""

    def row(self, family: Family, spec: FlightSpec, number: int) -> Row:
        """Row of the table."""
        row: Row = {
            "class": family.name,
            "number": number,
            "reference": str(spec.reference),
            "gust_rms": spec.vehicle.gust_rms,
            "verdict": self.verdict,
            "reason": self.reason,
        }
        for name in QUANTITIES:
            result = self.estimates.get(name, IntervalEstimate())
            row[f"truth.{name}"] = self.truth.get(name, np.nan)
            row |= {f"{RECIPE}.{name}.{part}": getattr(result, part) for part in ("value", "low", "high")}
            row[f"verdict.{name}"] = self.verdicts.get(name, "")
        row |= {f"named.{name}": self.named.get(name, False) for name in NAMES}
        return row | {
            "recipe.first_stage_F": self.numbers.get("first_stage_F", np.nan),
            "recipe.p_value": self.numbers.get("over_identification_p_value", np.nan),
        }


def _flight_row(family: Family, number: int) -> Row:
    spec = family.flight(number)
    flight = logged_flight(spec)
    if not flight.flown.flew:
        return _Outcome(LOST).row(family, spec, number)
    try:
        result = identify_flight(flight.recording, _options(family, spec))
    except EivorError as error:
        return _Outcome(FAILED, reason=str(error)).row(family, spec, number)
    return _outcome(result, _truth(result, 0, flight), result.quantities).row(family, spec, number)


def _pool_rows(family: Family, pool: int) -> tuple[Row, ...]:
    numbers = range(pool * family.pool, (pool + 1) * family.pool)
    specs = [family.flight(number) for number in numbers]
    flights = [logged_flight(spec) for spec in specs]
    try:
        result = identify_flight([flight.recording for flight in flights])
    except EivorError as error:
        outcomes = [_Outcome(FAILED, reason=str(error))] * family.pool
    else:
        outcomes = [
            _of_member(result, index, _truth(result, index, flight)) for index, flight in enumerate(flights)
        ]
    return tuple(
        outcome.row(family, spec, number)
        for outcome, spec, number in zip(outcomes, specs, numbers, strict=True)
    )


def _of_member(result: FlightEstimate, position: int, truth: Mapping[str, float]) -> _Outcome:
    """Outcome of a flight of a pool: verdict and quantities are its own where the pool has them."""
    if position >= len(result.by_flight):
        return _outcome(result, truth, result.quantities)
    member = result.by_flight[position]
    outcome = _outcome(result, truth, {**result.quantities, **member.quantities})
    against = "" if member.verdict is Status.IDENTIFIED else member.reasons[0]
    return replace(outcome, verdict=member.verdict.value, reason=against)


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


def _truth(result: FlightEstimate, position: int, flight: LoggedFlight) -> dict[str, float]:
    prepared = result.prepared[position]
    return flight.flown.effective(prepared.grid.time_s, prepared.used)


def _outcome(
    result: FlightEstimate, truth: Mapping[str, float], quantities: Mapping[str, Quantity]
) -> _Outcome:
    strengths = [value for name, value in result.diagnostics.items() if name.startswith("first_stage_F")]
    against = result.verdict.reasons
    return _Outcome(
        result.verdict.status.value,
        truth,
        {name: IntervalEstimate(quantities[name].value, *quantities[name].interval) for name in QUANTITIES},
        {name: quantities[name].verdict.value for name in QUANTITIES},
        named(result),
        {"first_stage_F": min(strengths, default=np.nan)}
        | {
            key: result.diagnostics[key]
            for key in ("over_identification_p_value",)
            if key in result.diagnostics
        },
        against[0].sentence if against and result.verdict.status is not Status.IDENTIFIED else "",
    )


def interleaved(families: Sequence[Family]) -> list[Task]:
    """Tasks of all families, so that a run that is cut short has flown the same share of each."""
    tasks = [(task.first / family.count, task) for family in families for task in family_tasks(family)]
    return [task for _, task in sorted(tasks, key=lambda each: each[0])]
