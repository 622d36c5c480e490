"""Physical parameters of the rigid body and the formulas that give them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from eivor.inference.distributions import check_level
from eivor.motions.rigid_body.inertia import (
    Combinations,
    Formula,
    Route,
    YawInertia,
    contradictions,
    yaw_inertia,
)
from eivor.motions.rigid_body.vehicle import KnownNumber, KnownVehicle
from eivor.signals.thrust_map import InputMap, Mixed, Power, input_map

# -- Formulas of physical parameters --

#: What stands in sentences for a number that may be supplied.
SUPPLIED = {
    "mass": "the mass",
    "arm_scale": "the arm length",
    "speed_scale": "the rotor speed per unit of command",
    "torque_ratio": "the torque ratio",
    "yaw_inertia_ratio": "a ratio of Izz to the mean of Ixx and Iyy",
}


@dataclass(frozen=True)
class Way:
    """A formula for a parameter, or for what is left of it without what it needs."""

    symbol: str
    unit: str
    found: tuple[str, ...]
    supplied: tuple[str, ...]
    formula: Formula


@dataclass(frozen=True)
class Sought:
    """A physical parameter."""

    name: str
    words: str
    ways: tuple[Way, ...]
    remark: str = ""
    refusal: str = ""
    helps: tuple[str, ...] = ()  # Names in `SUPPLIED` of which each would help against that


def sought(yaw: YawInertia, thrust_map: InputMap) -> tuple[Sought, ...]:
    """Every physical parameter that a flight may tell."""
    return (
        _tilting_inertia("xx", "roll"),
        _tilting_inertia("yy", "pitch"),
        _yaw_inertia(yaw),
        *_thrust(thrust_map),
        _torque_ratio(yaw),
        _offset("forward", "x", "pitch", 1.0),
        _offset("left", "y", "roll", -1.0),
        *(
            _per_kilogram(f"drag_{axis}", f"drag along {axis}", f"D_{axis}", "N/(m/s)", "1/s")
            for axis in "xyz"
        ),
        *(
            _per_kilogram(
                f"quadratic_drag_{axis}", f"quadratic drag along {axis}", f"C_{axis}", "N/(m/s)^2", "1/m"
            )
            for axis in "xyz"
        ),
        _per_kilogram("translational_lift", "thrust per squared speed across it", "H", "N/(m/s)^2", "1/m"),
        _tilting_drag("roll", "x"),
        _tilting_drag("pitch", "y"),
        _yaw_drag(yaw.route),
        _rotor_inertia(yaw.route),
    )


def _tilting_inertia(axes: str, turning: str) -> Sought:
    gain, symbol = f"{turning}_gain", f"I{axes}"
    found = ("thrust_gain", gain)

    def per_mass(v: Mapping[str, float]) -> float:
        return v["arm_scale"] * v["thrust_gain"] / v[gain]

    return Sought(
        f"inertia_{axes}",
        f"inertia in {turning}",
        (
            Way(symbol, "kg m^2", found, ("mass", "arm_scale"), lambda v: v["mass"] * per_mass(v)),
            Way(f"{symbol}/m", "m^2", found, ("arm_scale",), per_mass),
            Way(f"{symbol}/(m l)", "m", found, (), lambda v: v["thrust_gain"] / v[gain]),
        ),
    )


def _yaw_inertia(yaw: YawInertia) -> Sought:
    name, words = "inertia_zz", "inertia in yaw"
    left = Way(
        "Izz/(m kappa)", "1/m", ("thrust_gain", "yaw_gain"), (), lambda v: v["thrust_gain"] / v["yaw_gain"]
    )
    route = yaw.route
    if route is None:
        helps = ("torque_ratio", "yaw_inertia_ratio")
        return Sought(name, words, (left,), refusal=_unexcited(yaw), helps=helps)
    found = ("thrust_gain", *route.found)
    ways = [
        Way("Izz", "kg m^2", found, ("mass", *route.supplied), lambda v: v["mass"] * route.per_mass(v)),
        Way("Izz/m", "m^2", found, route.supplied, route.per_mass),
    ]
    if route.over_thrust is not None:
        over_thrust = route.over_thrust
        needs = tuple(one for one in route.supplied if one != "arm_scale")
        ways.append(
            Way("Izz/Ixx", "", ("roll_gain", *route.found), needs, lambda v: v["roll_gain"] * over_thrust(v))
        )
    return Sought(name, words, tuple(ways), f"It rests on {route.words}.")


def _unexcited(yaw: YawInertia) -> str:
    said = "The gyroscopic couplings of the flight do not tell Izz"
    if yaw.ratio is not None:
        low, high = yaw.ratio.interval
        said += f", as it hardly turns about two axes at once (Izz/Ixx is between {low:.3g} and {high:.3g})"
    return f"{said}; yaw torque alone tells only its ratio to the torque ratio."


def _thrust(thrust_map: InputMap) -> tuple[Sought, ...]:
    """Constant of each power of the rotor speed in the thrust."""
    match thrust_map:
        case Mixed(share):
            terms = [(2.0, share), (1.0, 1.0 - share)]
        case Power(exponent):
            terms = [(exponent, 1.0)]
        case _:  # no other map is made by name
            terms = []
    return tuple(_thrust_term(power, share) for power, share in terms if share > 0.0)


def _thrust_term(power: float, share: float) -> Sought:
    named = {
        1.0: ("thrust_linear", "thrust per rotor speed"),
        2.0: ("thrust_quadratic", "thrust per squared rotor speed"),
    }
    name, words = named.get(power, ("thrust_constant", f"thrust per rotor speed to the power {power:g}"))
    speed = "rad/s" if power == 1.0 else f"(rad/s)^{power:g}"
    command = "command" if power == 1.0 else f"command^{power:g}"
    per = f"/({speed})" if power == 1.0 else f"/{speed}"
    found = ("thrust_gain",)

    def per_mass(v: Mapping[str, float]) -> float:
        return share * v["thrust_gain"] / v["speed_scale"] ** power

    return Sought(
        name,
        words,
        (
            Way("k", f"N{per}", found, ("mass", "speed_scale"), lambda v: v["mass"] * per_mass(v)),
            Way("k", f"N/{command}", found, ("mass",), lambda v: v["mass"] * share * v["thrust_gain"]),
            Way("k/m", f"m/s^2{per}", found, ("speed_scale",), per_mass),
            Way("k/m", f"m/s^2/{command}", found, (), lambda v: share * v["thrust_gain"]),
        ),
    )


def _torque_ratio(yaw: YawInertia) -> Sought:
    name, words = "torque_ratio", "reaction torque over thrust"
    left = Way(
        "kappa m/Izz", "1/m", ("yaw_gain", "thrust_gain"), (), lambda v: v["yaw_gain"] / v["thrust_gain"]
    )
    route = next((one for one in yaw.routes if one.over_thrust is not None), None)
    if route is None or route.over_thrust is None:
        return Sought(name, words, (left,), refusal=_unexcited(yaw), helps=("yaw_inertia_ratio",))
    over_thrust = route.over_thrust
    found = ("yaw_gain", *route.found)
    scaled = tuple(one for one in route.supplied if one != "arm_scale")
    return Sought(
        name,
        words,
        (
            Way(
                "kappa", "m", found, route.supplied, lambda v: v["arm_scale"] * v["yaw_gain"] * over_thrust(v)
            ),
            Way("kappa/l", "", found, scaled, lambda v: v["yaw_gain"] * over_thrust(v)),
        ),
        f"It rests on {route.words}.",
    )


def _offset(words: str, axis: str, turning: str, sign: float) -> Sought:
    found = (f"{turning}_offset", f"{turning}_gain")

    def in_lengths(v: Mapping[str, float]) -> float:
        return sign * v[f"{turning}_offset"] / v[f"{turning}_gain"]

    return Sought(
        f"centre_of_mass_{words}",
        f"centre of mass, {words} of the rotors' middle",
        (
            Way(f"{axis}_c", "m", found, ("arm_scale",), lambda v: v["arm_scale"] * in_lengths(v)),
            Way(f"{axis}_c/l", "", found, (), in_lengths),
        ),
    )


def _per_kilogram(name: str, words: str, symbol: str, unit: str, left: str) -> Sought:
    return Sought(
        name,
        words,
        (
            Way(symbol, unit, (name,), ("mass",), lambda v: v["mass"] * v[name]),
            Way(f"{symbol}/m", left, (name,), (), lambda v: v[name]),
        ),
    )


def _tilting_drag(turning: str, axis: str) -> Sought:
    gain, damping = f"{turning}_gain", f"{turning}_damping"
    found = ("thrust_gain", gain, damping)

    def per_mass(v: Mapping[str, float]) -> float:
        return v["arm_scale"] * v[damping] * v["thrust_gain"] / v[gain]

    return _rate_drag(turning, axis, damping, found, ("arm_scale",), per_mass)


def _yaw_drag(route: Route | None) -> Sought:
    if route is None:
        return _rate_drag("yaw", "z", "yaw_damping", (), (), None)
    found = ("thrust_gain", *route.found, "yaw_damping")

    def per_mass(v: Mapping[str, float]) -> float:
        return v["yaw_damping"] * route.per_mass(v)

    return _rate_drag("yaw", "z", "yaw_damping", found, route.supplied, per_mass)


def _rate_drag(
    turning: str,
    axis: str,
    damping: str,
    found: tuple[str, ...],
    supplied: tuple[str, ...],
    per_mass: Formula | None,
) -> Sought:
    """Torque against a rate; without a formula the inertia is missing."""
    symbol = f"B_{axis}"
    left = Way(f"{symbol}/I{axis}{axis}", "1/s", (damping,), (), lambda v: v[damping])
    name, words = f"{turning}_drag", f"torque against {turning}ing"
    if per_mass is None:
        return Sought(name, words, (left,), refusal=_NO_YAW_INERTIA)
    return Sought(
        name,
        words,
        (
            Way(symbol, "N m/(rad/s)", found, ("mass", *supplied), lambda v: v["mass"] * per_mass(v)),
            Way(f"{symbol}/m", "m^2/s", found, supplied, per_mass),
            left,
        ),
    )


def _rotor_inertia(route: Route | None) -> Sought:
    name, words = "rotor_inertia", "inertia of a rotor"
    reaction = "rotor_reaction"
    left = (
        Way("J/Izz", "", (reaction,), ("speed_scale",), lambda v: v[reaction] / v["speed_scale"]),
        Way("J/Izz", "(rad/s)/command", (reaction,), (), lambda v: v[reaction]),
    )
    if route is None:
        return Sought(name, words, left, refusal=_NO_YAW_INERTIA)
    found = ("thrust_gain", *route.found, reaction)

    def per_mass(v: Mapping[str, float]) -> float:
        return v[reaction] * route.per_mass(v) / v["speed_scale"]

    supplied = ("speed_scale", *route.supplied)
    return Sought(
        name,
        words,
        (
            Way("J", "kg m^2", found, ("mass", *supplied), lambda v: v["mass"] * per_mass(v)),
            Way("J/m", "m^2", found, supplied, per_mass),
            *left,
        ),
    )


_NO_YAW_INERTIA = "Izz is not told."


# -- Physical --

#: A torque or force that goes with the motion is none that the air makes.
DRAGS = ("drag_x", "drag_y", "drag_z", "roll_drag", "pitch_drag", "yaw_drag")


@dataclass(frozen=True, slots=True)
class Told:
    """A number with its interval."""

    symbol: str
    unit: str
    value: float
    std_error: float
    interval: tuple[float, float]  # Lowest and highest value

    def __str__(self) -> str:
        low, high = self.interval
        return f"{self.symbol} = {self.value:.4g} ({low:.4g} to {high:.4g}) {self.unit}".rstrip()


@dataclass(frozen=True, slots=True)
class PhysicalParameter:
    """A physical parameter, or why it is not told."""

    name: str
    words: str
    told: Told | None
    instead: Told | None
    sentence: str


@dataclass(frozen=True, slots=True)
class PhysicalParameters:
    """All of them, and what speaks against them."""

    rows: tuple[PhysicalParameter, ...]
    contradictions: tuple[str, ...]

    def __getitem__(self, name: str) -> PhysicalParameter:
        return next(row for row in self.rows if row.name == name)


def physical_parameters(found: Combinations, known: KnownVehicle, level: float = 0.95) -> PhysicalParameters:
    """Physical parameters with intervals, each as far as the flight and what is supplied tell it."""
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
