"""Description of a simulated vehicle made from a result."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np

from eivor.errors import NotIdentifiedError, ParameterError, UsageError
from eivor.exports.fitted import VERTICAL, Exported, Fitted, Number, Supplied
from eivor.inference.covariance import CovariancePart, JointCovariance, JointEstimate
from eivor.inference.distributions import normal_quantile
from eivor.motions.rigid_body.physical_parameters import Combinations, physical_parameters
from eivor.motions.rigid_body.vehicle import NO_BODY_UNCERTAINTY, KnownNumber, KnownVehicle
from eivor.motions.vertical.model import GRAVITY
from eivor.signals.thrust_map import InputMap
from eivor.tools import Float

# -- Parts --

Column = Float[np.ndarray, " n"]
Columns = Mapping[str, Column]

WORDS = {
    "mass": "mass [kg]",
    "thrust": "thrust of a rotor per unit of mapped command [N]",
    "actuator_lag": "lag of the rotors [s]",
    "delay": "delay of the commands [s]",
    "drag_x": "drag along x [N/(m/s)]",
    "drag_y": "drag along y [N/(m/s)]",
    "drag_z": "drag along z [N/(m/s)]",
    "inertia_xx": "inertia in roll [kg m^2]",
    "inertia_yy": "inertia in pitch [kg m^2]",
    "inertia_zz": "inertia in yaw [kg m^2]",
    "torque_ratio": "reaction torque over thrust [m]",
    "arm_scale": "arms over the lengths in the vehicle's file",
    "largest_command": "largest command",
    "speed_scale": "rotor speed per unit of command [rad/s]",
}
INERTIAS = ("inertia_xx", "inertia_yy", "inertia_zz")
DRAGS = ("drag_x", "drag_y", "drag_z")


@dataclass(frozen=True)
class SimulatorNumber:
    """A number of the vehicle."""

    number: Number
    column: Callable[[Columns], Column]


def per_mass(mass: Number, number: Number, root: str, share: float = 1.0) -> SimulatorNumber:
    """Mass times what a flight identifies per mass; both err independently."""
    value = share * mass.value * number.value
    below, above = (
        share
        * math.hypot(
            number.value * (mass.interval[side] - mass.value),
            mass.value * (number.interval[side] - number.value),
        )
        for side in (0, 1)
    )
    product = Number(value, (value - below, value + above), f"{number.source}, times the mass as given")
    return SimulatorNumber(product, lambda columns: columns["mass"] * columns[root] * share)


# -- Physical quantities --

#: Simulators compare without allowance for rounding.
MARGIN = 1e-6


def realisable_inertia(values: Columns) -> tuple[Columns, tuple[str, ...]]:
    """Columns whose moments of inertia are those of bodies."""
    if not all(name in values for name in INERTIAS):
        return values, ()
    moments = np.stack([values[name] for name in INERTIAS])
    others = moments.sum(axis=0) - moments
    excess = (moments / others).max(axis=0) - 1.0
    bounded = np.minimum(moments, others * (1.0 - MARGIN))
    kept = {**values, **dict(zip(INERTIAS, bounded, strict=True))}
    if moments.shape[1] > 1 or excess[0] <= 0.0:
        return kept, ()
    text = ", ".join(f"{moment:.4g}" for moment in moments[:, 0])
    if excess[0] > NO_BODY_UNCERTAINTY:
        raise ParameterError(
            "moments of inertia none of which is larger than the other two together",
            f"{text} kg m^2",
            "Correct what is given of them; or fly as the report says, about two axes at once.",
        )
    return kept, (
        f"Moments of inertia {text} are those of no body: the largest is put at the sum of the others.",
    )


# -- Vehicle description --

#: Name in documents of the other motion that identifies a vehicle.
RIGID_BODY = "rigid_body"
#: What no vehicle flies without, beside mass and geometry.
BODY = ("thrust", "actuator_lag", *INERTIAS, "torque_ratio")
#: What the flight identifies of the vehicle's numbers at once, by its own name.
MADE_OF = {
    VERTICAL: {
        "thrust": "input_gain",
        "drag_z": "viscous_friction",
        "actuator_lag": "actuator_lag",
        "delay": "delay",
    },
    RIGID_BODY: {"thrust": "thrust_gain", "actuator_lag": "actuator_lag", "delay": "delay"},
}
#: What may be given with --prior beside these.
BESIDE = (*INERTIAS, "torque_ratio", "largest_command", "speed_scale")
MAY_BE_ZERO = ("viscous_friction", "actuator_lag", "delay", "torque_ratio")
#: Simulators divide by the lag, and fly off with a drag below zero.
LEAST = {"actuator_lag": 1e-3} | dict.fromkeys(DRAGS, 0.0)
#: What is given is drawn from a stream of its own, so that it leaves the flight's draws alone.
GIVEN_STREAM = 2
#: Least value of a draw of what is given, as a share of it.
LEAST_SHARE = 0.01


@dataclass(frozen=True)
class VehicleDescription:
    """A vehicle for a simulator."""

    vehicle: KnownVehicle
    thrust_map: InputMap
    values: Columns  # shape (n,)
    comments: tuple[str, ...]
    omitted: tuple[str, ...]


def describe(
    fitted: Fitted,
    supplied: Supplied,
    target: str,
    needs: tuple[str, ...],
    draws: Columns | None = None,
    seed: int = 0,
) -> VehicleDescription:
    """Vehicle of a result."""
    if fitted.model not in MADE_OF:
        raise UsageError(
            f"a result of the vertical motion or the rigid body for {target}",
            f"one of {fitted.model}",
            "Identify the log with --model vertical or rigid-body.",
        )
    supplied.check_only((*MADE_OF[fitted.model].values(), *BESIDE), target, body=True)
    _check_signs(supplied)
    vehicle = _vehicle(fitted, supplied, target)
    given = _given(fitted, supplied, vehicle)
    parts, missing = _parts(fitted, given, vehicle)
    selected = {
        **{name: SimulatorNumber(item, itemgetter(name)) for name, item in given.items() if name in WORDS},
        **parts,
    }
    lacking = [name for name in needs if name not in selected]
    if lacking:
        raise _lacks(lacking, missing, fitted, target)
    columns = _columns(fitted, given, selected, draws, seed)
    values, changed = realisable_inertia(
        {name: np.maximum(item.column(columns), LEAST.get(name, -np.inf)) for name, item in selected.items()}
    )
    gone = {name: f"{name} is not written: {why}" for name, why in missing.items() if name not in selected}
    numbers = (f"{words}: {selected[name].number.words}" for name, words in WORDS.items() if name in selected)
    comments = (*fitted.origin(), f"Vehicle: {vehicle.name}.", *numbers, *changed, *gone.values())
    return VehicleDescription(vehicle, fitted.input_map, values, comments, tuple(gone.values()))


def _check_signs(supplied: Supplied) -> None:
    for name, prior in supplied.priors.items():
        if prior.value < 0.0 or (prior.value == 0.0 and name not in MAY_BE_ZERO):
            raise UsageError(f"a {name} above zero", f"{prior.value:g}", "Correct the prior.")


def _vehicle(fitted: Fitted, supplied: Supplied, target: str) -> KnownVehicle:
    vehicle = supplied.vehicle or fitted.vehicle
    mass = supplied.mass is not None or (vehicle is not None and vehicle.mass is not None)
    if vehicle is not None and mass and vehicle.in_metres:
        return vehicle
    lacks = [] if mass else ["a mass (--mass 1.53:0.02)"]
    lacks += [] if vehicle is not None else ["where the rotors are (--vehicle FILE.toml)"]
    lacks += [] if vehicle is None or vehicle.in_metres else ["the arm's length (in the vehicle's file)"]
    raise NotIdentifiedError(
        f"for {target}, what a flight does not identify: {' and '.join(lacks)}",
        "none" if vehicle is None else f"the vehicle '{vehicle.name}'",
        "Give it; `eivor vehicle new` writes a vehicle's file to begin with.",
    )


def _given(fitted: Fitted, supplied: Supplied, vehicle: KnownVehicle) -> dict[str, Number]:
    """What is supplied and the flight does not identify, the priors before the vehicle's file."""
    known = {
        name: item
        for name in ("mass", "arm_scale", "speed_scale", "torque_ratio", "yaw_inertia_ratio")
        if (item := getattr(vehicle, name)) is not None
    }
    known.setdefault("speed_scale", KnownNumber(1.0))
    if _hovers_with_a_share(fitted, vehicle):
        known["largest_command"] = KnownNumber(1.0)
    known |= {
        name: prior for name, prior in supplied.priors.items() if fitted.identified_number(name) is None
    }
    if supplied.mass is not None:
        known["mass"] = supplied.mass
    return {name: Number(entry.value, entry.interval, "given") for name, entry in known.items()}


def _hovers_with_a_share(fitted: Fitted, vehicle: KnownVehicle) -> bool:
    """Whether commands are shares of the largest, as autopilots have them."""
    gain = fitted.identified_number(MADE_OF[fitted.model]["thrust"])
    if gain is None or fitted.input_measured:
        return False
    rotors = 1 if fitted.model == VERTICAL else vehicle.count
    return fitted.input_map.inverse(GRAVITY / (rotors * gain.value)) < 1.0


def _lacks(
    lacking: Iterable[str], missing: Mapping[str, str], fitted: Fitted, target: str
) -> NotIdentifiedError:
    reasons = " ".join(missing.get(name, f"No flight of this kind determines {name}.") for name in lacking)
    formulas = {"thrust": MADE_OF[fitted.model]["thrust"]}
    priors = " ".join(f"--prior {formulas.get(name, name)}=VALUE:STD" for name in lacking)
    words = ", ".join(WORDS[name] for name in lacking)
    return NotIdentifiedError(
        f"{words}: identified, or given, since {target} cannot do without",
        reasons.rstrip("."),
        f"Give what is known: {priors}",
    )


def _columns(
    fitted: Fitted,
    given: dict[str, Number],
    parts: dict[str, SimulatorNumber],
    draws: Columns | None,
    seed: int,
) -> dict[str, Column]:
    if draws is None:
        joint = {name: quantity.value for name, quantity in fitted.quantities.items()}
        given_values = {name: item.value for name, item in given.items()}
        return {name: np.array([value]) for name, value in (joint | given_values).items()}
    count = next(iter(draws.values())).size
    rng = np.random.default_rng([seed, GIVEN_STREAM])
    columns = {name: np.full(count, part.number.value) for name, part in parts.items()}
    for name, entry in given.items():
        drawn = entry.value + _std(entry) * rng.standard_normal(count)
        columns[name] = np.maximum(drawn, LEAST_SHARE * entry.value)
    return columns | {name: column for name, column in draws.items() if fitted.identified_number(name)}


def _std(number: Number) -> float:
    return (number.interval[1] - number.interval[0]) / (2.0 * normal_quantile(0.95))


# -- Parts of a vehicle --

PHYSICAL = (*INERTIAS, *DRAGS, "torque_ratio")
LEVEL = 0.95


def _parts(
    fitted: Fitted, given: dict[str, Number], vehicle: KnownVehicle
) -> tuple[dict[str, SimulatorNumber], dict[str, str]]:
    """What a flight identifies of a vehicle, and why it does not identify the rest."""
    parts: dict[str, SimulatorNumber] = {}
    missing: dict[str, str] = {}
    if fitted.model == RIGID_BODY:
        known = replace(vehicle, mass=KnownNumber(given["mass"].value, _std(given["mass"])))
        identified = _identified(fitted)
        rows = physical_parameters(identified, known, LEVEL)
        for name in PHYSICAL:
            row = rows[name]
            if row.estimate is not None and row.estimate.value > 0.0:
                number = Number(row.estimate.value, row.estimate.interval, f"identified. {row.sentence}")
                parts[name] = SimulatorNumber(number, row.formula.expression.evaluate)
            else:
                lacking = (item for item in row.formula.needed if not fitted.is_identified(item))
                missing[name] = " ".join(map(fitted.why_not, lacking)) or row.sentence
    for name, root in MADE_OF[fitted.model].items():
        root_number = fitted.identified_number(root) or given.get(root)
        if root_number is None:
            missing[name] = fitted.why_not(root)
        elif name in {"thrust", "drag_z"}:
            share = 1.0 / vehicle.count if root == "input_gain" else 1.0
            parts[name] = per_mass(given["mass"], root_number, root, share)
        else:
            parts[name] = SimulatorNumber(root_number, itemgetter(root))
    return parts, missing


def _identified(fitted: Fitted) -> Combinations:
    if fitted.joint is None:
        nothing = JointCovariance((CovariancePart("nothing", np.empty((0, 0))),))
        return Combinations((), JointEstimate(np.empty(0), nothing))
    names = frozenset(name for name in fitted.names if fitted.is_identified(name))
    return Combinations(fitted.names, fitted.joint).only(names)


# -- Quad x --

#: Signs of the places forward and left: front right, rear right, rear left, front left.
QUARTERS = ((1, -1), (-1, -1), (-1, 1), (1, 1))


def by_quarters(vehicle: KnownVehicle, target: str) -> tuple[int, ...]:
    """Numbers of the rotors, from zero, in the order of `QUARTERS`."""
    order = [
        number
        for item, left in QUARTERS
        for number, (x, y) in enumerate(vehicle.positions)
        if x * item > 0.0 and y * left > 0.0
    ]
    spins = [vehicle.spins[number] for number in order]
    if vehicle.count != len(QUARTERS) or spins not in ([1, -1, 1, -1], [-1, 1, -1, 1]):
        raise UsageError(
            f"four rotors for {target}, one in each quarter, neighbours of opposite spins",
            f"rotors at {vehicle.positions} with spins {vehicle.spins}",
            "Export to another simulator: mujoco, rotorpy and gazebo take rotors anywhere.",
        )
    return tuple(order)


def mean_distances(vehicle: KnownVehicle) -> tuple[float, float]:
    """Mean distance of the rotors forward or behind, and to a side [m]."""
    forward, sideways = np.abs(vehicle.positions).mean(axis=0).tolist()
    return forward, sideways


# -- Randomisation --

#: What stands above draws.
JOINT = (
    "Rows are joint draws: a thrust goes with the mass of its row, so that the hover command spreads as "
    "little as the flight identifies it. Numbers drawn each by itself would lose that."
)


@dataclass(frozen=True, slots=True)
class Randomisation:
    """A file of draws for those who train or test on many vehicles."""

    name: str  # Its word on the command line
    words: str  # What the file is
    export: Callable[[Fitted, Supplied, Columns, int], Exported]


# -- Rotors --


def mapped_hover(made: VehicleDescription) -> Column:
    """Mapped command at hover."""
    return made.values["mass"] * GRAVITY / (made.vehicle.count * made.values["thrust"])


def rotors_of(made: VehicleDescription, gravity: float = GRAVITY) -> dict[str, Column]:
    """Numbers of a rotor, a row for each vehicle, in N, N m and rad/s; drags are over a rotor's speed."""
    values, count = made.values, made.vehicle.count
    scale, thrust, zero = values["speed_scale"], values["thrust"], np.zeros_like(values["mass"])
    hover = scale * np.sqrt(mapped_hover(made))
    constant = thrust / scale**2 * (gravity / GRAVITY)
    largest = made.thrust_map(values.get("largest_command", zero + np.inf))
    across = [values[name] for name in ("drag_x", "drag_y") if name in values]
    return {
        "thrust_constant": constant,
        "torque_constant": values["torque_ratio"] * constant,
        "hover_speed": hover,
        "largest_speed": scale * np.sqrt(largest),
        "drag_along": values.get("drag_z", zero) / (count * hover),
        "drag_across": (np.mean(across, axis=0) if across else zero) / (count * hover),
    }


def speed_comments(made: VehicleDescription, simulator: str, gravity: float = GRAVITY) -> tuple[str, ...]:
    """What a rotor's speed, gravity and delays are in a simulator, as sentences."""
    sentence = []
    if made.thrust_map.name == "square":
        sentence.append("Rotor speeds are the commands times the rotor speed per unit of command.")
    else:
        sentence.append(
            "Rotor speeds are the rotor speed per unit of command times the square root of the mapped "
            "command: exact at rest, with the identified lag about hover."
        )
    if gravity != GRAVITY:
        sentence.append(
            f"{simulator} takes gravity for {gravity:g} m/s^2: thrust is times {gravity / GRAVITY:.6g}, "
            "so that the vehicle hovers with the same command."
        )
    return (*sentence, *delay_comments(made, simulator))


def delay_comments(made: VehicleDescription, simulator: str) -> tuple[str, ...]:
    """A sentence where there is a delay: none of the simulators has one."""
    delay = float(np.mean(made.values["delay"])) if "delay" in made.values else 0.0
    return (f"{simulator} has no delay: hold its commands back by {delay:.4g} s.",) if delay > 0.0 else ()
