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
            _per_kilogram(f"{kind}drag_{axis}", f"{words} along {axis}", f"{letter}_{axis}", *units)
            for kind, words, letter, *units in (
                ("", "drag", "D", "N/(m/s)", "1/s"),
                ("quadratic_", "quadratic drag", "C", "N/(m/s)^2", "1/m"),
            )
            for axis in "xyz"
        ),
        _per_kilogram("translational_lift", "thrust per squared speed across it", "H", "N/(m/s)^2", "1/m"),
        _tilting_drag("roll", "x"),
        _tilting_drag("pitch", "y"),
        _yaw_drag(yaw.route),
        _rotor_inertia(yaw.route),
    )


def _by_mass(
    symbol: str,
    units: tuple[str, str],
    needed: tuple[str, ...],
    supplied: tuple[str, ...],
    per_mass: FormulaFunction,
) -> tuple[Formula, Formula]:
    """A parameter, and what is left of it without the mass."""
    whole, left = units
    return (
        Formula(symbol, whole, needed, ("mass", *supplied), lambda v: v["mass"] * per_mass(v)),
        Formula(f"{symbol}/m", left, needed, supplied, per_mass),
    )


def _tilting_inertia(axes: str, turning: str) -> PhysicalParameter:
    gain, symbol, units = f"{turning}_gain", f"I{axes}", ("kg m^2", "m^2")
    needed = ("thrust_gain", gain)

    def per_mass(v: Mapping[str, float]) -> float:
        return v["arm_scale"] * v["thrust_gain"] / v[gain]

    formulas = (
        *_by_mass(symbol, units, needed, ("arm_scale",), per_mass),
        Formula(f"{symbol}/(m l)", "m", needed, (), lambda v: v["thrust_gain"] / v[gain]),
    )
    return PhysicalParameter(f"inertia_{axes}", f"inertia in {turning}", formulas)


def _yaw_inertia(yaw: YawInertia) -> PhysicalParameter:
    name, words, route = "inertia_zz", "inertia in yaw", yaw.route
    if route is None:
        gains = ("thrust_gain", "yaw_gain")
        left = Formula("Izz/(m kappa)", "1/m", gains, (), lambda v: v["thrust_gain"] / v["yaw_gain"])
        helps = ("torque_ratio", "yaw_inertia_ratio")
        return PhysicalParameter(name, words, (left,), refusal=_unexcited(yaw), helps=helps)
    needed, units = ("thrust_gain", *route.needed), ("kg m^2", "m^2")
    formulas = _by_mass("Izz", units, needed, route.supplied, route.per_mass)
    over_thrust = route.over_thrust
    if over_thrust is not None:
        ratio = Formula(
            "Izz/Ixx",
            "",
            ("roll_gain", *route.needed),
            tuple(item for item in route.supplied if item != "arm_scale"),
            lambda v: v["roll_gain"] * over_thrust(v),
        )
        return PhysicalParameter(name, words, (*formulas, ratio), f"It rests on {route.words}.")
    return PhysicalParameter(name, words, formulas, f"It rests on {route.words}.")


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
    name, words = {
        1.0: ("thrust_linear", "thrust per rotor speed"),
        2.0: ("thrust_quadratic", "thrust per squared rotor speed"),
    }.get(power, ("thrust_constant", f"thrust per rotor speed to the power {power:g}"))
    exponent = "" if power == 1.0 else f"^{power:g}"
    speed, command = f"(rad/s){exponent}", f"command{exponent}"

    def per_command(v: Mapping[str, float]) -> float:
        return share * v["thrust_gain"]

    def per_speed(v: Mapping[str, float]) -> float:
        return per_command(v) / v["speed_scale"] ** power

    needed = ("thrust_gain",)
    of_speed = _by_mass("k", (f"N/{speed}", f"m/s^2/{speed}"), needed, ("speed_scale",), per_speed)
    of_command = _by_mass("k", (f"N/{command}", f"m/s^2/{command}"), needed, (), per_command)
    formulas = tuple(formula for pair in zip(of_speed, of_command, strict=True) for formula in pair)
    return PhysicalParameter(name, words, formulas)


def _torque_ratio(yaw: YawInertia) -> PhysicalParameter:
    name, words = "torque_ratio", "reaction torque over thrust"
    route = next((item for item in yaw.routes if item.over_thrust is not None), None)
    if route is None or route.over_thrust is None:
        gains = ("yaw_gain", "thrust_gain")
        left = Formula("kappa m/Izz", "1/m", gains, (), lambda v: v["yaw_gain"] / v["thrust_gain"])
        return PhysicalParameter(name, words, (left,), refusal=_unexcited(yaw), helps=("yaw_inertia_ratio",))
    over_thrust, needed = route.over_thrust, ("yaw_gain", *route.needed)
    scaled = tuple(item for item in route.supplied if item != "arm_scale")
    formulas = (
        Formula(
            "kappa", "m", needed, route.supplied, lambda v: v["arm_scale"] * v["yaw_gain"] * over_thrust(v)
        ),
        Formula("kappa/l", "", needed, scaled, lambda v: v["yaw_gain"] * over_thrust(v)),
    )
    return PhysicalParameter(name, words, formulas, f"It rests on {route.words}.")


def _offset(words: str, axis: str, turning: str, sign: float) -> PhysicalParameter:
    needed = (f"{turning}_offset", f"{turning}_gain")

    def per_arm(v: Mapping[str, float]) -> float:
        offset, gain = (v[name] for name in needed)
        return sign * offset / gain

    formulas = (
        Formula(f"{axis}_c", "m", needed, ("arm_scale",), lambda v: v["arm_scale"] * per_arm(v)),
        Formula(f"{axis}_c/l", "", needed, (), per_arm),
    )
    name = f"centre_of_mass_{words}"
    return PhysicalParameter(name, f"centre of mass, {words} of the rotors' middle", formulas)


def _per_kilogram(name: str, words: str, symbol: str, *units: str) -> PhysicalParameter:
    whole, left = units
    return PhysicalParameter(name, words, _by_mass(symbol, (whole, left), (name,), (), lambda v: v[name]))


def _tilting_drag(turning: str, axis: str) -> PhysicalParameter:
    gain, damping = f"{turning}_gain", f"{turning}_damping"

    def per_mass(v: Mapping[str, float]) -> float:
        return v["arm_scale"] * v[damping] * v["thrust_gain"] / v[gain]

    by_mass = _by_mass(f"B_{axis}", DRAG_UNITS, ("thrust_gain", gain, damping), ("arm_scale",), per_mass)
    return PhysicalParameter(
        f"{turning}_drag", f"torque against {turning}ing", (*by_mass, _over_inertia(damping, axis))
    )


def _yaw_drag(route: YawInertiaRoute | None) -> PhysicalParameter:
    name, words, left = "yaw_drag", "torque against yawing", _over_inertia("yaw_damping", "z")
    if route is None:
        return PhysicalParameter(name, words, (left,), refusal=_NO_YAW_INERTIA)

    def per_mass(v: Mapping[str, float]) -> float:
        return v["yaw_damping"] * route.per_mass(v)

    needed = ("thrust_gain", *route.needed, "yaw_damping")
    by_mass = _by_mass("B_z", DRAG_UNITS, needed, route.supplied, per_mass)
    return PhysicalParameter(name, words, (*by_mass, left))


def _over_inertia(damping: str, axis: str) -> Formula:
    return Formula(f"B_{axis}/I{axis}{axis}", "1/s", (damping,), (), lambda v: v[damping])


def _rotor_inertia(route: YawInertiaRoute | None) -> PhysicalParameter:
    name, words, reaction = "rotor_inertia", "inertia of a rotor", "rotor_reaction"
    left = (
        Formula("J/Izz", "", (reaction,), ("speed_scale",), lambda v: v[reaction] / v["speed_scale"]),
        Formula("J/Izz", "(rad/s)/command", (reaction,), (), lambda v: v[reaction]),
    )
    if route is None:
        return PhysicalParameter(name, words, left, refusal=_NO_YAW_INERTIA)

    def per_mass(v: Mapping[str, float]) -> float:
        return v[reaction] * route.per_mass(v) / v["speed_scale"]

    needed, supplied = ("thrust_gain", *route.needed, reaction), ("speed_scale", *route.supplied)
    by_mass = _by_mass("J", ("kg m^2", "m^2"), needed, supplied, per_mass)
    return PhysicalParameter(name, words, (*by_mass, *left))


#: Units of torques against rates, with the mass and without.
DRAG_UNITS = ("N m/(rad/s)", "m^2/s")
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
    parameter: PhysicalParameter, combinations: Combinations, known: KnownVehicle, level: float
) -> PhysicalEstimateRow:
    fullest, number = parameter.formulas[0], None
    reason, missing = _why_not_identified(fullest, combinations, level), _missing(fullest.supplied, known)
    for formula in parameter.formulas:
        if not _missing(formula.supplied, known) and not _why_not_identified(formula, combinations, level):
            supplied: dict[str, KnownNumber] = {name: getattr(known, name) for name in formula.supplied}
            result = combinations.function(formula.formula, formula.needed, supplied, level)
            numbers = result.value, result.std_error, result.interval
            number = PhysicalEstimate(formula.symbol, formula.unit, *numbers)
            if formula is fullest and not parameter.refusal:
                basis = _basis(parameter, number, fullest)
                return PhysicalEstimateRow(parameter.name, parameter.words, number, None, basis)
            break
    left = "" if number is None else f"{number} is all that the flight gives"
    if parameter.refusal:
        helps = _remedy(_missing(parameter.helps, known), " or ")
        selected = [parameter.refusal, f"{left}." if left else reason, helps]
    elif reason:
        selected = [reason, f"{left}." if left else ""]
    else:
        selected = [f"{left} without {_listed(missing, ' and ')}.", _remedy(missing, " and ")]
    sentence = " ".join(part for part in selected if part)
    return PhysicalEstimateRow(parameter.name, parameter.words, None, number, sentence)


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


def _basis(parameter: PhysicalParameter, number: PhysicalEstimate, formula: Formula) -> str:
    """What a value rests on, and what is strange about it."""
    selected = [parameter.remark]
    if formula.supplied:
        selected.append(f"With {_listed(formula.supplied, ' and ')} as supplied.")
    if parameter.name in DRAGS and number.interval[1] < 0.0:
        selected.append(
            "Below zero: a disturbance that goes with the motion, such as wind, not the air's drag."
        )
    return " ".join(part for part in selected if part)


def _remedy(names: tuple[str, ...], joint: str) -> str:
    return f"Supply {_listed(names, joint)}." if names else ""


def _listed(names: tuple[str, ...], joint: str) -> str:
    *others, last = (SUPPLIED[name] for name in names)
    return f"{', '.join(others)}{joint}{last}" if others else last
