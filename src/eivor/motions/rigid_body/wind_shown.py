"""Whether a steady wind blew while the air was taken to rest.

The drag along an axis goes with v - R'w, velocities over the ground and of the wind w. While the heading
stays, R'w hardly moves and is an intercept. Where the vehicle yaws, the wind is two columns more, R'e_x and
R'e_y, whose parameters are d w_x and d w_y of both axes across. They are estimated beside the drags across
alone, at the lag that was found.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from eivor.errors import DataError, EstimationError
from eivor.estimation.fit import identify
from eivor.estimation.methods import by_name
from eivor.flights.prepared import PreparedFlight
from eivor.models.equation import Parameter
from eivor.models.lagged_runs import LaggedRuns
from eivor.models.separable import Values
from eivor.motions.rigid_body.body_velocity import on_body_axes
from eivor.motions.rigid_body.parameters import DRAG, FORCE_X, QUADRATIC_DRAG

#: Level of the interval that has to exclude that no wind blew, and the least speed that is told [m/s].
SURE, LEAST_SPEED = 0.999, 0.5
#: What it makes wrong: the drags across.
ACROSS = (*DRAG[:2], *QUADRATIC_DRAG[:2])

_WIND = (Parameter("wind_drag_x", "m/s^2"), Parameter("wind_drag_y", "m/s^2"))


@dataclass(frozen=True, slots=True)
class SteadyWind:
    """A wind that blew in a flight, over its mean and along the axes of the logged velocity.

    Parameters
    ----------
    x, y : float
        Of the air over the ground [m/s].
    """

    x: float
    y: float

    @classmethod
    def of_numbers(cls, numbers: Mapping[str, float]) -> SteadyWind | None:
        """That of the numbers of a result; None where there is none in them."""
        if "steady_wind_x" not in numbers:
            return None
        return cls(numbers["steady_wind_x"], numbers["steady_wind_y"])

    @property
    def numbers(self) -> dict[str, float]:
        """The same as numbers of a result."""
        return {"steady_wind_x": self.x, "steady_wind_y": self.y}

    @property
    def speed(self) -> float:
        """Its speed [m/s]."""
        return math.hypot(self.x, self.y)

    @property
    def sentence(self) -> str:
        """What it says of the drags across."""
        return (
            f"A steady wind of about {self.speed:.2g} m/s seems to have blown, which the drags along x and y "
            "suffer from: velocities count over the ground. Gains, couplings and the lag do not."
        )

    @property
    def remedy(self) -> str:
        """What to do about it."""
        return "Fly in calm air for these drags, or log the velocity through the air."


def steady_wind(problem: LaggedRuns, at: Values, flights: Sequence[PreparedFlight]) -> SteadyWind | None:
    """The strongest wind that a flight shows; None where none does, or no drag across is told.

    Parameters
    ----------
    problem : LaggedRuns
        Of the flights.
    at : mapping of str to float
        Lag and delay that were found.
    flights : sequence of PreparedFlight
        The flights.
    """
    if not set(QUADRATIC_DRAG[:2]) <= set(problem.parameters):
        return None
    found = [_of_flight(problem, at, number, flight) for number, flight in enumerate(flights)]
    return max((one for one in found if one is not None), key=lambda one: one.speed, default=None)


def _of_flight(problem: LaggedRuns, at: Values, number: int, flight: PreparedFlight) -> SteadyWind | None:
    signals = flight.signals
    one, nothing = np.ones(signals.sample_count), np.zeros(signals.sample_count)
    along_x = on_body_axes(signals, one, nothing, nothing)
    along_y = on_body_axes(signals, nothing, one, nothing)
    places = [problem.parameters.index(one) for one in QUADRATIC_DRAG[:2]]
    columns = tuple(
        replace(
            own,
            fixed=np.column_stack([along_x[:, along], along_y[:, along], own.fixed[:, places]]),
            instruments=np.empty((own.fixed.shape[0], 0)),
            moved=(along,),
        )
        for own in problem.columns
        if own.flight == number and (along := own.axis - FORCE_X) in (0, 1)
    )
    known = tuple(one.known_at(at[one.name]) for one in problem.nuisances)
    try:
        told = identify(
            LaggedRuns(columns, (*_WIND, *QUADRATIC_DRAG[:2], *DRAG[:2]), known),
            by_name("whitened_least_squares"),
        )
    except (DataError, EstimationError):  # too short, or a heading that stays
        return None
    drag = 0.5 * sum(told.parameters[one.name] for one in DRAG[:2])
    sure = any(low > 0.0 or high < 0.0 for low, high in (told.interval(one.name, SURE) for one in _WIND))
    if not sure or not drag > 0.0:
        return None
    wind = SteadyWind(*(told.parameters[one.name] / drag for one in _WIND))
    return wind if wind.speed >= LEAST_SPEED else None
