"""A scenario of the study: how its flights are flown and logged, and what is asked of what they tell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from validation.flight_recipe.rotorpy_vehicles import Vehicle


@dataclass(frozen=True, slots=True)
class Asked:
    """What a scenario must reach."""

    # Bounds by group of quantities, relative to the truth: of every error, of the root of their mean square,
    # of the size of their mean
    largest: Mapping[str, float]
    rmse: Mapping[str, float]
    bias: Mapping[str, float]
    coverage_each: float = 0.0  # What each quantity's coverage may be; zero where nothing is asked
    # Between which the coverage of all quantities with a bound lies; empty where nothing is asked
    coverage_pooled: tuple[float, ...] = ()

    @property
    def groups(self) -> tuple[str, ...]:
        """Groups of quantities with a bound, in order."""
        return tuple(dict.fromkeys([*self.largest, *self.rmse, *self.bias]))


@dataclass(frozen=True, slots=True)
class Scenario:
    """Flights of one kind."""

    name: str  # What they are
    seed: int  # Seed of the first flight, and flights of each vehicle
    count: int
    vehicles: tuple[Vehicle, ...]  # What flies
    methods: tuple[str, ...]  # What identifies; the first one is judged
    asked: Asked  # What it must reach
    others: int = 0  # So many flights are identified by methods other than the first
    noise: float = 1.0  # Of the sensors, times the nominal one
    delay_s: float = 0.0  # From a rotor's command to its first effect [s]
    taken_delay_s: float | None = None  # What that is taken for [s]; None where it is searched for
    # Standard deviation of every stamp's error [s]; with it channels are logged out of step
    jitter_s: float = 0.0
    command_hz: float = 0.0  # At which rotor commands are logged [Hz]; all of them where zero
    filtered: bool = False  # Gyroscope and accelerometer have filters onboard
    torque: float = 0.0  # Standard deviation of what the air does about each axis [rad/s^2]
    injected: float = 0.0  # Standard deviation of what is added to the normalised torque setpoints
    quickness: float = 0.6  # Of the controller, see `FlightController`
    derivative_share: float = 0.0
