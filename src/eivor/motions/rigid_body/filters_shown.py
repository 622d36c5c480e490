"""Whether a log has passed the onboard filters that the vehicle file names.

A filter that is named and was not passed makes the model's side late by what the log is not: gains come out
too large and the lag too short, and where no delay is left to make up for it, the references disagree. So
where they do, the flight is identified without each of the named filters, with the same instruments. Filters
without which the references agree far better are told. The vehicle file is one for all flights of a pool, so
that only the longest of them is identified so.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from eivor.errors import EstimationError
from eivor.estimation.estimate import Estimate
from eivor.estimation.fit import identify
from eivor.estimation.methods import by_name
from eivor.flights.prepared import PreparedFlight
from eivor.models.instruments import NoInstruments
from eivor.models.lagged_runs import LaggedRuns
from eivor.motions.rigid_body.flights import rigid_body_problem
from eivor.motions.rigid_body.layout import RotorLayout
from eivor.motions.rigid_body.one_spin import spin_of, with_one_spin

#: Filters that a vehicle file may name, and what they are of.
GYRO, ACCELEROMETER = "gyro_cutoff_hz", "accelerometer_cutoff_hz"
FILTERS = {GYRO: "the gyroscope's", ACCELEROMETER: "the accelerometer's"}
#: References that agree by this p-value need no explanation.
DISAGREE = 0.001
#: Their J must fall to this share of itself without a filter that the log has not passed.
FAR_BETTER = 0.5

_WITH, _WITHOUT = "filters_j", "_left_out_j"


@dataclass(frozen=True, slots=True)
class FiltersNotPassed:
    """Filters of the vehicle file without which the references agree far better.

    Parameters
    ----------
    with_all : float
        J of the references with the filters of the vehicle file.
    without : dict of str to float
        By the key of the vehicle file, J without that filter.
    """

    with_all: float
    without: Mapping[str, float]

    @classmethod
    def of_numbers(cls, numbers: Mapping[str, float]) -> FiltersNotPassed | None:
        """Those of the numbers of a result; None where there are none in them."""
        without = {key: numbers[key + _WITHOUT] for key in FILTERS if key + _WITHOUT in numbers}
        return cls(numbers[_WITH], without) if without else None

    @property
    def numbers(self) -> dict[str, float]:
        """The same as numbers of a result."""
        return {_WITH: self.with_all, **{key + _WITHOUT: J for key, J in self.without.items()}}

    @property
    def sentence(self) -> str:
        """What it says of the vehicle file."""
        which = " and ".join(FILTERS[key] for key in self.without)
        many = len(self.without) > 1
        fall = ", ".join(f"{J:.3g}" for J in self.without.values())
        return (
            f"The log does not look as if it had passed {which} filter{'s' * many} of the vehicle file: "
            f"without {'each' if many else 'it'} the references disagree far less (J {fall} instead of "
            f"{self.with_all:.3g})."
        )

    @property
    def remedy(self) -> str:
        """What to do about it."""
        return f"Take {' and '.join(self.without)} out of the vehicle file where the log is not filtered."


def filters_not_passed(
    problem: LaggedRuns, estimate: Estimate, flights: Sequence[PreparedFlight], layout: RotorLayout
) -> FiltersNotPassed | None:
    """Filters of the vehicle file that flights have not passed; None where nothing says so.

    Parameters
    ----------
    problem : LaggedRuns
        Of the flights, with the filters of the vehicle file.
    estimate : Estimate
        Its solution.
    flights : sequence of PreparedFlight
        The flights; of several the longest is asked.
    layout : RotorLayout
        Of their vehicle.
    """
    named = [key for key in FILTERS if getattr(layout.vehicle, key) is not None]
    if not named or not estimate.best.solved.assembler.needs_instruments:
        return None
    with_all, p_value = estimate.best.inference.over_identification
    if not p_value <= DISAGREE:
        return None
    number = max(range(len(flights)), key=lambda place: flights[place].used_s)
    own = replace(problem, columns=tuple(one for one in problem.columns if one.flight == number))
    if len(flights) > 1:
        with_all = _disagreement(own, estimate.method)
    if not math.isfinite(with_all):
        return None
    others = {key: _without_filter(own, flights[number], layout, key) for key in named}
    found = {key: _disagreement(other, estimate.method) for key, other in others.items()}
    without = {key: J for key, J in found.items() if FAR_BETTER * with_all > J}
    return FiltersNotPassed(with_all, without) if without else None


def _disagreement(problem: LaggedRuns, method: str) -> float:
    """J of the references; infinite where nothing can be identified."""
    try:
        J, _ = identify(problem, by_name(method)).best.inference.over_identification
    except EstimationError:
        return math.inf
    return J


def _without_filter(problem: LaggedRuns, flight: PreparedFlight, layout: RotorLayout, key: str) -> LaggedRuns:
    """The same problem for a vehicle without one of its filters; instruments and nuisances stay."""
    known = layout.vehicle
    unfiltered = (
        replace(known, gyro_cutoff_hz=None) if key == GYRO else replace(known, accelerometer_cutoff_hz=None)
    )
    made, spin = rigid_body_problem((flight,), RotorLayout(unfiltered), NoInstruments()), spin_of(problem)
    if spin is not None:
        made = with_one_spin(made, spin)
    columns = tuple(
        replace(new, instruments=old.instruments)
        for new, old in zip(made.columns, problem.columns, strict=True)
    )
    return replace(problem, columns=columns)
