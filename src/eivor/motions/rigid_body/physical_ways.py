"""From combinations to physical parameters: for each the formulas that serve, the fullest first.

Notation: k thrust per unit of phi, l what all positions have to be multiplied by, m mass, w rotor speed per
unit of command. A flight shows alpha_z = k / m, alpha_p = k l / Ixx, alpha_q = k l / Iyy, and
alpha_r = kappa k / Izz. What has m, l or w in it cannot be had without them, and the next formula of a row
is what can.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from eivor.motions.rigid_body.combinations import Formula
from eivor.motions.rigid_body.yaw_inertia import Route, YawInertia
from eivor.signals.input_map import InputMap, Mixed, Power

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
    """A formula for a parameter, or for what is left of it without what it needs.

    Parameters
    ----------
    symbol, unit : str
        Of what comes out.
    found : tuple of str
        Combinations that it takes.
    supplied : tuple of str
        Names in `SUPPLIED` that it takes.
    formula : callable
        From the mapping of all these names to values.
    """

    symbol: str
    unit: str
    found: tuple[str, ...]
    supplied: tuple[str, ...]
    formula: Formula


@dataclass(frozen=True)
class Sought:
    """A physical parameter.

    Parameters
    ----------
    name, words : str
        For programs, and for people.
    ways : tuple of Way
        The first tells it; the others tell combinations, the fullest first.
    remark : str
        What its value rests on beside what is supplied, as a sentence; empty for nothing.
    refusal : str
        Why the first way does not tell it, as a sentence; empty when it does.
    helps : tuple of str
        Names in `SUPPLIED` of which each would help against that.
    """

    name: str
    words: str
    ways: tuple[Way, ...]
    remark: str = ""
    refusal: str = ""
    helps: tuple[str, ...] = ()


def sought(yaw: YawInertia, thrust_map: InputMap) -> tuple[Sought, ...]:
    """Every physical parameter that a flight may tell.

    Parameters
    ----------
    yaw : YawInertia
        What there is to be said of Izz.
    thrust_map : InputMap
        From a rotor's state to phi.
    """
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
