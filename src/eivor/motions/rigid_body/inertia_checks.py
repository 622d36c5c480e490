"""Whether combinations can be those of one rigid body, and whether supplied numbers fit them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise

from eivor.motions.rigid_body.combinations import Combinations, Formula, told_from_zero
from eivor.motions.rigid_body.known_vehicle import KnownVehicle
from eivor.motions.rigid_body.parameter_ranges import NO_BODY_ALLOWANCE
from eivor.motions.rigid_body.yaw_inertia import Route, YawInertia
from eivor.motions.vertical.model import GRAVITY

COUPLINGS = {
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
    """Sentences about what no rigid body has, and about what is supplied and does not fit.

    Parameters
    ----------
    found : Combinations
        Of the flight.
    known : KnownVehicle
        What is supplied.
    yaw : YawInertia
        What there is to be said of Izz.
    level : float
        Confidence level of the intervals that have to contradict; `SURE` when it is lower.
    """
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
    for name, words in COUPLINGS.items():
        if found.has(name):
            low, high = found.interval(name, level)
            if low > 1.0 + NO_BODY_ALLOWANCE or high < -1.0 - NO_BODY_ALLOWANCE:
                told.append(
                    f"{name} = {words} is between {low:.3g} and {high:.3g}: no body has one beyond -1 or 1."
                )
    if found.has(*COUPLINGS):
        sum_of = found.function(_identity, tuple(COUPLINGS), {}, level, math.inf)
        low, high = sum_of.interval
        if told_from_zero(sum_of.interval) and min(abs(low), abs(high)) > ROUNDING:
            told.append(
                f"The gyroscopic couplings are not those of one body: beta_1 + beta_2 + beta_3 + beta_1 "
                f"beta_2 beta_3 is between {low:.3g} and {high:.3g} in place of 0."
            )
    return told


def _identity(v: Mapping[str, float]) -> float:
    first, second, third = (v[name] for name in COUPLINGS)
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
