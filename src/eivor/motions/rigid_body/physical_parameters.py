"""Physical parameters of the rigid body: formulas over what flights identify, ways to Izz, contradictions."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from eivor.estimation.estimate import LARGEST_BEND, DerivedQuantity, Estimate, OfVector, derived_from
from eivor.flights.quantity import Implied
from eivor.inference.covariance import CovariancePart, JointCovariance, JointEstimate
from eivor.inference.verdict import Status
from eivor.logs.channel_map import Expression, parse_expression
from eivor.motions.rigid_body.vehicle import NO_BODY_UNCERTAINTY, KnownNumber, KnownVehicle
from eivor.signals.recording import GRAVITY
from eivor.signals.thrust_map import InputMap, Mixed, Power, input_map
from eivor.tools import Float

#: What may be supplied, and what stands in sentences for it.
SUPPLIED = {
    "mass": "the mass",
    "arm_scale": "the arm length",
    "speed_scale": "the rotor speed per unit of command",
    "torque_ratio": "the torque ratio",
    "yaw_inertia_ratio": "a ratio of Izz to the mean of Ixx and Iyy",
}


@dataclass(frozen=True)
class Formula:
    """A number by what flights identify and what may be supplied, such as ``mass * drag_x``."""

    text: str
    symbol: str = ""
    unit: str = ""

    @cached_property
    def expression(self) -> Expression:
        return parse_expression(self.text, "a formula")

    @cached_property
    def needed(self) -> tuple[str, ...]:
        """Combinations that it takes."""
        return tuple(name for name in self.expression.columns if name not in SUPPLIED)

    @cached_property
    def supplied(self) -> tuple[str, ...]:
        """Numbers that it takes from outside the flight."""
        return tuple(name for name in self.expression.columns if name in SUPPLIED)

    def missing(self, known: KnownVehicle) -> tuple[str, ...]:
        """Those of them that a vehicle lacks."""
        return tuple(name for name in self.supplied if getattr(known, name) is None)


LEVEL = 0.95


@dataclass(frozen=True)
class Combinations:
    """What a flight identifies of a vehicle, in the order of its names."""

    names: tuple[str, ...]  # Such as ``roll_gain``
    joint: JointEstimate
    #: How much further intervals reach below and above than the covariance says
    beyond: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @classmethod
    def of_estimate(cls, estimate: Estimate) -> Combinations:
        """Those of an estimate, under their names in it."""
        return cls(estimate.names, JointEstimate(estimate.values, estimate.joint_covariance))

    def reaching(self, quantities: Mapping[str, Any]) -> Combinations:
        """Combinations with intervals at least as wide as a result's, without unbounded ones."""
        endless = {name for name, item in quantities.items() if not np.isfinite(item.interval).all()}
        kept, beyond = self.only([name for name in self.names if name not in endless]), {}
        for name in kept.names:
            if name in quantities:
                (low, high), value, here = quantities[name].interval, quantities[name].value, self.value(name)
                below = value - low - (here.value - here.interval[0])
                above = high - value - (here.interval[1] - here.value)
                beyond[name] = (max(below, 0.0), max(above, 0.0))
        return replace(kept, beyond=beyond)

    def finite(self) -> Combinations:
        """Those that have a finite value with a finite variance, whatever is assumed."""
        good = np.isfinite(self.joint.values)
        for part in self.joint.covariance.parts:
            good &= np.isfinite(np.diag(part.matrix))
        return self.only([name for name, kept in zip(self.names, good, strict=True) if kept])

    def only(self, names: Collection[str]) -> Combinations:
        """Those that have one of these names."""
        at = [position for position, name in enumerate(self.names) if name in names]
        parts = self.joint.covariance.parts
        kept = JointCovariance(tuple(replace(part, matrix=part.matrix[np.ix_(at, at)]) for part in parts))
        names, joint = tuple(self.names[item] for item in at), JointEstimate(self.joint.values[at], kept)
        return replace(self, names=names, joint=joint)

    def has(self, *names: str) -> bool:
        """Whether all of these were identified."""
        return set(names) <= set(self.names)

    def positive(self, *names: str, level: float = LEVEL) -> bool:
        """Whether all of these were identified, and are above zero."""
        return self.has(*names) and all(self.interval(name, level)[0] > 0.0 for name in names)

    def interval(self, name: str, level: float = LEVEL) -> tuple[float, float]:
        return self.value(name, level=level).interval

    def value(
        self,
        formula: str | Formula,
        known: KnownVehicle | None = None,
        *,
        level: float = LEVEL,
        largest_bend: float = math.inf,
    ) -> DerivedQuantity:
        """Value of a formula, with an interval that holds the errors of all it is made of."""
        formula = Formula(formula) if isinstance(formula, str) else formula
        numbers: dict[str, KnownNumber] = {name: getattr(known, name) for name in formula.supplied}
        exact = {name: number.value for name, number in numbers.items() if number.std == 0.0}
        uncertain = {name: number for name, number in numbers.items() if number.std > 0.0}
        index = [self.names.index(name) for name in formula.needed]
        errors = np.sqrt(np.maximum(np.diag(self.joint.covariance.matrix), 0.0))
        of_flight = [float(np.hypot(self.joint.values[item], errors[item])) or 1.0 for item in index]
        sizes = np.array([*of_flight, *(number.value for number in uncertain.values())])
        order, evaluate = (*formula.needed, *uncertain), formula.expression.evaluate

        def of_vector(values: Float[np.ndarray, " n"]) -> float:
            """In units of the sizes: those of combinations are many powers of ten apart."""
            return float(evaluate(exact | dict(zip(order, values * sizes, strict=True))))

        joint = _part_of(self.joint, index, tuple(uncertain.values()), sizes)
        result = derived_from(of_vector, joint, level, math.inf)
        if result.bend > largest_bend:
            by_logarithm = _by_logarithm(of_vector, joint, level)
            result = by_logarithm or derived_from(of_vector, joint, level, largest_bend)
        low, high = result.interval
        for number, name in enumerate(formula.needed):
            below, above = self.beyond.get(name, (0.0, 0.0))
            ends = joint.values + np.outer((-below, above), np.eye(sizes.size)[number]) / sizes
            moves = [0.0, *(of_vector(end) - result.value for end in ends)] if below or above else [0.0]
            low, high = low + min(moves), high + max(moves)
        return replace(result, interval=(low, high))


def _by_logarithm(function: OfVector, joint: JointEstimate, level: float) -> DerivedQuantity | None:
    """Estimate by the delta method for the logarithm; None where it is too nonlinear."""
    sign = math.copysign(1.0, function(joint.values))
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
    joint: JointEstimate, indices: list[int], known: tuple[KnownNumber, ...], sizes: Float[np.ndarray, " n"]
) -> JointEstimate:
    """Some combinations and what is supplied, in units of their sizes."""
    values = np.append(joint.values[indices], [number.value for number in known])
    size, parts = len(indices), []
    for part in joint.covariance.parts:
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
#: Inertias in roll and pitch over mass and arms.
TILTING = {turning: f"arm_scale * thrust_gain / {turning}_gain" for turning in ("roll", "pitch")}
GAINS = tuple(f"{turning}_gain" for turning in TILTING)
#: Izz over mass, arm and thrust gain: Iyy - beta_1 Ixx, and Ixx + beta_2 Iyy.
BY_COUPLING = {
    "roll_coupling": "(1 / pitch_gain - roll_coupling / roll_gain)",
    "pitch_coupling": "(1 / roll_gain + pitch_coupling / pitch_gain)",
}


@dataclass(frozen=True)
class YawInertiaRoute:
    """A way to Izz."""

    words: str
    per_mass: str  # Izz over the mass [m^2]
    over_thrust: str = ""  # The same over arm and thrust gain; empty where it does not go with them

    def at_hand(self, combinations: Combinations, known: KnownVehicle) -> bool:
        """Whether all is known to compare it with the other inertias."""
        formula = Formula(f"arm_scale * {self.per_mass}")
        gains = [name for name in formula.needed if name.endswith("_gain")]
        usable = combinations.positive("thrust_gain", *GAINS, *gains, level=SURE)
        return not formula.missing(known) and usable


def _by_arms(words: str, over_thrust: str) -> YawInertiaRoute:
    return YawInertiaRoute(words, f"arm_scale * thrust_gain * {over_thrust}", over_thrust)


_BY_TORQUE_RATIO = YawInertiaRoute(
    "the torque ratio that was supplied", "torque_ratio * thrust_gain / yaw_gain"
)
_BY_ASSUMPTION = _by_arms(
    "the ratio of Izz to Ixx and Iyy that was supplied, not on the flight",
    "0.5 * yaw_inertia_ratio * (1 / roll_gain + 1 / pitch_gain)",
)


#: Ways to Izz that are open, the one to go first.
Routes = tuple[YawInertiaRoute, ...]


def yaw_inertia(combinations: Combinations, known: KnownVehicle) -> tuple[Routes, str]:
    """Ways to Izz by gains above zero, and what to say where the couplings give none."""
    tilting = combinations.positive(*GAINS)
    routes, why = [], "The gyroscopic couplings of the flight do not identify Izz."
    at_hand = [text for name, text in BY_COUPLING.items() if combinations.has(name)]
    if at_hand and tilting:
        if len(at_hand) == 2:
            share = _weight(combinations)
            at_hand = [f"({share!r} * {at_hand[0]} + {1.0 - share!r} * {at_hand[1]})"]
        ratio = combinations.value(f"roll_gain * {at_hand[0]}", largest_bend=LARGEST_BEND)
        low, high = ratio.interval
        why += f" It hardly turns about two axes at once: Izz/Ixx is between {low:.3g} and {high:.3g}."
        if differs_from_zero(ratio.interval) and high - low <= 2.0 * EXCITED_SHARE * ratio.value:
            routes.append(_by_arms("the gyroscopic couplings of the flight", at_hand[0]))
    if known.torque_ratio is not None and combinations.positive("yaw_gain"):
        routes.append(_BY_TORQUE_RATIO)

    def relative_width(route: YawInertiaRoute) -> float:
        function = combinations.value(route.per_mass, known)
        return (function.interval[1] - function.interval[0]) / function.value

    if len(routes) == 2 and known.arm_scale is not None:
        routes.sort(key=relative_width)
    if not routes and known.yaw_inertia_ratio is not None and tilting:
        routes.append(_BY_ASSUMPTION)
    return tuple(routes), f"{why} Yaw torque alone determines only its ratio to the torque ratio."


def _weight(combinations: Combinations) -> float:
    """Weight of the first coupling in the combination of both of least variance."""
    first, second = BY_COUPLING.values()
    texts = first, second, f"{first} - {second}"
    variance, other, separated = (combinations.value(text).std_error ** 2 for text in texts)
    return min(max(0.5 * (other - variance + separated) / separated, 0.0), 1.0) if separated > 0.0 else 0.5


# -- Contradictions --

COUPLING_TEXTS = {
    "roll_coupling": "(Iyy - Izz) / Ixx",
    "pitch_coupling": "(Izz - Ixx) / Iyy",
    "yaw_coupling": "(Ixx - Iyy) / Izz",
}
#: Zero for couplings of one body.
IDENTITY = "roll_coupling + pitch_coupling + yaw_coupling + roll_coupling * pitch_coupling * yaw_coupling"
#: Pure numbers are equal within rounding.
ROUNDING = 1e-9
#: Level of their intervals: there are several ways to contradict, and most flights do in none.
SURE = 0.999
#: Weight over the square of the arms' length: what vehicles have [N/m^2].
WEIGHT_OVER_ARMS = (2.0, 20_000.0)
#: Squared radius of gyration in roll or pitch, over that of the rotors: what vehicles have.
GYRATION = (0.02, 1.5)


def contradictions(combinations: Combinations, known: KnownVehicle, routes: Routes) -> Iterator[str]:
    """Sentences about what no rigid body has, and about what is supplied and does not fit."""
    yield from _of_couplings(combinations)
    if known.arm_scale is not None:
        yield from _of_lengths(combinations, known, known.arm_scale.value * known.arm)
    at_hand = [route.at_hand(combinations, known) for route in routes]
    if any(at_hand[:1]):
        yield from _of_inertias(combinations, known, routes[0])
    for (item, other), both in zip(pairwise(routes), pairwise(at_hand), strict=True):
        formula = f"{other.per_mass} / ({item.per_mass}) - 1"
        function = combinations.value(formula, known, level=SURE) if all(both) else None
        if function is not None and differs_from_zero(function.interval) and abs(function.value) > ROUNDING:
            low, high = (100.0 * end for end in function.interval)
            yield f"Izz by {other.words} is {low:+.3g} to {high:+.3g} % off that by {item.words}."


def _of_couplings(combinations: Combinations) -> Iterator[str]:
    for name, words in COUPLING_TEXTS.items():
        low, high = combinations.interval(name, SURE) if combinations.has(name) else (0.0, 0.0)
        if low > 1.0 + NO_BODY_UNCERTAINTY or high < -1.0 - NO_BODY_UNCERTAINTY:
            yield f"{name} = {words} is between {low:.3g} and {high:.3g}: no body has one beyond -1 or 1."
    if combinations.has(*COUPLING_TEXTS):
        low, high = combinations.value(IDENTITY, level=SURE).interval
        if differs_from_zero((low, high)) and min(abs(low), abs(high)) > ROUNDING:
            yield (
                f"The gyroscopic couplings are not those of one body: beta_1 + beta_2 + beta_3 + beta_1 "
                f"beta_2 beta_3 is between {low:.3g} and {high:.3g} in place of 0."
            )


def _of_lengths(combinations: Combinations, known: KnownVehicle, arm_m: float) -> Iterator[str]:
    """Mass and inertias that the rotors' distances make those of no vehicle: a wrong unit, most likely."""
    low, high = WEIGHT_OVER_ARMS
    if known.mass is not None:
        loading = known.mass.value * GRAVITY / arm_m**2
        if not low <= loading <= high:
            yield (
                f"With mass and arms as supplied, the weight over the square of an arm would be "
                f"{loading:.2g} N/m^2, where vehicles have {low:g} to {high:g}: check the units of both."
            )
    for turning, inertia in TILTING.items():
        if combinations.positive("thrust_gain", f"{turning}_gain", level=SURE):
            ratio = combinations.value(f"{inertia} / {known.arm**2!r}", known, level=SURE)
            if ratio.interval[1] < GYRATION[0] or ratio.interval[0] > GYRATION[1]:
                yield (
                    f"With the rotors' distances as supplied the inertia in {turning} would be "
                    f"{ratio.value:.3g} times that of the whole mass at the rotors, where vehicles have "
                    f"{GYRATION[0]:g} to {GYRATION[1]:g}. Check their unit, and the thrust map."
                )


def _of_inertias(combinations: Combinations, known: KnownVehicle, route: YawInertiaRoute) -> Iterator[str]:
    """Any two inertias are together at least the third."""
    per_mass = {"Ixx": TILTING["roll"], "Iyy": TILTING["pitch"], "Izz": route.per_mass}
    for symbol, largest in per_mass.items():
        share = f"({' + '.join(per_mass.values())} - 2 * ({largest})) / ({per_mass['Ixx']})"
        if combinations.value(share, known, level=SURE).interval[1] < -NO_BODY_UNCERTAINTY:
            others = " and ".join(item for item in per_mass if item != symbol)
            yield f"{symbol} is more than {others} together, which no body has; Izz rests on {route.words}."


# -- Formulas of physical parameters --

#: Units with the mass, and without.
TORQUE_UNITS, INERTIA_UNITS = ("N m/(rad/s)", "m^2/s"), ("kg m^2", "m^2")
LINEAR_UNITS, QUADRATIC_UNITS = ("N/(m/s)", "1/s"), ("N/(m/s)^2", "1/m")
#: By the power of the rotor speed.
THRUST_WORDS = {
    1.0: ("thrust_linear", "thrust per rotor speed"),
    2.0: ("thrust_quadratic", "thrust per squared rotor speed"),
}


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


def sought(routes: Routes, unexcited: str, thrust_map: InputMap) -> Iterator[PhysicalParameter]:
    """Every physical parameter that a flight may identify."""
    made = PhysicalParameter
    formulas: tuple[Formula, ...]
    for axis, turning in zip("xy", TILTING, strict=True):
        by_mass = _by_mass(f"I{axis}{axis}", INERTIA_UNITS, TILTING[turning])
        formulas = (*by_mass, Formula(f"thrust_gain / {turning}_gain", f"I{axis}{axis}/(m l)", "m"))
        yield made(f"inertia_{axis}{axis}", f"inertia in {turning}", formulas)
    yield _yaw_inertia(routes, unexcited)
    yield from _thrust(thrust_map)
    yield _torque_ratio(routes, unexcited)
    for words, axis, offset in (
        ("forward", "x", "pitch_offset / pitch_gain"),
        ("left", "y", "-roll_offset / roll_gain"),
    ):
        formulas = Formula(f"arm_scale * {offset}", f"{axis}_c", "m"), Formula(offset, f"{axis}_c/l")
        yield made(f"centre_of_mass_{words}", f"centre of mass, {words} of the rotors' middle", formulas)
    for words, letter, units in (("drag", "D", LINEAR_UNITS), ("quadratic drag", "C", QUADRATIC_UNITS)):
        for axis in "xyz":
            name = f"{words.replace(' ', '_')}_{axis}"
            yield made(name, f"{words} along {axis}", _by_mass(f"{letter}_{axis}", units, name))
    lift = _by_mass("H", QUADRATIC_UNITS, "translational_lift")
    yield made("translational_lift", "thrust per squared speed across it", lift)
    inertias = TILTING | {"yaw": routes[0].per_mass if routes else ""}
    no_inertia = "" if routes else "Izz is not identified."
    for axis, (turning, inertia) in zip("xyz", inertias.items(), strict=True):
        damping = f"{turning}_damping"
        formulas = (Formula(damping, f"B_{axis}/I{axis}{axis}", "1/s"),)
        if inertia:
            formulas = (*_by_mass(f"B_{axis}", TORQUE_UNITS, f"{inertia} * {damping}"), *formulas)
        refusal = "" if inertia else no_inertia
        yield made(f"{turning}_drag", f"torque against {turning}ing", formulas, refusal=refusal)
    per_command = Formula("rotor_reaction", "J/Izz", "(rad/s)/command")
    formulas = Formula("rotor_reaction / speed_scale", "J/Izz"), per_command
    if inertias["yaw"]:
        per_mass = f"1 / speed_scale * {inertias['yaw']} * rotor_reaction"
        formulas = (*_by_mass("J", INERTIA_UNITS, per_mass), *formulas)
    yield made("rotor_inertia", "inertia of a rotor", formulas, refusal=no_inertia)


def _yaw_inertia(routes: Routes, unexcited: str) -> PhysicalParameter:
    name, words = "inertia_zz", "inertia in yaw"
    if not routes:
        left = Formula("thrust_gain / yaw_gain", "Izz/(m kappa)", "1/m")
        helps = ("torque_ratio", "yaw_inertia_ratio")
        return PhysicalParameter(name, words, (left,), refusal=unexcited, helps=helps)
    route = routes[0]
    ratio = (Formula(f"roll_gain * {route.over_thrust}", "Izz/Ixx"),) if route.over_thrust else ()
    formulas = (*_by_mass("Izz", INERTIA_UNITS, route.per_mass), *ratio)
    return PhysicalParameter(name, words, formulas, f"It rests on {route.words}.")


def _thrust(thrust_map: InputMap) -> Iterator[PhysicalParameter]:
    shares = {}
    if isinstance(thrust_map, Mixed):
        shares = {2.0: thrust_map.share, 1.0: 1.0 - thrust_map.share}
    elif isinstance(thrust_map, Power):
        shares = {thrust_map.exponent: 1.0}
    for power, share in shares.items():
        if share > 0.0:
            other = "thrust_constant", f"thrust per rotor speed to the power {power:g}"
            name, words = THRUST_WORDS.get(power, other)
            raised, per_command = "" if power == 1.0 else f"^{power:g}", f"{share!r} * thrust_gain"
            of_speed = f"{per_command} / pow(speed_scale, {power!r})"
            whole, left = _by_mass("k", (f"N/(rad/s){raised}", f"m/s^2/(rad/s){raised}"), of_speed)
            units = f"N/command{raised}", f"m/s^2/command{raised}"
            by_command, left_by_command = _by_mass("k", units, per_command)
            yield PhysicalParameter(name, words, (whole, by_command, left, left_by_command))


def _torque_ratio(routes: Routes, unexcited: str) -> PhysicalParameter:
    name, words = "torque_ratio", "reaction torque over thrust"
    route = next((item for item in routes if item.over_thrust), None)
    if route is None:
        left = Formula("yaw_gain / thrust_gain", "kappa m/Izz", "1/m")
        return PhysicalParameter(name, words, (left,), refusal=unexcited, helps=("yaw_inertia_ratio",))
    text = f"yaw_gain * {route.over_thrust}"
    formulas = Formula(f"arm_scale * {text}", "kappa", "m"), Formula(text, "kappa/l")
    return PhysicalParameter(name, words, formulas, f"It rests on {route.words}.")


# -- Physical --

#: A torque or force that goes with the motion is none that the air makes.
DRAGS = ("drag_x", "drag_y", "drag_z", "roll_drag", "pitch_drag", "yaw_drag")
#: Half-widths as shares: identified, and rough; those of what the air does.
WIDE, WIDE_AIR = (0.1, 0.25), (0.5, 1.0)
OF_THE_AIR = frozenset({*DRAGS, *(f"quadratic_drag_{axis}" for axis in "xyz"), "translational_lift"})


@dataclass(frozen=True, slots=True)
class PhysicalParameters:
    """Physical parameters of a vehicle, and contradictions to them."""

    numbers: Mapping[str, Implied]  # By name
    formulas: Mapping[str, Formula]  # Of each
    contradictions: tuple[str, ...]


def physical_parameters(combinations: Combinations, known: KnownVehicle) -> PhysicalParameters:
    """Physical parameters with intervals, each as far as the flight and what is supplied determine it."""
    combinations = combinations.finite()
    routes, unexcited = yaw_inertia(combinations, known)
    wanted = list(sought(routes, unexcited, input_map(known.thrust_map)))
    return PhysicalParameters(
        {item.name: _number(item, combinations, known) for item in wanted},
        {item.name: item.formulas[0] for item in wanted},
        tuple(contradictions(combinations, known, routes)),
    )


def _number(parameter: PhysicalParameter, combinations: Combinations, known: KnownVehicle) -> Implied:
    name, words, fullest, left = parameter.name, parameter.words, parameter.formulas[0], ""
    reason, missing = _why_not_identified(fullest, combinations), fullest.missing(known)
    open_ = (f for f in parameter.formulas if not (f.missing(known) or _why_not_identified(f, combinations)))
    formula = next(open_, None)
    if formula is not None:
        result = combinations.value(formula, known, largest_bend=LARGEST_BEND)
        (low, high), value, symbol, unit = result.interval, result.value, formula.symbol, formula.unit
        if formula is fullest and not parameter.refusal:
            identified, weak = WIDE_AIR if name in OF_THE_AIR else WIDE
            size = abs(value) if low * high > 0.0 else 0.0
            size = max(size, known.arm) if name.startswith("centre_of_mass") else size
            share = 0.5 * (high - low) / size if size else math.inf
            rough = Status.WEAK if share <= weak else Status.REFUSED
            bound = name in OF_THE_AIR and low <= 0.0 <= high  # as of the parameter that it follows from
            status, basis = Status.IDENTIFIED if bound or share <= identified else rough, [parameter.remark]
            if formula.supplied:
                basis.append(f"With {_listed(formula.supplied, ' and ')} as supplied.")
            if name in DRAGS and high < 0.0:
                basis.append(
                    "Below zero: a disturbance that goes with the motion, such as wind, not the air's drag."
                )
            numbers = value, result.std_error, result.interval
            return Implied(
                name, words, symbol, unit, *numbers, " ".join(filter(None, basis)), status, formula.needed
            )
        number = f"{symbol} = {value:.4g} ({low:.4g} to {high:.4g}) {unit}".rstrip()
        left = f"{number} is all that the flight gives"
    if parameter.refusal:
        helps = tuple(item for item in parameter.helps if getattr(known, item) is None)
        why = [parameter.refusal, f"{left}." if left else reason, _remedy(helps, " or ")]
    elif reason:
        why = [reason, f"{left}." if left else ""]
    else:
        why = [f"{left} without {_listed(missing, ' and ')}.", _remedy(missing, " and ")]
    return Implied(name, words, "", "", None, None, None, " ".join(filter(None, why)))


def _why_not_identified(formula: Formula, combinations: Combinations) -> str:
    """Reason why inputs of a formula are not identified; empty when they are."""
    absent = [name for name in formula.needed if not combinations.has(name)]
    if absent:
        return f"The flight identifies no {', no '.join(absent)}."
    for name in formula.needed:
        low, high = combinations.interval(name) if name.endswith("_gain") else (1.0, 1.0)
        if high < 0.0:
            return f"{name} is below zero: positions, order or spins of the rotors contradict the flight."
        if low <= 0.0:
            return f"The flight does not distinguish {name} from zero."
    return ""


def _remedy(names: tuple[str, ...], joint: str) -> str:
    return f"Supply {_listed(names, joint)}." if names else ""


def _listed(names: tuple[str, ...], joint: str) -> str:
    *others, last = (SUPPLIED[name] for name in names)
    return f"{', '.join(others)}{joint}{last}" if others else last
