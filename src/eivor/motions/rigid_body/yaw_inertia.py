"""Ways to the inertia about the vertical axis, which the torque gains alone do not tell.

Its torque is kappa times thrust, so alpha_r = kappa k / Izz holds two unknowns. There are three ways to them:

* the gyroscopic couplings, where the flight turns about two axes at once: beta_1 = (Iyy - Izz) / Ixx and
  beta_2 = (Izz - Ixx) / Iyy give Izz twice, and both are weighted by their errors;
* kappa that was supplied;
* a ratio of Izz to the mean of Ixx and Iyy that was supplied.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from eivor.estimation.derived import DerivedQuantity
from eivor.motions.rigid_body.combinations import Combinations, Formula, told_from_zero
from eivor.motions.rigid_body.known_vehicle import KnownVehicle

#: Couplings tell Izz when the half-width of its interval is at most this share of it.
EXCITED_SHARE = 0.25
COUPLINGS = ("roll_coupling", "pitch_coupling")
TILTING = ("roll_gain", "pitch_gain")


@dataclass(frozen=True)
class Route:
    """A way to Izz.

    Parameters
    ----------
    words : str
        What it rests on, for sentences.
    found : tuple of str
        Combinations that it takes.
    supplied : tuple of str
        What else, apart from the mass.
    per_mass : callable
        Izz over the mass [m^2].
    over_thrust : callable, optional
        Izz over k and the arm's scale, for a way that needs no torque ratio and so tells it.
    """

    words: str
    found: tuple[str, ...]
    supplied: tuple[str, ...]
    per_mass: Formula
    over_thrust: Formula | None = None


@dataclass(frozen=True)
class YawInertia:
    """What there is to be said of Izz.

    Parameters
    ----------
    couplings : Route or None
        By the couplings, when all that it takes was identified, whether it tells Izz or not.
    ratio : DerivedQuantity or None
        Izz / Ixx by them.
    routes : tuple of Route
        Those that tell Izz, the shortest interval first.
    """

    couplings: Route | None
    ratio: DerivedQuantity | None
    routes: tuple[Route, ...]

    @property
    def route(self) -> Route | None:
        """The one to go."""
        return self.routes[0] if self.routes else None


def yaw_inertia(found: Combinations, known: KnownVehicle, level: float) -> YawInertia:
    """Ways to Izz that are open; all gains that are taken must be told from zero.

    Parameters
    ----------
    found : Combinations
        Of the flight.
    known : KnownVehicle
        What is supplied.
    level : float
        Confidence level.
    """
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
    at_hand = tuple(name for name in COUPLINGS if found.has(name))
    if not at_hand or not _usable(found, TILTING, level):
        return None
    names = (*TILTING, *at_hand)
    over_thrust: Formula
    if len(at_hand) == 1:
        over_thrust = _by_roll if at_hand == COUPLINGS[:1] else _by_pitch
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
