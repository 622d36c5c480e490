"""Trials of the study: one flight, identified by instruments and, where it is excited, by least squares."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from eivor.inference.verdict import Status
from eivor.motions.identify import identify_flight
from eivor.simulation.rigid_body import RigidBodyFlight, simulate_rigid_body_flights
from validation.kept_study import keep, kept_lines
from validation.rates.flights import VEHICLES, Condition, flight_of
from validation.rates.grid import Grid

INSTRUMENTS, LEAST_SQUARES = "reference_iv", "least_squares"
EFFECTIVENESS = ("roll_effectiveness", "pitch_effectiveness")
LAG = "effective_lag"


@dataclass(frozen=True, slots=True)
class Told:
    """What one identification says of one quantity."""

    vehicle: str  # Names of the cell
    condition: str
    number: int  # Of the flight in its cell
    method: str  # What was asked
    quantity: str
    error: float  # Value less truth: of an effectiveness as a share of the truth, of the lag in seconds
    below: float  # Ends of the interval less the truth, likewise
    above: float
    accepted: bool  # The quantity's verdict is identified

    @property
    def held(self) -> bool:
        """The interval holds the truth."""
        return self.below <= 0.0 <= self.above


def strength_of(flight: RigidBodyFlight, vehicle: str, condition: Condition, number: int) -> Iterator[Told]:
    """Everything that one flight tells, by each method."""
    rotors = VEHICLES[vehicle].rotors
    truth = {
        **dict(zip(EFFECTIVENESS, flight.truth.control_effectiveness[:2], strict=True)),
        LAG: rotors.lag_up + rotors.delay,
    }
    for method in (INSTRUMENTS, LEAST_SQUARES) if condition.steps else (INSTRUMENTS,):
        result = identify_flight(flight.recording, model="rates", method=method)
        for name, true in truth.items():
            quantity, unit = result.quantities[name], 1.0 if name == LAG else true
            low, high = quantity.interval
            yield Told(
                vehicle,
                condition.name,
                number,
                method,
                name,
                (quantity.value - true) / unit,
                (low - true) / unit,
                (high - true) / unit,
                quantity.verdict is Status.IDENTIFIED,
            )


def run(grid: Grid, size: str, kept: Path) -> list[Told]:
    """Run what is left of the study, and return all that its file has."""
    result = read_told(kept)
    done = {(item.vehicle, item.condition, item.number) for item in result}
    for number in range(grid.flights[size]):
        cells = [
            (vehicle, condition)
            for condition in grid.conditions
            for vehicle in VEHICLES
            if (vehicle, condition.name, number) not in done
        ]
        seed = grid.seed + number
        flights = simulate_rigid_body_flights(
            [flight_of(vehicle, condition, grid.seconds, seed) for vehicle, condition in cells]
        )
        for (vehicle, condition), flight in zip(cells, flights, strict=True):
            reported = list(strength_of(flight, vehicle, condition, number))
            result += reported
            keep(kept, reported)
    return result


def read_told(path: Path) -> list[Told]:
    """What a file of the study has."""
    return kept_lines(path, Told)
