"""Physical parameters of the rigid body and the formulas that give them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from eivor.inference.distributions import check_level
from eivor.motions.rigid_body.inertia import (
    Combinations,
    FormulaFunction,
    YawInertia,
    YawInertiaRoute,
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
class Formula:
    """A formula for a parameter, or for what is left of it without what it needs."""

    symbol: str
    unit: str
    needed: tuple[str, ...]
    supplied: tuple[str, ...]
    formula: FormulaFunction


@dataclass(frozen=True)
class PhysicalParameter:
    """A physical parameter."""

    name: str
    words: str
    formulas: tuple[Formula, ...]
    remark: str = ""
    refusal: str = ""
    helps: tuple[str, ...] = ()  # Names in `SUPPLIED` of which each would help against that


def sought(yaw: YawInertia, thrust_map: InputMap) -> tuple[PhysicalParameter, ...]:
    """Every physical parameter that a flight may identify."""
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


def _tilting_inertia(axes: str, turning: str) -> PhysicalParameter:
    gain, symbol = f"{turning}_gain", f"I{axes}"
    texts = ("thrust_gain", gain)

    def per_mass(v: Mapping[str, float]) -> float:
        return v["arm_scale"] * v["thrust_gain"] / v[gain]

    return PhysicalParameter(
        f"inertia_{axes}",
        f"inertia in {turning}",
        (
            Formula(symbol, "kg m^2", texts, ("mass", "arm_scale"), lambda v: v["mass"] * per_mass(v)),
            Formula(f"{symbol}/m", "m^2", texts, ("arm_scale",), per_mass),
            Formula(f"{symbol}/(m l)", "m", texts, (), lambda v: v["thrust_gain"] / v[gain]),
        ),
    )


def _yaw_inertia(yaw: YawInertia) -> PhysicalParameter:
    name, words = "inertia_zz", "inertia in yaw"
    left = Formula(
        "Izz/(m kappa)", "1/m", ("thrust_gain", "yaw_gain"), (), lambda v: v["thrust_gain"] / v["yaw_gain"]
    )
    route = yaw.route
    if route is None:
        helps = ("torque_ratio", "yaw_inertia_ratio")
        return PhysicalParameter(name, words, (left,), refusal=_unexcited(yaw), helps=helps)
    texts = ("thrust_gain", *route.needed)
    formulas = [
        Formula("Izz", "kg m^2", texts, ("mass", *route.supplied), lambda v: v["mass"] * route.per_mass(v)),
        Formula("Izz/m", "m^2", texts, route.supplied, route.per_mass),
    ]
    if route.over_thrust is not None:
        over_thrust = route.over_thrust
        needs = tuple(item for item in route.supplied if item != "arm_scale")
        formulas.append(
            Formula(
                "Izz/Ixx", "", ("roll_gain", *route.needed), needs, lambda v: v["roll_gain"] * over_thrust(v)
            )
        )
    return PhysicalParameter(name, words, tuple(formulas), f"It rests on {route.words}.")


def _unexcited(yaw: YawInertia) -> str:
    text = "The gyroscopic couplings of the flight do not identify Izz"
    if yaw.ratio is not None:
        low, high = yaw.ratio.interval
        text += f", as it hardly turns about two axes at once (Izz/Ixx is between {low:.3g} and {high:.3g})"
    return f"{text}; yaw torque alone determines only its ratio to the torque ratio."


def _thrust(thrust_map: InputMap) -> tuple[PhysicalParameter, ...]:
    """Constant of each power of the rotor speed in the thrust."""
    match thrust_map:
        case Mixed(share):
            terms = [(2.0, share), (1.0, 1.0 - share)]
        case Power(exponent):
            terms = [(exponent, 1.0)]
        case _:  # no other map is made by name
            terms = []
    return tuple(_thrust_term(power, share) for power, share in terms if share > 0.0)


def _thrust_term(power: float, share: float) -> PhysicalParameter:
    named = {
        1.0: ("thrust_linear", "thrust per rotor speed"),
        2.0: ("thrust_quadratic", "thrust per squared rotor speed"),
    }
    name, words = named.get(power, ("thrust_constant", f"thrust per rotor speed to the power {power:g}"))
    speed = "rad/s" if power == 1.0 else f"(rad/s)^{power:g}"
    command = "command" if power == 1.0 else f"command^{power:g}"
    per = f"/({speed})" if power == 1.0 else f"/{speed}"
    texts = ("thrust_gain",)

    def per_mass(v: Mapping[str, float]) -> float:
        return share * v["thrust_gain"] / v["speed_scale"] ** power

    return PhysicalParameter(
        name,
        words,
        (
            Formula("k", f"N{per}", texts, ("mass", "speed_scale"), lambda v: v["mass"] * per_mass(v)),
            Formula("k", f"N/{command}", texts, ("mass",), lambda v: v["mass"] * share * v["thrust_gain"]),
            Formula("k/m", f"m/s^2{per}", texts, ("speed_scale",), per_mass),
            Formula("k/m", f"m/s^2/{command}", texts, (), lambda v: share * v["thrust_gain"]),
        ),
    )


def _torque_ratio(yaw: YawInertia) -> PhysicalParameter:
    name, words = "torque_ratio", "reaction torque over thrust"
    left = Formula(
        "kappa m/Izz", "1/m", ("yaw_gain", "thrust_gain"), (), lambda v: v["yaw_gain"] / v["thrust_gain"]
    )
    route = next((item for item in yaw.routes if item.over_thrust is not None), None)
    if route is None or route.over_thrust is None:
        return PhysicalParameter(name, words, (left,), refusal=_unexcited(yaw), helps=("yaw_inertia_ratio",))
    over_thrust = route.over_thrust
    texts = ("yaw_gain", *route.needed)
    scaled = tuple(item for item in route.supplied if item != "arm_scale")
    return PhysicalParameter(
        name,
        words,
        (
            Formula(
                "kappa", "m", texts, route.supplied, lambda v: v["arm_scale"] * v["yaw_gain"] * over_thrust(v)
            ),
            Formula("kappa/l", "", texts, scaled, lambda v: v["yaw_gain"] * over_thrust(v)),
        ),
        f"It rests on {route.words}.",
    )


def _offset(words: str, axis: str, turning: str, sign: float) -> PhysicalParameter:
    text = (f"{turning}_offset", f"{turning}_gain")

    def in_lengths(v: Mapping[str, float]) -> float:
        return sign * v[f"{turning}_offset"] / v[f"{turning}_gain"]

    return PhysicalParameter(
        f"centre_of_mass_{words}",
        f"centre of mass, {words} of the rotors' middle",
        (
            Formula(f"{axis}_c", "m", text, ("arm_scale",), lambda v: v["arm_scale"] * in_lengths(v)),
            Formula(f"{axis}_c/l", "", text, (), in_lengths),
        ),
    )


def _per_kilogram(name: str, words: str, symbol: str, unit: str, left: str) -> PhysicalParameter:
    return PhysicalParameter(
        name,
        words,
        (
            Formula(symbol, unit, (name,), ("mass",), lambda v: v["mass"] * v[name]),
            Formula(f"{symbol}/m", left, (name,), (), lambda v: v[name]),
        ),
    )


def _tilting_drag(turning: str, axis: str) -> PhysicalParameter:
    gain, damping = f"{turning}_gain", f"{turning}_damping"
    texts = ("thrust_gain", gain, damping)

    def per_mass(v: Mapping[str, float]) -> float:
        return v["arm_scale"] * v[damping] * v["thrust_gain"] / v[gain]

    return _rate_drag(turning, axis, damping, texts, ("arm_scale",), per_mass)


def _yaw_drag(route: YawInertiaRoute | None) -> PhysicalParameter:
    if route is None:
        return _rate_drag("yaw", "z", "yaw_damping", (), (), None)
    texts = ("thrust_gain", *route.needed, "yaw_damping")

    def per_mass(v: Mapping[str, float]) -> float:
        return v["yaw_damping"] * route.per_mass(v)

    return _rate_drag("yaw", "z", "yaw_damping", texts, route.supplied, per_mass)


def _rate_drag(
    turning: str,
    axis: str,
    damping: str,
    names: tuple[str, ...],
    supplied: tuple[str, ...],
    per_mass: FormulaFunction | None,
) -> PhysicalParameter:
    """Torque against a rate; without a formula the inertia is missing."""
    symbol = f"B_{axis}"
    left = Formula(f"{symbol}/I{axis}{axis}", "1/s", (damping,), (), lambda v: v[damping])
    name, words = f"{turning}_drag", f"torque against {turning}ing"
    if per_mass is None:
        return PhysicalParameter(name, words, (left,), refusal=_NO_YAW_INERTIA)
    return PhysicalParameter(
        name,
        words,
        (
            Formula(symbol, "N m/(rad/s)", names, ("mass", *supplied), lambda v: v["mass"] * per_mass(v)),
            Formula(f"{symbol}/m", "m^2/s", names, supplied, per_mass),
            left,
        ),
    )


def _rotor_inertia(route: YawInertiaRoute | None) -> PhysicalParameter:
    name, words = "rotor_inertia", "inertia of a rotor"
    reaction = "rotor_reaction"
    left = (
        Formula("J/Izz", "", (reaction,), ("speed_scale",), lambda v: v[reaction] / v["speed_scale"]),
        Formula("J/Izz", "(rad/s)/command", (reaction,), (), lambda v: v[reaction]),
    )
    if route is None:
        return PhysicalParameter(name, words, left, refusal=_NO_YAW_INERTIA)
    texts = ("thrust_gain", *route.needed, reaction)

    def per_mass(v: Mapping[str, float]) -> float:
        return v[reaction] * route.per_mass(v) / v["speed_scale"]

    supplied = ("speed_scale", *route.supplied)
    return PhysicalParameter(
        name,
        words,
        (
            Formula("J", "kg m^2", texts, ("mass", *supplied), lambda v: v["mass"] * per_mass(v)),
            Formula("J/m", "m^2", texts, supplied, per_mass),
            *left,
        ),
    )


_NO_YAW_INERTIA = "Izz is not identified."


# -- Physical --

#: A torque or force that goes with the motion is none that the air makes.
DRAGS = ("drag_x", "drag_y", "drag_z", "roll_drag", "pitch_drag", "yaw_drag")


@dataclass(frozen=True, slots=True)
class PhysicalEstimate:
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
class PhysicalEstimateRow:
    """A physical parameter, or why it is not identified."""

    name: str
    words: str
    estimate: PhysicalEstimate | None
    instead: PhysicalEstimate | None
    sentence: str


@dataclass(frozen=True, slots=True)
class PhysicalParameters:
    """All of them, and what speaks against them."""

    rows: tuple[PhysicalEstimateRow, ...]
    contradictions: tuple[str, ...]

    def __getitem__(self, name: str) -> PhysicalEstimateRow:
        return next(row for row in self.rows if row.name == name)


def physical_parameters(
    combinations: Combinations, known: KnownVehicle, level: float = 0.95
) -> PhysicalParameters:
    """Physical parameters with intervals, each as far as the flight and what is supplied determine it."""
    check_level(level)
    combinations = combinations.finite()
    yaw = yaw_inertia(combinations, known, level)
    rows = tuple(_row(item, combinations, known, level) for item in sought(yaw, input_map(known.thrust_map)))
    return PhysicalParameters(rows, contradictions(combinations, known, yaw, level))


def _row(
    physical_parameter: PhysicalParameter, combinations: Combinations, known: KnownVehicle, level: float
) -> PhysicalEstimateRow:
    fullest = physical_parameter.formulas[0]
    reason, missing = _why_not_identified(fullest, combinations, level), _missing(fullest.supplied, known)
    formula = next(
        (
            formula
            for formula in physical_parameter.formulas
            if not _missing(formula.supplied, known) and not _why_not_identified(formula, combinations, level)
        ),
        None,
    )
    number = None if formula is None else _report(formula, combinations, known, level)
    if number is not None and formula is fullest and not physical_parameter.refusal:
        return PhysicalEstimateRow(
            physical_parameter.name,
            physical_parameter.words,
            number,
            None,
            _basis(physical_parameter, number, fullest),
        )
    left = "" if number is None else f"{number} is all that the flight gives"
    if physical_parameter.refusal:
        selected = [
            physical_parameter.refusal,
            f"{left}." if left else reason,
            _remedy(_missing(physical_parameter.helps, known), " or "),
        ]
    elif reason:
        selected = [reason, f"{left}." if left else ""]
    else:
        selected = [f"{left} without {_listed(missing, ' and ')}.", _remedy(missing, " and ")]
    sentence = " ".join(part for part in selected if part)
    return PhysicalEstimateRow(physical_parameter.name, physical_parameter.words, None, number, sentence)


def _report(
    formula: Formula, combinations: Combinations, known: KnownVehicle, level: float
) -> PhysicalEstimate:
    supplied: dict[str, KnownNumber] = {name: getattr(known, name) for name in formula.supplied}
    quantity = combinations.function(formula.formula, formula.needed, supplied, level)
    return PhysicalEstimate(
        formula.symbol, formula.unit, quantity.value, quantity.std_error, quantity.interval
    )


def _missing(names: tuple[str, ...], known: KnownVehicle) -> tuple[str, ...]:
    return tuple(name for name in names if getattr(known, name) is None)


def _why_not_identified(formula: Formula, combinations: Combinations, level: float) -> str:
    """Why the flight does not identify what a formula takes; empty when it does."""
    absent = [name for name in formula.needed if not combinations.has(name)]
    if absent:
        return f"The flight identifies no {', no '.join(absent)}."
    for name in formula.needed:
        low, high = combinations.interval(name, level) if name.endswith("_gain") else (1.0, 1.0)
        if high < 0.0:
            return f"{name} is below zero: positions, order or spins of the rotors contradict the flight."
        if low <= 0.0:
            return f"The flight does not distinguish {name} from zero."
    return ""


def _basis(physical_parameter: PhysicalParameter, number: PhysicalEstimate, formula: Formula) -> str:
    """What a value rests on, and what is strange about it."""
    selected = [physical_parameter.remark]
    if formula.supplied:
        selected.append(f"With {_listed(formula.supplied, ' and ')} as supplied.")
    if physical_parameter.name in DRAGS and number.interval[1] < 0.0:
        selected.append(
            "Below zero: a disturbance that goes with the motion, such as wind, not the air's drag."
        )
    return " ".join(part for part in selected if part)


def _remedy(names: tuple[str, ...], joint: str) -> str:
    return f"Supply {_listed(names, joint)}." if names else ""


def _listed(names: tuple[str, ...], joint: str) -> str:
    *others, last = (SUPPLIED[name] for name in names)
    return f"{', '.join(others)}{joint}{last}" if others else last
