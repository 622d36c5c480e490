"""Physical parameters of a vehicle out of the combinations that its flight tells, and of what is supplied.

Combinations go by these names; those that are missing are taken for not identified:

    roll_coupling, pitch_coupling, yaw_coupling     beta_1, beta_2, beta_3
    roll_gain, pitch_gain                           alpha_p, alpha_q [rad/s^2 per m (or arm) and unit of phi]
    yaw_gain                                        alpha_r [rad/s^2 per unit of phi]
    roll_offset, pitch_offset                       of sum phi in p' and in q' [rad/s^2 per unit of phi]
    roll_damping, pitch_damping, yaw_damping        d_p, d_q, d_r [1/s]
    rotor_reaction                                  j [rad/s per unit of command]
    thrust_gain                                     alpha_z [m/s^2 per unit of phi]
    drag_x, drag_y, drag_z                          [1/s]
    quadratic_drag_x, ..._y, ..._z                  c_x, c_y, c_z [1/m]
    translational_lift                              h [1/m]

phi is the thrust map of a rotor's state in the unit of the logged commands.
"""

from __future__ import annotations

from dataclasses import dataclass

from eivor.inference.quantiles import check_level
from eivor.motions.rigid_body.combinations import Combinations
from eivor.motions.rigid_body.inertia_checks import contradictions
from eivor.motions.rigid_body.known_number import KnownNumber
from eivor.motions.rigid_body.known_vehicle import KnownVehicle
from eivor.motions.rigid_body.physical_ways import SUPPLIED, Sought, Way, sought
from eivor.motions.rigid_body.yaw_inertia import yaw_inertia
from eivor.signals.input_map import input_map

#: A torque or force that goes with the motion is none that the air makes.
DRAGS = ("drag_x", "drag_y", "drag_z", "roll_drag", "pitch_drag", "yaw_drag")


@dataclass(frozen=True, slots=True)
class Told:
    """A number with its interval.

    Parameters
    ----------
    symbol, unit : str
        Of what it is; the unit is empty for a pure number.
    value : float
        The estimate.
    std_error : float
        By the delta method.
    interval : tuple of float
        Lowest and highest value; it includes the errors of what is supplied.
    """

    symbol: str
    unit: str
    value: float
    std_error: float
    interval: tuple[float, float]

    def __str__(self) -> str:
        low, high = self.interval
        return f"{self.symbol} = {self.value:.4g} ({low:.4g} to {high:.4g}) {self.unit}".rstrip()


@dataclass(frozen=True, slots=True)
class PhysicalParameter:
    """A physical parameter, or why it is not told.

    Parameters
    ----------
    name, words : str
        For programs, and for people.
    told : Told or None
        Its value; None when the flight and what is supplied do not tell it.
    instead : Told or None
        What they tell of it when its value is not told; None when that is nothing.
    sentence : str
        What the value rests on; or what is missing, and what to supply.
    """

    name: str
    words: str
    told: Told | None
    instead: Told | None
    sentence: str


@dataclass(frozen=True, slots=True)
class PhysicalParameters:
    """All of them, and what speaks against them.

    Parameters
    ----------
    rows : tuple of PhysicalParameter
        In the order in which they are shown.
    contradictions : tuple of str
        Sentences about combinations that no rigid body has, and supplied numbers that do not fit the flight.
    """

    rows: tuple[PhysicalParameter, ...]
    contradictions: tuple[str, ...]

    def __getitem__(self, name: str) -> PhysicalParameter:
        return next(row for row in self.rows if row.name == name)


def physical_parameters(found: Combinations, known: KnownVehicle, level: float = 0.95) -> PhysicalParameters:
    """Physical parameters with intervals, each as far as the flight and what is supplied tell it.

    Parameters
    ----------
    found : Combinations
        Of the flight, see the names above.
    known : KnownVehicle
        What is supplied; its errors count as independent of the flight and of each other.
    level : float
        Confidence level.

    Returns
    -------
    PhysicalParameters
        A row for each parameter. A value is there only when every gain it is made of is told from zero, and
        everything it needs is supplied; else a sentence says what is missing, with the combination that is
        all that can be had.

    Raises
    ------
    UsageError
        When the level is not between 0 and 1.
    """
    check_level(level)
    found = found.finite()
    yaw = yaw_inertia(found, known, level)
    rows = tuple(_row(one, found, known, level) for one in sought(yaw, input_map(known.thrust_map)))
    return PhysicalParameters(rows, contradictions(found, known, yaw, level))


def _row(one: Sought, found: Combinations, known: KnownVehicle, level: float) -> PhysicalParameter:
    fullest = one.ways[0]
    reason, missing = _untold(fullest, found, level), _missing(fullest.supplied, known)
    way = next(
        (way for way in one.ways if not _missing(way.supplied, known) and not _untold(way, found, level)),
        None,
    )
    number = None if way is None else _told(way, found, known, level)
    if number is not None and way is fullest and not one.refusal:
        return PhysicalParameter(one.name, one.words, number, None, _basis(one, number, fullest))
    left = "" if number is None else f"{number} is all that the flight gives"
    if one.refusal:
        told = [one.refusal, f"{left}." if left else reason, _remedy(_missing(one.helps, known), " or ")]
    elif reason:
        told = [reason, f"{left}." if left else ""]
    else:
        told = [f"{left} without {_listed(missing, ' and ')}.", _remedy(missing, " and ")]
    sentence = " ".join(part for part in told if part)
    return PhysicalParameter(one.name, one.words, None, number, sentence)


def _told(way: Way, found: Combinations, known: KnownVehicle, level: float) -> Told:
    supplied: dict[str, KnownNumber] = {name: getattr(known, name) for name in way.supplied}
    quantity = found.function(way.formula, way.found, supplied, level)
    return Told(way.symbol, way.unit, quantity.value, quantity.std_error, quantity.interval)


def _missing(names: tuple[str, ...], known: KnownVehicle) -> tuple[str, ...]:
    return tuple(name for name in names if getattr(known, name) is None)


def _untold(way: Way, found: Combinations, level: float) -> str:
    """Why the flight does not tell what a formula takes; empty when it does."""
    absent = [name for name in way.found if not found.has(name)]
    if absent:
        return f"The flight tells no {', no '.join(absent)}."
    for name in way.found:
        low, high = found.interval(name, level) if name.endswith("_gain") else (1.0, 1.0)
        if high < 0.0:
            return f"{name} is below zero: positions, order or spins of the rotors contradict the flight."
        if low <= 0.0:
            return f"The flight does not tell {name} from zero."
    return ""


def _basis(one: Sought, number: Told, way: Way) -> str:
    """What a value rests on, and what is strange about it."""
    told = [one.remark]
    if way.supplied:
        told.append(f"With {_listed(way.supplied, ' and ')} as supplied.")
    if one.name in DRAGS and number.interval[1] < 0.0:
        told.append("Below zero: a disturbance that goes with the motion, such as wind, not the air's drag.")
    return " ".join(part for part in told if part)


def _remedy(names: tuple[str, ...], joint: str) -> str:
    return f"Supply {_listed(names, joint)}." if names else ""


def _listed(names: tuple[str, ...], joint: str) -> str:
    *others, last = (SUPPLIED[name] for name in names)
    return f"{', '.join(others)}{joint}{last}" if others else last
