"""Inertia from couplings and gains: combinations, yaw inertia and checks."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from eivor.errors import ShapeError
from eivor.estimation.derived import LARGEST_BEND, DerivedQuantity, OfVector, derived_from, joint_estimates
from eivor.estimation.estimate import Estimate
from eivor.inference.covariance import CovariancePart, JointCovariance, JointEstimate
from eivor.motions.rigid_body.vehicle import NO_BODY_ALLOWANCE, KnownNumber, KnownVehicle
from eivor.motions.vertical.model import GRAVITY
from eivor.tools import Float, Int

# -- Combinations --

Formula = Callable[[Mapping[str, float]], float]


@dataclass(frozen=True)
class Combinations:
    """What a flight tells of a vehicle, in the order of its names."""

    names: tuple[str, ...]  # Such as ``roll_gain``, see `eivor.motions.rigid_body.physical_parameters`
    candidates: tuple[JointEstimate, ...]  # Vectors that fit, with their covariances

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
        """Those of plain numbers."""
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
        """Value of a formula, with an interval that holds the errors of all it is made of."""
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


# -- Yaw inertia --

#: Couplings tell Izz when the half-width of its interval is at most this share of it.
EXCITED_SHARE = 0.25
TILT_COUPLINGS = ("roll_coupling", "pitch_coupling")
TILTING = ("roll_gain", "pitch_gain")


@dataclass(frozen=True)
class Route:
    """A way to Izz."""

    words: str
    found: tuple[str, ...]
    supplied: tuple[str, ...]
    per_mass: Formula  # Izz over the mass [m^2]
    over_thrust: Formula | None = None


@dataclass(frozen=True)
class YawInertia:
    """What there is to be said of Izz."""

    couplings: Route | None
    ratio: DerivedQuantity | None  # Izz / Ixx by them
    routes: tuple[Route, ...]

    @property
    def route(self) -> Route | None:
        """The one to go."""
        return self.routes[0] if self.routes else None


def yaw_inertia(found: Combinations, known: KnownVehicle, level: float) -> YawInertia:
    """Ways to Izz that are open; all gains that are taken must be told from zero."""
    couplings = _by_couplings(found, level)
    ratio = None
    routes = []
    if couplings is not None and couplings.over_thrust is not None:
        over_thrust = couplings.over_thrust
        ratio = found.function(lambda v: v["roll_gain"] * over_thrust(v), couplings.found, {}, level)
        low, high = ratio.interval
        if told_from_zero(ratio.interval) and high - low <= 2.0 * EXCITED_SHARE * ratio.value:
            routes.append(couplings)
    if known.torque_ratio is not None and _usable(found, ("yaw_gain",), level):
        routes.append(_BY_TORQUE_RATIO)
    if len(routes) == 2 and known.arm_scale is not None:
        routes.sort(key=lambda route: _relative_width(route, found, known, level))
    if not routes and known.yaw_inertia_ratio is not None and _usable(found, TILTING, level):
        routes.append(_BY_ASSUMPTION)
    return YawInertia(couplings, ratio, tuple(routes))


def _relative_width(route: Route, found: Combinations, known: KnownVehicle, level: float) -> float:
    supplied = {name: getattr(known, name) for name in route.supplied}
    told = found.function(route.per_mass, ("thrust_gain", *route.found), supplied, level, math.inf)
    return (told.interval[1] - told.interval[0]) / told.value


def _usable(found: Combinations, names: tuple[str, ...], level: float) -> bool:
    return found.has(*names) and all(found.interval(name, level)[0] > 0.0 for name in names)


def _by_couplings(found: Combinations, level: float) -> Route | None:
    at_hand = tuple(name for name in TILT_COUPLINGS if found.has(name))
    if not at_hand or not _usable(found, TILTING, level):
        return None
    names = (*TILTING, *at_hand)
    over_thrust: Formula
    if len(at_hand) == 1:
        over_thrust = _by_roll if at_hand == TILT_COUPLINGS[:1] else _by_pitch
    else:
        over_thrust = _weighted(_weight(found, names, level))
    words = "the gyroscopic couplings of the flight"
    return Route(words, names, ("arm_scale",), _with_arm(over_thrust), over_thrust)


def _by_roll(v: Mapping[str, float]) -> float:
    """Izz = Iyy - beta_1 Ixx."""
    return 1.0 / v["pitch_gain"] - v["roll_coupling"] / v["roll_gain"]


def _by_pitch(v: Mapping[str, float]) -> float:
    """Izz = Ixx + beta_2 Iyy."""
    return 1.0 / v["roll_gain"] + v["pitch_coupling"] / v["pitch_gain"]


def _weighted(share: float) -> Formula:
    return lambda v: share * _by_roll(v) + (1.0 - share) * _by_pitch(v)


def _weight(found: Combinations, names: tuple[str, ...], level: float) -> float:
    """Weight of the first of both in their combination of least variance."""

    def variance(formula: Formula) -> float:
        return found.function(formula, names, {}, level, math.inf).std_error ** 2

    own, other, apart = variance(_by_roll), variance(_by_pitch), variance(_difference)
    return min(max(0.5 * (other - own + apart) / apart, 0.0), 1.0) if apart > 0.0 else 0.5


def _difference(v: Mapping[str, float]) -> float:
    return _by_roll(v) - _by_pitch(v)


def _with_arm(over_thrust: Formula) -> Formula:
    return lambda v: v["arm_scale"] * v["thrust_gain"] * over_thrust(v)


def _assumed(v: Mapping[str, float]) -> float:
    return 0.5 * v["yaw_inertia_ratio"] * (1.0 / v["roll_gain"] + 1.0 / v["pitch_gain"])


_BY_TORQUE_RATIO = Route(
    "the torque ratio that was supplied",
    ("yaw_gain",),
    ("torque_ratio",),
    lambda v: v["torque_ratio"] * v["thrust_gain"] / v["yaw_gain"],
)
_BY_ASSUMPTION = Route(
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
    found: Combinations, known: KnownVehicle, yaw: YawInertia, level: float
) -> tuple[str, ...]:
    """Sentences about what no rigid body has, and about what is supplied and does not fit."""
    level = max(level, SURE)
    return (
        *_of_couplings(found, level),
        *_of_mass(known),
        *_of_lengths(found, known, level),
        *_of_inertias(found, known, yaw, level),
        *_of_routes(found, known, yaw, level),
    )


def _of_couplings(found: Combinations, level: float) -> list[str]:
    told = []
    for name, words in COUPLING_TEXTS.items():
        if found.has(name):
            low, high = found.interval(name, level)
            if low > 1.0 + NO_BODY_ALLOWANCE or high < -1.0 - NO_BODY_ALLOWANCE:
                told.append(
                    f"{name} = {words} is between {low:.3g} and {high:.3g}: no body has one beyond -1 or 1."
                )
    if found.has(*COUPLING_TEXTS):
        sum_of = found.function(_identity, tuple(COUPLING_TEXTS), {}, level, math.inf)
        low, high = sum_of.interval
        if told_from_zero(sum_of.interval) and min(abs(low), abs(high)) > ROUNDING:
            told.append(
                f"The gyroscopic couplings are not those of one body: beta_1 + beta_2 + beta_3 + beta_1 "
                f"beta_2 beta_3 is between {low:.3g} and {high:.3g} in place of 0."
            )
    return told


def _identity(v: Mapping[str, float]) -> float:
    first, second, third = (v[name] for name in COUPLING_TEXTS)
    return first + second + third + first * second * third


def _of_mass(known: KnownVehicle) -> list[str]:
    """A mass that rotors at these distances do not lift: another unit, most likely."""
    if known.mass is None or known.arm_scale is None:
        return []
    loading = known.mass.value * GRAVITY / (known.arm_scale.value * known.arm) ** 2
    low, high = WEIGHT_OVER_ARMS
    if low <= loading <= high:
        return []
    return [
        f"With mass and arms as supplied, the weight over the square of an arm would be {loading:.2g} N/m^2, "
        f"where vehicles have {low:g} to {high:g}: check the units of both."
    ]


def _of_lengths(found: Combinations, known: KnownVehicle, level: float) -> list[str]:
    """Inertias that the rotors' distances make those of no vehicle: a wrong unit, most likely."""
    if known.arm_scale is None:
        return []
    told = []
    for turning in ("roll", "pitch"):
        gain = f"{turning}_gain"
        if not _positive(found, level, "thrust_gain", gain):
            continue
        ratio = found.function(
            _gyration(gain, known.arm), ("thrust_gain", gain), {"arm_scale": known.arm_scale}, level, math.inf
        )
        low, high = ratio.interval
        if high < GYRATION[0] or low > GYRATION[1]:
            told.append(
                f"With the rotors' distances as supplied the inertia in {turning} would be {ratio.value:.3g} "
                f"times that of the whole mass at the rotors, where vehicles have {GYRATION[0]:g} to "
                f"{GYRATION[1]:g}: check their unit, and the thrust map."
            )
    return told


def _gyration(gain: str, arm: float) -> Formula:
    return lambda v: v["arm_scale"] * v["thrust_gain"] / v[gain] / arm**2


def _of_inertias(found: Combinations, known: KnownVehicle, yaw: YawInertia, level: float) -> list[str]:
    """Any two inertias are together at least the third."""
    route = yaw.route
    if route is None or not _at_hand(route, found, known, level):
        return []
    told = []
    names = tuple(dict.fromkeys(("thrust_gain", "roll_gain", "pitch_gain", *route.found)))
    supplied = {name: getattr(known, name) for name in ("arm_scale", *route.supplied)}
    for largest, symbol in enumerate(AXES):
        slack = found.function(_slack(route, largest), names, supplied, level, math.inf)
        if slack.interval[1] < -NO_BODY_ALLOWANCE:
            others = " and ".join(one for one in AXES if one != symbol)
            told.append(
                f"{symbol} is more than {others} together, which no body has; Izz rests on {route.words}."
            )
    return told


def _slack(route: Route, largest: int) -> Formula:
    """Share of Ixx by which the sum of the other two is above one of them."""

    def slack(v: Mapping[str, float]) -> float:
        of_gain = v["arm_scale"] * v["thrust_gain"]
        inertias = (of_gain / v["roll_gain"], of_gain / v["pitch_gain"], route.per_mass(v))
        return (sum(inertias) - 2.0 * inertias[largest]) / inertias[0]

    return slack


def _of_routes(found: Combinations, known: KnownVehicle, yaw: YawInertia, level: float) -> list[str]:
    """Two ways to Izz that exclude each other."""
    told = []
    for one, other in pairwise(yaw.routes):
        if not (_at_hand(one, found, known, level) and _at_hand(other, found, known, level)):
            continue
        names = tuple(dict.fromkeys(("thrust_gain", *one.found, *other.found)))
        supplied = {name: getattr(known, name) for name in (*one.supplied, *other.supplied)}
        apart = found.function(_apart(one.per_mass, other.per_mass), names, supplied, level, math.inf)
        if told_from_zero(apart.interval) and abs(apart.value) > ROUNDING:
            low, high = apart.interval
            told.append(
                f"Izz by {other.words} is {100.0 * low:+.3g} to {100.0 * high:+.3g} % off that by "
                f"{one.words}."
            )
    return told


def _apart(one: Formula, other: Formula) -> Formula:
    return lambda v: other(v) / one(v) - 1.0


def _at_hand(route: Route, found: Combinations, known: KnownVehicle, level: float) -> bool:
    supplied = all(getattr(known, name) is not None for name in ("arm_scale", *route.supplied))
    gains = ("thrust_gain", "roll_gain", "pitch_gain", *(n for n in route.found if n.endswith("_gain")))
    return supplied and _positive(found, level, *gains)


def _positive(found: Combinations, level: float, *names: str) -> bool:
    return found.has(*names) and all(found.interval(name, level)[0] > 0.0 for name in names)
