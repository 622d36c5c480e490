"""A scenario of the study: how its flights are flown and logged, and what is asked of what they tell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from validation.flight_recipe.rotorpy_vehicles import Vehicle


@dataclass(frozen=True, slots=True)
class Asked:
    """What a scenario must reach.

    Parameters
    ----------
    largest, rmse, bias : mapping of str to float
        Bounds by group of quantities, relative to the truth: of every error, of the root of their mean
        square, of the size of their mean.
    coverage_each : float
        What each quantity's coverage may be; zero where nothing is asked.
    coverage_pooled : tuple of float
        Between which the coverage of all quantities with a bound lies; empty where nothing is asked.
    """

    largest: Mapping[str, float]
    rmse: Mapping[str, float]
    bias: Mapping[str, float]
    coverage_each: float = 0.0
    coverage_pooled: tuple[float, ...] = ()

    @property
    def groups(self) -> tuple[str, ...]:
        """Groups of quantities with a bound, in order."""
        return tuple(dict.fromkeys([*self.largest, *self.rmse, *self.bias]))


@dataclass(frozen=True, slots=True)
class Scenario:
    """Flights of one kind.

    Parameters
    ----------
    name : str
        What they are.
    seed, count : int
        Seed of the first flight, and flights of each vehicle.
    vehicles : tuple of Vehicle
        What flies.
    methods : tuple of str
        What identifies; the first one is judged.
    asked : Asked
        What it must reach.
    others : int
        So many flights are identified by methods other than the first.
    noise : float
        Of the sensors, times the nominal one.
    delay_s : float
        From a rotor's command to its first effect [s].
    taken_delay_s : float or None
        What that is taken for [s]; None where it is searched for.
    jitter_s : float
        Standard deviation of every stamp's error [s]; with it channels are logged out of step.
    command_hz : float
        At which rotor commands are logged [Hz]; all of them where zero.
    filtered : bool
        Gyroscope and accelerometer have filters onboard.
    torque : float
        Standard deviation of what the air does about each axis [rad/s^2].
    injected : float
        Standard deviation of what is added to the normalised torque setpoints.
    quickness, derivative_share : float
        Of the controller, see `FlightController`.
    """

    name: str
    seed: int
    count: int
    vehicles: tuple[Vehicle, ...]
    methods: tuple[str, ...]
    asked: Asked
    others: int = 0
    noise: float = 1.0
    delay_s: float = 0.0
    taken_delay_s: float | None = None
    jitter_s: float = 0.0
    command_hz: float = 0.0
    filtered: bool = False
    torque: float = 0.0
    injected: float = 0.0
    quickness: float = 0.6
    derivative_share: float = 0.0
