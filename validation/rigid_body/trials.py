"""Trials of the study: flights are flown, logged and identified; a row is what came of a quantity."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from eivor.errors import EivorError
from eivor.motions.identify import identify_flight
from eivor.motions.rigid_body.motion import RigidBody
from eivor.signals.recording import Recording
from eivor.simulation.rigid_body import RigidBodyFlight, simulate_rigid_body_flights
from validation.flight_recipe.rotorpy_vehicles import Vehicle
from validation.rigid_body.flights import flight_of, jittered, known_vehicle
from validation.rigid_body.grid import Grid, published_grid
from validation.rigid_body.quantities import truth_of
from validation.rigid_body.scenario import Scenario
from validation.study_folder import Row

#: Flights of a task, which are simulated side by side.
FLIGHTS_TOGETHER = 10
#: Verdict of a flight that was lost, or not taken.
LOST, FAILED = "lost", "failed"


@dataclass(frozen=True, slots=True)
class Task:
    """Some flights of a scenario."""

    scenario: str  # Its name
    vehicle: Vehicle  # What flies
    first: int  # First flight, and the one after the last
    last: int

    @property
    def file_name(self) -> str:
        """Name of the file that its rows are kept in, without its ending."""
        index = [scenario.name for scenario in published_grid().scenarios].index(self.scenario)
        return f"scenario-{index + 1:02d}-{self.vehicle}-{self.first:03d}-{self.last:03d}"

    @property
    def facts(self) -> Mapping[str, str]:
        """What that file is sealed with."""
        return {"scenario": self.scenario, "flights": f"{self.vehicle} {self.first} to {self.last - 1}"}

    @property
    def flights(self) -> int:
        """Number of flights."""
        return self.last - self.first


def tasks_of(grid: Grid, share: float = 1.0, word: str = "") -> list[Task]:
    """Tasks of the first flights of scenarios whose name holds a word, an equal share of each first."""
    results = []
    for scenario in grid.scenarios:
        if word not in scenario.name:
            continue
        count = max(1, round(share * scenario.count))
        for vehicle in scenario.vehicles:
            for first in range(0, count, FLIGHTS_TOGETHER):
                task = Task(scenario.name, vehicle, first, min(first + FLIGHTS_TOGETHER, count))
                results.append((first / count, task))
    return [task for _, task in sorted(results, key=lambda each: each[0])]


def rows_of(task: Task) -> tuple[Row, ...]:
    """Rows of a task: one for each flight, method and quantity."""
    grid = published_grid()
    scenario = grid.scenario(task.scenario)
    numbers = range(task.first, task.last)
    specs = [flight_of(task.vehicle, scenario, grid.seconds, number) for number in numbers]
    flights = simulate_rigid_body_flights(specs)
    return tuple(
        row
        for number, flight in zip(numbers, flights, strict=True)
        for row in rows_of_flight(flight, task.vehicle, scenario, number)
    )


def rows_of_flight(
    flight: RigidBodyFlight, vehicle: Vehicle, scenario: Scenario, number: int
) -> Iterator[Row]:
    """Rows of a flight."""
    truth = truth_of(flight.truth.parameters)
    log = jittered(flight.recording, scenario.jitter_s, scenario.seed + number)
    motion = RigidBody(known_vehicle(vehicle, scenario))
    methods = scenario.methods if number < scenario.others else scenario.methods[:1]
    for method in methods:
        reported = _report(log, motion, method) if flight.flew else dict.fromkeys(truth, (*_NOTHING, LOST))
        for name, true in truth.items():
            value, low, high, verdict = reported.get(name, (*_NOTHING, FAILED))
            yield {
                "scenario": scenario.name,
                "vehicle": str(vehicle),
                "number": number,
                "method": method,
                "quantity": name,
                "truth": true,
                "value": value,
                "low": low,
                "high": high,
                "verdict": verdict,
            }


_NOTHING = (np.nan, np.nan, np.nan)


def _report(log: Recording, motion: RigidBody, method: str) -> dict[str, tuple[float, float, float, str]]:
    """Value, interval and verdict of every quantity; nothing of a flight that is not taken."""
    try:
        result = identify_flight(log, model=motion, method=method)
    except EivorError:
        return {}
    return {
        name: (quantity.value, *quantity.interval, quantity.verdict.value)
        for name, quantity in result.quantities.items()
    }
