"""Physical parameters of the rigid body and the formulas that give them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from eivor.estimation.derived import LARGEST_BEND
from eivor.inference.distributions import check_level
from eivor.motions.rigid_body.inertia import (
    SUPPLIED,
    Combinations,
    Formula,
    YawInertia,
    contradictions,
    yaw_inertia,
)
from eivor.motions.rigid_body.vehicle import KnownVehicle
from eivor.signals.thrust_map import InputMap, Mixed, Power, input_map

# -- Formulas of physical parameters --

#: Units of torques against rates, with the mass and without.
TORQUE_UNITS = ("N m/(rad/s)", "m^2/s")
#: The same of inertias, and of what goes with the speed and its square.
INERTIA_UNITS = ("kg m^2", "m^2")
LINEAR_UNITS, QUADRATIC_UNITS = ("N/(m/s)", "1/s"), ("N/(m/s)^2", "1/m")
_NO_YAW_INERTIA = "Izz is not identified."


@dataclass(frozen=True)
class PhysicalParameter:
    """A physical parameter."""

    name: str
    words: str
    formulas: tuple[Formula, ...]  # The parameter's, then those of what is left without what it needs
    remark: str = ""
    refusal: str = ""
    helps: tuple[str, ...] = ()  # Names in `SUPPLIED` of which each would help against that


def _by_mass(symbol: str, units: tuple[str, str], per_mass: str) -> tuple[Formula, Formula]:
    """A parameter, and what is left of it without the mass."""
    whole, left = units
    return Formula(f"mass * {per_mass}", symbol, whole), Formula(per_mass, f"{symbol}/m", left)


def sought(yaw: YawInertia, thrust_map: InputMap) -> Iterator[PhysicalParameter]:
    """Every physical parameter that a flight may identify."""
    formulas: tuple[Formula, ...]
    for axis, turning in (("x", "roll"), ("y", "pitch")):
        symbol, over_gain = f"I{axis}{axis}", f"thrust_gain / {turning}_gain"
        whole, left = _by_mass(symbol, INERTIA_UNITS, f"arm_scale * {over_gain}")
        formulas = (whole, left, Formula(over_gain, f"{symbol}/(m l)", "m"))
        yield PhysicalParameter(f"inertia_{axis}{axis}", f"inertia in {turning}", formulas)
    yield _yaw_inertia(yaw)
    yield from _thrust(thrust_map)
    yield _torque_ratio(yaw)
    for words, axis, over_gain in (
        ("forward", "x", "pitch_offset / pitch_gain"),
        ("left", "y", "-roll_offset / roll_gain"),
    ):
        formulas = Formula(f"arm_scale * {over_gain}", f"{axis}_c", "m"), Formula(over_gain, f"{axis}_c/l")
        words_of = f"centre of mass, {words} of the rotors' middle"
        yield PhysicalParameter(f"centre_of_mass_{words}", words_of, formulas)
    for kind, words, letter, units in (
        ("drag", "drag", "D", LINEAR_UNITS),
        ("quadratic_drag", "quadratic drag", "C", QUADRATIC_UNITS),
    ):
        for axis in "xyz":
            formulas = _by_mass(f"{letter}_{axis}", units, f"{kind}_{axis}")
            yield PhysicalParameter(f"{kind}_{axis}", f"{words} along {axis}", formulas)
    yield PhysicalParameter(
        "translational_lift",
        "thrust per squared speed across it",
        _by_mass("H", QUADRATIC_UNITS, "translational_lift"),
    )
    yaw_inertia = yaw.routes[0].per_mass if yaw.routes else ""
    for axis, turning, inertia in (
        ("x", "roll", "arm_scale * thrust_gain / roll_gain"),
        ("y", "pitch", "arm_scale * thrust_gain / pitch_gain"),
        ("z", "yaw", yaw_inertia),
    ):
        damping, refusal = f"{turning}_damping", "" if inertia else _NO_YAW_INERTIA
        by_mass = _by_mass(f"B_{axis}", TORQUE_UNITS, f"{inertia} * {damping}") if inertia else ()
        formulas = (*by_mass, Formula(damping, f"B_{axis}/I{axis}{axis}", "1/s"))
        words = f"torque against {turning}ing"
        yield PhysicalParameter(f"{turning}_drag", words, formulas, refusal=refusal)
    per_mass = f"1 / speed_scale * {yaw_inertia} * rotor_reaction"
    by_mass = _by_mass("J", INERTIA_UNITS, per_mass) if yaw_inertia else ()
    by_inertia = (
        Formula("rotor_reaction / speed_scale", "J/Izz"),
        Formula("rotor_reaction", "J/Izz", "(rad/s)/command"),
    )
    refusal = "" if yaw_inertia else _NO_YAW_INERTIA
    yield PhysicalParameter("rotor_inertia", "inertia of a rotor", (*by_mass, *by_inertia), refusal=refusal)


def _yaw_inertia(yaw: YawInertia) -> PhysicalParameter:
    name, words = "inertia_zz", "inertia in yaw"
    if not yaw.routes:
        left = Formula("thrust_gain / yaw_gain", "Izz/(m kappa)", "1/m")
        helps = ("torque_ratio", "yaw_inertia_ratio")
        return PhysicalParameter(name, words, (left,), refusal=_unexcited(yaw), helps=helps)
    route = yaw.routes[0]
    formulas = _by_mass("Izz", INERTIA_UNITS, route.per_mass)
    ratio = (Formula(f"roll_gain * {route.over_thrust}", "Izz/Ixx"),) if route.over_thrust else ()
    return PhysicalParameter(name, words, (*formulas, *ratio), f"It rests on {route.words}.")


def _unexcited(yaw: YawInertia) -> str:
    text = "The gyroscopic couplings of the flight do not identify Izz"
    if yaw.ratio is not None:
        low, high = yaw.ratio.interval
        text += f", as it hardly turns about two axes at once (Izz/Ixx is between {low:.3g} and {high:.3g})"
    return f"{text}; yaw torque alone determines only its ratio to the torque ratio."


def _thrust(thrust_map: InputMap) -> Iterator[PhysicalParameter]:
    """Constant of each power of the rotor speed in the thrust."""
    match thrust_map:
        case Mixed(share):
            terms = [(2.0, share), (1.0, 1.0 - share)]
        case Power(exponent):
            terms = [(exponent, 1.0)]
        case _:  # no other map is made by name
            terms = []
    for power, share in terms:
        if not share > 0.0:
            continue
        name, words = {
            1.0: ("thrust_linear", "thrust per rotor speed"),
            2.0: ("thrust_quadratic", "thrust per squared rotor speed"),
        }.get(power, ("thrust_constant", f"thrust per rotor speed to the power {power:g}"))
        raised = "" if power == 1.0 else f"^{power:g}"
        per_command = f"{share!r} * thrust_gain"
        of_speed = f"{per_command} / pow(speed_scale, {power!r})"
        by_speed = _by_mass("k", (f"N/(rad/s){raised}", f"m/s^2/(rad/s){raised}"), of_speed)
        by_command = _by_mass("k", (f"N/command{raised}", f"m/s^2/command{raised}"), per_command)
        formulas = (by_speed[0], by_command[0], by_speed[1], by_command[1])
        yield PhysicalParameter(name, words, formulas)


def _torque_ratio(yaw: YawInertia) -> PhysicalParameter:
    name, words = "torque_ratio", "reaction torque over thrust"
    route = next((item for item in yaw.routes if item.over_thrust), None)
    if route is None:
        left = Formula("yaw_gain / thrust_gain", "kappa m/Izz", "1/m")
        return PhysicalParameter(name, words, (left,), refusal=_unexcited(yaw), helps=("yaw_inertia_ratio",))
    text = f"yaw_gain * {route.over_thrust}"
    formulas = Formula(f"arm_scale * {text}", "kappa", "m"), Formula(text, "kappa/l")
    return PhysicalParameter(name, words, formulas, f"It rests on {route.words}.")


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
    formula: Formula  # The parameter's
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
    return PhysicalParameters(rows, tuple(contradictions(combinations, known, yaw, level)))


def _row(
    parameter: PhysicalParameter, combinations: Combinations, known: KnownVehicle, level: float
) -> PhysicalEstimateRow:
    fullest, number = parameter.formulas[0], None
    reason, missing = _why_not_identified(fullest, combinations, level), fullest.missing(known)
    for formula in parameter.formulas:
        if not formula.missing(known) and not _why_not_identified(formula, combinations, level):
            result = combinations.value(formula, level, known, LARGEST_BEND)
            numbers = result.value, result.std_error, result.interval
            number = PhysicalEstimate(formula.symbol, formula.unit, *numbers)
            if formula is fullest and not parameter.refusal:
                basis = _basis(parameter, number, fullest)
                return PhysicalEstimateRow(parameter.name, parameter.words, fullest, number, None, basis)
            break
    left = "" if number is None else f"{number} is all that the flight gives"
    if parameter.refusal:
        helps = tuple(name for name in parameter.helps if getattr(known, name) is None)
        selected = [parameter.refusal, f"{left}." if left else reason, _remedy(helps, " or ")]
    elif reason:
        selected = [reason, f"{left}." if left else ""]
    else:
        selected = [f"{left} without {_listed(missing, ' and ')}.", _remedy(missing, " and ")]
    sentence = " ".join(part for part in selected if part)
    return PhysicalEstimateRow(parameter.name, parameter.words, fullest, None, number, sentence)


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
