"""Combinations that flights identify, formulas over them, ways to the yaw inertia and contradictions."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from eivor.errors import ShapeError
from eivor.estimation.derived import LARGEST_BEND, DerivedQuantity, OfVector, derived_from
from eivor.estimation.estimate import Estimate
from eivor.inference.covariance import CovariancePart, JointCovariance, JointEstimate
from eivor.logs.channel_map import Expression, parse_expression
from eivor.motions.rigid_body.vehicle import NO_BODY_UNCERTAINTY, KnownNumber, KnownVehicle
from eivor.motions.vertical.model import GRAVITY
from eivor.tools import Float, Int

# -- Formulas --

#: What may be supplied, and what stands in sentences for it.
SUPPLIED = {
    "mass": "the mass",
    "arm_scale": "the arm length",
    "speed_scale": "the rotor speed per unit of command",
    "torque_ratio": "the torque ratio",
    "yaw_inertia_ratio": "a ratio of Izz to the mean of Ixx and Iyy",
}


@dataclass(frozen=True)
class Formula:
    """A number by what flights identify and what may be supplied, such as ``mass * drag_x``."""

    text: str
    symbol: str = ""
    unit: str = ""

    @cached_property
    def expression(self) -> Expression:
        """The formula, to evaluate."""
        return parse_expression(self.text, "a formula")

    @cached_property
    def needed(self) -> tuple[str, ...]:
        """Combinations that it takes."""
        return tuple(name for name in self.expression.columns if name not in SUPPLIED)

    @cached_property
    def supplied(self) -> tuple[str, ...]:
        """Numbers that it takes from outside the flight."""
        return tuple(name for name in self.expression.columns if name in SUPPLIED)

    def missing(self, known: KnownVehicle) -> tuple[str, ...]:
        """Those of them that a vehicle lacks."""
        return tuple(name for name in self.supplied if getattr(known, name) is None)


# -- Combinations --


@dataclass(frozen=True)
class Combinations:
    """What a flight identifies of a vehicle, in the order of its names."""

    names: tuple[str, ...]  # Such as ``roll_gain``, see `eivor.motions.rigid_body.physical_parameters`
    candidates: tuple[JointEstimate, ...]  # Vectors that fit, with their covariances

    def __post_init__(self) -> None:
        size = len(self.names)
        for candidate in self.candidates:
            shapes = {part.matrix.shape for part in candidate.covariance.parts}
            if candidate.values.shape != (size,) or shapes != {(size, size)}:
                raise ShapeError(
                    f"vectors and covariances of {size} combinations",
                    f"a vector of {candidate.values.shape} and covariances of {sorted(shapes)}",
                    "Give all in the order of the names.",
                )

    @classmethod
    def of_estimate(cls, estimate: Estimate) -> Combinations:
        """Those of an estimate, under their names in it."""
        return cls(estimate.names, (JointEstimate(estimate.values, estimate.joint_covariance),))

    @classmethod
    def of_values(cls, values: Mapping[str, float], covariance: Float[np.ndarray, "n n"]) -> Combinations:
        """Those of plain numbers."""
        vector = np.array(list(values.values()), dtype=np.float64)
        joint = JointCovariance((CovariancePart("given", covariance),))
        return cls(tuple(values), (JointEstimate(vector, joint),))

    def finite(self) -> Combinations:
        """Those that have a finite value with a finite variance, whatever is assumed."""
        good = np.ones(len(self.names), dtype=bool)
        for candidate in self.candidates:
            for part in candidate.covariance.parts:
                good &= np.isfinite(candidate.values) & np.isfinite(np.diag(part.matrix))
        return self._at(np.flatnonzero(good))

    def only(self, names: Collection[str]) -> Combinations:
        """Those that have one of these names."""
        return self._at(np.flatnonzero([name in names for name in self.names]))

    def _at(self, positions: Int[np.ndarray, " k"]) -> Combinations:
        def some(candidate: JointEstimate) -> JointEstimate:
            parts = candidate.covariance.parts
            kept = (replace(part, matrix=part.matrix[np.ix_(positions, positions)]) for part in parts)
            return JointEstimate(candidate.values[positions], JointCovariance(tuple(kept)))

        return Combinations(
            tuple(self.names[position] for position in positions), tuple(map(some, self.candidates))
        )

    def has(self, *names: str) -> bool:
        """Whether all of these were identified."""
        return set(names) <= set(self.names)

    def positive(self, *names: str, level: float) -> bool:
        """Whether all of these were identified, and are above zero."""
        return self.has(*names) and all(self.interval(name, level)[0] > 0.0 for name in names)

    def interval(self, name: str, level: float) -> tuple[float, float]:
        """Interval of one combination."""
        return self.value(name, level).interval

    def value(
        self,
        formula: str | Formula,
        level: float,
        known: KnownVehicle | None = None,
        largest_bend: float = math.inf,
    ) -> DerivedQuantity:
        """Value of a formula, with an interval that holds the errors of all it is made of."""
        formula = Formula(formula) if isinstance(formula, str) else formula
        numbers: dict[str, KnownNumber] = {name: getattr(known, name) for name in formula.supplied}
        exact = {name: number.value for name, number in numbers.items() if number.std == 0.0}
        uncertain = {name: number for name, number in numbers.items() if number.std > 0.0}
        index = [self.names.index(name) for name in formula.needed]
        best = self.candidates[0]
        errors = np.sqrt(np.maximum(np.diag(best.covariance.matrix), 0.0))
        sizes = np.array(
            [
                *(float(np.hypot(best.values[item], errors[item])) or 1.0 for item in index),
                *(number.value for number in uncertain.values()),
            ]
        )
        order, evaluate = (*formula.needed, *uncertain), formula.expression.evaluate

        def of_vector(values: Float[np.ndarray, " n"]) -> float:
            """In units of the sizes: those of combinations are many powers of ten apart."""
            return float(evaluate(exact | dict(zip(order, values * sizes, strict=True))))

        joint = tuple(
            _part_of(candidate, index, tuple(uncertain.values()), sizes) for candidate in self.candidates
        )
        straight = derived_from(of_vector, joint, level, math.inf)
        if straight.bend <= largest_bend:
            return straight
        return _by_logarithm(of_vector, joint, level) or derived_from(of_vector, joint, level, largest_bend)


def _by_logarithm(
    function: OfVector, joint: tuple[JointEstimate, ...], level: float
) -> DerivedQuantity | None:
    """By the delta method for the logarithm, which products and ratios bend less; None where it bends too."""
    sign = math.copysign(1.0, function(joint[0].values))
    try:
        result = derived_from(lambda values: math.log(sign * function(values)), joint, level, math.inf)
    except ValueError:  # another sign somewhere
        return None
    if not result.bend <= LARGEST_BEND:
        return None
    ends = sorted(sign * math.exp(end) for end in result.interval)
    value = sign * math.exp(result.value)
    return replace(result, value=value, std_error=result.std_error * abs(value), interval=(ends[0], ends[1]))


def _part_of(
    candidate: JointEstimate,
    indices: list[int],
    known: tuple[KnownNumber, ...],
    sizes: Float[np.ndarray, " n"],
) -> JointEstimate:
    """Some combinations of a candidate and what is supplied, in units of their sizes."""
    values = np.append(candidate.values[indices], [number.value for number in known])
    size, parts = len(indices), []
    for part in candidate.covariance.parts:
        matrix = np.zeros((sizes.size, sizes.size))
        matrix[:size, :size] = part.matrix[np.ix_(indices, indices)]
        for index, number in enumerate(known, start=size):
            # what is supplied is no kernel's estimate, of whose variance only a share is seen
            matrix[index, index] = part.share * number.std**2
        parts.append(CovariancePart(part.name, matrix / np.outer(sizes, sizes), part.degrees, part.share))
    return JointEstimate(values / sizes, JointCovariance(tuple(parts)))


def differs_from_zero(interval: tuple[float, float]) -> bool:
    """Whether an interval is finite and does not hold zero."""
    low, high = interval
    return math.isfinite(low) and math.isfinite(high) and low * high > 0.0


# -- Yaw inertia --

#: Couplings determine Izz when the half-width of its interval is at most this share of it.
EXCITED_SHARE = 0.25
TILTING = ("roll_gain", "pitch_gain")
#: Izz over mass, arm and thrust gain: Iyy - beta_1 Ixx, and Ixx + beta_2 Iyy.
BY_COUPLING = {
    "roll_coupling": "(1 / pitch_gain - roll_coupling / roll_gain)",
    "pitch_coupling": "(1 / roll_gain + pitch_coupling / pitch_gain)",
}


@dataclass(frozen=True)
class YawInertiaRoute:
    """A way to Izz."""

    words: str
    per_mass: str  # Izz over the mass [m^2]
    over_thrust: str = ""  # The same over arm and thrust gain; empty where it does not go with them

    def at_hand(self, combinations: Combinations, known: KnownVehicle, level: float) -> bool:
        """Whether all is known to compare it with the other inertias."""
        formula = Formula(f"arm_scale * {self.per_mass}")
        gains = [name for name in formula.needed if name.endswith("_gain")]
        usable = combinations.positive("thrust_gain", *TILTING, *gains, level=level)
        return not formula.missing(known) and usable


def _by_arms(words: str, over_thrust: str) -> YawInertiaRoute:
    return YawInertiaRoute(words, f"arm_scale * thrust_gain * {over_thrust}", over_thrust)


_BY_TORQUE_RATIO = YawInertiaRoute(
    "the torque ratio that was supplied", "torque_ratio * thrust_gain / yaw_gain"
)
_BY_ASSUMPTION = _by_arms(
    "the ratio of Izz to Ixx and Iyy that was supplied, not on the flight",
    "0.5 * yaw_inertia_ratio * (1 / roll_gain + 1 / pitch_gain)",
)


@dataclass(frozen=True)
class YawInertia:
    """What there is to be said of Izz."""

    ratio: DerivedQuantity | None  # Izz / Ixx by the couplings
    routes: tuple[YawInertiaRoute, ...]  # Those that are open, the one to go first


def yaw_inertia(combinations: Combinations, known: KnownVehicle, level: float) -> YawInertia:
    """Ways to Izz that are open; all gains that are taken must be distinguished from zero."""
    tilting = combinations.positive(*TILTING, level=level)
    ratio, routes = None, []
    at_hand = [text for name, text in BY_COUPLING.items() if combinations.has(name)]
    if at_hand and tilting:
        if len(at_hand) == 2:
            share = _weight(combinations, level)
            at_hand = [f"({share!r} * {at_hand[0]} + {1.0 - share!r} * {at_hand[1]})"]
        ratio = combinations.value(f"roll_gain * {at_hand[0]}", level, largest_bend=LARGEST_BEND)
        low, high = ratio.interval
        if differs_from_zero(ratio.interval) and high - low <= 2.0 * EXCITED_SHARE * ratio.value:
            routes.append(_by_arms("the gyroscopic couplings of the flight", at_hand[0]))
    if known.torque_ratio is not None and combinations.positive("yaw_gain", level=level):
        routes.append(_BY_TORQUE_RATIO)

    def relative_width(route: YawInertiaRoute) -> float:
        function = combinations.value(route.per_mass, level, known)
        return (function.interval[1] - function.interval[0]) / function.value

    if len(routes) == 2 and known.arm_scale is not None:
        routes.sort(key=relative_width)
    if not routes and known.yaw_inertia_ratio is not None and tilting:
        routes.append(_BY_ASSUMPTION)
    return YawInertia(ratio, tuple(routes))


def _weight(combinations: Combinations, level: float) -> float:
    """Weight of the first coupling in the combination of both of least variance."""
    first, second = BY_COUPLING.values()
    variance, other, separated = (
        combinations.value(text, level).std_error ** 2 for text in (first, second, f"{first} - {second}")
    )
    return min(max(0.5 * (other - variance + separated) / separated, 0.0), 1.0) if separated > 0.0 else 0.5


# -- Contradictions --

COUPLING_TEXTS = {
    "roll_coupling": "(Iyy - Izz) / Ixx",
    "pitch_coupling": "(Izz - Ixx) / Iyy",
    "yaw_coupling": "(Ixx - Iyy) / Izz",
}
#: Zero for couplings of one body.
IDENTITY = "roll_coupling + pitch_coupling + yaw_coupling + roll_coupling * pitch_coupling * yaw_coupling"
AXES = ("Ixx", "Iyy", "Izz")
#: Pure numbers are equal within rounding.
ROUNDING = 1e-9
#: There are several ways to contradict, and most flights do in none.
SURE = 0.999
#: Weight over the square of the arms' length: what vehicles have [N/m^2].
WEIGHT_OVER_ARMS = (2.0, 20_000.0)
#: Squared radius of gyration in roll or pitch, over that of the rotors: what vehicles have.
GYRATION = (0.02, 1.5)


def contradictions(
    combinations: Combinations, known: KnownVehicle, yaw: YawInertia, level: float
) -> Iterator[str]:
    """Sentences about what no rigid body has, and about what is supplied and does not fit."""
    level = max(level, SURE)
    yield from _of_couplings(combinations, level)
    if known.arm_scale is not None:
        yield from _of_lengths(combinations, known, known.arm_scale.value * known.arm, level)
    for route in yaw.routes[:1]:
        if route.at_hand(combinations, known, level):
            yield from _of_inertias(combinations, known, route, level)
    for item, other in pairwise(yaw.routes):
        if not all(route.at_hand(combinations, known, level) for route in (item, other)):
            continue
        function = combinations.value(f"{other.per_mass} / ({item.per_mass}) - 1", level, known)
        if differs_from_zero(function.interval) and abs(function.value) > ROUNDING:
            low, high = (100.0 * end for end in function.interval)
            yield f"Izz by {other.words} is {low:+.3g} to {high:+.3g} % off that by {item.words}."


def _of_couplings(combinations: Combinations, level: float) -> Iterator[str]:
    for name, words in COUPLING_TEXTS.items():
        low, high = combinations.interval(name, level) if combinations.has(name) else (0.0, 0.0)
        if low > 1.0 + NO_BODY_UNCERTAINTY or high < -1.0 - NO_BODY_UNCERTAINTY:
            yield f"{name} = {words} is between {low:.3g} and {high:.3g}: no body has one beyond -1 or 1."
    if combinations.has(*COUPLING_TEXTS):
        low, high = combinations.value(IDENTITY, level).interval
        if differs_from_zero((low, high)) and min(abs(low), abs(high)) > ROUNDING:
            yield (
                f"The gyroscopic couplings are not those of one body: beta_1 + beta_2 + beta_3 + beta_1 "
                f"beta_2 beta_3 is between {low:.3g} and {high:.3g} in place of 0."
            )


def _of_lengths(combinations: Combinations, known: KnownVehicle, arm_m: float, level: float) -> Iterator[str]:
    """Mass and inertias that the rotors' distances make those of no vehicle: a wrong unit, most likely."""
    low, high = WEIGHT_OVER_ARMS
    if known.mass is not None:
        loading = known.mass.value * GRAVITY / arm_m**2
        if not low <= loading <= high:
            yield (
                f"With mass and arms as supplied, the weight over the square of an arm would be "
                f"{loading:.2g} N/m^2, where vehicles have {low:g} to {high:g}: check the units of both."
            )
    for turning in ("roll", "pitch"):
        if combinations.positive("thrust_gain", f"{turning}_gain", level=level):
            gyration = f"arm_scale * thrust_gain / {turning}_gain / {known.arm**2!r}"
            ratio = combinations.value(gyration, level, known)
            if ratio.interval[1] < GYRATION[0] or ratio.interval[0] > GYRATION[1]:
                yield (
                    f"With the rotors' distances as supplied the inertia in {turning} would be "
                    f"{ratio.value:.3g} times that of the whole mass at the rotors, where vehicles have "
                    f"{GYRATION[0]:g} to {GYRATION[1]:g}. Check their unit, and the thrust map."
                )


def _of_inertias(
    combinations: Combinations, known: KnownVehicle, route: YawInertiaRoute, level: float
) -> Iterator[str]:
    """Any two inertias are together at least the third."""
    per_mass = [f"arm_scale * thrust_gain / {gain}" for gain in TILTING] + [route.per_mass]
    for symbol, largest in zip(AXES, per_mass, strict=True):
        share = f"({' + '.join(per_mass)} - 2 * ({largest})) / ({per_mass[0]})"  # of Ixx
        if combinations.value(share, level, known).interval[1] < -NO_BODY_UNCERTAINTY:
            others = " and ".join(item for item in AXES if item != symbol)
            yield f"{symbol} is more than {others} together, which no body has; Izz rests on {route.words}."
