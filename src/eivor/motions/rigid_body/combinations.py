"""Identified combinations with their joint covariance; functions of them and of what is supplied."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from eivor.errors import ShapeError
from eivor.estimation.derived import (
    LARGEST_BEND,
    DerivedQuantity,
    OfVector,
    derived_from,
    joint_estimates,
)
from eivor.estimation.estimate import Estimate
from eivor.estimation.joint_estimate import JointEstimate
from eivor.inference.covariances.covariance import CovariancePart, JointCovariance
from eivor.motions.rigid_body.known_number import KnownNumber
from eivor.shapes import Float, Int

Formula = Callable[[Mapping[str, float]], float]


@dataclass(frozen=True)
class Combinations:
    """What a flight tells of a vehicle, in the order of its names.

    Parameters
    ----------
    names : tuple of str
        Such as ``roll_gain``, see `eivor.motions.rigid_body.physical`.
    candidates : tuple of JointEstimate
        Vectors that fit, with their covariances; the first is the best.

    Raises
    ------
    ShapeError
        When a vector has another length than the names.
    """

    names: tuple[str, ...]
    candidates: tuple[JointEstimate, ...]

    def __post_init__(self) -> None:
        size = len(self.names)
        for one in self.candidates:
            shapes = {part.matrix.shape for part in one.covariance.parts}
            if one.values.shape != (size,) or shapes != {(size, size)}:
                raise ShapeError(
                    f"vectors and covariances of {size} combinations",
                    f"a vector of {one.values.shape} and covariances of {sorted(shapes)}",
                    "Give all in the order of the names.",
                )

    @classmethod
    def of_estimate(cls, estimate: Estimate, level: float = 0.95) -> Combinations:
        """Those of an estimate, under their names in it."""
        return cls(estimate.names, joint_estimates(estimate, level))

    @classmethod
    def of_values(cls, values: Mapping[str, float], covariance: Float[np.ndarray, "n n"]) -> Combinations:
        """Those of plain numbers.

        Parameters
        ----------
        values : mapping of str to float
            By name.
        covariance : ndarray, shape (n, n)
            In the order of the names.
        """
        vector = np.array(list(values.values()), dtype=np.float64)
        joint = JointCovariance((CovariancePart("given", covariance),))
        return cls(tuple(values), (JointEstimate(vector, joint),))

    def finite(self) -> Combinations:
        """Those that have a finite value with a finite variance, whatever is assumed."""
        good = np.ones(len(self.names), dtype=bool)
        for one in self.candidates:
            for part in one.covariance.parts:
                good &= np.isfinite(one.values) & np.isfinite(np.diag(part.matrix))
        return self._at(np.flatnonzero(good))

    def only(self, names: Collection[str]) -> Combinations:
        """Those that have one of these names."""
        return self._at(np.flatnonzero([name in names for name in self.names]))

    def _at(self, places: Int[np.ndarray, " k"]) -> Combinations:
        return Combinations(
            tuple(self.names[place] for place in places),
            tuple(_some_of(one, places) for one in self.candidates),
        )

    def has(self, *names: str) -> bool:
        """Whether all of these were identified."""
        return set(names) <= set(self.names)

    def function(
        self,
        formula: Formula,
        names: tuple[str, ...],
        supplied: Mapping[str, KnownNumber],
        level: float,
        largest_bend: float = LARGEST_BEND,
    ) -> DerivedQuantity:
        """Value of a formula, with an interval that holds the errors of all it is made of.

        By the delta method where the formula, or its logarithm, is straight over the interval; by the
        profile over the joint ellipsoid (for a ratio that is Fieller's interval) where both bend.

        Parameters
        ----------
        formula : callable
            From the mapping of names to values.
        names : tuple of str
            Combinations that it takes.
        supplied : mapping of str to KnownNumber
            What else it takes; its errors are independent of the flight.
        level : float
            Confidence level.
        largest_bend : float
            Share of the half-width by which the formula may bend before it is profiled.
        """
        exact = {name: number.value for name, number in supplied.items() if number.std == 0.0}
        known = {name: number for name, number in supplied.items() if number.std > 0.0}
        places = [self.names.index(name) for name in names]
        best = self.candidates[0]
        errors = np.sqrt(np.maximum(np.diag(best.covariance.matrix), 0.0))
        sizes = np.array(
            [
                *(float(np.hypot(best.values[place], errors[place])) or 1.0 for place in places),
                *(number.value for number in known.values()),
            ]
        )
        order = (*names, *known)

        def of_vector(values: Float[np.ndarray, " n"]) -> float:
            """In units of the sizes: those of combinations are many powers of ten apart."""
            return formula(exact | dict(zip(order, (values * sizes).tolist(), strict=True)))

        joint = tuple(_part_of(one, places, tuple(known.values()), sizes) for one in self.candidates)
        straight = derived_from(of_vector, joint, level, math.inf)
        if straight.bend <= largest_bend:
            return straight
        return _by_logarithm(of_vector, joint, level) or derived_from(of_vector, joint, level, largest_bend)

    def interval(self, name: str, level: float) -> tuple[float, float]:
        """Interval of one combination."""
        return self.function(lambda v: v[name], (name,), {}, level).interval


def _some_of(one: JointEstimate, places: Int[np.ndarray, " k"]) -> JointEstimate:
    parts = (replace(part, matrix=part.matrix[np.ix_(places, places)]) for part in one.covariance.parts)
    return JointEstimate(one.values[places], JointCovariance(tuple(parts)))


def _by_logarithm(
    function: OfVector, joint: tuple[JointEstimate, ...], level: float
) -> DerivedQuantity | None:
    """By the delta method for the logarithm, which products and ratios bend less; None where it bends too."""
    sign = math.copysign(1.0, function(joint[0].values))
    try:
        found = derived_from(lambda values: math.log(sign * function(values)), joint, level, math.inf)
    except ValueError:  # another sign somewhere
        return None
    if not found.bend <= LARGEST_BEND:
        return None
    ends = sorted(sign * math.exp(end) for end in found.interval)
    value = sign * math.exp(found.value)
    return replace(found, value=value, std_error=found.std_error * abs(value), interval=(ends[0], ends[1]))


def _part_of(
    candidate: JointEstimate,
    places: list[int],
    known: tuple[KnownNumber, ...],
    sizes: Float[np.ndarray, " n"],
) -> JointEstimate:
    """Some combinations of a candidate and what is supplied, in units of their sizes."""
    values = np.append(candidate.values[places], [number.value for number in known])
    size, parts = len(places), []
    for part in candidate.covariance.parts:
        matrix = np.zeros((sizes.size, sizes.size))
        matrix[:size, :size] = part.matrix[np.ix_(places, places)]
        for place, number in enumerate(known, start=size):
            # what is supplied is no kernel's estimate, of whose variance only a share is seen
            matrix[place, place] = part.share * number.std**2
        parts.append(CovariancePart(part.name, matrix / np.outer(sizes, sizes), part.degrees, part.share))
    return JointEstimate(values / sizes, JointCovariance(tuple(parts)))


def told_from_zero(interval: tuple[float, float]) -> bool:
    """Whether an interval is finite and does not hold zero."""
    low, high = interval
    return math.isfinite(low) and math.isfinite(high) and low * high > 0.0
