"""Inertia from couplings and gains: combinations, yaw inertia and checks."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from eivor.errors import ShapeError
from eivor.estimation.derived import LARGEST_BEND, DerivedQuantity, OfVector, derived_from
from eivor.estimation.estimate import Estimate
from eivor.inference.covariance import CovariancePart, JointCovariance, JointEstimate
from eivor.motions.rigid_body.vehicle import NO_BODY_UNCERTAINTY, KnownNumber, KnownVehicle
from eivor.motions.vertical.model import GRAVITY
from eivor.tools import Float, Int

# -- Combinations --

FormulaFunction = Callable[[Mapping[str, float]], float]


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
        return Combinations(
            tuple(self.names[position] for position in positions),
            tuple(_some_of(candidate, positions) for candidate in self.candidates),
        )

    def has(self, *names: str) -> bool:
        """Whether all of these were identified."""
        return set(names) <= set(self.names)

    def function(
        self,
        formula: FormulaFunction,
        names: tuple[str, ...],
        supplied: Mapping[str, KnownNumber],
        level: float,
        largest_bend: float = LARGEST_BEND,
    ) -> DerivedQuantity:
        """Value of a formula, with an interval that holds the errors of all it is made of."""
        exact = {name: number.value for name, number in supplied.items() if number.std == 0.0}
        known = {name: number for name, number in supplied.items() if number.std > 0.0}
        index = [self.names.index(name) for name in names]
        best = self.candidates[0]
        errors = np.sqrt(np.maximum(np.diag(best.covariance.matrix), 0.0))
        sizes = np.array(
            [
                *(float(np.hypot(best.values[item], errors[item])) or 1.0 for item in index),
                *(number.value for number in known.values()),
            ]
        )
        order = (*names, *known)

        def of_vector(values: Float[np.ndarray, " n"]) -> float:
            """In units of the sizes: those of combinations are many powers of ten apart."""
            return formula(exact | dict(zip(order, (values * sizes).tolist(), strict=True)))

        joint = tuple(
            _part_of(candidate, index, tuple(known.values()), sizes) for candidate in self.candidates
        )
        straight = derived_from(of_vector, joint, level, math.inf)
        if straight.bend <= largest_bend:
            return straight
        return _by_logarithm(of_vector, joint, level) or derived_from(of_vector, joint, level, largest_bend)

    def interval(self, name: str, level: float) -> tuple[float, float]:
        """Interval of one combination."""
        return self.function(lambda v: v[name], (name,), {}, level).interval


def _some_of(joint_estimate: JointEstimate, positions: Int[np.ndarray, " k"]) -> JointEstimate:
    parts = (
        replace(part, matrix=part.matrix[np.ix_(positions, positions)])
        for part in joint_estimate.covariance.parts
    )
    return JointEstimate(joint_estimate.values[positions], JointCovariance(tuple(parts)))


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
TILT_COUPLINGS = ("roll_coupling", "pitch_coupling")
TILTING = ("roll_gain", "pitch_gain")


@dataclass(frozen=True)
class YawInertiaRoute:
    """A way to Izz."""

    words: str
    needed: tuple[str, ...]
    supplied: tuple[str, ...]
    per_mass: FormulaFunction  # Izz over the mass [m^2]
    over_thrust: FormulaFunction | None = None


@dataclass(frozen=True)
class YawInertia:
    """What there is to be said of Izz."""

    couplings: YawInertiaRoute | None
    ratio: DerivedQuantity | None  # Izz / Ixx by them
    routes: tuple[YawInertiaRoute, ...]

    @property
    def route(self) -> YawInertiaRoute | None:
        """The one to go."""
        return self.routes[0] if self.routes else None


def yaw_inertia(combinations: Combinations, known: KnownVehicle, level: float) -> YawInertia:
    """Ways to Izz that are open; all gains that are taken must be distinguished from zero."""
    couplings = _by_couplings(combinations, level)
    ratio = None
    routes = []
    if couplings is not None and couplings.over_thrust is not None:
        over_thrust = couplings.over_thrust
        ratio = combinations.function(lambda v: v["roll_gain"] * over_thrust(v), couplings.needed, {}, level)
        low, high = ratio.interval
        if differs_from_zero(ratio.interval) and high - low <= 2.0 * EXCITED_SHARE * ratio.value:
            routes.append(couplings)
    if known.torque_ratio is not None and _usable(combinations, ("yaw_gain",), level):
        routes.append(_BY_TORQUE_RATIO)
    if len(routes) == 2 and known.arm_scale is not None:
        routes.sort(key=lambda route: _relative_width(route, combinations, known, level))
    if not routes and known.yaw_inertia_ratio is not None and _usable(combinations, TILTING, level):
        routes.append(_BY_ASSUMPTION)
    return YawInertia(couplings, ratio, tuple(routes))


def _relative_width(
    route: YawInertiaRoute, combinations: Combinations, known: KnownVehicle, level: float
) -> float:
    supplied = {name: getattr(known, name) for name in route.supplied}
    function = combinations.function(
        route.per_mass, ("thrust_gain", *route.needed), supplied, level, math.inf
    )
    return (function.interval[1] - function.interval[0]) / function.value


def _usable(combinations: Combinations, names: tuple[str, ...], level: float) -> bool:
    return combinations.has(*names) and all(combinations.interval(name, level)[0] > 0.0 for name in names)


def _by_couplings(combinations: Combinations, level: float) -> YawInertiaRoute | None:
    at_hand = tuple(name for name in TILT_COUPLINGS if combinations.has(name))
    if not at_hand or not _usable(combinations, TILTING, level):
        return None
    names, over_thrust = (
        (*TILTING, *at_hand),
        {"roll_coupling": _by_roll, "pitch_coupling": _by_pitch}[at_hand[0]],
    )
    if len(at_hand) == 2:
        over_thrust = partial(_weighted, _weight(combinations, names, level))
    words = "the gyroscopic couplings of the flight"
    return YawInertiaRoute(words, names, ("arm_scale",), _with_arm(over_thrust), over_thrust)


def _by_roll(v: Mapping[str, float]) -> float:
    """Izz = Iyy - beta_1 Ixx."""
    return 1.0 / v["pitch_gain"] - v["roll_coupling"] / v["roll_gain"]


def _by_pitch(v: Mapping[str, float]) -> float:
    """Izz = Ixx + beta_2 Iyy."""
    return 1.0 / v["roll_gain"] + v["pitch_coupling"] / v["pitch_gain"]


def _weighted(share: float, v: Mapping[str, float]) -> float:
    return share * _by_roll(v) + (1.0 - share) * _by_pitch(v)


def _weight(combinations: Combinations, names: tuple[str, ...], level: float) -> float:
    """Weight of the first of both in their combination of least variance."""
    variance, other, separated = (
        combinations.function(formula, names, {}, level, math.inf).std_error ** 2
        for formula in (_by_roll, _by_pitch, lambda v: _by_roll(v) - _by_pitch(v))
    )
    return min(max(0.5 * (other - variance + separated) / separated, 0.0), 1.0) if separated > 0.0 else 0.5


def _with_arm(over_thrust: FormulaFunction) -> FormulaFunction:
    return lambda v: v["arm_scale"] * v["thrust_gain"] * over_thrust(v)


def _assumed(v: Mapping[str, float]) -> float:
    return 0.5 * v["yaw_inertia_ratio"] * (1.0 / v["roll_gain"] + 1.0 / v["pitch_gain"])


_BY_TORQUE_RATIO = YawInertiaRoute(
    "the torque ratio that was supplied",
    ("yaw_gain",),
    ("torque_ratio",),
    lambda v: v["torque_ratio"] * v["thrust_gain"] / v["yaw_gain"],
)
_BY_ASSUMPTION = YawInertiaRoute(
    "the ratio of Izz to Ixx and Iyy that was supplied, not on the flight",
    TILTING,
    ("arm_scale", "yaw_inertia_ratio"),
    _with_arm(_assumed),
    _assumed,
)


# -- Inertia checks --

COUPLING_TEXTS = {
    "roll_coupling": "(Iyy - Izz) / Ixx",
    "pitch_coupling": "(Izz - Ixx) / Iyy",
    "yaw_coupling": "(Ixx - Iyy) / Izz",
}
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
) -> tuple[str, ...]:
    """Sentences about what no rigid body has, and about what is supplied and does not fit."""
    level = max(level, SURE)
    return (
        *_of_couplings(combinations, level),
        *_of_lengths(combinations, known, level),
        *_of_inertias(combinations, known, yaw, level),
        *_of_routes(combinations, known, yaw, level),
    )


def _of_couplings(combinations: Combinations, level: float) -> Iterator[str]:
    for name, words in COUPLING_TEXTS.items():
        low, high = combinations.interval(name, level) if combinations.has(name) else (0.0, 0.0)
        if low > 1.0 + NO_BODY_UNCERTAINTY or high < -1.0 - NO_BODY_UNCERTAINTY:
            yield f"{name} = {words} is between {low:.3g} and {high:.3g}: no body has one beyond -1 or 1."
    if combinations.has(*COUPLING_TEXTS):
        low, high = combinations.function(_identity, tuple(COUPLING_TEXTS), {}, level, math.inf).interval
        if differs_from_zero((low, high)) and min(abs(low), abs(high)) > ROUNDING:
            yield (
                f"The gyroscopic couplings are not those of one body: beta_1 + beta_2 + beta_3 + beta_1 "
                f"beta_2 beta_3 is between {low:.3g} and {high:.3g} in place of 0."
            )


def _identity(v: Mapping[str, float]) -> float:
    first, second, third = (v[name] for name in COUPLING_TEXTS)
    return first + second + third + first * second * third


def _of_lengths(combinations: Combinations, known: KnownVehicle, level: float) -> Iterator[str]:
    """Mass and inertias that the rotors' distances make those of no vehicle: a wrong unit, most likely."""
    if known.arm_scale is None:
        return
    low, high = WEIGHT_OVER_ARMS
    if known.mass is not None:
        loading = known.mass.value * GRAVITY / (known.arm_scale.value * known.arm) ** 2
        if not low <= loading <= high:
            yield (
                f"With mass and arms as supplied, the weight over the square of an arm would be "
                f"{loading:.2g} N/m^2, where vehicles have {low:g} to {high:g}: check the units of both."
            )
    for turning in ("roll", "pitch"):
        names = ("thrust_gain", f"{turning}_gain")
        if _usable(combinations, names, level):
            formula, supplied = _gyration(names[1], known.arm), {"arm_scale": known.arm_scale}
            ratio = combinations.function(formula, names, supplied, level, math.inf)
            if ratio.interval[1] < GYRATION[0] or ratio.interval[0] > GYRATION[1]:
                yield (
                    f"With the rotors' distances as supplied the inertia in {turning} would be "
                    f"{ratio.value:.3g} times that of the whole mass at the rotors, where vehicles have "
                    f"{GYRATION[0]:g} to {GYRATION[1]:g}. Check their unit, and the thrust map."
                )


def _gyration(gain: str, arm: float) -> FormulaFunction:
    return lambda v: v["arm_scale"] * v["thrust_gain"] / v[gain] / arm**2


def _of_inertias(
    combinations: Combinations, known: KnownVehicle, yaw: YawInertia, level: float
) -> Iterator[str]:
    """Any two inertias are together at least the third."""
    route = yaw.route
    if route is None or not _at_hand(route, combinations, known, level):
        return
    names = tuple(dict.fromkeys(("thrust_gain", *TILTING, *route.needed)))
    supplied = {name: getattr(known, name) for name in ("arm_scale", *route.supplied)}
    for largest, symbol in enumerate(AXES):
        slack = combinations.function(_slack(route, largest), names, supplied, level, math.inf)
        if slack.interval[1] < -NO_BODY_UNCERTAINTY:
            others = " and ".join(item for item in AXES if item != symbol)
            yield f"{symbol} is more than {others} together, which no body has; Izz rests on {route.words}."


def _slack(route: YawInertiaRoute, largest: int) -> FormulaFunction:
    """Share of Ixx by which the sum of the other two is above one of them."""

    def slack(v: Mapping[str, float]) -> float:
        of_gain = v["arm_scale"] * v["thrust_gain"]
        inertias = (of_gain / v["roll_gain"], of_gain / v["pitch_gain"], route.per_mass(v))
        return (sum(inertias) - 2.0 * inertias[largest]) / inertias[0]

    return slack


def _of_routes(
    combinations: Combinations, known: KnownVehicle, yaw: YawInertia, level: float
) -> Iterator[str]:
    """Two ways to Izz that exclude each other."""
    for item, other in pairwise(yaw.routes):
        if not all(_at_hand(route, combinations, known, level) for route in (item, other)):
            continue
        names = tuple(dict.fromkeys(("thrust_gain", *item.needed, *other.needed)))
        supplied = {name: getattr(known, name) for name in (*item.supplied, *other.supplied)}
        separated = partial(_relative_difference, item.per_mass, other.per_mass)
        function = combinations.function(separated, names, supplied, level, math.inf)
        if differs_from_zero(function.interval) and abs(function.value) > ROUNDING:
            low, high = (100.0 * end for end in function.interval)
            yield f"Izz by {other.words} is {low:+.3g} to {high:+.3g} % off that by {item.words}."


def _relative_difference(formula: FormulaFunction, other: FormulaFunction, v: Mapping[str, float]) -> float:
    return other(v) / formula(v) - 1.0


def _at_hand(route: YawInertiaRoute, combinations: Combinations, known: KnownVehicle, level: float) -> bool:
    gains = ("thrust_gain", *TILTING, *(name for name in route.needed if name.endswith("_gain")))
    supplied = all(getattr(known, name) is not None for name in ("arm_scale", *route.supplied))
    return supplied and _usable(combinations, gains, level)
